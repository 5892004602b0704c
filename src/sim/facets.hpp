// The facets of a fluid's free surface (sim/surface.hpp), from each particle's neighbors.
//
// For each particle that may be at the surface, a group of lanes:
//   collect   its neighbors, and of these the ones that a ball may touch together with it: each a lane
//   balls     two balls of the given radius touch it and two neighbors, one on either side: each pair of neighbors a
//   lane open      most are told to be full by a neighbor that lies deep in them: three multiplications each take what
//   is left is decided by the numbers that all three particles share; an empty ball is a facet finish    facets in the
//   order of the neighbors, and the particle's normal
#pragma once
#include "sim/surface.hpp"

namespace globule::core::sim {

/// The facets around every row's particle, and its normal.
template <class Packet, bool periodic> struct FindFacets {
    static constexpr float kSurely = 0.01f;  ///< of the squared radius: deeper in a ball than that is within, whatever
                                             ///< the rounding, and nearer than kFarthest to all three
    static constexpr int kAtOnce = 4;        ///< neighbors that are tried before a look at who is left
    template <class Group> struct Scratch {
        std::uint32_t slot[kMostAround];                       ///< of the neighbors, to a full run of lanes
        float x[kMostAround], y[kMostAround], z[kMostAround];  ///< from the particle
        float reach[kMostAround];                              ///< half of their squared distance
        std::uint32_t kept[kMostNear + Group::width];
        Quad near[kMostNear];  ///< place, and tension, of those that a facet may have, in the slots' order
        std::uint32_t near_slot[kMostNear];
        std::uint32_t found[kMostFacets];  ///< balls
        Quad normal[kMostFacets];          ///< of a facet, and what it is taken by
        float angle[kMostFacets];
    };
    /// A ball of a pair of neighbors as a number: whether it is below the facet, then the two in `near`, a byte each.
    struct Ball {
        std::uint32_t code;
        GB_FN static std::uint32_t of(std::uint32_t below, std::uint32_t i, std::uint32_t k) {
            return below << 16 | i << 8 | k;
        }
        GB_FN int i() const { return int(code >> 8 & 255u); }
        GB_FN int k() const { return int(code & 255u); }
        GB_FN bool below() const { return code >> 16; }
        GB_FN std::uint32_t rank() const {
            return (code << 1 | code >> 16) & 0x1ffffu;
        }  ///< by pair, the one above first
    };
    /// Circle through three particles, as seen from the first of them.
    template <class F> struct Circle {
        Vec3<F> first, second, third;  ///< the latter two from the first
        Vec3<F> middle, across;
        F n2, height2;  ///< of across; of the centers of balls over the middle
        GB_FN Vec3<F> up() const { return across * sqrt(height2 / n2); }
    };
    Lists<Packet> lists;
    Skin skin;
    Period period;
    const Directions* directions;
    float radius;  ///< of the ball
    float reach2;  ///< squared: from a fluid to what is not

    template <class Group> GB_FN void operator()(Group& g, Scratch<Group>& s, std::size_t item) const {
        using F = typename Group::F;
        using B = typename Group::B;
        const std::size_t row = skin.rows[item];
        const std::uint32_t slot = lists.rows[row];
        const Quad mine = skin.place[slot];
        if (!(mine.w > 0.0f)) return;
        const int n = int(lists.count[row]);
        g.sync();
        list_slots(g, lists, row, n, s.slot);
        const int n_near = collect(g, s, row, n, mine.xyz());
        const float3 outwards = open_side(row);
        const int before = count_before(s, n_near, slot), n_pairs = n_near * (n_near - 1) / 2;
        int n_found = 0;
        for (int p = 0; p < n_pairs; p += Group::width) {
            Circle<F> c;
            const B may = balls(g, s, p, n_pairs, mine.xyz(), before, c);
            if (!g.any(may)) continue;
            const Vec3<F> up = c.up(),
                          middle = c.middle + period.template shortest<periodic>(c.first - wide<F>(mine.xyz()));
            // Balls on the fluid's side go together: a few neighbors close them all.
            const B turned = dot(up, wide<F>(outwards)) < F(0.0f);
            const Vec3<F> out = choose(turned, up * F(-1.0f), up);
            const B outer = open(g, s, n, may, middle + out), inner = open(g, s, n, may, middle - out);
            n_found = take(g, s, n, (outer & !turned) | (inner & turned), p, 0u, mine.xyz(), before, n_found);
            n_found = take(g, s, n, (outer & turned) | (inner & !turned), p, 1u, mine.xyz(), before, n_found);
        }
        g.sync();
        if (n_found) finish(g, s, row, slot, mine, before, n_found);
    }

private:
    template <class B, class F> GB_FN static Vec3<F> choose(const B& m, const Vec3<F>& p, const Vec3<F>& q) {
        return {select(m, p.x, q.x), select(m, p.y, q.y), select(m, p.z, q.z)};
    }

    /// fn(number) for the directions in which there may be nobody.
    template <class Fn> GB_FN void each_open(std::size_t row, const Fn& fn) const {
        for (int v = 0; v < kDirections / 32; ++v)
            for (std::uint32_t set = skin.open[v * skin.padded + row]; set; set &= set - 1)
                fn(32 * v + trailing_zeros(set));
    }
    /// Where there is nobody: the sum of those directions.
    GB_FN float3 open_side(std::size_t row) const {
        float3 sum{0, 0, 0};
        each_open(row, [&](int i) { sum = sum + float3{directions->x[i], directions->y[i], directions->z[i]}; });
        return sum;
    }

    /// The neighbors as seen from the particle, and in `near` those that a facet may have; how many these are.
    template <class Group>
    GB_FN int collect(Group& g, Scratch<Group>& s, std::size_t row, int n, const float3& at) const {
        using F = typename Group::F;
        using B = typename Group::B;
        int n_near = 0;
        for (int k = 0; k < n; k += Group::width) {
            const Four<F> p = g.gather(skin.place, s.slot + k);
            const Vec3<F> d = period.template shortest<periodic>(p.xyz() - wide<F>(at));
            const F d2 = dot(d, d);
            g.store_run(d.x, s.x + k);
            g.store_run(d.y, s.y + k);
            g.store_run(d.z, s.z + k);
            g.store_run(F(0.5f) * d2, s.reach + k);
            const B reaches = (p.w > F(0.0f)) | ((p.w < F(0.0f)) & (d2 < F(reach2)));
            const B taken = reaches & may_touch(g, row, d * F(1.0f / radius));
            if (n_near < kMostNear) g.keep(taken, g.numbers(std::uint32_t(k)), s.kept + n_near);
            n_near += g.count(taken);
        }
        g.sync();
        n_near = min(n_near, kMostNear);
        keep_near(g, s, n_near);
        return n_near;
    }
    /// Whether a ball that touches the particle in an open direction may touch a neighbor that is `away`, in radii,
    /// too.
    template <class Group>
    GB_FN typename Group::B may_touch(Group& g, std::size_t row, const Vec3<typename Group::F>& away) const {
        using F = typename Group::F;
        constexpr float low = kSurelyEmpty * kSurelyEmpty, high = (2.0f - kSurelyEmpty) * (2.0f - kSurelyEmpty);
        const F both2 = dot(away, away) + F(1.0f), least_along = F(0.5f) * (both2 - F(high)),
                most_along = F(0.5f) * (both2 - F(low));
        typename Group::B touched = g.none();
        each_open(row, [&](int i) {
            const F along = away.x * F(directions->x[i]) + away.y * F(directions->y[i]) + away.z * F(directions->z[i]);
            touched = touched | ((along >= least_along) & (along <= most_along));
        });
        return touched;
    }
    /// Those kept, side by side in the slots' order.
    template <class Group> GB_FN void keep_near(Group& g, Scratch<Group>& s, int n_near) const {
        g.share(n_near, [&](int i) {
            const std::uint32_t j = s.slot[s.kept[i]];
            int place = i;
            if constexpr (periodic) {  // lists are in the slots' order but for the domain's copies
                place = 0;
                for (int k = 0; k < n_near; ++k) place += s.slot[s.kept[k]] < j;
            }
            s.near[place] = skin.place[j];
            s.near_slot[place] = j;
        });
        g.sync();
    }
    /// How many of `near` come before a slot.
    template <class S> GB_FN static int count_before(const S& s, int n_near, std::uint32_t slot) {
        int n = 0;
        while (n < n_near && s.near_slot[n] < slot) ++n;
        return n;
    }

    /// Whether two particles so far apart are in each other's list of neighbors.
    template <class F> GB_FN auto nearer(const Vec3<F>& away) const {
        return dot(away, away) < F(kFarthest * kFarthest * radius * radius);
    }

    /// Of the particle and two others, i's slot lower than k's.  From the lowest slot, in the slots' order: the same
    /// numbers whoever asks.
    template <class F, class B>
    GB_FN Circle<F> circle(
        const Vec3<F>& at, const Vec3<F>& i, const Vec3<F>& k, const B& i_first, const B& k_first) const {
        Circle<F> c;
        c.first = choose(i_first, i, at);
        const Vec3<F> u = c.second =
            period.template shortest<periodic>(choose(k_first, k, choose(i_first, at, i)) - c.first);
        const Vec3<F> v = c.third = period.template shortest<periodic>(choose(k_first, at, k) - c.first);
        c.across = cross(u, v);
        const F u2 = dot(u, u), v2 = dot(v, v);
        c.n2 = dot(c.across, c.across);
        c.middle = cross(v * u2 - u * v2, c.across) * (F(0.5f) / c.n2);
        const B is_one = (c.n2 > F(1e-6f) * u2 * v2) & nearer(u) & nearer(v) & nearer(v - u);
        c.height2 = select(is_one, F(radius * radius) - dot(c.middle, c.middle), F(0.0f));
        return c;
    }
    template <class S> GB_FN Circle<float> circle(const S& s, Ball ball, const float3& at, int before) const {
        return circle(at, s.near[ball.i()].xyz(), s.near[ball.k()].xyz(), ball.i() < before, ball.k() < before);
    }
    /// Circles of the pairs from p on, a lane each; the lanes that have one, of which a facet may be.
    template <class Group>
    GB_FN typename Group::B balls(Group& g, const Scratch<Group>& s, int p, int n_pairs, const float3& at, int before,
        Circle<typename Group::F>& c) const {
        using F = typename Group::F;
        using B = typename Group::B;
        const Four<F> i = g.gather(s.near, directions->pair_i + p), k = g.gather(s.near, directions->pair_k + p);
        const B i_first = g.before(directions->pair_i + p, std::uint32_t(before)),
                k_first = g.before(directions->pair_k + p, std::uint32_t(before));
        c = circle(wide<F>(at), i.xyz(), k.xyz(), i_first, k_first);
        const Vec3<F> between = period.template shortest<periodic>(k.xyz() - i.xyz());
        const B held = (i.w * k.w > F(0.0f)) | (dot(between, between) < F(reach2));
        return g.first_lanes(n_pairs - p) & held & (c.height2 > F(0.0f));
    }

    /// Those of the balls that nobody is deep in; their centers are seen from the particle.
    template <class Group>
    GB_FN typename Group::B open(Group& g, const Scratch<Group>& s, int n, const typename Group::B& which,
        const Vec3<typename Group::F>& center) const {
        using F = typename Group::F;
        const F sure = F(0.5f * kSurely * radius * radius);
        F deep = select(which, F(-infinity()), F(infinity()));
        for (int m = 0; m < n && g.any(deep <= sure); m += kAtOnce)
            for (int k = m; k < m + kAtOnce; ++k)
                deep =
                    max(deep, F(s.x[k]) * center.x + (F(s.y[k]) * center.y + (F(s.z[k]) * center.z - F(s.reach[k]))));
        return which &
               (deep <= sure);  // who is none of them may have been anything, and max() forgets what is no number
    }
    /// Adds those of the balls that hold nobody.
    template <class Group>
    GB_FN int take(Group& g, Scratch<Group>& s, int n, const typename Group::B& which, int p, std::uint32_t below,
        const float3& at, int before, int n_found) const {
        g.each(which, [&](int lane) {
            const Ball ball{Ball::of(below, directions->pair_i[p + lane], directions->pair_k[p + lane])};
            if (n_found == kMostFacets || !empty(g, s, n, ball, at, before)) return;
            if (g.is_first()) s.found[n_found] = ball.code;
            ++n_found;
        });
        return n_found;
    }
    /// Nobody is in the ball but the three it touches. Who is not near to all three is not known to all, and does not
    /// count.
    template <class Group>
    GB_FN bool empty(Group& g, const Scratch<Group>& s, int n, Ball ball, const float3& at, int before) const {
        using F = typename Group::F;
        const Circle<float> c = circle(s, ball, at, before);
        const float3 center = ball.below() ? c.middle - c.up() : c.middle + c.up();
        const std::uint32_t i = s.near_slot[ball.i()], k = s.near_slot[ball.k()];
        for (int m = 0; m < n; m += Group::width) {
            const Vec3<F> p = period.template shortest<periodic>(
                              g.gather(skin.place, s.slot + m).xyz() - wide<F>(c.first)),
                          d = p - wide<F>(center);
            const typename Group::B inside =
                (dot(d, d) < F(radius * radius)) & g.differ(s.slot + m, i) & g.differ(s.slot + m, k);
            if (g.any(inside) &&
                g.any(inside & nearer(p) & nearer(p - wide<F>(c.second)) & nearer(p - wide<F>(c.third))))
                return false;
        }
        return true;
    }

    /// Writes the facets and the normal, in the order of the neighbors.
    template <class Group>
    GB_FN void finish(Group& g, Scratch<Group>& s, std::size_t row, std::uint32_t slot, const Quad& mine, int before,
        int n_found) const {
        g.share(n_found, [&](int f) {
            const Ball ball{s.found[f]};
            const int j = ball.i(), k = ball.k();
            int place = 0;
            for (int i = 0; i < n_found; ++i) place += Ball{s.found[i]}.rank() < ball.rank();
            const std::size_t at = std::size_t(place) * 2 * skin.padded + row;
            skin.facets[at] = s.near_slot[j];
            skin.facets[at + skin.padded] = s.near_slot[k];
            const Circle<float> c = circle(s, ball, mine.xyz(), before);
            const float3 e = period.template shortest<periodic>(s.near[j].xyz() - mine.xyz()),
                         o = period.template shortest<periodic>(s.near[k].xyz() - mine.xyz());
            const float angle = atan2f(length(cross(e, o)), dot(e, o));
            s.normal[place] = {c.across.x, c.across.y, c.across.z, (ball.below() ? -angle : angle) / sqrt(c.n2)};
            s.angle[place] = angle;
        });
        g.sync();
        if (!g.is_first()) return;
        float3 normal{0, 0, 0};
        float angles = 0.0f;
        for (int f = 0; f < n_found; ++f) {
            normal = normal + s.normal[f].xyz() * s.normal[f].w;
            angles += s.angle[f];
        }
        skin.count[row] = std::uint32_t(n_found);
        const float scale = 1.0f / max(length(normal), 0.5f * angles);
        skin.normal[slot] = {scale * normal.x, scale * normal.y, scale * normal.z, mine.w};
    }
};

}  // namespace globule::core::sim
