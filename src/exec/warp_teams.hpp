// Where only some lanes of a warp have a ray to work on, teams of lanes share the rays out: every lane is in a team,
// a team adds up its ray's field together, and the ray's own lane takes the sum.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

/// The lanes that have a ray, numbered in order: `rank` is the number of this lane's.
struct RanksInWarp {
    static constexpr unsigned all = 0xffffffffu;
    int n, rank;

    __device__ explicit RanksInWarp(bool active) {
        const unsigned set = __ballot_sync(all, active);
        n = __popc(set);
        rank = __popc(set & ((1u << (threadIdx.x & 31)) - 1));
    }
};

/// Teams of 2^log_size lanes, which work on the rays from the `first` on.
struct WarpTeams {
    static constexpr unsigned all = 0xffffffffu;
    int log_size, first;

    __device__ int size() const { return 1 << log_size; }
    __device__ int n_teams() const { return 32 >> log_size; }
    /// The ray that this lane's team works on, and which of the team this lane is.
    __device__ int ray() const { return first + ((threadIdx.x & 31) >> log_size); }
    __device__ int member() const { return threadIdx.x & (size() - 1); }
    __device__ bool holds(int rank) const { return rank >= first && rank < first + n_teams(); }

    __device__ static float3 pick(const float3& v, int lane) {
        return {__shfl_sync(all, v.x, lane), __shfl_sync(all, v.y, lane), __shfl_sync(all, v.z, lane)};
    }
    /// Adds up what the members hold, and gives each ray's lane its team's sum.
    template <bool Bounds, class Sum> __device__ Sum total(Sum sum, int rank) const {
        for (int s = size() / 2; s; s >>= 1) {
            sum.f += __shfl_xor_sync(all, sum.f, s);
            sum.slope += __shfl_xor_sync(all, sum.slope, s);
            if constexpr (Bounds) {
                sum.rise += __shfl_xor_sync(all, sum.rise, s);
                sum.fall += __shfl_xor_sync(all, sum.fall, s);
            }
        }
        const int from = (rank - first) << log_size & 31;
        sum.f = __shfl_sync(all, sum.f, from);
        sum.slope = __shfl_sync(all, sum.slope, from);
        if constexpr (Bounds) {
            sum.rise = __shfl_sync(all, sum.rise, from);
            sum.fall = __shfl_sync(all, sum.fall, from);
        }
        return sum;
    }
};

}  // namespace globule::core
