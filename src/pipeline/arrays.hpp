// The caller's arrays, where this backend can read them.
#pragma once
#include "base/device.hpp"
#include "exec/buffer.hpp"

namespace globule::core {

/// The array itself where it lies in this backend's memory, else a copy in `room`; work given to `exec` from now on
/// finds there what the caller gave to its stream before the call.
template <class Exec, class T>
const T* bring(Exec& exec, Buffer<T, Exec>& room, const ArrayAt<const T>& array, std::size_t n) {
    if (!array.data || n == 0) return array.data;
    if (array.device == exec.device()) {
        exec.wait_for_caller(array.stream);
        return array.data;
    }
    T* to = room.reserve(n);
    if (array.device == kHost) exec.upload(to, array.data, n * sizeof(T));
    else exec.copy_peer(to, array.data, {array.data, array.device, array.stream}, n * sizeof(T));
    return to;
}

/// The caller's streams go on when what was given to `exec` has read these arrays.
template <class Exec, class... T> void let_callers_go_on(Exec& exec, const ArrayAt<T>&... arrays) {
    const auto one = [&](const auto& array) {
        if (array.data && array.device == exec.device()) exec.let_caller_wait(array.stream);
    };
    (one(arrays), ...);
}

}  // namespace globule::core
