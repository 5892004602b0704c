// What every binding takes and how it calls the core: addresses in, addresses out.  Python has checked every array
// before it comes here.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>

#include <atomic>
#include <cstdint>
#include <optional>
#include <tuple>

#include "api/guard.hpp"

namespace globule::core {

namespace nb = nanobind;

using Address = std::uintptr_t;
template <class T> T* at(Address a) { return reinterpret_cast<T*>(a); }

/// (address, device, stream) as in base/device.hpp; address 0 stands for an absent array.
using Array = std::tuple<Address, int, std::uintptr_t>;
template <class T = const float> ArrayAt<T> array(const Array& a) {
    return {at<T>(std::get<0>(a)), std::get<1>(a), std::get<2>(a)};
}

template <class T> T item(const nb::dict& d, const char* name) { return nb::cast<T>(d[name]); }

/// For tests: every poll asks and is counted, and one acts as Ctrl-C does (stop_at_poll in _core.pyi).
struct Counted {
    std::atomic<bool> on{false};
    std::atomic<std::uint64_t> n{0}, last{0};  ///< polls so far; the one that acts, 0 for none
};
inline Counted counted;

/// Ctrl-C during long work: true once Python has a pending signal's exception.
inline bool stop_asked() {
    if (counted.on) {
        if (++counted.n != counted.last) return false;  // and Python is not touched
        PyErr_SetInterrupt();
    }
    nb::gil_scoped_acquire gil;
    return PyErr_CheckSignals() != 0;
}
inline Poll poll_signals{stop_asked};

inline void stop_at_poll(std::optional<std::uint64_t> poll) {
    counted.n = 0;
    counted.last = poll.value_or(0);
    counted.on = poll.has_value();
    poll_signals.pause_ms = poll ? 0 : Poll::kPause;
}

/// As the Python exception of its kind.
[[noreturn]] inline void raise(const Error& e) {
    if (e.code() == ErrorCode::cancelled && PyErr_Occurred()) throw nb::python_error();
    PyObject* kind = e.code() == ErrorCode::invalid     ? PyExc_ValueError
                     : e.code() == ErrorCode::memory    ? PyExc_MemoryError
                     : e.code() == ErrorCode::cancelled ? PyExc_KeyboardInterrupt
                                                        : PyExc_RuntimeError;
    PyErr_SetString(kind, e.what());
    throw nb::python_error();
}

/// Runs without the GIL.
template <class Fn> decltype(auto) work(const Fn& fn) {
    try {
        nb::gil_scoped_release release;
        return fn();
    } catch (const Error& e) { raise(e); }
}

/// Calls an entry of a handle without the GIL.
template <auto Method, class O, class... A> auto call(const Handle<O>& object, const A&... arguments) {
    return work([&] { return object.template call<Method>(arguments...); });
}

}  // namespace globule::core
