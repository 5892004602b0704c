// What every binding takes and how it calls the library: arrays of NumPy as views, or addresses, which Python has
// checked.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <bit>
#include <cstdint>
#include <optional>
#include <tuple>

#include "api/impl.hpp"
#include "globule/array.hpp"

namespace nanobind::detail {

/// A contiguous array in host memory as a view, which nothing copies; None where .none() allows it: no array.
template <class View, class... Access> struct view_caster {
    NB_TYPE_CASTER(View, const_name("numpy.ndarray"))
    ndarray<Access..., c_contig, device::cpu> kept;

    bool from_python(handle src, std::uint32_t flags, cleanup_list* cleanup) noexcept {
        using enum globule::DType;
        if (src.is_none()) return true;
        make_caster<decltype(kept)> array;
        if (!array.from_python(src, flags & ~std::uint32_t(cast_flags::convert), cleanup)) return false;
        kept = std::move(array.value);
        constexpr globule::DType types[3][4] = {
            {uint8, uint16, int32, int64}, {uint8, uint16, uint32, uint64}, {uint8, uint16, float32, float64}};
        const auto [code, bits, lanes] = kept.dtype();
        const std::size_t n = kept.ndim();
        if (code > 2 || bits > 64 || n < 1 || n > 4 || (code != 1 && bits < 32)) return false;
        const auto size = [&](std::size_t k) { return k < n ? kept.shape(k) : 1; };
        const globule::Shape shapes[] = {
            {size(0)}, {size(0), size(1)}, {size(0), size(1), size(2)}, {size(0), size(1), size(2), size(3)}};
        value = View(kept.data(), types[code][std::countr_zero(bits) - 3], shapes[n - 1]);
        return true;
    }
};
template <> struct type_caster<globule::ArrayView> : view_caster<globule::ArrayView, ro> {};
template <> struct type_caster<globule::MutableArrayView> : view_caster<globule::MutableArrayView> {};

}  // namespace nanobind::detail

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
                     : e.code() == ErrorCode::diverged  ? PyExc_ArithmeticError
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

/// A method of a public class that takes and gives plain values.
template <auto Method, class... A> struct Plain;
template <class O, class R, class... P, R (O::*Method)(P...)> struct Plain<Method> {
    static auto call(O& o, const std::remove_cvref_t<P>&... arguments) {
        return work([&] { return (o.*Method)(arguments...); });
    }
};
template <class O, class R, class... P, R (O::*Method)(P...) const> struct Plain<Method> {
    static auto call(O& o, const std::remove_cvref_t<P>&... arguments) {
        return work([&] { return (o.*Method)(arguments...); });
    }
};
template <auto Method> inline constexpr auto plain = &Plain<Method>::call;

/// A list as a NumPy array that owns it.
template <class T> nb::object owned(std::vector<T>&& values) {
    auto* kept = new std::vector<T>(std::move(values));
    nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    return nb::cast(nb::ndarray<nb::numpy, T>(kept->data(), {kept->size()}, owner));
}

/// Calls an entry of a handle without the GIL.
template <auto Method, class O, class... A> auto call(const Handle<O>& object, const A&... arguments) {
    return work([&] { return object.template call<Method>(arguments...); });
}

}  // namespace globule::core
