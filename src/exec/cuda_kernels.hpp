// What launches run: a functor's items one a thread, one a warp, in teams, or as walks of uneven length; sums in order.
#pragma once
#include <cub/block/block_reduce.cuh>
#include <cuda_runtime.h>

#include "exec/cuda_group.hpp"
#include "exec/cuda_packet.hpp"

namespace globule::core {

/// What every kernel begins with: it starts while the one before ends (Cuda::launch), and what that one wrote is there
/// only now.
__device__ inline void wait_for_last_kernel() {
#if __CUDA_ARCH__ >= 900
    cudaGridDependencySynchronize();
#endif
}
/// Tells what a program was compiled for (Cuda::can_overlap).
template <class = void> __global__ void run_nothing() {}

template <class Functor> __global__ void run_each(std::size_t n, Functor functor) {
    wait_for_last_kernel();
    const std::size_t i = std::size_t(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i < n) functor(i);
}

/// Where more registers serve a functor better than more warps, it says 1: then the compiler asks for some neighbors
/// before it waits for the first.
template <class Functor> constexpr int packet_blocks() {
    if constexpr (requires { Functor::packet_blocks; }) return Functor::packet_blocks;
    else return 0;
}
template <class Functor>
__global__ void __launch_bounds__(128, packet_blocks<Functor>()) run_packets(std::size_t n, Functor functor) {
    wait_for_last_kernel();
    const std::size_t i = std::size_t(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i < n) functor.template run<CudaPacket>(i);
}

/// Rows past n have no writer: their threads leave after the team's only meeting (CudaTeam::add_up).
template <int kTeam, class Functor>
__global__ void __launch_bounds__(32 * kTeam) run_teams(std::size_t n, Functor functor) {
    wait_for_last_kernel();
    const std::size_t row = std::size_t(blockIdx.x) * 32 + threadIdx.x % 32;
    if (row < n) functor.template run<CudaTeam<kTeam>>(row);
}

/// The sum of all items and what follows from it, in one launch: blocks add up a thousand items each, and the block
/// that ends last adds these sums.  The order is that of the items.
inline constexpr int kSumThreads = 256, kSumItems = 1024;
template <class T, class Map, class Combine, class Then>
__global__ void __launch_bounds__(kSumThreads)
    run_sum(std::size_t n, Map map, Combine combine, T identity, T* parts, unsigned* arrived, T* out, Then then) {
    using Block = cub::BlockReduce<T, kSumThreads>;
    __shared__ typename Block::TempStorage room;
    __shared__ bool is_last;
    wait_for_last_kernel();
    if (then.is_over()) return;
    const std::size_t begin = std::size_t(blockIdx.x) * kSumItems + threadIdx.x;
    T sum = identity;
#pragma unroll
    for (int k = 0; k < kSumItems; k += kSumThreads)
        sum = combine(sum, begin + k < n ? map(begin + k) : identity);  // all are asked for at once
    sum = Block(room).Reduce(sum, combine);
    if (threadIdx.x == 0) {
        parts[blockIdx.x] = sum;
        __threadfence();
        is_last = atomicAdd(arrived, 1u) == gridDim.x - 1;
        __threadfence();
    }
    __syncthreads();
    if (!is_last) return;
    sum = identity;
#pragma unroll 4
    for (unsigned i = threadIdx.x; i < gridDim.x; i += kSumThreads) sum = combine(sum, parts[i]);
    sum = Block(room).Reduce(sum, combine);
    if (threadIdx.x > 0) return;
    *arrived = 0;
    *out = sum;
    then(0);
}

inline constexpr int kWarpsPerBlock = 4;
inline constexpr int kWalkBlocks = 5;  ///< of 128 threads to a processor, in run_walks: 96 registers a thread

/// Blocks of tiles that a processor holds at one time: 4 leaves 128 registers a thread; a functor that does with 96
/// says 5.
template <class Functor> constexpr int tile_blocks() {
    if constexpr (requires { Functor::tile_blocks; }) return Functor::tile_blocks;
    else return 4;
}
/// Tiles of a block: one alone where they differ much in length, so that none waits for the others to leave.
template <class Functor> constexpr int warps_per_block() {
    if constexpr (requires { Functor::tiles_of_block; }) return Functor::tiles_of_block;
    else return kWarpsPerBlock;
}

template <class Functor>
__global__ void __launch_bounds__(32 * warps_per_block<Functor>(),
    tile_blocks<Functor>() * kWarpsPerBlock / warps_per_block<Functor>()) run_tiles(std::size_t n, Functor functor) {
    wait_for_last_kernel();
    using Scratch = typename Functor::template Scratch<CudaGroup>;
    constexpr int warps = warps_per_block<Functor>();
    __shared__ Scratch scratch[warps];
    const int warp = threadIdx.x / 32;
    const std::size_t tile = std::size_t(blockIdx.x) * warps + warp;
    CudaGroup group;
    if (tile < n) functor(group, scratch[warp], tile);
}

template <class Functor> __global__ void __launch_bounds__(128) run_uneven(std::size_t n, Functor functor) {
    wait_for_last_kernel();
    const std::size_t i = std::size_t(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i < n) functor(i);
}

/// Few items a warp: where they differ much, what one lane does the others wait for (docs/design/meshes.md).
inline constexpr int kSparse = 8;
template <class Functor> __global__ void __launch_bounds__(128) run_sparse(std::size_t n, Functor functor) {
    wait_for_last_kernel();
    const int lane = threadIdx.x & 31;
    const std::size_t i = (std::size_t(blockIdx.x) * 4 + threadIdx.x / 32) * kSparse + lane;
    if (lane < kSparse && i < n) functor(i);
}

/// Lanes that are done with their item take the next ones, some at a time, so that a warp stays full
/// whatever the items' lengths (Aila & Laine 2009).  All lanes advance together, active or not.
template <class Walk>
__global__ void __launch_bounds__(128, kWalkBlocks)
    run_walks(unsigned long long n, unsigned long long* next, Walk walk) {
    wait_for_last_kernel();
    constexpr unsigned all = 0xffffffffu;
    constexpr int kIdle = 20;  // lanes that wait before new items are taken
    const int lane = threadIdx.x & 31;
    typename Walk::State state{};
    bool busy = false, more = true;
    for (;;) {
        const unsigned idle = __ballot_sync(all, !busy);
        if (more && __popc(idle) >= kIdle) {
            unsigned long long first = 0;
            if (lane == 0) first = atomicAdd(next, (unsigned long long)__popc(idle));
            first = __shfl_sync(all, first, 0);
            more = first + __popc(idle) < n;
            if (!busy) {
                const unsigned long long i = first + __popc(idle & ((1u << lane) - 1));
                busy = i < n && walk.begin(i, state);
            }
            __syncwarp();
        }
        if (!__any_sync(all, busy)) {
            if (!more) return;
            continue;
        }
        const bool on = walk.advance(state, busy);
        if (busy && !on) {
            walk.end(state);
            busy = false;
        }
        __syncwarp();
    }
}

/// As run_tiles, the number of tiles known on the device only: warps take every n-th.
template <class Functor>
__global__ void __launch_bounds__(32 * kWarpsPerBlock, 4) run_tiles_of(const std::uint32_t* n, Functor functor) {
    wait_for_last_kernel();
    using Scratch = typename Functor::template Scratch<CudaGroup>;
    __shared__ Scratch scratch[kWarpsPerBlock];
    const int warp = threadIdx.x / 32;
    CudaGroup group;
    for (std::uint32_t tile = blockIdx.x * kWarpsPerBlock + warp; tile < *n; tile += gridDim.x * kWarpsPerBlock) {
        functor(group, scratch[warp], tile);
        __syncwarp();
    }
}

}  // namespace globule::core
