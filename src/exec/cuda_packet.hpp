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
    using D = double;
    static constexpr int half = 1;
    using Short = __half;
    static constexpr std::uint32_t team = 1;
    __device__ static std::uint32_t member() { return 0; }
    __device__ static F own(F v) { return v; }
    template <class... T> __device__ static bool add_up(T&...) { return true; }

    __device__ static void fetch(const void*) {}  ///< other warps work while one waits
    /// Its eight bytes together.
    template <class T> __device__ static T read(const T& p) {
        return __builtin_bit_cast(T, *reinterpret_cast<const uint2*>(&p));
    }
    /// What fn(T&) sets.
    template <class T, class Fn> __device__ static void write(T& p, const Fn& fn) {
        T v;
        fn(v);
        *reinterpret_cast<uint2*>(&p) = __builtin_bit_cast(uint2, v);
    }
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

    /// Where slots of 16 bits count from (sim/neighbors.hpp): the neighbors of a warp are two runs of slots where the
    /// curve jumps.
    struct alignas(8) Bases {
        std::uint32_t first, second;
        __device__ bool are_far() const { return first == ~0u; }
    };
    template <class T> __device__ static auto gather(const T* p, const Bases& from, const std::uint16_t* slots) {
        const std::uint32_t slot = (*slots & kRun ? from.second : from.first) + (*slots & (kRun - 1));
        return gather(p, &slot);
    }
    /// Writes the slots of a warp's lists, which are in slot order, in 16 bits: all lanes of the rows that there are
    /// call it.
    class ShortSlots {
    public:
        __device__ ShortSlots(const std::uint32_t* index, const std::uint32_t* count, std::size_t n_rows_from_here) {
            const std::size_t n_rows = n_rows_from_here + threadIdx.x % 32;
            if (n_rows < 32) lanes_ = (1u << n_rows) - 1;
            const std::uint32_t n = *count;
            from_.first = least(n > 0 ? *index : ~0u);
            from_.second = ~least(n > 0 ? ~index[std::size_t(n - 1) * stride] : ~0u) - (kRun - 1);
        }
        /// Nobody is the first: the gradient is 0 there.
        __device__ void add(std::uint16_t* out, const std::uint32_t* index, std::uint32_t nobody) {
            const std::uint32_t slot = *index, a = slot == nobody ? 0 : slot - from_.first, b = slot - from_.second;
            *out = a < kRun ? a : b | kRun;
            near_ = near_ && (a < kRun || b < kRun);
        }
        __device__ void finish(Bases* out) const {
            const bool near = __all_sync(lanes_, near_);
            if (threadIdx.x % 32 == 0) *out = near ? from_ : Bases{~0u, ~0u};
        }

    private:
        __device__ std::uint32_t least(std::uint32_t v) const {
#if __CUDA_ARCH__ >= 800
            return __reduce_min_sync(lanes_, v);
#else
            std::uint32_t r = v;
            for (unsigned left = lanes_; left; left &= left - 1) r = min(r, __shfl_sync(lanes_, v, __ffs(left) - 1));
            return r;
#endif
        }
        unsigned lanes_ = 0xffffffffu;
        Bases from_;
        bool near_ = true;
    };
    __device__ static std::uint32_t longest(const std::uint32_t* counts) { return *counts; }
    template <class Fn> __device__ static F map(const Fn& fn) { return fn(0); }
    template <class Fn> __device__ static D map_d(const Fn& fn) { return fn(0); }
    __device__ static float get(F v, int) { return v; }
    __device__ static double get(D v, int) { return v; }

private:
    static constexpr std::uint32_t kRun = 1u << 15;
};

/// Several warps to 32 rows: each takes every team-th neighbor, and the first one adds up, in order.  A GPU that rows
/// alone do not fill waits for memory less.  A block has one or several such groups.
template <int kTeam, int kGroups = 1> struct CudaTeam : CudaPacket {
    static constexpr std::uint32_t team = kTeam;
    __device__ static std::uint32_t member() { return threadIdx.x / 32 % kTeam; }
    /// A row's own share of a sum: once.
    __device__ static F own(F v) { return member() == 0 ? v : 0.0f; }
    /// The sums of the whole team, where true; the others have done their work.
    template <class... T> __device__ static bool add_up(T&... sums) {
        __shared__ float all[kGroups][kTeam - 1][sizeof...(T)][32];
        const std::uint32_t lane = threadIdx.x % 32, m = member();
        auto& parts = all[kGroups == 1 ? 0 : threadIdx.x / (32 * kTeam)];
        int i = 0;
        if (m > 0) ((parts[m - 1][i++][lane] = sums), ...);
        __syncthreads();
        if (m > 0) return false;
        for (int k = 0; k < kTeam - 1; ++k) i = 0, ((sums += parts[k][i++][lane]), ...);
        return true;
    }
};

}  // namespace globule::core
