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
template <class T>
struct Bins {
    Grid grid;
    const std::uint32_t* slots;
    const std::uint64_t* masks;
    const T* values;
};

template <class T>
struct Sums {
    using Total = std::uint64_t;
    GB_FN static Total term(std::uint32_t weight, T value) { return std::uint64_t(weight) * value; }
    /// To nearest, halves up; exact while sums stay below 2^53.
    GB_FN static T quotient(Total sum, std::uint64_t weight) { return T(double(sum + weight / 2) / double(weight)); }
};
template <>
struct Sums<float> {
    using Total = double;
    GB_FN static double term(std::uint32_t weight, float value) { return double(weight) * value; }
    GB_FN static float quotient(double sum, std::uint64_t weight) { return float(sum / double(weight)); }
};

/// What the cube of a radius covers of a row of four: masks of the block's bits by axis.
struct CubeMasks {
    int reach;                  ///< largest radius
    int span;                   ///< blocks that it reaches on either side
    const std::uint64_t* masks; ///< [axis][radius][place in block][block offset + span]
    GB_FN const std::uint64_t* of(int axis, int radius, int place) const {
        return masks + ((std::size_t(axis) * (reach + 1) + radius) * kBlock + place) * (2 * span + 1) + span;
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

/// Fills voxel `place` of block (bx, by, bz); returns the radius, kFar where nothing is in reach.
template <class T>
struct HoleFiller {
    Bins<T> bins;
    HoleTables tables;

    /// visit(block offset x, y, z, block, bits) for blocks with voxels in the cube; how many bits.
    template <class Visit>
    GB_FN void for_each_hit(const int* b, const int* l, int r, const Visit& visit) const {
        const std::uint64_t *mx = tables.cubes.of(0, r, l[0]), *my = tables.cubes.of(1, r, l[1]), *mz = tables.cubes.of(2, r, l[2]);
        for (int dz = (l[2] - r) >> 2; dz <= (l[2] + r) >> 2; ++dz)
            for (int dy = (l[1] - r) >> 2; dy <= (l[1] + r) >> 2; ++dy)
                for (int dx = (l[0] - r) >> 2; dx <= (l[0] + r) >> 2; ++dx) {
                    if (!bins.grid.has_block(b[0] + dx, b[1] + dy, b[2] + dz)) continue;
                    const std::size_t block = bins.grid.block(b[0] + dx, b[1] + dy, b[2] + dz);
                    const std::uint64_t hits = bins.masks[block] & mx[dx] & my[dy] & mz[dz];
                    if (hits) visit(dx, dy, dz, block, hits);
                }
    }

    GB_FN std::uint8_t fill(const int* b, int place, T& out) const {
        const int l[3] = {place & 3, place >> 2 & 3, place >> 4};
        for (int r = 1; r <= tables.cubes.reach; ++r)
            if (weigh(l, out, [&](const auto& visit) {
                    for_each_hit(b, l, r, [&](int dx, int dy, int dz, std::size_t block, std::uint64_t hits) {
                        visit(dx, dy, dz, bins.slots[block], hits);
                    });
                }))
                return std::uint8_t(r);
        out = T{};
        return kFar;
    }
    /// The weighted mean of the hits around voxel l; false where there is none.  for_each calls
    /// visit(block offset x, y, z, slot, bits), the same way each time.
    template <class ForEach>
    GB_FN bool weigh(const int* l, T& out, const ForEach& for_each) const {
        int sigma2 = 0;
        for_each([&](int dx, int dy, int dz, std::uint32_t, std::uint64_t hits) {
            const int x = 4 * dx - l[0], y = 4 * dy - l[1], z = 4 * dz - l[2];
            for (; hits; hits &= hits - 1) {
                const int u = trailing_zeros(hits);
                sigma2 = max(sigma2, square(x + (u & 3)) + square(y + (u >> 2 & 3)) + square(z + (u >> 4)));
            }
        });
        if (!sigma2) return false;
        typename Sums<T>::Total sum{};
        std::uint64_t weight = 0, n = 0;
        for_each([&](int dx, int dy, int dz, std::uint32_t slot, std::uint64_t hits) {
            const int x = 4 * dx - l[0], y = 4 * dy - l[1], z = 4 * dz - l[2];
            const T* values = bins.values + std::size_t(slot) * kVoxels;
            for (; hits; hits &= hits - 1) {
                const int u = trailing_zeros(hits);
                const std::uint32_t w =
                    tables.weight(sigma2, square(x + (u & 3)) + square(y + (u >> 2 & 3)) + square(z + (u >> 4)));
                sum += Sums<T>::term(w, values[u]);
                weight += w;
                ++n;
            }
        });
        out = Sums<T>::quotient(sum, tables.kind == HoleWeights::normalized ? weight : n << 24);
        return true;
    }
    GB_FN static int square(int v) { return v * v; }
};

/// A voxel of the dense volume, block by block; on the CPU a row of blocks is one task.
template <class T>
struct FillVoxel {
    HoleFiller<T> filler;
    DenseVolume<T> out;
    const std::uint32_t* near;   ///< per block: 0 where no data is in reach
    const std::uint32_t* dirty;  ///< per block: 0 where nothing changed since; null: all may have
    GB_FN void operator()(std::size_t i) const {
        const Grid& grid = filler.bins.grid;
        const std::size_t block = i / kVoxels;
        if (dirty && !dirty[block]) return;
        const int b[3] = {int(block % grid.blocks[0]), int(block / grid.blocks[0] % grid.blocks[1]),
                          int(block / grid.blocks[0] / grid.blocks[1])};
        one(b, block, int(i % kVoxels));
    }
    GB_FN void one(const int* b, std::size_t block, int place) const {
        const Grid& grid = filler.bins.grid;
        const int x = 4 * b[0] + (place & 3), y = 4 * b[1] + (place >> 2 & 3), z = 4 * b[2] + (place >> 4);
        if (x >= grid.size[0] || y >= grid.size[1] || z >= grid.size[2]) return;
        if (!out.holds(grid, x, y, z)) return;
        const std::size_t at = out.at(grid, x, y, z);
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
template <class T>
struct FillBlockRow {
    FillVoxel<T> each;
    GB_FN void operator()(std::size_t i) const {
        const Grid& grid = each.filler.bins.grid;
        for (int x = 0; x < grid.blocks[0]; ++x) {
            const int b[3] = {x, int(i % grid.blocks[1]), int(i / grid.blocks[1])};
            const std::size_t block = grid.block(x, b[1], b[2]);
            if (each.dirty && !each.dirty[block]) continue;
            for (int place = 0; place < kVoxels; ++place) each.one(b, block, place);
        }
    }
};

/// A row of blocks where no hole is to be filled: empty rows of voxels, then those that have pixels.
template <class T>
struct CopyBlockRow {
    FillVoxel<T> each;
    GB_FN void operator()(std::size_t i) const {
        const Bins<T>& bins = each.filler.bins;
        const Grid& grid = bins.grid;
        const int y = int(i % grid.blocks[1]), z = int(i / grid.blocks[1]);
        for (int k = 4 * z; k < min(4 * z + 4, grid.size[2]); ++k)
            for (int j = 4 * y; j < min(4 * y + 4, grid.size[1]); ++j) {
                const std::size_t at = grid.voxel(0, j, k);
                memset(each.out.values + at, 0, grid.size[0] * sizeof(T));
                memset(each.out.radius + at, kFar, grid.size[0]);
            }
        for (int x = 0; x < grid.blocks[0]; ++x) {
            const std::size_t block = grid.block(x, y, z);
            if (!bins.masks[block]) continue;
            const T* values = bins.values + std::size_t(bins.slots[block]) * kVoxels;
            for (std::uint64_t mask = bins.masks[block]; mask; mask &= mask - 1) {
                const int place = trailing_zeros(mask);
                const std::size_t at = grid.voxel(4 * x + (place & 3), 4 * y + (place >> 2 & 3), 4 * z + (place >> 4));
                each.out.values[at] = values[place];
                each.out.radius[at] = 0;
            }
        }
    }
};

/// Blocks within `span` blocks of one with data, one axis at a time.
struct SpreadNear {
    Grid grid;
    int axis, span;
    const std::uint32_t* from;
    std::uint32_t* to;
    GB_FN void operator()(std::size_t i) const {
        const std::size_t step = axis == 0 ? 1 : axis == 1 ? grid.blocks[0] : std::size_t(grid.blocks[0]) * grid.blocks[1];
        const int at = int(i / step % grid.blocks[axis]);
        std::uint32_t any = 0;
        for (int d = max(-span, -at); d <= min(span, grid.blocks[axis] - 1 - at); ++d) any |= from[i + d * step];
        to[i] = any;
    }
};
/// The same, a row of blocks a task.
struct SpreadNearRow {
    SpreadNear each;
    GB_FN void operator()(std::size_t i) const {
        const Grid& grid = each.grid;
        const int n = grid.blocks[0], at[3] = {0, int(i % grid.blocks[1]), int(i / grid.blocks[1])};
        const std::uint32_t* from = each.from + i * n;
        std::uint32_t* to = each.to + i * n;
        memcpy(to, from, n * sizeof *to);
        const std::ptrdiff_t step = each.axis == 0 ? 1 : each.axis == 1 ? n : std::ptrdiff_t(n) * grid.blocks[1];
        for (int d = -each.span; d <= each.span; ++d) {
            if (each.axis != 0 && (at[each.axis] + d < 0 || at[each.axis] + d >= grid.blocks[each.axis])) continue;
            const int first = each.axis == 0 ? max(0, -d) : 0, last = each.axis == 0 ? n - max(0, d) : n;
            for (int x = first; x < last; ++x) to[x] |= from[x + d * step];
        }
    }
};
struct HasData {
    const std::uint64_t* masks;
    std::uint32_t* out;
    GB_FN void operator()(std::size_t i) const { out[i] = masks[i] != 0; }
};

}  // namespace globule::core::sweep
