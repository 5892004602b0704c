// The holes of a tile of 64 x 4 x 4 voxels at once, for the CPU: the same sums as holes.hpp, in another order,
// which integers do not mind.
//
//   load     the tile's voxels and those up to a reach around them: values, 0 where there is none, and what is known
//   add_up   for each voxel (x, y) and each pair a <= b: what lies at (+-a, +-b) and (+-b, +-a) of it, by row and plane
//   fill     radius by radius, 32 voxels of a row as lanes: sums of planes +-c give those of the distances d^2 = a^2 +
//   b^2 + c^2,
//            on which alone a weight depends; lanes whose cube holds something first get its weighted mean
//
// A voxel's cube of radius r so takes a handful of additions a lane instead of hundreds of look-ups.
#pragma once
#include <cstring>

#include "sweep/holes.hpp"

namespace globule::core::sweep {

template <class T> struct LaneSum;
template <> struct LaneSum<std::uint8_t> {
    using type = std::uint16_t;  ///< at most 48 values at one distance
};
template <> struct LaneSum<std::uint16_t> { using type = std::uint32_t; };

/// What the surface of a cube of radius r has of distances: their squares, ascending.
struct Distances {
    static constexpr int kMost = 16, kFarthest = 3 * kBlock * kBlock;
    int n = 0;
    int d2[kMost] = {};
    int number[kFarthest + 1] = {};  ///< of a squared distance among them

