// The holes of a tile of 64 x 4 x 4 voxels at once, for the CPU: the same sums as holes.hpp, in another order,
// which integers do not mind.
//
// A weight depends on d^2 = a^2 + b^2 + c^2 alone, so values at (+-a, +-b, +-c) are added up first:
// in x, then in y (where a and b may be swapped, too), then in z.  A voxel's cube of radius r then takes
// a handful of additions a lane instead of hundreds of look-ups.
#pragma once
#include <cstring>

#include "sweep/holes.hpp"

namespace globule::core::sweep {

template <class T>
struct LaneSum;
template <>
struct LaneSum<std::uint8_t> {
    using type = std::uint16_t;  ///< at most 48 values at one distance
};
template <>
struct LaneSum<std::uint16_t> {
    using type = std::uint32_t;
};

template <class T>
struct FillTile {
    static constexpr int kReach = kBlock;                  ///< largest radius: one block
    static constexpr int kLong = kTile, kHalo = kBlock + 2 * kReach;
    static constexpr int kPairs = (kReach + 1) * (kReach + 2) / 2;  ///< a <= b
    static constexpr int kLanes = 32, kMostClasses = 16;
    using S = typename LaneSum<T>::type;

    FillVoxel<T> each;

    struct Room {
        S values[kHalo][kHalo][kLong + 2 * kReach];  ///< 0 where not measured
        std::uint8_t known[kHalo][kHalo][kLong + 2 * kReach];
        S sums[kPairs][kHalo][kBlock][kLong];        ///< [a <= b][z][y][x]
        std::uint8_t counts[kPairs][kHalo][kBlock][kLong];
    };
    template <class Group>
    using Scratch = Room;

    /// Distances squared on the surface of the cube of radius r, ascending.
    struct Classes {
        int n;
        int d2[kMostClasses];
        int of[3 * kReach * kReach + 1];
    };
    static Classes classes_of(int r) {
        Classes out{};
        bool seen[3 * kReach * kReach + 1] = {};
        for (int b = 0; b <= r; ++b)
            for (int a = 0; a <= b; ++a) seen[r * r + a * a + b * b] = true;
        for (int d = 0; d <= 3 * r * r; ++d)
            if (seen[d]) {
                out.of[d] = out.n;
                out.d2[out.n++] = d;
            }
        return out;
    }

    template <class Group>
    void operator()(Group&, Room& scratch, std::size_t i) const {
        static const Classes classes[kReach + 1] = {classes_of(0), classes_of(1), classes_of(2), classes_of(3), classes_of(4)};
        const Grid& grid = each.filler.bins.grid;
        const int n_tiles = tile_columns(grid);
        const int tile = int(i % n_tiles), by = int(i / n_tiles % grid.blocks[1]), bz = int(i / n_tiles / grid.blocks[1]);
        const int x0 = tile * kLong, width = min(kLong, grid.size[0] - x0);
        bool any_near = false, any_dirty = !each.dirty;
        for (int x = x0 / kBlock; x < ceil_div(x0 + width, kBlock); ++x) {
            any_near |= each.near[grid.block(x, by, bz)] != 0;
            any_dirty |= each.dirty && each.dirty[grid.block(x, by, bz)];
        }
        if (!any_dirty || !each.out.holds(grid, x0, kBlock * by, kBlock * bz)) return;
        if (!any_near) {
            for_each_row(by, bz, [&](int y, int z) {
                const std::size_t at = each.out.at(grid, x0, y, z);
                memset(each.out.values + at, 0, width * sizeof(T));
                memset(each.out.radius + at, kFar, width);
            });
            return;
        }
        load(scratch, x0, by, bz);
        add_up(scratch);
        for_each_row(by, bz, [&](int y, int z) { fill_row(scratch, classes, x0, width, y, z); });
    }
    template <class Row>
    void for_each_row(int by, int bz, const Row& row) const {
        const Grid& grid = each.filler.bins.grid;
        for (int z = kBlock * bz; z < min(kBlock * (bz + 1), grid.size[2]); ++z)
            for (int y = kBlock * by; y < min(kBlock * (by + 1), grid.size[1]); ++y) row(y, z);
    }

    void load(Room& s, int x0, int by, int bz) const {
        const Bins<T>& bins = each.filler.bins;
        memset(s.values, 0, sizeof s.values);
        memset(s.known, 0, sizeof s.known);
        for (int dz = 0; dz < 3; ++dz)
            for (int dy = 0; dy < 3; ++dy)
                for (int dx = 0; dx < kLong / kBlock + 2; ++dx) {
                    const int x = x0 / kBlock + dx - 1, y = by + dy - 1, z = bz + dz - 1;
                    if (!bins.grid.has_block(x, y, z)) continue;
                    const std::size_t block = bins.grid.block(x, y, z);
                    const std::uint64_t mask = bins.masks[block];
                    if (!mask) continue;
                    const T* from = bins.values + std::size_t(bins.slots[block]) * kVoxels;
                    for (int v = 0; v < kVoxels; v += 4) {
                        const int k = 4 * dz + (v >> 4), j = 4 * dy + (v >> 2 & 3);
                        // Bit i of four becomes byte i; values without a bit are 0 already.
                        const std::uint32_t known = std::uint32_t((mask >> v & 15) * 0x00204081u) & 0x01010101u;
                        memcpy(&s.known[k][j][4 * dx], &known, 4);
                        for (int l = 0; l < 4; ++l) s.values[k][j][4 * dx + l] = from[v + l];
                    }
                }
    }

    static int pair(int a, int b) { return a < b ? b * (b + 1) / 2 + a : a * (a + 1) / 2 + b; }

