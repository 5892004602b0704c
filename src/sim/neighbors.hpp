// Neighbour lists from the octree: for each packet of consecutive rows one walk of the tree, whose
// candidates every row of the packet then tests.  The lists of a packet's rows are interleaved (sliced
// ELLPACK), a fixed number of places each, so that lanes and warps read them as vectors.
#pragma once
#include <type_traits>

#include "octree/query.hpp"
#include "sim/sizes.hpp"

namespace globule::core::sim {

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
    /// Asks for the same place of the next packet's lists: what a processor foresees by itself ends with a packet's own.
    GB_FN void fetch_next(std::size_t at) const {
        const std::size_t next = at + std::size_t(places) * Packet::stride;
        fetch_next_index(at);
        Packet::fetch(gx + next);
        Packet::fetch(gy + next);
        Packet::fetch(gz + next);
    }
    GB_FN void fetch_next_index(std::size_t at) const { Packet::fetch(index + at + std::size_t(places) * Packet::stride); }
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

/// fn(std::bool_constant: does any axis repeat).
template <class Fn>
void with_period(const Period& period, const Fn& fn) {
    if (period.any()) fn(std::true_type{});
    else fn(std::false_type{});
}

/// Squared distances that float32 cannot tell from the support's: these pairs are decided in float64.
inline constexpr float kDoubt = 4e-6f;

/// For each packet of rows:
///   bunch    rows that lie together (where the curve jumps, a packet's are far apart), and the box around them
///   gather   the leaves that the box, enlarged by the support, meets; of their particles those near the box are the bunch's candidates
///   look     one row after the other tests a vector of candidates at a time, and writes the near ones to its list
///   finish   lists are filled up to the longest of the packet
template <class Tree, class Packet, bool mixed>
struct FindLists {
    static constexpr int kCandidates = 384;  ///< at once; there may be more
    static constexpr int tile_blocks = mixed ? 4 : 6;  ///< at one time on a GPU's processor
    template <class Group>
    struct Scratch {
        float x[kCandidates + Group::width], y[kCandidates + Group::width], z[kCandidates + Group::width];
        std::uint32_t slot[kCandidates + Group::width], found[kCandidates + Group::width];
        float size[mixed ? kCandidates + Group::width : 1];
    };

    Tree tree;
    SortedParticles particles;
    Lists<Packet> lists;
    const Quad* place;
    float support;         ///< of the kernel, the largest; the tree's boxes hold it
    Sizes sizes;           ///< a pair's support is the mean of both
    Period period;
    std::uint32_t* most_count;

    template <class Group>
    GB_FN void operator()(Group& g, Scratch<Group>& near, std::size_t tile) const {
        const std::size_t first = tile * Group::width;
        std::uint32_t* out = lists.index + lists.at(first);
        Rows<Group> rows;
        load(g, first, rows);
        typename Group::B pending = rows.x < F<Group>(morton::kFarthest);
        while (g.any(pending)) {
            const Bunch b = bunch(g, rows, pending);
            int n_near = 0;
            period.each_image([&](const float3& shift) { gather(g, near, n_near, rows, b, shift, out); });
            look(g, near, n_near, rows, b.set, out);
        }
        finish(g, first, out, rows.count);
    }

private:
    template <class Group>
    using F = typename Group::F;

    template <class Group>
    struct Rows {
        typename Group::F x, y, z;
        typename Group::U slot, count;
    };
    /// Rows that share a walk of the tree.
    struct Bunch {
        std::uint32_t set;
        float3 lo, hi;
    };

    template <class Group>
    GB_FN void load(Group& g, std::size_t first, Rows<Group>& rows) const {
        Group::for_lanes([&](int lane) {
            const std::uint32_t s = lists.rows[first + g.lane_number(lane)];
            const Quad p = place[s];
            Group::put(rows.slot, lane, s);
            Group::put(rows.count, lane, 0u);
            Group::put(rows.x, lane, p.x);
            Group::put(rows.y, lane, p.y);
            Group::put(rows.z, lane, p.z);
        });
    }

    /// The first of the rows that are left, and who is near it; they are not left any more.
    template <class Group>
    GB_FN Bunch bunch(Group& g, const Rows<Group>& rows, typename Group::B& left) const {
        using V = F<Group>;
        const int leader = g.first_from(left, 0);
        const V cx = V(g.pick(rows.x, leader)), cy = V(g.pick(rows.y, leader)), cz = V(g.pick(rows.z, leader)), spread = V(2.0f * support), inf = V(infinity());
        const typename Group::B together = left & (abs(rows.x - cx) < spread) & (abs(rows.y - cy) < spread) & (abs(rows.z - cz) < spread);
        left = left & !together;
        return {g.set_of(together),
                {g.smallest(select(together, rows.x, inf)), g.smallest(select(together, rows.y, inf)), g.smallest(select(together, rows.z, inf))},
                {g.largest(select(together, rows.x, -inf)), g.largest(select(together, rows.y, -inf)), g.largest(select(together, rows.z, -inf))}};
    }

