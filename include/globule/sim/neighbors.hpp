// Neighbour lists from the octree: for each packet of consecutive rows one walk of the tree, whose
// candidates every row of the packet then tests.  The lists of a packet's rows are interleaved (sliced
// ELLPACK), a fixed number of places each, so that lanes and warps read them as vectors.
#pragma once
#include "globule/octree/query.hpp"
#include "globule/sim/state.hpp"

namespace globule::sim {

/// Rows are the particles that the solver moves, in slot order.
template <class Packet>
struct Lists {
    using Short = typename Packet::Short;
    std::size_t n_rows = 0;
    std::uint32_t places = 0;             ///< room of each list
    std::uint32_t n = 0;                  ///< particles; slot n is nobody's and far away, lists are padded with it
    const std::uint32_t* rows = nullptr;  ///< slot of each row, padded with n
    std::uint32_t* count = nullptr;       ///< per row
    std::uint32_t* index = nullptr;       ///< slots of the neighbours, in slot order
    Short *gx = nullptr, *gy = nullptr, *gz = nullptr;  ///< V_j grad W_ij of each, times the support

    /// Place of a row's k-th neighbour; the next one is Packet::stride further.
    GB_FN std::size_t at(std::size_t row, std::uint32_t k = 0) const {
        constexpr std::size_t s = Packet::stride;
        return (row / s * places + k) * s + row % s;
    }
};

/// Axes along which the domain repeats: its length there, else 0.
struct Period {
    float3 length{0, 0, 0};
    GB_FN bool any() const { return length.x > 0.0f || length.y > 0.0f || length.z > 0.0f; }
    GB_FN static float wrap(float x, float lo, float length) {
        return length > 0.0f ? (x < lo ? x + length : x >= lo + length ? x - length : x) : x;
    }
    /// From j to i the shorter way round.
    template <bool periodic, class F>
    GB_FN Vec3<F> shortest(const Vec3<F>& v) const {
        if constexpr (!periodic) return v;
        else return {one(v.x, length.x), one(v.y, length.y), one(v.z, length.z)};
    }
    /// fn(shift) for each copy of the domain that may hold neighbours.
    template <class Fn>
    GB_FN void each_image(const Fn& fn) const {
        const int nx = length.x > 0.0f, ny = length.y > 0.0f, nz = length.z > 0.0f;
        for (int x = -nx; x <= nx; ++x)
            for (int y = -ny; y <= ny; ++y)
                for (int z = -nz; z <= nz; ++z) fn(float3{x * length.x, y * length.y, z * length.z});
    }

private:
    template <class F>
    GB_FN static F one(const F& v, float length) {
        const float half = length > 0.0f ? 0.5f * length : infinity();
        return select(v > F(half), v - F(length), select(v < F(-half), v + F(length), v));
    }
};

/// Squared distances that float32 cannot tell from the support's: these pairs are decided in float64.
inline constexpr float kDoubt = 4e-6f;

template <class Tree, class Packet>
struct FindLists {
    struct Nothing {};
    template <class Group>
    using Scratch = Nothing;

    Tree tree;
    Lists<Packet> lists;
    const Quad* place;
    float support;         ///< of the smoothing kernel; the tree's boxes hold it
    Period period;
    std::uint32_t* most_count;

