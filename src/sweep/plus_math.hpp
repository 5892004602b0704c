// The arithmetic of the PLUS toolkit (IGSIO), bit for bit: 14-bit fixed point, and rounding of
// doubles to 16 fractional bits.  Compile without contraction into fused multiply-add.
#pragma once
#include <cstring>

#include "base/scalar.hpp"

namespace globule::core::plus {

inline constexpr int kPoint = 14;

/// Rounded to a multiple of 2^-16 first, as PLUS does: a value just below an integer counts as it.
GB_FN int floor_of(double x) { return int(static_cast<long long>(x + 103079215104.0) - 103079215104LL); }
GB_FN int round_of(double x) { return int(static_cast<long long>(x + 103079215104.5) - 103079215104LL); }

/// Products that exceed 32 bits wrap, in PLUS as here.
GB_FN std::int32_t wrap_multiply(std::int32_t a, std::int32_t b) {
    return std::int32_t(std::uint32_t(a) * std::uint32_t(b));
}
GB_FN std::int32_t wrap_add(std::int32_t a, std::int32_t b) {
    return std::int32_t(std::uint32_t(a) + std::uint32_t(b));
}

/// A number with 14 fractional bits.
struct Fixed {
    std::int32_t i;

    GB_FN static Fixed raw(std::int32_t i) { return {i}; }
    GB_FN static Fixed of_int(std::int32_t v) { return {std::int32_t(std::uint32_t(v) << kPoint)}; }
    /// Nearest, ties to even, by adding 1.5 * 2^38; the low word of the sum is the number.
    GB_FN static Fixed of(double x) {
        const double sum = x + 412316860416.0;
        std::uint64_t bits;
        memcpy(&bits, &sum, sizeof bits);
        return {std::int32_t(std::uint32_t(bits))};
    }
    GB_FN double value() const { return i * (1.0 / (1 << kPoint)); }
    GB_FN float single() const { return float(value()); }
};

GB_FN Fixed operator+(Fixed a, Fixed b) { return Fixed::raw(wrap_add(a.i, b.i)); }
GB_FN Fixed operator-(Fixed a, Fixed b) { return Fixed::raw(wrap_add(a.i, -b.i)); }
GB_FN Fixed operator*(Fixed a, Fixed b) {
    return Fixed::raw(wrap_add(wrap_multiply(a.i, b.i), 1 << (kPoint - 1)) >> kPoint);
}
GB_FN Fixed operator*(int a, Fixed b) { return Fixed::raw(wrap_multiply(a, b.i)); }
GB_FN Fixed operator/(Fixed a, Fixed b) { return Fixed::of(double(a.i) / b.i); }
GB_FN int floor_of(Fixed x) { return x.i >> kPoint; }
GB_FN int round_of(Fixed x) { return wrap_add(x.i, 1 << (kPoint - 1)) >> kPoint; }
GB_FN bool is_zero(Fixed x) { return x.i == 0; }
GB_FN bool is_zero(double x) { return x == 0; }

/// What both arithmetics must be able to do: Fixed (optimisation FULL) and double (PARTIAL, NONE).
template <class F> struct Number;
template <> struct Number<Fixed> {
    GB_FN static Fixed of(double x) { return Fixed::of(x); }
    GB_FN static Fixed of_int(int v) { return Fixed::of_int(v); }
    GB_FN static bool at_least_eighth(Fixed x) { return x.i >= (1 << kPoint) / 8; }
};
template <> struct Number<double> {
    GB_FN static double of(double x) { return x; }
    GB_FN static double of_int(int v) { return v; }
    GB_FN static bool at_least_eighth(double x) { return x >= 0.125; }
};

}  // namespace globule::core::plus
