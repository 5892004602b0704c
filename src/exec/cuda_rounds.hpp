// All rounds of an iteration in one launch, whose blocks meet.
#pragma once
#include <cooperative_groups.h>

#include "exec/cuda_kernels.hpp"

namespace globule::core {

/// All blocks of a launch, which are there at one time; what each wrote is there for the others then. The counter's
/// highest bit turns, so that it need not be cleared.
__device__ inline void meet_all(unsigned* arrived) {
    __syncthreads();
    if (threadIdx.x == 0) {
        __threadfence();
        const unsigned before = atomicAdd(arrived, blockIdx.x == 0 ? 0x80000000u - (gridDim.x - 1) : 1u);
        while (((before ^ *reinterpret_cast<volatile unsigned*>(arrived)) & 0x80000000u) == 0) {}
        __threadfence();
    }
    __syncthreads();
}

/// Rounds of an iteration, each two passes over the rows, a sum of what they found and a judgement, in one launch.
/// Every block adds up all sums and judges by itself, with a copy of the state of its own: the same numbers in the same
/// order. Blocks meet as a cluster, or else as a grid.
inline constexpr int kRoundTeam = 4, kClusterBlocks = 16, kClusterGroups = 8;
template <bool kCluster, class Rounds>
__global__ void __launch_bounds__(32 * kRoundTeam * (kCluster ? kClusterGroups : 1))
    run_rounds(std::size_t n, bool leads, Rounds given, typename Rounds::Sum* parts, unsigned* arrived) {
    constexpr int kGroups = kCluster ? kClusterGroups : 1;
    using Sum = typename Rounds::Sum;
    using Team = CudaTeam<kRoundTeam, kGroups>;
    constexpr unsigned all = 0xffffffffu;
    __shared__ typename Rounds::State state;
    __shared__ Sum sum, of_group[kGroups], of_block[kClusterBlocks];
    wait_for_last_kernel();
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32, group = warp / kRoundTeam,
              n_groups = blockDim.x / (32 * kRoundTeam);
    const std::size_t own = (std::size_t(blockIdx.x) * n_groups + group) * 32 + lane;
    const std::size_t row = min(own, n - 1);  // the last one is done by more threads, which write the same
    if (threadIdx.x == 0) state = *given.state();
    const Rounds rounds = given.with(&state, &sum);
    const auto meet = [&] {
#if __CUDA_ARCH__ >= 900
        if constexpr (kCluster) return cooperative_groups::this_cluster().sync();
#endif
        meet_all(arrived);
    };
    if constexpr (kCluster) meet();  // nobody writes to a block that is not there yet
    else __syncthreads();
    const auto add_up = [&](Sum s) {
        for (int k = 16; k; k >>= 1) {
            Sum other;
            for (int i = 0; i < int(sizeof(Sum) / sizeof(double)); ++i)
                reinterpret_cast<double*>(&other)[i] = __shfl_down_sync(all, reinterpret_cast<double*>(&s)[i], k);
            s = Rounds::combine(s, other);
        }
        return s;
    };
    while (!state.done) {
        if (leads) {
            rounds.template lead<Team>(row);
            meet();
        }
        leads = true;
        rounds.template follow<Team>(row);
        if (warp % kRoundTeam == 0) {
            const Sum s = add_up(own < n ? rounds.item(own) : Sum{});
            if (lane == 0) of_group[group] = s;
        }
        __syncthreads();
        if (threadIdx.x < (kCluster ? gridDim.x : 1)) {
            Sum s = of_group[0];
            for (int g = 1; g < n_groups; ++g) s = Rounds::combine(s, of_group[g]);
#if __CUDA_ARCH__ >= 900
            if constexpr (kCluster)
                cooperative_groups::this_cluster().map_shared_rank(of_block, threadIdx.x)[blockIdx.x] = s;
            else
#endif
                parts[blockIdx.x] = s;
        }
        meet();
        if (warp == 0) {
            const Sum* found = kCluster ? of_block : parts;
            Sum s{};
            for (unsigned i = lane; i < gridDim.x; i += 32) s = Rounds::combine(s, found[i]);
            s = add_up(s);
            if (lane == 0) {
                sum = s;
                rounds.judge();
            }
        }
        __syncthreads();
    }
    if (blockIdx.x == 0 && threadIdx.x == 0) *given.state() = state;
    if constexpr (kCluster) meet();  // a block's memory stays until nobody writes there any more
}

/// Whether the device has room for such a cluster.
template <class... Parameters> bool cluster_fits(void (*kernel)(Parameters...), unsigned blocks, unsigned threads) {
    cudaLaunchAttribute attribute{};
    attribute.id = cudaLaunchAttributeClusterDimension;
    attribute.val.clusterDim = {blocks, 1, 1};
    cudaLaunchConfig_t config{};
    config.gridDim = blocks;
    config.blockDim = threads;
    config.attrs = &attribute;
    config.numAttrs = 1;
    int n = 0;
    const bool fits = cudaFuncSetAttribute(kernel, cudaFuncAttributeNonPortableClusterSizeAllowed, 1) == cudaSuccess &&
                      cudaOccupancyMaxActiveClusters(&n, kernel, &config) == cudaSuccess && n > 0;
    if (!fits) cudaGetLastError();
    return fits;
}

}  // namespace globule::core
