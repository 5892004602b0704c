// The sparse grid: blocks of 4 x 4 x 4 voxels, stored where pixels fell.  A block is the octree's
// node two levels above its leaves, the voxels; inside it z y x are the two high, middle and low bits.
#pragma once
#include "globule/exec/bits.hpp"
#include "globule/sweep/walk.hpp"

namespace globule::sweep {

inline constexpr int kBlock = 4, kVoxels = kBlock * kBlock * kBlock;
inline constexpr std::uint32_t kNone = ~std::uint32_t(0);

struct Grid {
    int size[3];    ///< voxels
    int blocks[3];  ///< blocks, rounded up

    GB_FN std::size_t n_blocks() const { return std::size_t(blocks[0]) * blocks[1] * blocks[2]; }
    GB_FN std::size_t n_voxels() const { return std::size_t(size[0]) * size[1] * size[2]; }
    GB_FN std::size_t block(int x, int y, int z) const { return (std::size_t(z) * blocks[1] + y) * blocks[0] + x; }
    GB_FN bool has_block(int x, int y, int z) const {
        return x >= 0 && x < blocks[0] && y >= 0 && y < blocks[1] && z >= 0 && z < blocks[2];
    }
    GB_FN std::size_t voxel(int x, int y, int z) const { return (std::size_t(z) * size[1] + y) * size[0] + x; }
};

GB_FN int voxel_in_block(int x, int y, int z) { return (z & 3) << 4 | (y & 3) << 2 | (x & 3); }

/// Calls visit(block, voxel in block, column) for the pixels of a row, in order.
template <class T, class Visit>
GB_FN void for_each_pixel(const Frames<T>& frames, std::size_t row, const Grid& grid, const Visit& visit) {
    const Row r = row_inside(frames, row, grid.size);
    const std::uint8_t* mask = frames.mask ? frames.mask + row % frames.height * frames.width : nullptr;
    Fix x = r.at[0], y = r.at[1], z = r.at[2];
    const Fix dx = r.step[0], dy = r.step[1], dz = r.step[2];
    for (int column = r.first; column <= r.last; ++column, x += dx, y += dy, z += dz) {
        if (mask && !mask[column]) continue;
        const std::uint32_t i = std::uint32_t(x >> kFraction), j = std::uint32_t(y >> kFraction), k = std::uint32_t(z >> kFraction);
        visit(grid.block(i >> 2, j >> 2, k >> 2), voxel_in_block(i, j, k), column);
    }
}

/// Marks the blocks that pixels fall into as changed, and those that have no place yet as wanted.
template <class T>
struct TouchBlocks {
    Frames<T> frames;
    Grid grid;
    const std::uint32_t* slots;
    std::uint32_t* wanted;  ///< or null
    std::uint32_t* changed;
    GB_FN void operator()(std::size_t row) const {
        std::size_t last = ~std::size_t(0);
        for_each_pixel(frames, row, grid, [&](std::size_t block, int, int) {
            if (block == last) return;
            last = block;
            changed[block] = 1;
            if (wanted && slots[block] == kNone) wanted[block] = 1;
        });
    }
};

/// Places in order of the blocks, after those given before; `wanted` has been summed up.
struct PlaceBlocks {
    const std::uint32_t* first;  ///< exclusive sums of wanted, one more than blocks
    std::uint32_t n_before;
    std::uint32_t* slots;
    std::uint32_t* block_of_slot;
    GB_FN void operator()(std::size_t block) const {
        if (first[block + 1] == first[block]) return;
        slots[block] = n_before + first[block];
        block_of_slot[n_before + first[block]] = std::uint32_t(block);
    }
};

/// The same blocks in a larger grid.
struct MoveBlocks {
    Grid from, to;
    int shift[3];  ///< blocks
    std::uint32_t* block_of_slot;
    std::uint32_t* slots;  ///< of `to`
    GB_FN void operator()(std::size_t slot) const {
        const std::size_t b = block_of_slot[slot];
        const int x = int(b % from.blocks[0]), y = int(b / from.blocks[0] % from.blocks[1]), z = int(b / from.blocks[0] / from.blocks[1]);
        const std::size_t moved = to.block(x + shift[0], y + shift[1], z + shift[2]);
        block_of_slot[slot] = std::uint32_t(moved);
        slots[moved] = std::uint32_t(slot);
    }
};

template <class T>
struct Copy {
    const T* from;
    T* to;
    GB_FN void operator()(std::size_t i) const { to[i] = from[i]; }
};
template <class T>
struct Set {
    T* to;
    T value;
    GB_FN void operator()(std::size_t i) const { to[i] = value; }
};

}  // namespace globule::sweep
