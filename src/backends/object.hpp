// What every object has that a backend hands out.
#pragma once
#include "exec/interrupt.hpp"

namespace globule::core {

struct Object {
    virtual ~Object() = default;
    Object() = default;
    Object(const Object&) = delete;
    Object& operator=(const Object&) = delete;

    /// An entry begins: earlier requests to stop are forgotten, what other objects left to do is done.
    virtual void begin() {}
    /// An entry was interrupted or failed: what it was making counts as not there, so that it is made again.
    virtual void invalidate() noexcept {}
    /// For objects whose entries are short and cannot be made again from what the caller has: nothing stops them half
    /// way.
    virtual Interrupt* whole() noexcept { return nullptr; }
    /// From any thread: the entry that is running, if any, is to stop.
    virtual void cancel() noexcept {}
    /// The GPU's number, or kHost.
    virtual int device() const noexcept = 0;
};

}  // namespace globule::core
