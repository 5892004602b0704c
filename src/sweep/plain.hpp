// The baselines without octree and keys, for comparison: PVN on a dense grid of bins, VVN on a dense
// grid of point lists.  Cubes are scanned from scratch at each size, as the source describes them.
#pragma once
#include "sweep/points.hpp"

namespace globule::core::sweep {

struct Cube {
    int lo[3], hi[3];  ///< inclusive
    GB_FN static Cube around(const Grid& grid, int x, int y, int z, int r) {
        return {{max(x - r, 0), max(y - r, 0), max(z - r, 0)},
                {min(x + r, grid.size[0] - 1), min(y + r, grid.size[1] - 1), min(z + r, grid.size[2] - 1)}};
    }
    template <class Visit>
    GB_FN void for_each(const Visit& visit) const {
        for (int k = lo[2]; k <= hi[2]; ++k)
            for (int j = lo[1]; j <= hi[1]; ++j)
                for (int i = lo[0]; i <= hi[0]; ++i) visit(i, j, k);
    }
};

/// Sum and count of every voxel of the dense grid.
template <class T>
struct BinPlain {
    Frames<T> frames;
    Grid grid;
    double scale;
    std::uint64_t* bins;  ///< (voxels, 2)
    GB_FN void operator()(std::size_t row) const {
        for_each_pixel(frames, row, grid, [&](std::size_t b, int v, int column) {
            const std::size_t at = grid.voxel(4 * int(b % grid.blocks[0]) + (v & 3), 4 * int(b / grid.blocks[0] % grid.blocks[1]) + (v >> 2 & 3),
                                              4 * int(b / grid.blocks[0] / grid.blocks[1]) + (v >> 4));
            atomic_add(bins + 2 * at, std::uint64_t(quantized(frames.values[row * frames.width + column], scale)));
            atomic_add(bins + 2 * at + 1, 1);
        });
    }
};
template <class T>
struct FinishPlain {
    FinishBlock<T> finish;
    T* values;
    std::uint8_t* measured;
    GB_FN void operator()(std::size_t i) const {
        T value{};
        measured[i] = finish.finish(i, value);
        values[i] = value;
    }
};

template <class T>
struct FillPlain {
    Grid grid;
    const T* values;
    const std::uint8_t* measured;
    HoleTables tables;
    DenseVolume<T> out;
    GB_FN void operator()(std::size_t i) const {
        out.values[i] = values[i];
        out.radius[i] = 0;
        if (measured[i]) return;
        const int x = int(i % grid.size[0]), y = int(i / grid.size[0] % grid.size[1]), z = int(i / grid.size[0] / grid.size[1]);
        out.radius[i] = kFar;
        for (int r = 1; r <= tables.cubes.reach; ++r) {
            const Cube cube = Cube::around(grid, x, y, z, r);
            int sigma2 = 0;
            cube.for_each([&](int a, int b, int c) {
                if (measured[grid.voxel(a, b, c)]) sigma2 = max(sigma2, distance2(a - x, b - y, c - z));
            });
            if (!sigma2) continue;
            typename Sums<T>::Total sum{};
            std::uint64_t weight = 0, n = 0;
            cube.for_each([&](int a, int b, int c) {
                const std::size_t at = grid.voxel(a, b, c);
                if (!measured[at]) return;
                const std::uint32_t w = tables.weight(sigma2, distance2(a - x, b - y, c - z));
                sum += Sums<T>::term(w, values[at]);
                weight += w;
                ++n;
            });
            out.values[i] = Sums<T>::quotient(sum, tables.kind == HoleWeights::normalized ? weight : n << 24);
            out.radius[i] = std::uint8_t(r);
            return;
        }
    }
    GB_FN static int distance2(int a, int b, int c) { return a * a + b * b + c * c; }
};

template <class T>
struct GatherPlain {
    Grid grid;
    int reach;
    HoleWeights kind;
    SortedPoints<T> points;
    const std::uint32_t *first, *last;
    DenseVolume<T> out;
    GB_FN void operator()(std::size_t i) const {
        const int x = int(i % grid.size[0]), y = int(i / grid.size[0] % grid.size[1]), z = int(i / grid.size[0] / grid.size[1]);
        out.values[i] = T{};
        out.radius[i] = kFar;
        for (int r = 1; r <= reach; ++r) {
            const Cube cube = Cube::around(grid, x, y, z, r);
            Sphere<T> sphere{points, (r + 0.5f) * (r + 0.5f)};
            cube.for_each([&](int a, int b, int c) {
                const std::size_t at = grid.voxel(a, b, c);
                sphere.look(first[at], last[at], a - x, b - y, c - z);
            });
            if (!sphere.n) continue;
            cube.for_each([&](int a, int b, int c) {
                const std::size_t at = grid.voxel(a, b, c);
                sphere.add(first[at], last[at], a - x, b - y, c - z);
            });
            out.values[i] = sphere.value(kind);
            out.radius[i] = std::uint8_t(last[i] > first[i] ? 0 : r);
            return;
        }
    }
};

}  // namespace globule::core::sweep
