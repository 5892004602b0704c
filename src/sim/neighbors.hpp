// Neighbor lists from the octree: for each packet of consecutive rows one walk of the tree, whose
// candidates every row of the packet then tests.  The lists of a packet's rows are interleaved (sliced
// ELLPACK), a fixed number of places each, so that lanes and warps read them as vectors.
#pragma once
#include <type_traits>

#include "octree/query.hpp"
#include "sim/candidates.hpp"

namespace globule::core::sim {

/// A place of all rows of a packet: 8 bytes a pair where the processor converts floats of 16 bits.
template <class Packet> struct alignas(8) Pairs {
    std::uint16_t slot[Packet::width];  ///< of the neighbors, from the packet's bases; written with the gradients
    typename Packet::Short gx[Packet::width], gy[Packet::width],
        gz[Packet::width];  ///< V_j grad W_ij of each, times the support
    using F = typename Packet::F;
    GB_FN Vec3<F> gradient() const { return {Packet::load(gx), Packet::load(gy), Packet::load(gz)}; }
    /// Returns what 16 bits keep of it.
    GB_FN Vec3<F> keep(const Vec3<F>& g) {
        return {Packet::keep(gx, g.x), Packet::keep(gy, g.y), Packet::keep(gz, g.z)};
    }
};

/// Rows are the particles that the solver moves, in slot order.
template <class Packet> struct Lists {
    using F = typename Packet::F;
    std::size_t n_rows = 0;
    std::uint32_t places = 0;             ///< room of each list
    std::uint32_t n = 0;                  ///< particles; slot n is nobody's and far away, lists are padded with it
    const std::uint32_t* rows = nullptr;  ///< slot of each row, padded with n
    std::uint32_t* count = nullptr;       ///< per row
    std::uint32_t* index = nullptr;       ///< slots of the neighbors, in slot order
    Pairs<Packet>* pairs = nullptr;
    typename Packet::Bases* bases = nullptr;  ///< per `stride` rows

    /// Place of a row's k-th neighbor; the next one is Packet::stride further.
    GB_FN std::size_t at(std::size_t row, std::uint32_t k = 0) const {
        constexpr std::size_t s = Packet::stride;
        return (row / s * places + k) * s + row % s;
    }
    GB_FN Pairs<Packet>& pair(std::size_t at) const { return pairs[at / Packet::width]; }
    /// A copy on a GPU, which reads all of a pair at once.
    GB_FN decltype(auto) read_pair(std::size_t at) const { return Packet::read(pair(at)); }
    GB_FN Vec3<F> gradient(std::size_t at) const { return read_pair(at).gradient(); }
    /// Of one row.
    GB_FN float3 one_gradient(std::size_t at) const {
        const Pairs<Packet>& p = pair(at);
        const std::size_t i = at % Packet::width;
        return {Packet::one(p.gx + i), Packet::one(p.gy + i), Packet::one(p.gz + i)};
    }
    /// Returns what 16 bits keep of it.
    GB_FN Vec3<F> keep_gradient(std::size_t at, const Vec3<F>& g) const { return pair(at).keep(g); }
    GB_FN Vec3<F> keep_pair(std::size_t at, typename Packet::ShortSlots& shorts, const Vec3<F>& g) const {
        Vec3<F> kept;
        Packet::write(pair(at), [&](Pairs<Packet>& p) {
            shorts.add(p.slot, index + at, n);
            kept = p.keep(g);
        });
        return kept;
    }
    /// fn(gather), and gather(p, at, pair) is what p has for the neighbors at a place: slots of 16 bits are read where
    /// they tell of all.
    template <class Fn> GB_FN void with_slots(std::size_t row, const Fn& fn) const {
        const typename Packet::Bases from = bases[row / Packet::stride];
        if (!from.are_far()) {
            fn([&](const auto* p, std::size_t, const Pairs<Packet>& pair) {
                return Packet::gather(p, from, pair.slot);
            });
        } else {
            fn([&](const auto* p, std::size_t at, const Pairs<Packet>&) {
                fetch_next_index(at);
                return Packet::gather(p, index + at);
            });
        }
    }
    /// Asks for the same place of the next packet's lists: what a processor foresees by itself ends with a packet's
    /// own.
    GB_FN void fetch_next_pair(std::size_t at) const { Packet::fetch(&pair(next(at))); }
    GB_FN void fetch_next_index(std::size_t at) const { Packet::fetch(index + next(at)); }
    GB_FN void fetch_next(std::size_t at) const {
        fetch_next_index(at);
        fetch_next_pair(at);
    }

private:
    GB_FN std::size_t next(std::size_t at) const { return at + std::size_t(places) * Packet::stride; }
};

/// Axes along which the domain repeats: its length there, else 0.
struct Period {
    float3 length{0, 0, 0};
    GB_FN bool any() const { return length.x > 0.0f || length.y > 0.0f || length.z > 0.0f; }
    GB_FN static float wrap(float x, float lo, float length) {
        return length > 0.0f ? (x < lo ? x + length : x >= lo + length ? x - length : x) : x;
    }
    /// From j to i the shorter way round.
    template <bool periodic, class F> GB_FN Vec3<F> shortest(const Vec3<F>& v) const {
        if constexpr (!periodic) return v;
        else return {one(v.x, length.x), one(v.y, length.y), one(v.z, length.z)};
    }
    /// fn(shift) for each copy of the domain that may hold neighbors.
    template <class Fn> GB_FN void each_image(const Fn& fn) const {
        const int nx = length.x > 0.0f, ny = length.y > 0.0f, nz = length.z > 0.0f;
        for (int x = -nx; x <= nx; ++x)
            for (int y = -ny; y <= ny; ++y)
                for (int z = -nz; z <= nz; ++z) fn(float3{x * length.x, y * length.y, z * length.z});
    }

private:
    template <class F> GB_FN static F one(const F& v, float length) {
        const float half = length > 0.0f ? 0.5f * length : infinity();
        return select(v > F(half), v - F(length), select(v < F(-half), v + F(length), v));
    }
};

/// fn(std::bool_constant: does any axis repeat).
template <class Fn> void with_period(const Period& period, const Fn& fn) {
    if (period.any()) fn(std::true_type{});
    else fn(std::false_type{});
}

/// For each packet of rows:
///   bunch    rows that lie together (where the curve jumps, a packet's are far apart), and the box around them
///   gather   the leaves that the box, enlarged by the support, meets; of their particles those near the box are the
///   bunch's candidates look     who of them is near which row (candidates.hpp) finish   lists are filled up to the
///   longest of the packet
template <class Packet, bool mixed> struct FindLists {
    static constexpr bool by_lane = Packet::width == 1;
    static constexpr int kCandidates = by_lane ? 192 : 384;  ///< at once; there may be more
    static constexpr int tile_blocks = 9;  ///< at one time on a GPU's processor, where its memory has room
    template <class Group>
    using Scratch = std::conditional_t<by_lane, CandidatesByLane<Group, mixed, kCandidates>,
        CandidatesByRow<Group, mixed, kCandidates>>;

    Tree tree;
    Nearness near;  ///< the support is the largest; the tree's boxes hold it
    Lists<Packet> lists;
    const Quad* place;
    Period period;
    std::uint32_t* most_count;

    template <class Group> GB_FN void operator()(Group& g, Scratch<Group>& candidates, std::size_t tile) const {
        const std::size_t first = tile * Group::width;
        std::uint32_t* out = lists.index + lists.at(first);
        TileRows<Group> rows;
        load(g, first, rows);
        typename Group::B pending = rows.x < F<Group>(morton::kFarthest);
        while (g.any(pending)) {
            const Bunch b = bunch(g, rows, pending);
            period.each_image([&](const float3& shift) { gather(g, candidates, rows, b, shift, {out, lists.places}); });
        }
        finish(g, first, out, rows.count);
    }

private:
    template <class Group> using F = typename Group::F;

    template <class Group> GB_FN void load(Group& g, std::size_t first, TileRows<Group>& rows) const {
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
    template <class Group> GB_FN Bunch bunch(Group& g, const TileRows<Group>& rows, typename Group::B& left) const {
        using V = F<Group>;
        const int leader = g.first_from(left, 0);
        const V cx = V(g.pick(rows.x, leader)), cy = V(g.pick(rows.y, leader)), cz = V(g.pick(rows.z, leader)),
                spread = V(2.0f * near.support), inf = V(infinity());
        const typename Group::B together =
            left & (abs(rows.x - cx) < spread) & (abs(rows.y - cy) < spread) & (abs(rows.z - cz) < spread);
        left = left & !together;
        return {g.set_of(together),
            {g.smallest(select(together, rows.x, inf)), g.smallest(select(together, rows.y, inf)),
                g.smallest(select(together, rows.z, inf))},
            {g.largest(select(together, rows.x, -inf)), g.largest(select(together, rows.y, -inf)),
                g.largest(select(together, rows.z, -inf))}};
    }

    /// Candidates of a bunch in one copy of the domain; its rows look at them whenever there is no room for more, and
    /// at the end.
    template <class Group>
    GB_FN void gather(Group& g, Scratch<Group>& candidates, TileRows<Group>& rows, const Bunch& b, const float3& shift,
        const TileLists& out) const {
        const float3 from = b.lo - shift, to = b.hi - shift;
        int n = 0;
        std::uint32_t begin = 0, end = 0;  // leaves that follow each other in memory are one run
        const auto take = [&] {
            for (; begin < end; begin += Group::width) {
                if (n > kCandidates) {
                    candidates.look(g, n, rows, b, near, shift, out);
                    n = 0;
                }
                n = collect(g, candidates, n, begin, g.first_lanes(int(end - begin)), b, from, to, shift);
            }
        };
        for_each_leaf(g, tree, from, to, [&](std::uint32_t first, std::uint32_t count) {
            if (first != end) {
                take();
                begin = first;
            }
            end = first + count;
        });
        take();
        if (n > 0) candidates.look(g, n, rows, b, near, shift, out);
    }

    /// Of a group's worth of particles those that some row in the box may reach.
    template <class Group>
    GB_FN int collect(Group& g, Scratch<Group>& candidates, int n, std::uint32_t begin, typename Group::B present,
        const Bunch& b, const float3& from, const float3& to, const float3& shift) const {
        using V = F<Group>;
        const SortedParticles& p = near.particles;
        const V zero = V(0.0f), x = g.load_run(p.x + begin), y = g.load_run(p.y + begin), z = g.load_run(p.z + begin);
        const V ex = max(max(V(from.x) - x, x - V(to.x)), zero), ey = max(max(V(from.y) - y, y - V(to.y)), zero),
                ez = max(max(V(from.z) - z, z - V(to.z)), zero);
        const typename Group::B may =
            present & (ex * ex + ey * ey + ez * ez < V(1.0002f * near.support * near.support));
        return candidates.add(g, n, may, x + V(shift.x), y + V(shift.y), z + V(shift.z), begin, near, b);
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
            for (std::uint32_t k = mine; k < min(longest, lists.places); ++k)
                out[std::size_t(k) * Packet::stride + l] = lists.n;
        });
        if (longest > *most_count) atomic_max(most_count, longest);
    }
};

}  // namespace globule::core::sim
