// Hole filling (PVN-OM): for each voxel without a value a cube grows by one voxel on each side until
// it holds a bin-filled one; the value is their mean, weighted by exp(-(|u - v| / sigma)^2), sigma the
// distance of the farthest.  Whatever the cube finds lies on its surface, since the smaller one was
// empty: nothing inside is ever looked at twice.
//
// Weights are integers of 24 bits from a table, so that sums of 8- and 16-bit values are exact and the
// same on every machine.
#pragma once
#include <cmath>
#include <cstdlib>
#include <vector>

#include "sweep/bin.hpp"
#include "sweep/dense.hpp"

namespace globule::core::sweep {

enum class HoleWeights { normalized, printed };

/// Values of voxels by block.
template <class T> struct Bins {
    Grid grid;
    const std::uint32_t* slots;
    const std::uint64_t* masks;
    const T* values;
};

template <class T> struct Sums {
    using Total = std::uint64_t;
    GB_FN static Total term(std::uint32_t weight, T value) { return std::uint64_t(weight) * value; }
    /// To nearest, halves up; exact while sums stay below 2^53.
    GB_FN static T quotient(Total sum, std::uint64_t weight) { return T(double(sum + weight / 2) / double(weight)); }
};
template <> struct Sums<float> {
    using Total = double;
    GB_FN static double term(std::uint32_t weight, float value) { return double(weight) * value; }
    GB_FN static float quotient(double sum, std::uint64_t weight) { return float(sum / double(weight)); }
};

/// What the cube of a radius covers of a row of four: masks of the block's bits by axis.
struct CubeMasks {
    int reach;                   ///< largest radius
    int span;                    ///< blocks that it reaches on either side
    const std::uint64_t* masks;  ///< [axis][radius][place in block][block offset + span]
    GB_FN const std::uint64_t* of(int axis, int radius, int place) const {
        return masks + ((std::size_t(axis) * (reach + 1) + radius) * kBlock + place) * (2 * span + 1) + span;
    }
    /// visit(blocks away, bits of that block in the cube) for the blocks that the cube of radius r around voxel l of a
    /// block meets.
    template <class Visit> GB_FN void for_each_block(Cell l, int r, const Visit& visit) const {
        const std::uint64_t *mx = of(0, r, l.x), *my = of(1, r, l.y), *mz = of(2, r, l.z);
        const Cell from = Block::of({l.x - r, l.y - r, l.z - r}), to = Block::of({l.x + r, l.y + r, l.z + r});
        for (int z = from.z; z <= to.z; ++z)
            for (int y = from.y; y <= to.y; ++y)
                for (int x = from.x; x <= to.x; ++x) visit(Cell{x, y, z}, mx[x] & my[y] & mz[z]);
    }
};

inline std::vector<std::uint64_t> cube_masks(int reach, int span) {
    const std::uint64_t units[3] = {0x1111111111111111ull, 0x000f000f000f000full, 0xffffull};
    const int steps[3] = {1, 4, 16};
    std::vector<std::uint64_t> masks;
    for (int axis = 0; axis < 3; ++axis)
        for (int radius = 0; radius <= reach; ++radius)
            for (int place = 0; place < 4; ++place)
                for (int offset = -span; offset <= span; ++offset) {
                    std::uint64_t mask = 0;
                    for (int u = 0; u < 4; ++u)
                        if (std::abs(4 * offset + u - place) <= radius) mask |= units[axis] << u * steps[axis];
                    masks.push_back(mask);
                }
    return masks;
}

struct HoleTables {
    CubeMasks cubes;
    const std::uint32_t* weights;  ///< [sigma^2][d^2], 2^24 = 1; rows of 3 reach^2 + 1; null: too large
    HoleWeights kind;
    GB_FN std::uint32_t weight(int sigma2, int d2) const {
        if (!weights) return std::uint32_t(rint(exp(-double(d2) / sigma2) * (1 << 24)));
        return weights[std::size_t(sigma2) * (3 * cubes.reach * cubes.reach + 1) + d2];
    }
};

/// Fills voxel `place` of a block; returns the radius, kFar where nothing is in reach.
template <class T> struct HoleFiller {
    Bins<T> bins;
    HoleTables tables;

    /// visit(blocks away, block, bits) for blocks with voxels in the cube around voxel l of a block.
    template <class Visit> GB_FN void for_each_hit(Cell around, Cell l, int r, const Visit& visit) const {
        tables.cubes.for_each_block(l, r, [&](Cell away, std::uint64_t cube) {
            if (!bins.grid.has_block(around + away)) return;
            const std::size_t block = bins.grid.block(around + away);
            const std::uint64_t hits = bins.masks[block] & cube;
            if (hits) visit(away, block, hits);
        });
    }

    GB_FN std::uint8_t fill(Cell around, int place, T& out) const {
        const Cell l = Block::inside(place);
        for (int r = 1; r <= tables.cubes.reach; ++r)
            if (weigh(l, out, [&](const auto& visit) {
                    for_each_hit(around, l, r, [&](Cell away, std::size_t block, std::uint64_t hits) {
                        visit(away, bins.slots[block], hits);
                    });
                }))
                return std::uint8_t(r);
        out = T{};
        return kFar;
    }
    /// The weighted mean of the hits around voxel l; false where there is none.  for_each calls
    /// visit(blocks away, slot, bits), the same way each time.
    template <class ForEach> GB_FN bool weigh(Cell l, T& out, const ForEach& for_each) const {
        int sigma2 = 0;
        for_each([&](Cell away, std::uint32_t, std::uint64_t hits) {
            const Cell d = Block::first(away) - l;
            for (; hits; hits &= hits - 1) sigma2 = max(sigma2, square(d + Block::inside(trailing_zeros(hits))));
        });
        if (!sigma2) return false;
        typename Sums<T>::Total sum{};
        std::uint64_t weight = 0, n = 0;
        for_each([&](Cell away, std::uint32_t slot, std::uint64_t hits) {
            const Cell d = Block::first(away) - l;
            const T* values = bins.values + std::size_t(slot) * kVoxels;
            for (; hits; hits &= hits - 1) {
                const int u = trailing_zeros(hits);
                const std::uint32_t w = tables.weight(sigma2, square(d + Block::inside(u)));
                sum += Sums<T>::term(w, values[u]);
                weight += w;
                ++n;
            }
        });
        out = Sums<T>::quotient(sum, tables.kind == HoleWeights::normalized ? weight : n << 24);
        return true;
    }
};

/// A voxel of the dense volume, block by block.
template <class T> struct FillVoxel {
    HoleFiller<T> filler;
    DenseVolume<T> out;
    const std::uint32_t* near;   ///< per block: 0 where no data is in reach
    const std::uint32_t* dirty;  ///< per block: 0 where nothing changed since; null: all may have
    GB_FN bool skips(std::size_t block) const { return dirty && !dirty[block]; }
    GB_FN void operator()(Cell b, std::size_t block, int place) const {
        const Grid& grid = filler.bins.grid;
        const Cell v = Block::voxel(b, place);
        if (!grid.has_voxel(v) || !out.holds(grid, v)) return;
        const std::size_t at = out.at(grid, v);
        if (filler.bins.masks[block] >> place & 1) {
            out.values[at] = filler.bins.values[std::size_t(filler.bins.slots[block]) * kVoxels + place];
            out.radius[at] = 0;
        } else if (!near[block]) {
            out.values[at] = T{};
            out.radius[at] = kFar;
        } else {
            T value{};
            out.radius[at] = filler.fill(b, place, value);
            out.values[at] = value;
        }
    }
};
/// Each voxel for itself: any radius, any type.  A block a tile on the CPU; a thread a voxel on the GPU, where tiles of
/// so much code get half as many registers again (92 instead of 64 for VVN-OM), and so fewer warps at a time.
template <class Each> struct EachVoxel {
    Grid grid;
    Each each;
    GB_FN void operator()(std::size_t voxel) const {
        const std::size_t block = voxel / kVoxels;
        if (!each.skips(block)) each(grid.block(block), block, int(voxel % kVoxels));
    }
    struct Nothing {};
    template <class Group> using Scratch = Nothing;
    template <class Group> GB_FN void operator()(Group& g, Nothing&, std::size_t block) const {
        if (each.skips(block)) return;
        const Cell b = grid.block(block);
        g.share(kVoxels, [&](int place) { each(b, block, place); });
    }
};

/// A row of blocks where no hole is to be filled: empty rows of voxels, then those that have pixels.
template <class T> struct CopyBlockRow {
    FillVoxel<T> each;
    GB_FN void operator()(std::size_t i) const {
        const Bins<T>& bins = each.filler.bins;
        const Grid& grid = bins.grid;
        const int y = int(i % grid.blocks[1]), z = int(i / grid.blocks[1]);
        for (int k = 4 * z; k < min(4 * z + 4, grid.size[2]); ++k)
            for (int j = 4 * y; j < min(4 * y + 4, grid.size[1]); ++j) {
                const std::size_t at = grid.voxel(Cell{0, j, k});
                memset(each.out.values + at, 0, grid.size[0] * sizeof(T));
                memset(each.out.radius + at, kFar, grid.size[0]);
            }
        for (int x = 0; x < grid.blocks[0]; ++x) {
            const Cell b{x, y, z};
            const std::size_t block = grid.block(b);
            if (!bins.masks[block]) continue;
            const T* values = bins.values + std::size_t(bins.slots[block]) * kVoxels;
            for (std::uint64_t mask = bins.masks[block]; mask; mask &= mask - 1) {
                const int place = trailing_zeros(mask);
                const std::size_t at = grid.voxel(Block::voxel(b, place));
                each.out.values[at] = values[place];
                each.out.radius[at] = 0;
            }
        }
    }
};

/// Blocks within `span` blocks of one with data, one axis at a time.  A group takes a row of blocks, its lanes go along
/// x.
struct SpreadNear {
    Grid grid;
    int axis, span;
    const std::uint32_t* from;
    std::uint32_t* to;
    struct Nothing {};
    template <class Group> using Scratch = Nothing;
    template <class Group> GB_FN void operator()(Group& g, Nothing&, std::size_t row) const {
        const int n = grid.blocks[0], at[3] = {0, int(row % grid.blocks[1]), int(row / grid.blocks[1])};
        const std::uint32_t* in = from + row * n;
        std::uint32_t* out = to + row * n;
        const std::ptrdiff_t step = axis == 0 ? 1 : axis == 1 ? n : std::ptrdiff_t(n) * grid.blocks[1];
        g.share(n, [&](int x) { out[x] = in[x]; });
        for (int d = -span; d <= span; ++d) {
            if (axis != 0 && (at[axis] + d < 0 || at[axis] + d >= grid.blocks[axis])) continue;
            const int first = axis == 0 ? max(0, -d) : 0, last = axis == 0 ? n - max(0, d) : n;
            g.share(last - first, [&](int x) { out[first + x] |= in[first + x + d * step]; });
        }
    }
};
struct HasData {
    const std::uint64_t* masks;
    std::uint32_t* out;
    GB_FN void operator()(std::size_t i) const { out[i] = masks[i] != 0; }
};

}  // namespace globule::core::sweep
