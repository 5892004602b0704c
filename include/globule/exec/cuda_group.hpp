// A group of lanes on the GPU: a warp.  The same face as exec/cpu_group.hpp.
#pragma once
#include "globule/base/vec.hpp"

namespace globule {

struct CudaGroup {
    static constexpr int width = 32;
    static constexpr int vectors = 1;
    static constexpr int list_capacity = 224;
    static constexpr int stack_capacity = 288;
    using F = float;
    using B = bool;
    using U = std::uint32_t;
    static constexpr unsigned all = 0xffffffffu;

    __device__ int lane() const { return threadIdx.x & 31; }
    __device__ F ramp() const { return float(lane()); }
    __device__ B first_lanes(int n) const { return lane() < n; }
    __device__ B none() const { return false; }

    template <class T>
    __device__ static T get(const T& v, int) { return v; }
    template <class T>
    __device__ static void put(T& v, int, T x) { v = x; }
    template <class T>
    __device__ static T pick(const T& v, int lane) { return __shfl_sync(all, v, lane); }

    __device__ bool any(B m) const { return __any_sync(all, m); }
    __device__ int count(B m) const { return __popc(__ballot_sync(all, m)); }
    __device__ float smallest(float v) const {
        for (int s = 16; s; s >>= 1) v = fminf(v, __shfl_xor_sync(all, v, s));
        return v;
    }
    __device__ float largest(float v) const { return -smallest(-v); }
    __device__ F load_run(const float* p) const { return p[lane()]; }

    template <class Fn>
    __device__ void each(B m, const Fn& fn) const {
        for (unsigned set = __ballot_sync(all, m); set; set &= set - 1) fn(__ffs(set) - 1);
    }
    template <class Fn>
    __device__ void per_lane(B m, const Fn& fn) const {
        if (m) fn(lane());
        __syncwarp();
    }
    template <class Write>
    __device__ int append(B m, int n, const Write& write) const {
        const unsigned set = __ballot_sync(all, m);
        if (m) write(lane(), n + __popc(set & ((1u << lane()) - 1)));
        return n + __popc(set);
    }
    __device__ void sync() const { __syncwarp(); }
};

}  // namespace globule
