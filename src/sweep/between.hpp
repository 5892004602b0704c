// Which filled voxels lie between data: on a straight line along an axis or a diagonal, measured voxels lie on both
// sides within the kernel's reach.  The others are extrapolated: they are emptied, or labeled.  Rows of 64 voxels are
// words of bits.
#pragma once
#include "sweep/dense.hpp"
#include "sweep/holes.hpp"

namespace globule::core::sweep {

inline constexpr int kMostFilled = 126;             ///< largest radius of a filled voxel
inline constexpr std::uint8_t kExtrapolated = 128;  ///< added to the radius of an extrapolated voxel

/// Measured voxels, 64 along x a word.
struct Words {
    int n, ny, nz;  ///< words of a row
    std::uint64_t* bits;

    std::size_t size() const { return std::size_t(n) * ny * nz; }
    GB_FN std::uint64_t word(int w, std::size_t row) const { return w >= 0 && w < n ? bits[row * n + w] : 0; }
    /// Bit i: whether voxel (64 w + i + dx, y, z) is measured.
    GB_FN std::uint64_t at(int w, int y, int z, int dx) const {
        if (y < 0 || y >= ny || z < 0 || z >= nz) return 0;
        const std::size_t row = std::size_t(z) * ny + y;
        const int first = w + (dx >> 6), shift = dx & 63;
        const std::uint64_t low = word(first, row) >> shift;
        return shift ? low | word(first + 1, row) << (64 - shift) : low;
    }
};

template <class T> struct MarkMeasured {
    Grid grid;
    Words words;
    DenseVolume<T> volume;
    GB_FN void operator()(std::size_t i) const {
        const Cell v{int(i % words.n) * kTile, int(i / words.n % words.ny), int(i / words.n / words.ny)};
        std::uint64_t bits = 0;
        if (volume.holds(grid, v)) {
            const std::uint8_t* radius = volume.radius + volume.at(grid, v);
            for (int l = 0; l < min(kTile, grid.size[0] - v.x); ++l) bits |= std::uint64_t(radius[l] == 0) << l;
        }
        words.bits[i] = bits;
    }
};

template <class T> struct KeepBetween {
    MarkMeasured<T> measured;
    int reach;
    bool extrapolate;            ///< label the others instead of emptying them
    const std::uint32_t* dirty;  ///< per block: 0 where nothing changed since; null: all may have

    GB_FN void operator()(std::size_t i) const {
        const Grid& grid = measured.grid;
        const Words& words = measured.words;
        const DenseVolume<T>& out = measured.volume;
        const int w = int(i % words.n), y = int(i / words.n % words.ny), z = int(i / words.n / words.ny);
        const Cell v{w * kTile, y, z};
        if (!out.holds(grid, v)) return;
        const int n = min(kTile, grid.size[0] - v.x);
        if (dirty) {
            std::uint32_t any = 0;
            for (int x = 0; x < n; x += kBlock) any |= dirty[grid.block(Block::of({v.x + x, y, z}))];
            if (!any) return;
        }
        const std::size_t first = out.at(grid, v);
        std::uint64_t open = 0;  // filled, and not known to lie between
        for (int l = 0; l < n; ++l) open |= std::uint64_t(std::uint8_t(out.radius[first + l] - 1) < kMostFilled) << l;
        for (int direction = 14; direction < 27 && open; ++direction) {
            const int dx = direction % 3 - 1, dy = direction / 3 % 3 - 1, dz = direction / 9 - 1;
            std::uint64_t ahead = 0, behind = 0;
            for (int s = 1; s <= reach; ++s) {
                ahead |= words.at(w, y + s * dy, z + s * dz, s * dx);
                behind |= words.at(w, y - s * dy, z - s * dz, -s * dx);
            }
            open &= ~(ahead & behind);
        }
        for (; open; open &= open - 1) {
            const std::size_t at = first + trailing_zeros(open);
            if (extrapolate) {
                out.radius[at] = std::uint8_t(out.radius[at] + kExtrapolated);
            } else {
                out.radius[at] = kFar;
                out.values[at] = T{};
            }
        }
    }
};

}  // namespace globule::core::sweep
