// A packet of lanes for the CPU: the same kernel that a GPU thread runs on one float runs here on
// W of them, as one SIMD register (GCC/Clang vector extensions; W is the register's width).
#pragma once
#include <cmath>
#include <cstring>

#if defined(__SSE2__)
#include <immintrin.h>
#endif

#include "globule/base/fn.hpp"

#if defined(__AVX512F__)
#define GB_WIDTH 16
#elif defined(__AVX2__)
#define GB_WIDTH 8
#else
#define GB_WIDTH 4
#endif

namespace globule {

/// Registers of N lanes, spelt out because GCC drops the attribute where its size is a template's parameter.
template <int N>
struct Vectors;
template <>
struct Vectors<4> {
    typedef float F __attribute__((vector_size(16)));
    typedef std::int32_t I __attribute__((vector_size(16)));
};
template <>
struct Vectors<8> {
    typedef float F __attribute__((vector_size(32)));
    typedef std::int32_t I __attribute__((vector_size(32)));
};
template <>
struct Vectors<16> {
    typedef float F __attribute__((vector_size(64)));
    typedef std::int32_t I __attribute__((vector_size(64)));
};

/// Lane mask: every lane 0 or -1.
template <int N>
struct WideMask {
    using Vec = typename Vectors<N>::I;
    Vec v;
    GB_FN friend WideMask operator&(WideMask a, WideMask b) { return {a.v & b.v}; }
    GB_FN friend WideMask operator|(WideMask a, WideMask b) { return {a.v | b.v}; }
    GB_FN friend WideMask operator!(WideMask a) { return {~a.v}; }
    /// One bit a lane.
    GB_FN friend unsigned bits(WideMask m) {
#if defined(__AVX512F__)
        if constexpr (N == 16) return _mm512_test_epi32_mask((__m512i)m.v, (__m512i)m.v);
#endif
#if defined(__AVX2__)
        if constexpr (N == 8) return unsigned(_mm256_movemask_ps((__m256)m.v));
#endif
#if defined(__SSE2__)
        if constexpr (N == 4) return unsigned(_mm_movemask_ps((__m128)m.v));
#endif
        unsigned set = 0;
        for (int i = 0; i < N; ++i) set |= unsigned(m.v[i] & 1) << i;
        return set;
    }
    GB_FN friend bool any(WideMask m) { return bits(m) != 0; }
};

template <int N>
struct Wide {
    using Vec = typename Vectors<N>::F;
    using Mask = WideMask<N>;
    Vec v;
    Wide() = default;
    GB_FN Wide(float s) : v(s - Vec{}) {}  // s + 0 would not be the same for -0, and so be computed
    GB_FN Wide(Vec x) : v(x) {}

    GB_FN friend Wide operator+(Wide a, Wide b) { return a.v + b.v; }
    GB_FN friend Wide operator-(Wide a, Wide b) { return a.v - b.v; }
    GB_FN friend Wide operator*(Wide a, Wide b) { return a.v * b.v; }
    GB_FN friend Wide operator/(Wide a, Wide b) { return a.v / b.v; }
    GB_FN friend Wide operator-(Wide a) { return -a.v; }
    GB_FN friend Wide& operator+=(Wide& a, Wide b) { a.v += b.v; return a; }
    GB_FN friend Wide& operator-=(Wide& a, Wide b) { a.v -= b.v; return a; }
    GB_FN friend Wide& operator*=(Wide& a, Wide b) { a.v *= b.v; return a; }
    GB_FN friend Mask operator<(Wide a, Wide b) { return {a.v < b.v}; }
    GB_FN friend Mask operator>(Wide a, Wide b) { return {a.v > b.v}; }
    GB_FN friend Mask operator<=(Wide a, Wide b) { return {a.v <= b.v}; }
    GB_FN friend Mask operator>=(Wide a, Wide b) { return {a.v >= b.v}; }
    GB_FN friend Wide select(Mask m, Wide a, Wide b) { return m.v ? a.v : b.v; }
    GB_FN friend Wide least(Wide a, Wide b) { return a.v < b.v ? a.v : b.v; }
    GB_FN friend Wide most(Wide a, Wide b) { return a.v > b.v ? a.v : b.v; }
    GB_FN friend Wide magnitude(Wide a) {
        const typename Mask::Vec bits = (typename Mask::Vec)a.v & 0x7fffffff;
        return (Vec)bits;
    }
    GB_FN friend Wide root(Wide a) {
        Wide r;
        for (int i = 0; i < N; ++i) r.v[i] = __builtin_sqrtf(a.v[i]);
        return r;
    }
    GB_FN friend Wide exp_negative(Wide a) {
        Wide r;
        for (int i = 0; i < N; ++i) r.v[i] = expf(a.v[i]);
        return r;
    }
};

inline constexpr int kWidth = GB_WIDTH;
using WideF = Wide<kWidth>;
using WideB = WideMask<kWidth>;
using VecF = WideF::Vec;
using VecI = WideB::Vec;

}  // namespace globule
