// Reconstruction by Bezier curves (Huang et al., IEEE Trans. Human-Machine Systems 45, 2015): the
// pixels at one image position in four consecutive images are the control points of a cubic, both in
// space and in value; voxels along it take the mean of its samples.  Consecutive curves share an image.
#pragma once
#include <cmath>

#include "sweep/between.hpp"

namespace globule::core::sweep {

inline constexpr std::uint32_t kCurve = kMostFilled + 1, kPixel = kCurve;

template <class T> struct BezierRows {
    Images<T> images;
    Grid grid;
    double scale;  ///< samples are summed as rint(value * scale)
    const std::uint32_t* slots;
    std::uint32_t* wanted;    ///< first run: blocks that samples need
    std::uint64_t* bins;      ///< second run: (slots, 64, 2) sums and counts
    std::uint32_t* nearness;  ///< (slots, 64) kCurve less the smallest distance of a sample from a pixel, voxels

    /// Row `i % height` of curve `i / height`.
    GB_FN void operator()(std::size_t i) const {
        const int row = int(i % images.height), start = 3 * int(i / images.height);
        const int degree = min(3, images.n - 1 - start);
        for (int column = 0; column < images.width; ++column)
            if (!images.mask || images.mask[std::size_t(row) * images.width + column])
                curve(start, degree, row, column);
    }
    GB_FN void curve(int start, int degree, int row, int column) const {
        double p[4][3] = {}, v[4] = {};
        double length = 0;
        for (int f = 0; f <= degree; ++f) {
            const Pose& pose = images.poses[start + f];
            v[f] = images.values[(std::size_t(start + f) * images.height + row) * images.width + column];
            double step = 0;
            for (int k = 0; k < 3; ++k) {
                p[f][k] = double(pose.origin[k] + row * pose.y[k] + column * pose.x[k]) * 0x1p-32;
                if (f) step = max(step, abs(p[f][k] - p[f - 1][k]));
            }
            length += step;
        }
        const int n = int(min(length, 1e6)) + 1;  // steps of at most a voxel
        for (int s = 0; s < n + (start + degree == images.n - 1); ++s) {
            double b[4];
            bernstein(degree, double(s) / n, b);
            double at[3] = {}, value = 0;
            for (int f = 0; f <= degree; ++f) {
                value += b[f] * v[f];
                for (int k = 0; k < 3; ++k) at[k] += b[f] * p[f][k];
            }
            double distance = kMostFilled;
            for (int f = 0; f <= degree; ++f)
                distance = min(distance, max(abs(at[0] - p[f][0]), max(abs(at[1] - p[f][1]), abs(at[2] - p[f][2]))));
            put(at, value, max(int(ceil(distance)), 1));
        }
    }
    GB_FN static void bernstein(int degree, double t, double* b) {
        const double u = 1 - t;
        if (degree == 3) {
            b[0] = u * u * u;
            b[1] = 3 * u * u * t;
            b[2] = 3 * u * t * t;
            b[3] = t * t * t;
        } else if (degree == 2) {
            b[0] = u * u;
            b[1] = 2 * u * t;
            b[2] = t * t;
        } else {
            b[0] = degree ? u : 1;
            b[1] = t;
        }
    }
    GB_FN void put(const double* at, double value, int distance) const {
        int c[3];
        for (int k = 0; k < 3; ++k) {
            if (!(at[k] >= 0 && at[k] < grid.size[k])) return;
            c[k] = int(at[k]);
        }
        const Cell v{c[0], c[1], c[2]};
        const std::size_t block = grid.block(Block::of(v));
        if (wanted) {
            if (slots[block] == kNone) raise_flag(wanted + block);
            return;
        }
        const std::size_t bin = std::size_t(slots[block]) * kVoxels + Block::place(v);
        atomic_add(bins + 2 * bin, std::uint64_t(std::int64_t(rint(value * scale))));
        atomic_add(bins + 2 * bin + 1, 1);
        atomic_max(nearness + bin, kCurve - std::uint32_t(distance));
    }
};

/// Voxels that hold pixels and no sample take the mean of the pixels.
template <class T> struct BinPixelsOffCurves {
    Images<T> images;
    Grid grid;
    double scale;
    const std::uint32_t* slots;
    const std::uint32_t* nearness;
    std::uint64_t* bins;
    GB_FN void operator()(std::size_t row) const {
        for_each_pixel(images, row, grid, [&](std::size_t block, int voxel, int column) {
            const std::size_t bin = std::size_t(slots[block]) * kVoxels + voxel;
            if (nearness[bin]) return;
            atomic_add(bins + 2 * bin,
                std::uint64_t(std::int64_t(rint(double(images.values[row * images.width + column]) * scale))));
            atomic_add(bins + 2 * bin + 1, 1);
        });
    }
};
/// Marks the voxels that pixels lie in.
template <class T> struct MarkPixels {
    Images<T> images;
    Grid grid;
    const std::uint32_t* slots;
    std::uint32_t* nearness;
    GB_FN void operator()(std::size_t row) const {
        for_each_pixel(images, row, grid, [&](std::size_t block, int voxel, int) {
            atomic_max(nearness + std::size_t(slots[block]) * kVoxels + voxel, kPixel);
        });
    }
};
/// Voxels that curves cross without a pixel in them are filled, not measured.
template <class T> struct LabelCurves {
    Grid grid;
    const std::uint32_t* block_of_slot;
    const std::uint32_t* nearness;
    DenseVolume<T> out;
    GB_FN void operator()(std::size_t i) const {
        if (nearness[i] == 0 || nearness[i] == kPixel) return;
        const Cell v = Block::voxel(grid.block(std::size_t(block_of_slot[i / kVoxels])), int(i % kVoxels));
        if (grid.has_voxel(v)) out.radius[out.at(grid, v)] = std::uint8_t(kCurve - nearness[i]);
    }
};

}  // namespace globule::core::sweep
