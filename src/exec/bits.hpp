// Operations that the two compilers spell differently: bits, quick roots, atomics.
#pragma once
#if defined(__CUDACC__)
#include <cuda/atomic>
#else
#include <atomic>
#endif

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
GB_FN int trailing_zeros(std::uint32_t v) {
#if defined(__CUDA_ARCH__)
    return __ffs(int(v)) - 1;
#else
    return __builtin_ctz(v);
#endif
}
GB_FN int count_bits(std::uint64_t v) {
#if defined(__CUDA_ARCH__)
    return __popcll(v);
#else
    return __builtin_popcountll(v);
#endif
}
GB_FN int count_bits(std::uint32_t v) {
#if defined(__CUDA_ARCH__)
    return __popc(v);
#else
    return __builtin_popcount(v);
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
template <class F> GB_FN F quick_root(F a) { return sqrt(a); }
template <class F> GB_FN F quick_quotient(F a, F b) { return a / b; }

// Atomics on what other threads of the same launch touch, too: std::atomic_ref on the host, libcu++'s at the device's
// scope in CUDA. Relaxed unless said otherwise.  Sums, greatest, least and bits are of integers, so that no order can
// change the result.
//
// The device keeps its own intrinsics where libcu++ (CUDA 13.0) makes worse code of the same thing: it emits generic
// ATOM instead of RED, for 64 bits with a branch for shared memory, and for a byte's store a loop of compare-and-swap.
#if defined(__CUDACC__)
template <class T> using AtomicRef = cuda::atomic_ref<T, cuda::thread_scope_device>;
inline constexpr auto kRelaxed = cuda::std::memory_order_relaxed, kAcquireRelease = cuda::std::memory_order_acq_rel;
#else
template <class T> using AtomicRef = std::atomic_ref<T>;
inline constexpr auto kRelaxed = std::memory_order_relaxed, kAcquireRelease = std::memory_order_acq_rel;
#endif

/// Adds one and returns the value before; everything written before is visible to whoever sees the sum.
GB_FN std::uint32_t atomic_increment(std::uint32_t* counter) {
    return AtomicRef<std::uint32_t>(*counter).fetch_add(1u, kAcquireRelease);
}
/// Adds n and returns the value before.
GB_FN std::uint32_t atomic_take(std::uint32_t* counter, std::uint32_t n) {
#if defined(__CUDA_ARCH__)
    return atomicAdd(counter, n);
#else
    return AtomicRef<std::uint32_t>(*counter).fetch_add(n, kRelaxed);
#endif
}
GB_FN void atomic_add(std::uint64_t* at, std::uint64_t v) {
#if defined(__CUDA_ARCH__)
    atomicAdd(reinterpret_cast<unsigned long long*>(at), (unsigned long long)v);
#else
    AtomicRef<std::uint64_t>(*at).fetch_add(v, kRelaxed);
#endif
}
GB_FN void atomic_or(std::uint64_t* at, std::uint64_t v) {
#if defined(__CUDA_ARCH__)
    atomicOr(reinterpret_cast<unsigned long long*>(at), (unsigned long long)v);
#else
    AtomicRef<std::uint64_t>(*at).fetch_or(v, kRelaxed);
#endif
}

/// Puts v where yields(now, v); std::atomic_ref has neither minimum nor maximum before C++26.
template <class T, class Yields> GB_FN void replace_where(T* at, T v, const Yields& yields) {
    AtomicRef<T> ref(*at);
    T now = ref.load(kRelaxed);
    while (yields(now, v) && !ref.compare_exchange_weak(now, v, kRelaxed, kRelaxed)) {}
}
GB_FN void atomic_max(std::uint64_t* at, std::uint64_t v) {
#if defined(__CUDA_ARCH__)
    atomicMax(reinterpret_cast<unsigned long long*>(at), (unsigned long long)v);
#else
    replace_where(at, v, [](std::uint64_t now, std::uint64_t v) { return now < v; });
#endif
}
GB_FN void atomic_max(std::uint32_t* at, std::uint32_t v) {
#if defined(__CUDA_ARCH__)
    atomicMax(at, v);
#else
    replace_where(at, v, [](std::uint32_t now, std::uint32_t v) { return now < v; });
#endif
}
GB_FN void atomic_min(std::uint32_t* at, std::uint32_t v) {
#if defined(__CUDA_ARCH__)
    atomicMin(at, v);
#else
    replace_where(at, v, [](std::uint32_t now, std::uint32_t v) { return now > v; });
#endif
}

/// A number that others may be changing.  (atomic_ref of a const comes with C++26.)
GB_FN std::uint32_t read_now(const std::uint32_t* p) {
    return AtomicRef<std::uint32_t>(const_cast<std::uint32_t&>(*p)).load(kRelaxed);
}
/// A float that another thread has written before an atomic_increment() whose sum this one has seen.
GB_FN float read_fresh(const float* p) {
#if defined(__CUDA_ARCH__)
    return __ldcg(p);
#else
    return *p;
#endif
}

/// Flags that several threads may raise and look at.
GB_FN void raise_flag(std::uint32_t* flag, std::uint32_t raised = 1) {
    AtomicRef<std::uint32_t>(*flag).store(raised, kRelaxed);
}
GB_FN void raise_flag(std::uint8_t* flag) {
#if defined(__CUDA_ARCH__)
    *static_cast<volatile std::uint8_t*>(flag) = 1;
#else
    AtomicRef<std::uint8_t>(*flag).store(1, kRelaxed);
#endif
}
GB_FN bool flag_is_up(const std::uint8_t* flag) {
#if defined(__CUDA_ARCH__)
    return *static_cast<const volatile std::uint8_t*>(flag);
#else
    return AtomicRef<std::uint8_t>(const_cast<std::uint8_t&>(*flag)).load(kRelaxed);
#endif
}

}  // namespace globule::core
