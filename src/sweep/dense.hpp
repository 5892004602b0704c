// The volume of all voxels: as plain arrays, or in tiles of which only those near data are stored, so that
// it can grow without being moved: then only the table of tiles is.
#pragma once
#include "sweep/blocks.hpp"

namespace globule::core::sweep {

inline constexpr std::uint8_t kFar = 255;  ///< radius of a voxel that stays empty

inline constexpr int kTile = 64;          ///< voxels of a tile along x; kBlock along y and z
inline constexpr std::size_t kTileVoxels = kTile * kBlock * kBlock;

/// Tiles of a grid along x; along y and z they are its blocks.
GB_FN int tile_columns(const Grid& grid) { return ceil_div(grid.size[0], kTile); }
GB_FN std::size_t tile(const Grid& grid, int x, int y, int z) {
    return (std::size_t(z / kBlock) * grid.blocks[1] + y / kBlock) * tile_columns(grid) + x / kTile;
}

/// Values and radii of a whole grid.
template <class T>
struct DenseVolume {
    T* values;
    std::uint8_t* radius;
    const std::uint32_t* tiles = nullptr;  ///< null: (z, y, x); else where each tile lies, kNone if it is far from all data

    GB_FN bool holds(const Grid& grid, int x, int y, int z) const { return !tiles || tiles[tile(grid, x, y, z)] != kNone; }
    GB_FN std::size_t at(const Grid& grid, int x, int y, int z) const {
        if (!tiles) return grid.voxel(x, y, z);
        return tiles[tile(grid, x, y, z)] * kTileVoxels + (z % kBlock * kBlock + y % kBlock) * kTile + x % kTile;
    }
};

/// A place in a volume.
template <class T>
struct Corner {
    Grid grid;
    DenseVolume<T> volume;
    int first[3];
};

/// A row of a box of voxels, from one volume into the arrays of another; either may be left out.
template <class T>
struct CopyRow {
    Corner<T> from, to;
    int size[3];
    GB_FN void operator()(std::size_t row) const {
        const int y = int(row % size[1]), z = int(row / size[1]);
        const int j = from.first[1] + y, k = from.first[2] + z;
        std::size_t out = to.grid.voxel(to.first[0], to.first[1] + y, to.first[2] + z);
        for (int x = from.first[0], last = x + size[0]; x < last;) {
            const int n = from.volume.tiles ? min(last - x, kTile - x % kTile) : last - x;
            if (from.volume.holds(from.grid, x, j, k)) {
                const std::size_t in = from.volume.at(from.grid, x, j, k);
                if (to.volume.values) memcpy(to.volume.values + out, from.volume.values + in, n * sizeof(T));
                if (to.volume.radius) memcpy(to.volume.radius + out, from.volume.radius + in, n);
            } else {
                if (to.volume.values) memset(to.volume.values + out, 0, n * sizeof(T));
                if (to.volume.radius) memset(to.volume.radius + out, kFar, n);
            }
            x += n;
            out += n;
        }
    }
};

}  // namespace globule::core::sweep
