// Entries: how a method of a backend's object is called from another library.  The function that an entry points to
// lies in the backend, sets its device, catches all, and gives the caller's device back.
#pragma once
#include <new>
#include <optional>
#include <tuple>
#include <type_traits>
#include <utility>

#include "backends/object.hpp"
#include "backends/status.hpp"
#include "base/device.hpp"
#include "exec/interrupt.hpp"

namespace globule::core {

/// What an entry of this method looks like: the object, room for the result, the arguments.
template <class Method>
struct Signature;
template <class O, class R, class... A>
struct Signature<R (O::*)(A...)> {
    using Class = O;
    using Result = std::conditional_t<std::is_void_v<R>, std::nullptr_t, R>;
    using Function = Status (*)(O&, Result*, A...) noexcept;
};

/// Entries of a list of methods; one that is not listed cannot be called.
template <auto... Methods>
struct EntryTable {
    std::tuple<typename Signature<decltype(Methods)>::Function...> functions;

    template <auto Method>
    auto get() const {
        constexpr std::size_t at = place<Method>();
        static_assert(at < sizeof...(Methods), "no entry of this method: list it in backends/backend.hpp");
        return std::get<at>(functions);
    }

private:
    template <auto Method>
    static constexpr std::size_t place() {
        std::size_t at = 0;
        bool found = false;
        ((found = found || same<Method, Methods>(), at += !found), ...);
        return at;
    }
    template <auto A, auto B>
    static constexpr bool same() {
        if constexpr (std::is_same_v<decltype(A), decltype(B)>) return A == B;
        else return false;
    }
};

// ---- in the backends only ----

/// Runs body and says how it ended.
template <class Body>
Status caught(const Body& body) noexcept {
    try {
        try {
            body();
            return {};
        } catch (const Cancelled&) {
            return {Code::cancelled, "interrupted"};
        } catch (const Refused& e) {
            return {Code::refused, e.what()};
        } catch (const Stale& e) {
            return {Code::stale, e.what()};
        } catch (const std::bad_alloc&) {
            return {Code::memory, "out of memory"};
        } catch (const DeviceFailure& e) {
            return {Code::device, e.what()};
        } catch (const std::exception& e) {
            return {Code::failed, e.what()};
        }
    } catch (...) {
        return {Code::failed, {}};  // not even a message could be made
    }
}

template <class DeviceScope, auto Method>
struct Entry;
template <class DeviceScope, class O, class R, class... A, R (O::*Method)(A...)>
struct Entry<DeviceScope, Method> {
    static Status call(O& object, typename Signature<R (O::*)(A...)>::Result* result, A... arguments) noexcept {
        bool begun = false;
        const Status status = caught([&] {
            const DeviceScope scope(object.device());
            Interrupt* const whole = object.whole();
            const std::optional<Interrupt::Hold> hold = whole ? std::optional<Interrupt::Hold>(std::in_place, *whole) : std::nullopt;
            object.begin();
            begun = true;
            if constexpr (std::is_void_v<R>) (object.*Method)(std::forward<A>(arguments)...);
            else *result = (object.*Method)(std::forward<A>(arguments)...);
        });
        if (begun && status.code != Code::ok && status.code != Code::refused && status.code != Code::stale) object.invalidate();
        return status;
    }
};

template <class DeviceScope, auto... Methods>
constexpr void fill_entries(EntryTable<Methods...>& table) {
    table.functions = {&Entry<DeviceScope, Methods>::call...};
}

}  // namespace globule::core