    template <class Group>
    GB_FN void operator()(Group& g, Nothing&, std::size_t tile) const {
        using F = typename Group::F;
        using B = typename Group::B;
        using U = typename Group::U;
        const std::size_t first = tile * Group::width;
        U slot, count;
        F x, y, z;
        Group::for_lanes([&](int lane) {
            const std::uint32_t s = lists.rows[first + g.lane_number(lane)];
            const Quad p = place[s];
            Group::put(slot, lane, s);
            Group::put(count, lane, 0u);
            Group::put(x, lane, p.x);
            Group::put(y, lane, p.y);
            Group::put(z, lane, p.z);
        });
        const float h2 = support * support;
        const F sure = F(h2 * (1.0f - kDoubt)), possible = F(h2 * (1.0f + kDoubt));
        std::uint32_t* out = lists.index + lists.at(first);
        const auto append = [&](int lane, std::uint32_t j) {
            const std::uint32_t k = Group::get(count, lane);
            if (k < lists.places) out[std::size_t(k) * Packet::stride + g.lane_number(lane)] = j;
            Group::put(count, lane, k + 1);
        };
        // Where the curve jumps, a packet's rows are far apart: a walk of the tree for each place.
        B pending = x < F(morton::kFarthest);
        while (g.any(pending)) {
            const int leader = g.first_from(pending, 0);
            const F cx = F(g.pick(x, leader)), cy = F(g.pick(y, leader)), cz = F(g.pick(z, leader)), spread = F(2.0f * support), inf = F(infinity());
            const B together = pending & (magnitude(x - cx) < spread) & (magnitude(y - cy) < spread) & (magnitude(z - cz) < spread);
            pending = pending & !together;
            const float3 lo{g.smallest(select(together, x, inf)), g.smallest(select(together, y, inf)), g.smallest(select(together, z, inf))};
            const float3 hi{g.largest(select(together, x, -inf)), g.largest(select(together, y, -inf)), g.largest(select(together, z, -inf))};
            period.each_image([&](const float3& shift) {
                const float3 from = lo - shift, to = hi - shift;
                const float wide2 = 1.0002f * h2;
                const auto may_reach = [&](const float3& q) {
                    const float ex = most(most(from.x - q.x, q.x - to.x), 0.0f), ey = most(most(from.y - q.y, q.y - to.y), 0.0f),
                                ez = most(most(from.z - q.z, q.z - to.z), 0.0f);
                    return ex * ex + ey * ey + ez * ez < wide2;
                };
                for_each_leaf(g, tree, from, to, [&](std::uint32_t begin, std::uint32_t n) {
                    g.each_of(place, begin, n, may_reach, [&](std::uint32_t j, const float3& q) {
                        const float3 p = q + shift;
                        const F dx = x - F(p.x), dy = y - F(p.y), dz = z - F(p.z);
                        const F r2 = dx * dx + dy * dy + dz * dz;
                        const B near = together & (r2 < possible);
                        if (!g.any(near)) return;
                        const B doubtful = near & !(r2 < sure);
                        if (!g.any(doubtful)) {
                            g.per_lane(near, [&](int lane) {
                                if (Group::get(slot, lane) != j) append(lane, j);
                            });
                            return;
                        }
                        g.per_lane(near, [&](int lane) {
                            if (Group::get(slot, lane) == j) return;
                            if (Group::get(doubtful, lane)) {
                                const double ex = double(Group::get(x, lane)) - p.x, ey = double(Group::get(y, lane)) - p.y,
                                             ez = double(Group::get(z, lane)) - p.z;
                                if (!(ex * ex + ey * ey + ez * ez < double(support) * support)) return;
                            }
                            append(lane, j);
                        });
                    });
                });
            });
        }
        finish(g, first, out, count);
    }

private:
    /// Rows of one packet all get the length of the longest.
    template <class Group, class U>
    GB_FN void finish(Group& g, std::size_t first, std::uint32_t* out, const U& count) const {
        std::uint32_t longest = 0;
        Group::for_lanes([&](int lane) { longest = most(longest, Group::get(count, lane)); });
        Group::for_lanes([&](int lane) {
            const int l = g.lane_number(lane);
            const std::uint32_t mine = Group::get(count, lane);
            lists.count[first + l] = least(mine, lists.places);
            for (std::uint32_t k = mine; k < least(longest, lists.places); ++k) out[std::size_t(k) * Packet::stride + l] = lists.n;
        });
        if (longest > *most_count) atomic_most(most_count, longest);
    }
};

}  // namespace globule::sim
