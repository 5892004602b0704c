// How a method of a backend's object is called from another library: the one entry that each backend has, run(), sets
// the device, catches all, and gives the caller's device back.
#pragma once
#include <new>
#include <optional>

#include "backends/object.hpp"
#include "backends/status.hpp"
#include "base/device.hpp"
#include "exec/interrupt.hpp"

namespace globule::core {

/// Runs body and says how it ended.
template <class Body> Status caught(const Body& body) noexcept {
    try {
        try {
            body();
            return {};
        } catch (const Cancelled&) { return {Code::cancelled, "interrupted"}; } catch (const Refused& e) {
            return {Code::refused, e.what()};
        } catch (const Stale& e) { return {Code::stale, e.what()}; } catch (const std::bad_alloc&) {
            return {Code::memory, "out of memory"};
        } catch (const DeviceFailure& e) { return {Code::device, e.what()}; } catch (const std::exception& e) {
            return {Code::failed, e.what()};
        }
    } catch (...) {
        return {Code::failed, {}};  // not even a message could be made
    }
}

/// Calls function(context), which calls a method of the object.
template <class DeviceScope> Status run(Object& object, void (*function)(void* context), void* context) noexcept {
    bool begun = false;
    const Status status = caught([&] {
        const DeviceScope scope(object.device());
        Interrupt* const whole = object.whole();
        const std::optional<Interrupt::Hold> hold =
            whole ? std::optional<Interrupt::Hold>(std::in_place, *whole) : std::nullopt;
        object.begin();
        begun = true;
        function(context);
    });
    if (begun && status.code != Code::ok && status.code != Code::refused && status.code != Code::stale)
        object.invalidate();
    return status;
}

}  // namespace globule::core
