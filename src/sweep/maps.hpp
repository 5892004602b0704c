// Records of where a value came from: how many pixels, how much they differ, the latest image.
#pragma once
#include "sweep/bin.hpp"

namespace globule::core::sweep {

/// Squares of the values, summed per voxel.
template <class T> struct SquareRows {
    Images<T> images;
    Grid grid;
    double scale;
    const std::uint32_t* slots;
    std::uint64_t* squares;  ///< (slots, 64)
    GB_FN void operator()(std::size_t row) const {
        for_each_pixel(images, row, grid, [&](std::size_t block, int voxel, int column) {
            const std::int64_t v = quantized(images.values[row * images.width + column], scale);
            atomic_add(squares + std::size_t(slots[block]) * kVoxels + voxel, std::uint64_t(v * v));
        });
    }
};

/// Writes one value a voxel of the occupied blocks into a dense map.
template <class Out, class Of> struct ScatterMap {
    Grid grid;
    const std::uint32_t* block_of_slot;
    Of of;
    Out* out;
    GB_FN void operator()(std::size_t i) const {
        const std::size_t block = block_of_slot[i / kVoxels];
        const Cell v = Block::voxel(grid.block(block), int(i % kVoxels));
        if (grid.has_voxel(v)) out[grid.voxel(v)] = of(i);
    }
};
struct CountOf {
    const std::uint64_t* bins;  ///< sums and counts
    GB_FN std::uint32_t operator()(std::size_t i) const { return std::uint32_t(bins[2 * i + 1]); }
};
struct VarianceOf {
    const std::uint64_t *bins, *squares;
    double scale;
    GB_FN float operator()(std::size_t i) const {
        const double n = double(bins[2 * i + 1]);
        if (n < 2) return 0;
        const double mean = double(std::int64_t(bins[2 * i])) / n;
        return float(max(double(squares[i]) / n - mean * mean, 0.0) / (scale * scale));
    }
};
struct SourceOf {
    const std::uint64_t* latest;
    std::uint32_t pixels;  ///< of an image
    GB_FN std::int32_t operator()(std::size_t i) const {
        return latest[i] ? std::int32_t((std::uint32_t(latest[i] >> 32) - 1) / pixels) : -1;
    }
};

}  // namespace globule::core::sweep
