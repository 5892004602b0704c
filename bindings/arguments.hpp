// What every binding takes and how it calls the core: addresses in, addresses out.  Python has checked every array
// before it comes here.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>

#include <cstdint>
#include <tuple>

#include "backends/backend.hpp"

namespace globule::core {

using Address = std::uintptr_t;
template <class T>
T* at(Address a) { return reinterpret_cast<T*>(a); }

/// (address, is it device memory); address 0 stands for an absent array.
using Array = std::tuple<Address, bool>;

template <class T>
T item(const nanobind::dict& d, const char* name) { return nanobind::cast<T>(d[name]); }

/// Ctrl-C during long work: true once Python has a pending signal's exception.
inline bool poll_signals() {
    nanobind::gil_scoped_acquire gil;
    return PyErr_CheckSignals() != 0;
}

/// Runs without the GIL; a cancelled call leaves Python's own exception set.
template <class Fn>
decltype(auto) work(const Fn& fn) {
    try {
        nanobind::gil_scoped_release release;
        return fn();
    } catch (const Cancelled&) {
        throw nanobind::python_error();
    }
}

}  // namespace globule::core