    explicit Distances(int r) {
        bool seen[kFarthest + 1] = {};
        for (int b = 0; b <= r; ++b)
            for (int a = 0; a <= b; ++a) seen[r * r + a * a + b * b] = true;
        for (int d = 0; d <= 3 * r * r; ++d)
            if (seen[d]) {
                number[d] = n;
                d2[n++] = d;
            }
    }
};

template <class T> struct FillTile {
    static constexpr int kReach = kBlock;  ///< largest radius: one block
    static constexpr int kLong = kTile, kHalo = kBlock + 2 * kReach;
    static constexpr int kPairs = (kReach + 1) * (kReach + 2) / 2;  ///< a <= b
    static constexpr int kLanes = 32;
    using S = typename LaneSum<T>::type;

    FillVoxel<T> each;

    struct Room {
        S values[kHalo][kHalo][kLong + 2 * kReach];  ///< 0 where not measured
        std::uint8_t known[kHalo][kHalo][kLong + 2 * kReach];
        S sums[kPairs][kHalo][kBlock][kLong];  ///< [a <= b][z][y][x]
        std::uint8_t counts[kPairs][kHalo][kBlock][kLong];
    };
    template <class Group> using Scratch = Room;

    template <class Group> void operator()(Group&, Room& room, std::size_t i) const {
        const Grid& grid = each.filler.bins.grid;
        const int columns = tile_columns(grid);
        const Cell tile{int(i % columns), int(i / columns % grid.blocks[1]), int(i / columns / grid.blocks[1])};
        const Cell first{tile.x * kLong, tile.y * kBlock, tile.z * kBlock};
        const int width = min(kLong, grid.size[0] - first.x);
        if (!is_dirty(first, width) || !each.out.holds(grid, first)) return;
        if (is_near(first, width)) {
            load(room, Block::of(first));
            add_up(room);
            for_each_row(first, [&](Cell row) { fill_row(room, row, width); });
        } else {
            for_each_row(first, [&](Cell row) { set_empty(row, width); });
        }
    }

private:
    /// row(its first voxel)
    template <class Row> void for_each_row(Cell first, const Row& row) const {
        const Grid& grid = each.filler.bins.grid;
        for (int z = first.z; z < min(first.z + kBlock, grid.size[2]); ++z)
            for (int y = first.y; y < min(first.y + kBlock, grid.size[1]); ++y) row(Cell{first.x, y, z});
    }
    /// Whether any of the blocks that n voxels from the first on lie in is flagged.
    bool any_block(const std::uint32_t* flags, Cell first, int n) const {
        const std::uint32_t* row = flags + each.filler.bins.grid.block(Cell{0, first.y / kBlock, first.z / kBlock});
        std::uint32_t any = 0;
        for (int b = first.x / kBlock; b < ceil_div(first.x + n, kBlock); ++b) any |= row[b];
        return any;
    }
    bool is_near(Cell first, int n) const { return any_block(each.near, first, n); }
    bool is_dirty(Cell first, int n) const { return !each.dirty || any_block(each.dirty, first, n); }

    void set_empty(Cell row, int width) const {
        const std::size_t at = each.out.at(each.filler.bins.grid, row);
        memset(each.out.values + at, 0, width * sizeof(T));
        memset(each.out.radius + at, kFar, width);
    }

    void load(Room& s, Cell first) const {
        memset(s.values, 0, sizeof s.values);
        memset(s.known, 0, sizeof s.known);
        for (int z = 0; z < 3; ++z)
            for (int y = 0; y < 3; ++y)
                for (int x = 0; x < kLong / kBlock + 2; ++x)
                    load_block(s, first + Cell{x - 1, y - 1, z - 1}, Cell{x, y, z});
    }
    static constexpr int kRow = kBlock;  ///< voxels of a block that lie side by side
    /// A block of the grid into the room's block `to`.
    void load_block(Room& s, Cell from, Cell to) const {
        const Bins<T>& bins = each.filler.bins;
        if (!bins.grid.has_block(from)) return;
        const std::size_t block = bins.grid.block(from);
        const std::uint64_t mask = bins.masks[block];
        if (!mask) return;
        const T* values = bins.values + std::size_t(bins.slots[block]) * kVoxels;
        for (int place = 0; place < kVoxels; place += kRow) {
            const Cell c = Block::voxel(to, place);
            // Bit i of four becomes byte i; values without a bit are 0 already.
            const std::uint32_t known = std::uint32_t((mask >> place & 15) * 0x00204081u) & 0x01010101u;
            memcpy(&s.known[c.z][c.y][c.x], &known, kRow);
            for (int l = 0; l < kRow; ++l) s.values[c.z][c.y][c.x + l] = values[place + l];
        }
    }

    static int pair(int a, int b) { return a < b ? b * (b + 1) / 2 + a : a * (a + 1) / 2 + b; }

    static void add_up(Room& s) {
        for (int z = 0; z < kHalo; ++z) {
            alignas(64) S sums[kReach + 1][kHalo][kLong];  // [a][y][x]: at x - a and x + a
            alignas(64) std::uint8_t counts[kReach + 1][kHalo][kLong];
            for (int a = 0; a <= kReach; ++a)
                for (int y = 0; y < kHalo; ++y) {
                    mirror(s.values[z][y] + kReach - a, s.values[z][y] + kReach + a, a != 0, sums[a][y]);
                    mirror(s.known[z][y] + kReach - a, s.known[z][y] + kReach + a, a != 0, counts[a][y]);
                }
            for (int y = 0; y < kBlock; ++y)
                for (int b = 0; b <= kReach; ++b)
                    for (int a = 0; a <= b; ++a) {
                        mirror_both(sums, a, b, y + kReach, s.sums[pair(a, b)][z][y]);
                        mirror_both(counts, a, b, y + kReach, s.counts[pair(a, b)][z][y]);
                    }
        }
    }
    template <class U> static void mirror(const U* left, const U* right, bool two, U* out) {
        for (int x = 0; x < kLong; ++x) out[x] = U(left[x] + (two ? right[x] : U(0)));
    }
    /// What is at (+-a, +-b) and (+-b, +-a), each place once: two of the four, or three, are the same where a or b is 0
    /// or a = b.
    template <class U> static void mirror_both(const U (*in)[kHalo][kLong], int a, int b, int y, U* out) {
        const U *p = in[a][y - b], *q = in[a][y + b], *u = in[b][y - a], *v = in[b][y + a];
        if (b == 0) memcpy(out, p, kLong * sizeof(U));
        else if (a == b)
            for (int x = 0; x < kLong; ++x) out[x] = U(p[x] + q[x]);
        else if (a == 0)
            for (int x = 0; x < kLong; ++x) out[x] = U(p[x] + q[x] + u[x]);
        else
            for (int x = 0; x < kLong; ++x) out[x] = U(p[x] + q[x] + u[x] + v[x]);
    }

    void fill_row(const Room& s, Cell row, int width) const {
        static const Distances distances[kReach + 1] = {
            Distances(0), Distances(1), Distances(2), Distances(3), Distances(4)};
        const std::size_t base = each.out.at(each.filler.bins.grid, row);
        const int j = row.y & 3, k = (row.z & 3) + kReach;
        for (int x = 0; x < width; x += kLanes) {
            const int n = min(kLanes, width - x);
            if (!is_dirty({row.x + x, row.y, row.z}, n)) continue;
            alignas(64) std::uint8_t hole[kLanes] = {};
            int open = copy_known(s, x, j, k, n, hole, base + x);
            for (int r = 1; r <= each.filler.tables.cubes.reach && open; ++r)
                open -= fill_lanes(s, distances[r], r, x, j, k, hole, base + x);
        }
    }
    /// Measured values; holes are left empty and marked.  How many.
    int copy_known(const Room& s, int x, int j, int k, int n, std::uint8_t* hole, std::size_t base) const {
        int open = 0;
        for (int l = 0; l < n; ++l) {
            const bool known = s.known[k][j + kReach][x + l + kReach];
            each.out.values[base + l] = T(s.values[k][j + kReach][x + l + kReach]);
            each.out.radius[base + l] = known ? 0 : kFar;
            hole[l] = !known;
            open += !known;
        }
        return open;
    }

    /// Sums and numbers by distance, of 32 voxels.
    struct ByDistance {
        alignas(64) S sums[Distances::kMost][kLanes];
        alignas(64) std::uint8_t counts[Distances::kMost][kLanes];
    };
    /// The lanes whose cube of radius r is the first to hold something; how many.
    int fill_lanes(const Room& s, const Distances& distances, int r, int x, int j, int k, std::uint8_t* hole,
        std::size_t base) const {
        ByDistance by;
        add_surface(s, distances, r, x, j, k, by);
        alignas(64) std::uint8_t found[kLanes] = {};
        for (int at = 0; at < distances.n; ++at)
            for (int l = 0; l < kLanes; ++l) found[l] |= by.counts[at][l];
        int n = 0;
        for (int l = 0; l < kLanes; ++l) {
            if (!found[l] || !hole[l]) continue;
            hole[l] = 0;
            ++n;
            each.out.values[base + l] = weighted_mean(by, distances, l);
            each.out.radius[base + l] = std::uint8_t(r);
        }
        return n;
    }
    /// The surface of the cubes: (a, b, c) with one of them r; a <= b, since their order is in the sums already.
    static void add_surface(const Room& s, const Distances& distances, int r, int x, int j, int k, ByDistance& by) {
        memset(by.sums, 0, distances.n * sizeof by.sums[0]);
        memset(by.counts, 0, distances.n * sizeof by.counts[0]);
        for (int b = 0; b <= r; ++b)
            for (int a = 0; a <= b; ++a)
                for (int c = b == r ? 0 : r; c <= r; ++c) {
                    const int at = distances.number[a * a + b * b + c * c], p = pair(a, b);
                    add(s.sums[p][k - c][j] + x, s.sums[p][k + c][j] + x, c != 0, by.sums[at]);
                    add(s.counts[p][k - c][j] + x, s.counts[p][k + c][j] + x, c != 0, by.counts[at]);
                }
    }
    template <class U> static void add(const U* p, const U* q, bool two, U* out) {
        if (two)
            for (int l = 0; l < kLanes; ++l) out[l] = U(out[l] + p[l] + q[l]);
        else
            for (int l = 0; l < kLanes; ++l) out[l] = U(out[l] + p[l]);
    }
    T weighted_mean(const ByDistance& by, const Distances& distances, int lane) const {
        const HoleTables& tables = each.filler.tables;
        int last = distances.n - 1;  // the farthest: sigma
        while (!by.counts[last][lane]) --last;
        std::uint64_t sum = 0, weight = 0, known = 0;
        for (int at = 0; at <= last; ++at) {
            const std::uint64_t w = tables.weight(distances.d2[last], distances.d2[at]);
            sum += w * by.sums[at][lane];
            weight += w * by.counts[at][lane];
            known += by.counts[at][lane];
        }
        return Sums<T>::quotient(sum, tables.kind == HoleWeights::printed ? known << 24 : weight);
    }
};

}  // namespace globule::core::sweep
