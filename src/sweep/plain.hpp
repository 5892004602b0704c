// The baselines without octree and keys, for comparison: PVN on a dense grid of bins, VVN on a dense
// grid of point lists.  Cubes are scanned from scratch at each size, as the source describes them.
#pragma once
#include "sweep/points.hpp"

namespace globule::core::sweep {

struct Cube {
    Cell lo, hi;  ///< inclusive
    GB_FN static Cube around(const Grid& grid, Cell c, int r) {
        return {{max(c.x - r, 0), max(c.y - r, 0), max(c.z - r, 0)},
            {min(c.x + r, grid.size[0] - 1), min(c.y + r, grid.size[1] - 1), min(c.z + r, grid.size[2] - 1)}};
    }
    /// visit(voxel)
    template <class Visit> GB_FN void for_each(const Visit& visit) const {
        for (int z = lo.z; z <= hi.z; ++z)
            for (int y = lo.y; y <= hi.y; ++y)
                for (int x = lo.x; x <= hi.x; ++x) visit(Cell{x, y, z});
    }
};

/// Sum and count of every voxel of the dense grid.
template <class T> struct BinPlain {
    Images<T> images;
    Grid grid;
    double scale;
    std::uint64_t* bins;  ///< (voxels, 2)
    GB_FN void operator()(std::size_t row) const {
        for_each_pixel(images, row, grid, [&](std::size_t b, int v, int column) {
            const std::size_t at = grid.voxel(Block::voxel(grid.block(b), v));
            atomic_add(bins + 2 * at, std::uint64_t(quantized(images.values[row * images.width + column], scale)));
            atomic_add(bins + 2 * at + 1, 1);
        });
    }
};
template <class T> struct FinishPlain {
    FinishBlock<T> finish;
    T* values;
    std::uint8_t* measured;
    GB_FN void operator()(std::size_t i) const {
        T value{};
        measured[i] = finish.finish(i, value);
        values[i] = value;
    }
};

template <class T> struct FillPlain {
    Grid grid;
    const T* values;
    const std::uint8_t* measured;
    HoleTables tables;
    DenseVolume<T> out;
    GB_FN void operator()(std::size_t i) const {
        out.values[i] = values[i];
        out.radius[i] = 0;
        if (measured[i]) return;
        const Cell middle = grid.voxel(i);
        out.radius[i] = kFar;
        for (int r = 1; r <= tables.cubes.reach; ++r) {
            const Cube cube = Cube::around(grid, middle, r);
            int sigma2 = 0;
            cube.for_each([&](Cell c) {
                if (measured[grid.voxel(c)]) sigma2 = max(sigma2, square(c - middle));
            });
            if (!sigma2) continue;
            typename Sums<T>::Total sum{};
            std::uint64_t weight = 0, n = 0;
            cube.for_each([&](Cell c) {
                const std::size_t at = grid.voxel(c);
                if (!measured[at]) return;
                const std::uint32_t w = tables.weight(sigma2, square(c - middle));
                sum += Sums<T>::term(w, values[at]);
                weight += w;
                ++n;
            });
            out.values[i] = Sums<T>::quotient(sum, tables.kind == HoleWeights::normalized ? weight : n << 24);
            out.radius[i] = std::uint8_t(r);
            return;
        }
    }
};

template <class T> struct GatherPlain {
    Grid grid;
    int reach;
    HoleWeights kind;
    SortedPoints<T> points;
    const std::uint32_t *first, *last;
    DenseVolume<T> out;
    GB_FN void operator()(std::size_t i) const {
        const Cell middle = grid.voxel(i);
        out.values[i] = T{};
        out.radius[i] = kFar;
        for (int r = 1; r <= reach; ++r) {
            const Cube cube = Cube::around(grid, middle, r);
            Sphere<T> sphere{points, (r + 0.5f) * (r + 0.5f)};
            cube.for_each([&](Cell c) {
                const std::size_t at = grid.voxel(c);
                sphere.look(first[at], last[at], c - middle);
            });
            if (!sphere.n) continue;
            cube.for_each([&](Cell c) {
                const std::size_t at = grid.voxel(c);
                sphere.add(first[at], last[at], c - middle);
            });
            out.values[i] = sphere.value(kind);
            out.radius[i] = std::uint8_t(last[i] > first[i] ? 0 : r);
            return;
        }
    }
};

}  // namespace globule::core::sweep