    /// Candidates of a bunch in one copy of the domain; whenever there is no room for more, its rows look at them.
    template <class Group>
    GB_FN void gather(Group& g, Scratch<Group>& near, int& n_near, Rows<Group>& rows, const Bunch& b, const float3& shift, std::uint32_t* out) const {
        const float3 from = b.lo - shift, to = b.hi - shift;
        std::uint32_t begin = 0, end = 0;  // leaves that follow each other in memory are one run
        const auto take = [&] {
            for (; begin < end; begin += Group::width) {
                if (n_near > kCandidates - Group::width) {
                    look(g, near, n_near, rows, b.set, out);
                    n_near = 0;
                }
                n_near = collect(g, near, n_near, begin, g.first_lanes(int(end - begin)), from, to, shift);
            }
        };
        for_each_leaf(g, tree, from, to, [&](std::uint32_t first, std::uint32_t n) {
            if (first != end) {
                take();
                begin = first;
            }
            end = first + n;
        });
        take();
    }

    /// Of a group's worth of particles those that some row in the box may reach.
    template <class Group>
    GB_FN int collect(Group& g, Scratch<Group>& near, int n_near, std::uint32_t begin, typename Group::B present, const float3& from, const float3& to,
                      const float3& shift) const {
        using V = F<Group>;
        const V zero = V(0.0f), x = g.load_run(particles.x + begin), y = g.load_run(particles.y + begin), z = g.load_run(particles.z + begin);
        const V ex = max(max(V(from.x) - x, x - V(to.x)), zero), ey = max(max(V(from.y) - y, y - V(to.y)), zero),
                ez = max(max(V(from.z) - z, z - V(to.z)), zero);
        const typename Group::B may = present & (ex * ex + ey * ey + ez * ez < V(1.0002f * support * support));
        g.keep(may, x + V(shift.x), near.x + n_near);
        g.keep(may, y + V(shift.y), near.y + n_near);
        g.keep(may, z + V(shift.z), near.z + n_near);
        g.keep(may, g.numbers(begin), near.slot + n_near);
        if constexpr (mixed) g.keep(may, g.load_run(sizes.of + begin), near.size + n_near);
        return n_near + g.count(may);
    }

    /// The rows of `set` take up those of the candidates that are theirs.
    template <class Group>
    GB_FN void look(Group& g, Scratch<Group>& near, int n_near, Rows<Group>& rows, std::uint32_t set, std::uint32_t* out) const {
        g.sync();
        for (; set; set &= set - 1) {
            const int row = trailing_zeros(set);
            const std::uint32_t before = g.pick(rows.count, row);
            const int n = find(g, near, n_near, {g.pick(rows.x, row), g.pick(rows.y, row), g.pick(rows.z, row)}, g.pick(rows.slot, row));
            g.sync();
            const int room = max(int(lists.places) - int(before), 0);
            g.share(min(n, room), [&](int k) { out[std::size_t(before + k) * Packet::stride + row] = near.found[k]; });
            g.per_lane(g.only(row), [&](int lane) { Group::put(rows.count, lane, before + std::uint32_t(n)); });
        }
        g.sync();
    }
    /// Puts the candidates within the support of a place, but for the one in `slot`, into near.found; how many.
    template <class Group>
    GB_FN int find(Group& g, Scratch<Group>& near, int n_near, const float3& at, std::uint32_t slot) const {
        using V = F<Group>;
        const float h2 = support * support;
        V sure = V(h2 * (1.0f - kDoubt)), possible = V(h2 * (1.0f + kDoubt));
        [[maybe_unused]] const float own = sizes.at(slot);
        int n = 0;
        for (int k = 0; k < n_near; k += Group::width) {
            if constexpr (mixed) {
                const V mean = V(0.5f) * (V(own) + g.load_run(near.size + k)), m2 = mean * mean;
                sure = V(h2 * (1.0f - kDoubt)) * m2;
                possible = V(h2 * (1.0f + kDoubt)) * m2;
            }
            const V dx = V(at.x) - g.load_run(near.x + k), dy = V(at.y) - g.load_run(near.y + k), dz = V(at.z) - g.load_run(near.z + k);
            const V r2 = dx * dx + dy * dy + dz * dz;
            typename Group::B mine = g.first_lanes(n_near - k) & (r2 < possible) & g.differ(near.slot + k, slot);
            const typename Group::B doubtful = mine & !(r2 < sure);
            if (g.any(doubtful))
                g.per_lane(doubtful, [&](int lane) {
                    const int j = k + g.lane_number(lane);
                    double h = support;
                    if constexpr (mixed) h *= 0.5 * (double(own) + near.size[j]);
                    const double ex = double(at.x) - near.x[j], ey = double(at.y) - near.y[j], ez = double(at.z) - near.z[j];
                    Group::put(mine, lane, ex * ex + ey * ey + ez * ez < h * h);
                });
            g.keep(mine, g.load_run(near.slot + k), near.found + n);
            n += g.count(mine);
        }
        return n;
    }

    /// Rows of one packet all get the length of the longest.
    template <class Group, class U>
    GB_FN void finish(Group& g, std::size_t first, std::uint32_t* out, const U& count) const {
        std::uint32_t longest = 0;
        Group::for_lanes([&](int lane) { longest = max(longest, Group::get(count, lane)); });
        Group::for_lanes([&](int lane) {
            const int l = g.lane_number(lane);
            const std::uint32_t mine = Group::get(count, lane);
            lists.count[first + l] = min(mine, lists.places);
            for (std::uint32_t k = mine; k < min(longest, lists.places); ++k) out[std::size_t(k) * Packet::stride + l] = lists.n;
        });
        if (longest > *most_count) atomic_max(most_count, longest);
    }
};

}  // namespace globule::core::sim
