// The volume of all voxels: as plain arrays, or in tiles of which only those near data are stored, so that
// it can grow without being moved: then only the table of tiles is.
#pragma once
#include "sweep/blocks.hpp"

namespace globule::core::sweep {

inline constexpr std::uint8_t kFar = 255;  ///< radius of a voxel that stays empty

inline constexpr int kTile = 64;  ///< voxels of a tile along x; kBlock along y and z
inline constexpr std::size_t kTileVoxels = kTile * kBlock * kBlock;

/// Tiles of a grid along x; along y and z they are its blocks.
GB_FN int tile_columns(const Grid& grid) { return ceil_div(grid.size[0], kTile); }
GB_FN std::size_t tile(const Grid& grid, Cell voxel) {
    const Cell b = Block::of(voxel);
    return (std::size_t(b.z) * grid.blocks[1] + b.y) * tile_columns(grid) + voxel.x / kTile;
}

/// Values and radii of a whole grid.
template <class T> struct DenseVolume {
    T* values;
    std::uint8_t* radius;
    const std::uint32_t* tiles =
        nullptr;  ///< null: (z, y, x); else where each tile lies, kNone if it is far from all data

    GB_FN bool holds(const Grid& grid, Cell v) const { return !tiles || tiles[tile(grid, v)] != kNone; }
    GB_FN std::size_t at(const Grid& grid, Cell v) const {
        if (!tiles) return grid.voxel(v);
        return tiles[tile(grid, v)] * kTileVoxels + (v.z % kBlock * kBlock + v.y % kBlock) * kTile + v.x % kTile;
    }
};

/// A place in a volume.
template <class T> struct Corner {
    Grid grid;
    DenseVolume<T> volume;
    int first[3];
};

/// A row of a box of voxels, from one volume into the arrays of another; either may be left out.
template <class T> struct CopyRow {
    Corner<T> from, to;
    int size[3];
    GB_FN void operator()(std::size_t row) const {
        const int y = int(row % size[1]), z = int(row / size[1]);
        std::size_t out = to.grid.voxel(Cell{to.first[0], to.first[1] + y, to.first[2] + z});
        Cell v{from.first[0], from.first[1] + y, from.first[2] + z};
        for (const int last = v.x + size[0]; v.x < last;) {
            const int n = from.volume.tiles ? min(last - v.x, kTile - v.x % kTile) : last - v.x;
            if (from.volume.holds(from.grid, v)) {
                const std::size_t in = from.volume.at(from.grid, v);
                if (to.volume.values) memcpy(to.volume.values + out, from.volume.values + in, n * sizeof(T));
                if (to.volume.radius) memcpy(to.volume.radius + out, from.volume.radius + in, n);
            } else {
                if (to.volume.values) memset(to.volume.values + out, 0, n * sizeof(T));
                if (to.volume.radius) memset(to.volume.radius + out, kFar, n);
            }
            v.x += n;
            out += n;
        }
    }
};

}  // namespace globule::core::sweep
