// A packet of rows on the GPU: one thread, one row.  The same face as exec/cpu_packet.hpp.
#pragma once
#include <cuda_fp16.h>

#include "base/quad.hpp"

namespace globule::core {

struct CudaPacket {
    static constexpr int width = 1;
    static constexpr int stride = 32;  ///< a warp's lists are interleaved, so that it loads them together
    using F = float;
    using B = bool;
    using Short = __half;
    static constexpr bool short_slots = false;
    static constexpr std::uint32_t team = 1;
    __device__ static std::uint32_t member() { return 0; }
    __device__ static F own(F v) { return v; }
    template <class... T>
    __device__ static bool add_up(T&...) { return true; }

    __device__ static void fetch(const void*) {}  ///< other warps work while one waits
    __device__ static F load(const float* p) { return *p; }
    __device__ static void store(float* p, F v) { *p = v; }
    __device__ static F gather(const float* p, const std::uint32_t* index) { return p[*index]; }
    __device__ static void scatter(float* p, const std::uint32_t* index, F v) { p[*index] = v; }
    __device__ static Four<F> gather(const Quad* p, const std::uint32_t* index) {
        const float4 q = *reinterpret_cast<const float4*>(p + *index);
        return {q.x, q.y, q.z, q.w};
    }
    __device__ static void scatter(Quad* p, const std::uint32_t* index, const Four<F>& v) {
        *reinterpret_cast<float4*>(p + *index) = {v.x, v.y, v.z, v.w};
    }
    __device__ static void scatter_rows(Quad* p, std::size_t row, const Four<F>& v) {
        *reinterpret_cast<float4*>(p + row) = {v.x, v.y, v.z, v.w};
    }
    __device__ static F load(const Short* p) { return __half2float(*p); }
    __host__ __device__ static float one(const Short* p) { return __half2float(*p); }
    __device__ static F keep(Short* p, F v) {
        const Short s = __float2half_rn(v);
        *p = s;
        return __half2float(s);
    }
    __device__ static std::uint32_t longest(const std::uint32_t* counts) { return *counts; }
    template <class Fn>
    __device__ static F map(const Fn& fn) { return fn(0); }
    __device__ static float get(F v, int) { return v; }
};

/// Several warps to 32 rows: each takes every team-th neighbor, and the first one adds up, in order.  A GPU that rows alone
/// do not fill waits for memory less.
template <int kTeam>
struct CudaTeam : CudaPacket {
    static constexpr std::uint32_t team = kTeam;
    __device__ static std::uint32_t member() { return threadIdx.x / 32; }
    /// A row's own share of a sum: once.
    __device__ static F own(F v) { return member() == 0 ? v : 0.0f; }
    /// The sums of the whole team, where true; the others have done their work.
    template <class... T>
    __device__ static bool add_up(T&... sums) {
        __shared__ float parts[kTeam - 1][sizeof...(T)][32];
        const std::uint32_t lane = threadIdx.x % 32, m = member();
        int i = 0;
        if (m > 0) ((parts[m - 1][i++][lane] = sums), ...);
        __syncthreads();
        if (m > 0) return false;
        for (int k = 0; k < kTeam - 1; ++k) i = 0, ((sums += parts[k][i++][lane]), ...);
        return true;
    }
};

}  // namespace globule::core