    static void add_up(Room& s) {
        for (int z = 0; z < kHalo; ++z) {
            alignas(64) S sums[kReach + 1][kHalo][kLong];
            alignas(64) std::uint8_t counts[kReach + 1][kHalo][kLong];
            for (int a = 0; a <= kReach; ++a)
                for (int y = 0; y < kHalo; ++y) {
                    mirror(s.values[z][y] + kReach - a, s.values[z][y] + kReach + a, a != 0, sums[a][y]);
                    mirror(s.known[z][y] + kReach - a, s.known[z][y] + kReach + a, a != 0, counts[a][y]);
                }
            for (int y = 0; y < kBlock; ++y)
                for (int b = 0; b <= kReach; ++b)
                    for (int a = 0; a <= b; ++a) {
                        both(sums, a, b, y + kReach, s.sums[pair(a, b)][z][y]);
                        both(counts, a, b, y + kReach, s.counts[pair(a, b)][z][y]);
                    }
        }
    }
    template <class U>
    static void mirror(const U* left, const U* right, bool two, U* out) {
        for (int x = 0; x < kLong; ++x) out[x] = U(left[x] + (two ? right[x] : U(0)));
    }
    /// Values at (+-a, +-b) and (+-b, +-a).
    template <class U>
    static void both(const U (*in)[kHalo][kLong], int a, int b, int y, U* out) {
        const U *p = in[a][y - b], *q = in[a][y + b], *u = in[b][y - a], *v = in[b][y + a];
        if (b == 0) memcpy(out, p, kLong * sizeof(U));
        else if (a == b)
            for (int x = 0; x < kLong; ++x) out[x] = U(p[x] + q[x]);
        else if (a == 0)
            for (int x = 0; x < kLong; ++x) out[x] = U(p[x] + q[x] + u[x]);
        else
            for (int x = 0; x < kLong; ++x) out[x] = U(p[x] + q[x] + u[x] + v[x]);
    }

    void fill_row(const Room& s, const Classes* classes, int x0, int width, int y, int z) const {
        const std::size_t base = each.out.at(each.filler.bins.grid, x0, y, z);
        const int j = y & 3, k = (z & 3) + kReach;
        for (int x = 0; x < width; x += kLanes) {
            const int n = min(kLanes, width - x);
            if (!is_dirty(x0 + x, n, y, z)) continue;
            int open = 0;
            alignas(64) std::uint8_t hole[kLanes] = {};
            for (int l = 0; l < n; ++l) {
                const bool known = s.known[k][j + kReach][x + l + kReach];
                each.out.values[base + x + l] = T(s.values[k][j + kReach][x + l + kReach]);
                each.out.radius[base + x + l] = known ? 0 : kFar;
                hole[l] = !known;
                open += !known;
            }
            for (int r = 1; r <= each.filler.tables.cubes.reach && open; ++r)
                open -= fill_lanes(s, classes[r], r, x, j, k, hole, base + x);
        }
    }

    bool is_dirty(int x, int n, int y, int z) const {
        if (!each.dirty) return true;
        const std::size_t row = each.filler.bins.grid.block(0, y / kBlock, z / kBlock);
        std::uint32_t any = 0;
        for (int b = x / kBlock; b < ceil_div(x + n, kBlock); ++b) any |= each.dirty[row + b];
        return any;
    }

    /// The lanes whose cube of radius r is the first to hold something; how many.
    int fill_lanes(const Room& s, const Classes& classes, int r, int x, int j, int k, std::uint8_t* hole, std::size_t base) const {
        alignas(64) S sums[kMostClasses][kLanes];
        alignas(64) std::uint8_t counts[kMostClasses][kLanes];
        memset(sums, 0, classes.n * sizeof sums[0]);
        memset(counts, 0, classes.n * sizeof counts[0]);
        for (int b = 0; b <= r; ++b)
            for (int a = 0; a <= b; ++a)
                for (int c = b == r ? 0 : r; c <= r; ++c) {
                    const int at = classes.of[a * a + b * b + c * c], p = pair(a, b);
                    add(s.sums[p][k - c][j] + x, s.sums[p][k + c][j] + x, c != 0, sums[at]);
                    add(s.counts[p][k - c][j] + x, s.counts[p][k + c][j] + x, c != 0, counts[at]);
                }
        alignas(64) std::uint8_t found[kLanes] = {};
        for (int at = 0; at < classes.n; ++at)
            for (int l = 0; l < kLanes; ++l) found[l] |= counts[at][l];
        int n = 0;
        for (int l = 0; l < kLanes; ++l) {
            if (!found[l] || !hole[l]) continue;
            hole[l] = 0;
            ++n;
            int last = classes.n - 1;
            while (!counts[last][l]) --last;
            std::uint64_t sum = 0, weight = 0, known = 0;
            for (int at = 0; at <= last; ++at) {
                const std::uint64_t w = each.filler.tables.weight(classes.d2[last], classes.d2[at]);
                sum += w * sums[at][l];
                weight += w * counts[at][l];
                known += counts[at][l];
            }
            if (each.filler.tables.kind == HoleWeights::printed) weight = known << 24;
            each.out.values[base + l] = Sums<T>::quotient(sum, weight);
            each.out.radius[base + l] = std::uint8_t(r);
        }
        return n;
    }
    template <class U>
    static void add(const U* p, const U* q, bool two, U* out) {
        if (two)
            for (int l = 0; l < kLanes; ++l) out[l] = U(out[l] + p[l] + q[l]);
        else
            for (int l = 0; l < kLanes; ++l) out[l] = U(out[l] + p[l]);
    }
};

}  // namespace globule::core::sweep
