// A packet of lanes for the CPU: the same kernel that a GPU thread runs on one float runs here on
// W of them, as one SIMD register (GCC/Clang vector extensions; W is the register's width).
#pragma once
#include <cmath>
#include <cstring>

#if defined(__SSE2__)
#include <immintrin.h>
#endif

#include "base/fn.hpp"

#if defined(__AVX512F__)
#define GB_WIDTH 16
#elif defined(__AVX2__)
#define GB_WIDTH 8
#else
#define GB_WIDTH 4
#endif

namespace globule::core {

inline constexpr int kWidth = GB_WIDTH;
typedef float VecF __attribute__((vector_size(4 * GB_WIDTH)));
typedef std::int32_t VecI __attribute__((vector_size(4 * GB_WIDTH)));

/// Lane mask: every lane 0 or -1.
struct WideB { VecI v; };
struct WideF {
    VecF v;
    WideF() = default;
    GB_FN WideF(float s) : v(s - VecF{}) {}  // s + 0 is not s for -0, and so would be computed
    GB_FN WideF(VecF x) : v(x) {}
};

GB_FN WideF operator+(WideF a, WideF b) { return a.v + b.v; }
GB_FN WideF operator-(WideF a, WideF b) { return a.v - b.v; }
GB_FN WideF operator*(WideF a, WideF b) { return a.v * b.v; }
GB_FN WideF operator/(WideF a, WideF b) { return a.v / b.v; }
GB_FN WideF operator-(WideF a) { return -a.v; }
GB_FN WideF& operator+=(WideF& a, WideF b) {
    a.v += b.v;
    return a;
}
GB_FN WideF& operator-=(WideF& a, WideF b) {
    a.v -= b.v;
    return a;
}
GB_FN WideF& operator*=(WideF& a, WideF b) {
    a.v *= b.v;
    return a;
}
GB_FN WideB operator<(WideF a, WideF b) { return {a.v < b.v}; }
GB_FN WideB operator>(WideF a, WideF b) { return {a.v > b.v}; }
GB_FN WideB operator<=(WideF a, WideF b) { return {a.v <= b.v}; }
GB_FN WideB operator>=(WideF a, WideF b) { return {a.v >= b.v}; }
GB_FN WideB operator&(WideB a, WideB b) { return {a.v & b.v}; }
GB_FN WideB operator|(WideB a, WideB b) { return {a.v | b.v}; }
GB_FN WideB operator!(WideB a) { return {~a.v}; }

/// One bit a lane.
GB_FN unsigned bits(WideB m) {
#if defined(__AVX512F__)
    return _mm512_test_epi32_mask((__m512i)m.v, (__m512i)m.v);
#elif defined(__AVX2__)
    return unsigned(_mm256_movemask_ps((__m256)m.v));
#elif defined(__SSE2__)
    return unsigned(_mm_movemask_ps((__m128)m.v));
#else
    unsigned set = 0;
    for (int i = 0; i < GB_WIDTH; ++i) set |= unsigned(m.v[i] & 1) << i;
    return set;
#endif
}
GB_FN bool any(WideB m) { return bits(m) != 0; }
GB_FN WideF select(WideB m, WideF a, WideF b) { return m.v ? a.v : b.v; }
GB_FN WideF min(WideF a, WideF b) { return a.v < b.v ? a.v : b.v; }
GB_FN WideF max(WideF a, WideF b) { return a.v > b.v ? a.v : b.v; }
GB_FN WideF abs(WideF a) {
    const VecI bits = (VecI)a.v & 0x7fffffff;
    return (VecF)bits;
}
GB_FN WideF sqrt(WideF a) {
    WideF r;
    for (int i = 0; i < kWidth; ++i) r.v[i] = __builtin_sqrtf(a.v[i]);
    return r;
}
GB_FN WideF exp(WideF a) {
    WideF r;
    for (int i = 0; i < kWidth; ++i) r.v[i] = expf(a.v[i]);
    return r;
}

/// A register of float64, half as many lanes.
inline constexpr int kWideD = GB_WIDTH / 2;
typedef double VecD __attribute__((vector_size(4 * GB_WIDTH)));
typedef std::int64_t VecL __attribute__((vector_size(4 * GB_WIDTH)));
typedef std::int32_t VecH __attribute__((vector_size(2 * GB_WIDTH)));
struct WideBD { VecL v; };
struct WideD {
    VecD v;
    WideD() = default;
    GB_FN WideD(double s) : v(s - VecD{}) {}
    GB_FN WideD(VecD x) : v(x) {}
};

GB_FN WideD operator+(WideD a, WideD b) { return a.v + b.v; }
GB_FN WideD operator-(WideD a, WideD b) { return a.v - b.v; }
GB_FN WideD operator*(WideD a, WideD b) { return a.v * b.v; }
GB_FN WideD operator/(WideD a, WideD b) { return a.v / b.v; }
GB_FN WideD& operator+=(WideD& a, WideD b) {
    a.v += b.v;
    return a;
}
GB_FN WideBD operator<=(WideD a, WideD b) { return {a.v <= b.v}; }
GB_FN WideBD operator>(WideD a, WideD b) { return {a.v > b.v}; }
GB_FN unsigned bits(WideBD m) {
#if defined(__AVX512F__)
    return _mm512_test_epi64_mask((__m512i)m.v, (__m512i)m.v);
#elif defined(__AVX2__)
    return unsigned(_mm256_movemask_pd((__m256d)m.v));
#else
    unsigned set = 0;
    for (int i = 0; i < kWideD; ++i) set |= unsigned(m.v[i] & 1) << i;
    return set;
#endif
}
GB_FN bool any(WideBD m) { return bits(m) != 0; }
GB_FN WideD select(WideBD m, WideD a, WideD b) { return m.v ? a.v : b.v; }
GB_FN WideD min(WideD a, WideD b) { return a.v < b.v ? a.v : b.v; }
GB_FN WideD max(WideD a, WideD b) { return a.v > b.v ? a.v : b.v; }
GB_FN WideD sqrt(WideD a) {
    WideD r;
    for (int i = 0; i < kWideD; ++i) r.v[i] = __builtin_sqrt(a.v[i]);
    return r;
}
GB_FN WideD exp(WideD a) {
    WideD r;
    for (int i = 0; i < kWideD; ++i) r.v[i] = ::exp(a.v[i]);
    return r;
}

}  // namespace globule::core
