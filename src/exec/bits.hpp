// Operations that the two compilers spell differently.
#pragma once
#include "base/scalar.hpp"

namespace globule::core {

GB_FN int leading_zeros(std::uint32_t v) {
#if defined(__CUDA_ARCH__)
    return __clz(int(v));
#else
    return v ? __builtin_clz(v) : 32;
#endif
}
GB_FN int leading_zeros(std::uint64_t v) {
    const std::uint32_t high = std::uint32_t(v >> 32);
    return high ? leading_zeros(high) : 32 + leading_zeros(std::uint32_t(v));
}

/// Index of the lowest set bit; v is not 0.
GB_FN int trailing_zeros(std::uint64_t v) {
#if defined(__CUDA_ARCH__)
    return __ffsll((long long)v) - 1;
#else
    return __builtin_ctzll(v);
#endif
}
GB_FN int count_bits(std::uint64_t v) {
#if defined(__CUDA_ARCH__)
    return __popcll(v);
#else
    return __builtin_popcountll(v);
#endif
}

/// Square root and quotient to within two units in the last place, where bounds allow for that.
GB_FN float quick_root(float a) {
#if defined(__CUDA_ARCH__)
    float r;
    asm("sqrt.approx.f32 %0, %1;" : "=f"(r) : "f"(a));
    return r;
#else
    return sqrt(a);
#endif
}
GB_FN float quick_quotient(float a, float b) {
#if defined(__CUDA_ARCH__)
    return __fdividef(a, b);
#else
    return a / b;
#endif
}
template <class F>
GB_FN F quick_root(F a) { return sqrt(a); }
template <class F>
GB_FN F quick_quotient(F a, F b) { return a / b; }

/// Adds one and returns the value before; everything written before is visible to whoever sees the sum.
GB_FN std::uint32_t atomic_increment(std::uint32_t* counter) {
#if defined(__CUDA_ARCH__)
    __threadfence();
    const std::uint32_t before = atomicAdd(counter, 1u);
    __threadfence();
    return before;
#else
    return __atomic_fetch_add(counter, 1u, __ATOMIC_ACQ_REL);
#endif
}

/// Adds n and returns the value before.
GB_FN std::uint32_t atomic_take(std::uint32_t* counter, std::uint32_t n) {
#if defined(__CUDA_ARCH__)
    return atomicAdd(counter, n);
#else
    return __atomic_fetch_add(counter, n, __ATOMIC_RELAXED);
#endif
}

GB_FN void raise_flag(std::uint32_t* flag) {
#if defined(__CUDA_ARCH__)
    *static_cast<volatile std::uint32_t*>(flag) = 1;
#else
    __atomic_store_n(flag, 1u, __ATOMIC_RELAXED);
#endif
}
/// Flags that several threads of one launch may raise and look at.
GB_FN void raise_flag(std::uint8_t* flag) {
#if defined(__CUDA_ARCH__)
    *static_cast<volatile std::uint8_t*>(flag) = 1;
#else
    __atomic_store_n(flag, std::uint8_t(1), __ATOMIC_RELAXED);
#endif
}
GB_FN bool flag_is_up(const std::uint8_t* flag) {
#if defined(__CUDA_ARCH__)
    return *static_cast<const volatile std::uint8_t*>(flag);
#else
    return __atomic_load_n(flag, __ATOMIC_RELAXED);
#endif
}
/// Sums, greatest and bits of many threads' values; integers, so that no order can change the result.
GB_FN void atomic_add(std::uint64_t* at, std::uint64_t v) {
#if defined(__CUDA_ARCH__)
    atomicAdd(reinterpret_cast<unsigned long long*>(at), (unsigned long long)v);
#else
    __atomic_fetch_add(at, v, __ATOMIC_RELAXED);
#endif
}
GB_FN void atomic_or(std::uint64_t* at, std::uint64_t v) {
#if defined(__CUDA_ARCH__)
    atomicOr(reinterpret_cast<unsigned long long*>(at), (unsigned long long)v);
#else
    __atomic_fetch_or(at, v, __ATOMIC_RELAXED);
#endif
}
GB_FN void atomic_max(std::uint64_t* at, std::uint64_t v) {
#if defined(__CUDA_ARCH__)
    atomicMax(reinterpret_cast<unsigned long long*>(at), (unsigned long long)v);
#else
    std::uint64_t now = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (now < v && !__atomic_compare_exchange_n(at, &now, v, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
#endif
}

GB_FN void atomic_min(std::uint32_t* at, std::uint32_t v) {
#if defined(__CUDA_ARCH__)
    atomicMin(at, v);
#else
    std::uint32_t now = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (now > v && !__atomic_compare_exchange_n(at, &now, v, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
#endif
}
/// Reads a number that other threads of the same launch may be lowering.
GB_FN std::uint32_t read_now(const std::uint32_t* p) {
#if defined(__CUDA_ARCH__)
    return *static_cast<const volatile std::uint32_t*>(p);
#else
    return __atomic_load_n(p, __ATOMIC_RELAXED);
#endif
}
GB_FN void atomic_most(std::uint32_t* at, std::uint32_t v) {
#if defined(__CUDA_ARCH__)
    atomicMax(at, v);
#else
    std::uint32_t now = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (now < v && !__atomic_compare_exchange_n(at, &now, v, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
#endif
}

/// Reads a float that another thread of the same launch may just have written.
GB_FN float read_fresh(const float* p) {
#if defined(__CUDA_ARCH__)
    return __ldcg(p);
#else
    return *p;
#endif
}

}  // namespace globule::core
