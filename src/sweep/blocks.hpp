// The sparse grid: blocks of 4 x 4 x 4 voxels, stored where pixels fell.  A block is the octree's
// node two levels above its leaves, the voxels.
#pragma once
#include <cstring>

#include "exec/bits.hpp"
#include "sweep/images.hpp"

namespace globule::core::sweep {

inline constexpr int kBlock = 4, kVoxels = kBlock * kBlock * kBlock;
inline constexpr std::uint32_t kNone = ~std::uint32_t(0);

/// Counts along x, y and z: a voxel of a grid, a block of it, or how far one is from another.
struct Cell {
    int x, y, z;
    GB_FN friend Cell operator+(Cell a, Cell b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
    GB_FN friend Cell operator-(Cell a, Cell b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
};
GB_FN int square(Cell d) { return d.x * d.x + d.y * d.y + d.z * d.z; }

/// The one coder of voxels: a voxel is place 0 to 63 of a block; bits zzyyxx of the place are the low two of its
/// coordinates.
struct Block {
    GB_FN static Cell of(Cell voxel) { return {voxel.x >> 2, voxel.y >> 2, voxel.z >> 2}; }
    GB_FN static int place(Cell voxel) { return (voxel.z & 3) << 4 | (voxel.y & 3) << 2 | (voxel.x & 3); }
    GB_FN static Cell first(Cell block) { return {kBlock * block.x, kBlock * block.y, kBlock * block.z}; }
    GB_FN static Cell inside(int place) { return {place & 3, place >> 2 & 3, place >> 4}; }
    GB_FN static Cell voxel(Cell block, int place) { return first(block) + inside(place); }
};

/// Numbers of blocks (32 bits) and voxels count x first, then y, then z.
struct Grid {
    int size[3];    ///< voxels
    int blocks[3];  ///< blocks, rounded up

    GB_FN std::size_t n_blocks() const { return std::size_t(blocks[0]) * blocks[1] * blocks[2]; }
    GB_FN std::size_t n_voxels() const { return std::size_t(size[0]) * size[1] * size[2]; }
    GB_FN std::size_t block(Cell b) const { return (std::uint32_t(b.z) * blocks[1] + b.y) * blocks[0] + b.x; }
    GB_FN Cell block(std::size_t number) const {
        const std::uint32_t n = std::uint32_t(number), nx = blocks[0], ny = blocks[1], row = n / nx;
        return {int(n - row * nx), int(row % ny), int(row / ny)};
    }
    GB_FN bool has_block(Cell b) const {
        return b.x >= 0 && b.x < blocks[0] && b.y >= 0 && b.y < blocks[1] && b.z >= 0 && b.z < blocks[2];
    }
    GB_FN std::size_t voxel(Cell v) const { return (std::size_t(v.z) * size[1] + v.y) * size[0] + v.x; }
    GB_FN Cell voxel(std::size_t number) const {
        const std::size_t row = number / size[0];
        return {int(number % size[0]), int(row % size[1]), int(row / size[1])};
    }
    /// The last blocks along an axis may go past it.
    GB_FN bool has_voxel(Cell v) const { return v.x < size[0] && v.y < size[1] && v.z < size[2]; }
};

/// Calls visit(block, voxel in block, column) for the pixels of a row, in order.
template <class T, class Visit>
GB_FN void for_each_pixel(const Images<T>& images, std::size_t row, const Grid& grid, const Visit& visit) {
    const Row r = row_inside(images, row, grid.size);
    const std::uint8_t* mask = images.mask ? images.mask + row % images.height * images.width : nullptr;
    Fix x = r.at[0], y = r.at[1], z = r.at[2];
    const Fix dx = r.step[0], dy = r.step[1], dz = r.step[2];
    for (int column = r.first; column <= r.last; ++column, x += dx, y += dy, z += dz) {
        if (mask && !mask[column]) continue;
        const Cell v{int(x >> kFraction), int(y >> kFraction), int(z >> kFraction)};
        visit(grid.block(Block::of(v)), Block::place(v), column);
    }
}

/// Calls visit(block, voxel in block, column) for pixel i of all, if it lies inside.
template <class T, class Visit>
GB_FN void visit_pixel(const Images<T>& images, std::size_t i, const Grid& grid, const Visit& visit) {
    const std::uint32_t row = std::uint32_t(i) / std::uint32_t(images.width),
                        column = std::uint32_t(i) % std::uint32_t(images.width);
    const std::uint32_t f = row / std::uint32_t(images.height), j = row % std::uint32_t(images.height);
    if (images.mask && !images.mask[std::size_t(j) * images.width + column]) return;
    const Pose& pose = images.poses[f];
    int at[3];
    for (int k = 0; k < 3; ++k) {
        const Fix p = pose.origin[k] + Fix(j) * pose.y[k] + Fix(column) * pose.x[k];
        if (p < 0 || (p >> kFraction) >= grid.size[k]) return;
        at[k] = int(p >> kFraction);
    }
    const Cell v{at[0], at[1], at[2]};
    visit(grid.block(Block::of(v)), Block::place(v));
}

/// Calls visit(block, voxel in block, first column, column past the last) for the runs of a row's
/// pixels that share a voxel; 64 pixels at a time as vectors, so a run may come in two pieces.
template <class T, class Visit>
GB_FN void for_each_run(const Images<T>& images, std::size_t row, const Grid& grid, const Visit& visit) {
    constexpr int n = 64;
    const Row r = row_inside(images, row, grid.size);
    const std::uint8_t* mask = images.mask ? images.mask + row % images.height * images.width : nullptr;
    Fix at[3] = {r.at[0], r.at[1], r.at[2]};
    for (int first = r.first; first <= r.last; first += n) {
        const int count = min(n, r.last + 1 - first);
        alignas(64) std::int32_t v[3][n];
        alignas(64) std::uint32_t block[n], voxel[n];
        for (int k = 0; k < 3; ++k) {
            Fix p = at[k];
            for (int l = 0; l < n; ++l, p += r.step[k]) v[k][l] = std::int32_t(std::uint64_t(p) >> kFraction);
            at[k] = p;
        }
        const Grid here = grid;  // nothing that is written below can change it, so that the loop becomes vectors
        for (int l = 0; l < n; ++l) {
            const Cell c{v[0][l], v[1][l], v[2][l]};
            block[l] = std::uint32_t(here.block(Block::of(c)));
            voxel[l] = std::uint32_t(Block::place(c));
        }
        if (mask)
            for (int l = 0; l < count; ++l) voxel[l] |= mask[first + l] ? 0 : kVoxels;
        alignas(64) std::uint8_t change[n];
        change[0] = 1;
        for (int l = 1; l < n; ++l) change[l] = ((block[l] ^ block[l - 1]) | (voxel[l] ^ voxel[l - 1])) != 0;
        std::uint64_t starts = 0;
        for (int l = 0; l < n; l += 8) {
            std::uint64_t eight;
            memcpy(&eight, change + l, 8);
            starts |= (eight * 0x0102040810204080ull >> 56) << l;
        }
        starts &= ~std::uint64_t(0) >> (n - count);
        while (starts) {
            const int l = trailing_zeros(starts);
            starts &= starts - 1;
            const int end = starts ? trailing_zeros(starts) : count;
            if (voxel[l] < kVoxels) visit(std::size_t(block[l]), int(voxel[l]), first + l, first + end);
        }
    }
}

/// Marks the blocks that pixels fall into as changed, and those that have no place yet as wanted.
template <class T> struct TouchBlocks {
    Images<T> images;
    Grid grid;
    const std::uint32_t* slots;
    std::uint32_t* wanted;  ///< or null
    std::uint32_t* changed;
    GB_FN void operator()(std::size_t row) const {
        for_each_run(images, row, grid, [&](std::size_t block, int, int, int) { mark(block); });
    }
    GB_FN void mark(std::size_t block) const {
        raise_flag(changed + block);
        if (wanted && slots[block] == kNone) raise_flag(wanted + block);
    }
};
/// The same, a pixel a thread.
template <class T> struct TouchPixels {
    TouchBlocks<T> rows;
    GB_FN void operator()(std::size_t i) const {
        visit_pixel(rows.images, i, rows.grid, [&](std::size_t block, int) { rows.mark(block); });
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

/// A table of cells, larger than another that it holds `shift` cells inside.
struct Growth {
    int from[3], to[3], shift[3];

    GB_FN std::size_t moved(std::size_t cell) const {
        const std::size_t x = cell % from[0], y = cell / from[0] % from[1], z = cell / from[0] / from[1];
        return ((z + shift[2]) * to[1] + y + shift[1]) * to[0] + x + shift[0];
    }
    std::size_t n_cells() const { return std::size_t(to[0]) * to[1] * to[2]; }
};
struct MoveSlots {
    Growth growth;
    std::uint32_t* block_of_slot;
    GB_FN void operator()(std::size_t slot) const {
        block_of_slot[slot] = std::uint32_t(growth.moved(block_of_slot[slot]));
    }
};
/// A row of a table, for the larger one.
template <class U> struct MoveTableRow {
    Growth growth;
    const U* from;
    U* to;
    U outside;
    GB_FN void operator()(std::size_t row) const {
        const int y = int(row % growth.to[1]) - growth.shift[1], z = int(row / growth.to[1]) - growth.shift[2];
        const bool inside = y >= 0 && y < growth.from[1] && z >= 0 && z < growth.from[2];
        const int first = growth.shift[0], last = inside ? first + growth.from[0] : first;
        const U* old = from + (std::ptrdiff_t(z) * growth.from[1] + y) * growth.from[0];
        U* out = to + row * growth.to[0];
        for (int x = 0; x < first; ++x) out[x] = outside;
        for (int x = first; x < last; ++x) out[x] = old[x - first];
        for (int x = last; x < growth.to[0]; ++x) out[x] = outside;
    }
};

template <class T> struct Copy {
    const T* from;
    T* to;
    GB_FN void operator()(std::size_t i) const { to[i] = from[i]; }
};
template <class T> struct Set {
    T* to;
    T value;
    GB_FN void operator()(std::size_t i) const { to[i] = value; }
};

}  // namespace globule::core::sweep
