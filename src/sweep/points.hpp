// Pixels as points sorted by voxel, for the methods that look at points rather than at bins: the
// median, and the voxel-based VVN-OM and VVN.
#pragma once
#include <cmath>

#include "morton/code.hpp"
#include "sweep/holes.hpp"

namespace globule::core::sweep {

/// How a voxel's key is made: Morton code (the octree's leaf) or place in the plain grid.
enum class Keying { morton, plain, bins };

template <class T> struct CountRow {
    Images<T> images;
    Grid grid;
    std::uint32_t* counts;
    GB_FN void operator()(std::size_t row) const {
        std::uint32_t n = 0;
        for_each_pixel(images, row, grid, [&](std::size_t, int, int) { ++n; });
        counts[row] = n;
    }
};

template <class T> struct EmitPoints {
    Images<T> images;
    Grid grid;
    Keying keying;
    const std::uint32_t* slots;    ///< keying bins: key = place in the bins, then the value
    const std::uint32_t* offsets;  ///< of each row
    std::uint64_t* keys;
    std::uint32_t* pixels;
    GB_FN void operator()(std::size_t row) const {
        std::uint32_t at = offsets[row];
        for_each_pixel(images, row, grid, [&](std::size_t block, int voxel, int column) {
            const std::size_t pixel = row * images.width + column;
            keys[at] = key(block, voxel, pixel);
            pixels[at++] = std::uint32_t(pixel);
        });
    }
    GB_FN std::uint64_t key(std::size_t block, int voxel, std::size_t pixel) const {
        if (keying == Keying::bins)
            return (std::uint64_t(slots[block]) * kVoxels + voxel) << 32 | ordered_bits(images.values[pixel]);
        const Cell v = Block::voxel(grid.block(block), voxel);
        return keying == Keying::morton ? morton::encode(std::uint64_t(v.x), std::uint64_t(v.y), std::uint64_t(v.z))
                                        : grid.voxel(v);
    }
};

/// The middle value of each run of equal bins; of an even number the mean of the middle two.
template <class T> struct TakeMedian {
    std::size_t n;
    const std::uint64_t* keys;
    const std::uint32_t* block_of_slot;
    T* values;
    std::uint64_t* masks;
    GB_FN void operator()(std::size_t i) const {
        const std::uint64_t bin = keys[i] >> 32;
        if (i && keys[i - 1] >> 32 == bin) return;
        std::size_t end = i + 1;
        while (end < n && keys[end] >> 32 == bin) ++end;
        const T a = from_ordered_bits<T>(std::uint32_t(keys[(i + end - 1) / 2])),
                b = from_ordered_bits<T>(std::uint32_t(keys[(i + end) / 2]));
        if constexpr (is_real<T>) values[bin] = 0.5f * a + 0.5f * b;
        else values[bin] = T((a + b + 1) / 2);
        atomic_or(masks + block_of_slot[bin / kVoxels], std::uint64_t(1) << bin % kVoxels);
    }
};

/// Points in key order: place inside of their voxel, in voxels, and value.
template <class T> struct SortedPoints {
    float *x, *y, *z;
    T* values;
};
template <class T> struct GatherPoints {
    Images<T> images;
    const std::uint32_t* pixels;
    SortedPoints<T> points;
    GB_FN void operator()(std::size_t i) const {
        const std::size_t pixel = pixels[i], row = pixel / images.width;
        const Pose& pose = images.poses[row / images.height];
        float place[3];
        for (int k = 0; k < 3; ++k) {
            const Fix p = pose.origin[k] + Fix(row % images.height) * pose.y[k] + Fix(pixel % images.width) * pose.x[k];
            place[k] = float(std::uint32_t(p) >> 8) * 0x1p-24f;
        }
        points.x[i] = place[0];
        points.y[i] = place[1];
        points.z[i] = place[2];
        points.values[i] = images.values[pixel];
    }
};

/// First point of each voxel: by bin (sparse) or by place in the plain grid.
struct MarkRuns {
    std::size_t n;
    const std::uint64_t* keys;
    Grid grid;
    bool plain;
    const std::uint32_t* slots;
    std::uint32_t *first, *last;
    std::uint64_t* masks;
    GB_FN void operator()(std::size_t i) const {
        const bool begins = i == 0 || keys[i - 1] != keys[i], ends = i + 1 == n || keys[i + 1] != keys[i];
        if (!begins && !ends) return;
        std::size_t at = keys[i];
        if (!plain) {
            const auto m = morton::decode(keys[i]);
            const Cell v{int(m.x), int(m.y), int(m.z)};
            const std::size_t block = grid.block(Block::of(v));
            const int place = Block::place(v);
            at = std::size_t(slots[block]) * kVoxels + place;
            if (begins) atomic_or(masks + block, std::uint64_t(1) << place);
        }
        if (begins) first[at] = std::uint32_t(i);
        if (ends) last[at] = std::uint32_t(i + 1);
    }
};

/// exp(-q) for 0 <= q <= 1 to 1e-7: its series about 1/2.  Only products and sums, so that it has the
/// same bits everywhere and runs as vectors.
GB_FN float exp_of_share(float q) {
    const float x = 0.5f - q;
    float s = 1.0f / 5040.0f;
    s = s * x + 1.0f / 720.0f;
    s = s * x + 1.0f / 120.0f;
    s = s * x + 1.0f / 24.0f;
    s = s * x + 1.0f / 6.0f;
    s = s * x + 0.5f;
    s = s * x + 1.0f;
    s = s * x + 1.0f;
    return s * 0.60653066f;
}

/// Weighted mean of the points within rho of a voxel's center, given voxel by voxel, each d voxels away; twice over the
/// same points, first for the farthest.  Weights have 24 bits: sums of integers are exact.
template <class T> struct Sphere {
    SortedPoints<T> points;
    float rho2;
    std::int32_t farthest = 0;  ///< bits of sigma^2; they order like the numbers
    std::uint32_t n = 0;
    std::uint64_t weight = 0;
    typename Sums<T>::Total sum = 0;

    GB_FN float distance2(std::uint32_t i, Cell d) const {
        const float x = d.x + (points.x[i] - 0.5f), y = d.y + (points.y[i] - 0.5f), z = d.z + (points.z[i] - 0.5f);
        return x * x + y * y + z * z;
    }
    GB_FN void look(std::uint32_t from, std::uint32_t to, Cell d) {
        std::int32_t most_bits = 0;
        std::uint32_t count = 0;
        for (std::uint32_t i = from; i < to; ++i) {
            const float d2 = distance2(i, d);
            std::int32_t bits;
            memcpy(&bits, &d2, 4);
            const bool inside = d2 <= rho2;
            most_bits = max(most_bits, inside ? bits : 0);
            count += inside;
        }
        farthest = max(farthest, most_bits);
        n += count;
    }
    GB_FN void add(std::uint32_t from, std::uint32_t to, Cell d) {
        float sigma2;
        memcpy(&sigma2, &farthest, 4);
        const float share = sigma2 > 0 ? 1.0f / sigma2 : 0.0f;
        std::uint64_t weights = 0;
        typename Sums<T>::Total total = 0;
        for (std::uint32_t i = from; i < to; ++i) {
            const float d2 = distance2(i, d);
            const float w = exp_of_share(d2 * share) * 0x1p24f;
            const std::uint32_t whole = d2 <= rho2 ? std::uint32_t(std::int32_t(w)) : 0;
            weights += whole;
            total += Sums<T>::term(whole, points.values[i]);
        }
        weight += weights;
        sum += total;
    }
    GB_FN T value(HoleWeights kind) const {
        return Sums<T>::quotient(sum, kind == HoleWeights::normalized ? weight : std::uint64_t(n) << 24);
    }
};

/// VVN-OM: the cube grows from 3^3 until its inscribed sphere, rho = half its edge, holds a point.
template <class T> struct GatherSphere {
    HoleFiller<T> filler;  ///< for its masks; its values are not used
    SortedPoints<T> points;
    const std::uint32_t *first, *last;

    GB_FN std::uint8_t at(Cell block, int place, T& out) const {
        const Cell l = Block::inside(place);
        for (int r = 1; r <= filler.tables.cubes.reach; ++r) {
            Sphere<T> sphere{points, (r + 0.5f) * (r + 0.5f)};
            for_each_run(block, l, r, [&](std::uint32_t from, std::uint32_t to, Cell d) { sphere.look(from, to, d); });
            if (!sphere.n) continue;
            for_each_run(block, l, r, [&](std::uint32_t from, std::uint32_t to, Cell d) { sphere.add(from, to, d); });
            out = sphere.value(filler.tables.kind);
            return std::uint8_t(r);
        }
        out = T{};
        return kFar;
    }
    template <class Visit> GB_FN void for_each_run(Cell around, Cell l, int r, const Visit& visit) const {
        filler.for_each_hit(around, l, r, [&](Cell away, std::size_t block, std::uint64_t hits) {
            for (; hits; hits &= hits - 1) {
                const int u = trailing_zeros(hits);
                const std::size_t bin = std::size_t(filler.bins.slots[block]) * kVoxels + u;
                visit(first[bin], last[bin], Block::voxel(away, u) - l);
            }
        });
    }
};

template <class T> struct GatherVoxel {
    GatherSphere<T> gather;
    DenseVolume<T> out;
    const std::uint32_t* near;
    GB_FN bool skips(std::size_t) const { return false; }
    GB_FN void operator()(Cell b, std::size_t block, int place) const {
        const Grid& grid = gather.filler.bins.grid;
        const Cell v = Block::voxel(b, place);
        if (!grid.has_voxel(v)) return;
        const std::size_t at = grid.voxel(v);
        T value{};
        const std::uint8_t r = near[block] ? gather.at(b, place, value) : kFar;
        out.values[at] = value;
        out.radius[at] = gather.filler.bins.masks[block] >> place & 1 ? 0 : r;
    }
};
}  // namespace globule::core::sweep
