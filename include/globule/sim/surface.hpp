// Surface tension, from the area of the fluid's free surface.
//
// The surface is where a ball as large as a spacing can roll over the particles (the boundary of their
// alpha shape; Edelsbrunner & Mücke 1994): a facet is three particles that such a ball touches with nobody in
// it.  Its vertices lie at the surface, outside of their particles.  Tension is what the facets' area
// costs: every vertex is pulled by -sigma dA/dx.  The three pulls of a facet add up to nothing, and so does their
// torque: momentum is kept.  Each particle finds the facets around it by itself, from its own neighbours;
// all three come to the same ones, for they ask the same questions with the same numbers.
// Facets reach to the particles of walls and tissue, which hold them: a surface ends there, it is not drawn away.
#pragma once
#include "globule/exec/bits.hpp"
#include "globule/sim/density.hpp"

namespace globule::sim {

inline constexpr int kMostFacets = 32;        ///< around a particle; about 6 in a surface, 12 in a sheet, 30 in spray
inline constexpr int kMostNear = 48;          ///< neighbours at the surface that are looked at
inline constexpr int kMostAround = 192;       ///< neighbours; about 30 are usual, who has more than this is at no surface
inline constexpr float kSurfaceGradient = 0.1f;  ///< of the density, per spacing: less is not at a surface (with 0.2, some that are)
/// Spacings from the outermost particles to the surface: with this one, facets enclose the fluid's volume (within 1 %
/// in drops of 5 to 10 spacings), for the density solve packs particles closer at the surface than inside.
inline constexpr float kSurfaceOffset = 0.69f;
inline constexpr float kJitter = 1e-3f;       ///< spacings: four of a lattice lie on one ball

/// Spacings from fluid to what is not: fluid that lies against a wall is nearer, and one that is not yet there is not drawn to it.
inline constexpr float kReach = 1.2f;

/// Directions all around, none farther than 16 degrees from one of them.
inline constexpr int kDirections = 96;
inline constexpr int kPairs = kMostNear * (kMostNear - 1) / 2;
inline constexpr int kFiner = 7;  ///< around each: what is nearest to it is at most 8 degrees from one of these
struct Directions {
    float x[kDirections], y[kDirections], z[kDirections];
    float3 finer[kDirections][kFiner];
    /// All pairs of the first so many of anything: i < k, by k.
    std::uint32_t pair_i[kPairs + 32] = {}, pair_k[kPairs + 32] = {};
    Directions() {
        for (int k = 0, p = 0; k < kMostNear; ++k)
            for (int i = 0; i < k; ++i, ++p) {
                pair_i[p] = std::uint32_t(i);
                pair_k[p] = std::uint32_t(k);
            }
        constexpr float turn = 1.0471976f, tilt = 0.2268928f;  // 60 and 13 degrees
        for (int k = 0; k < kDirections; ++k) {
            z[k] = 1.0f - float(2 * k + 1) / kDirections;
            const float r = std::sqrt(1.0f - z[k] * z[k]);
            x[k] = r * std::cos(2.399963f * k);
            y[k] = r * std::sin(2.399963f * k);
            const float3 d{x[k], y[k], z[k]}, e{y[k] / r, -x[k] / r, 0.0f}, f = cross(d, e);
            finer[k][0] = d;
            for (int c = 1; c < kFiner; ++c)
                finer[k][c] = d * std::cos(tilt) + (e * std::cos(turn * c) + f * std::sin(turn * c)) * std::sin(tilt);
        }
    }
};
/// Where a ball of one spacing's radius touches a particle in any direction, nobody is in one of this radius
/// that touches it in the nearest of the directions above, at one spacing's distance of their centres.
inline constexpr float kSurelyEmpty = 0.72f;
inline constexpr float kSurelyEmptyFiner = 0.86f;

/// Who may be at the surface of a fluid with tension.
struct Skin {
    Quad* place;        ///< per slot: position (jittered); w: tension, 0 where not at a surface, -1: not fluid
    Quad* normal;       ///< per slot: outwards, at most 1 long; w: tension
    std::uint32_t* facets;  ///< (kMostFacets, 2, padded rows): slots of the other two vertices
    std::uint32_t* count;   ///< per row
    std::uint32_t* open;    ///< (kDirections / 32, padded rows): bits of the directions that may have nobody
    std::uint32_t* rows;    ///< those with a gradient of the density, in any order; n_rows of them
    std::uint32_t* n_rows;
    std::size_t padded;
};

struct MarkSkin {
    State state;
    const Phase* phases;
    Skin skin;
    float spacing;
    GB_FN static float jitter(std::uint32_t id) {
        id ^= id >> 16;
        id *= 0x7feb352du;
        id ^= id >> 15;
        id *= 0x846ca68bu;
        id ^= id >> 16;
        return float(id >> 8) * (1.0f / 8388608.0f) - 1.0f;
    }
    GB_FN void operator()(std::size_t i) const {
        skin.normal[i] = {0.0f, 0.0f, 0.0f, 0.0f};
        if (i >= state.n) {
            skin.place[i] = {2e18f, 2e18f, 2e18f, 0.0f};
            return;
        }
        const Quad p = state.place[i];
        const std::uint32_t id = 3u * state.id[i];
        const float s = kJitter * spacing;
        skin.place[i] = {p.x + s * jitter(id), p.y + s * jitter(id + 1), p.z + s * jitter(id + 2), phases[state.phase[i]].kind == Kind::fluid ? 0.0f : -1.0f};
    }
};
/// Lists the rows of fluids with tension where the density has a gradient.
struct ListSteep {
    const std::uint32_t* slots;
    const std::uint32_t* neighbors;  ///< how many
    State state;
    const Phase* phases;
    Rows values;
    float least_gradient;  ///< |G| times the support
    Skin skin;
    GB_FN void operator()(std::size_t row) const {
        skin.count[row] = 0;
        const Phase& phase = phases[state.phase[slots[row]]];
        const float3 g{values.gx[row], values.gy[row], values.gz[row]};
        if (phase.kind != Kind::fluid || !(phase.tension > 0.0f) || !(dot(g, g) > least_gradient * least_gradient)) return;
        if (neighbors[row] <= std::uint32_t(kMostAround)) skin.rows[atomic_take(skin.n_rows, 1)] = std::uint32_t(row);
    }
};

template <class F>
GB_FN Vec3<F> wide(const float3& p) { return {F(p.x), F(p.y), F(p.z)}; }
/// Slots of a row's n neighbours; the last run of lanes is filled up with nobody, who is far away.
template <class Group, class Packet>
GB_FN void list_slots(Group& g, const Lists<Packet>& lists, std::size_t row, int n, std::uint32_t* slots) {
    g.share(ceil_div(n, Group::width) * Group::width, [&](int k) { slots[k] = k < n ? lists.index[lists.at(row, std::uint32_t(k))] : lists.n; });
}

/// Of these, the particles that a ball may touch.  A group's lanes are directions, then neighbours.
template <class Packet, bool periodic>
struct MarkTension {
    template <class Group>
    struct Scratch {
        std::uint32_t slot[kMostAround];  ///< of the neighbours, to a full run of lanes
        float x[kMostAround], y[kMostAround], z[kMostAround];  ///< in spacings from the particle
        float reach[kMostAround];  ///< half of 1 + their squared distance
    };
    Lists<Packet> lists;
    State state;
    Period period;
    const Directions* directions;
    float per_spacing;
    const Phase* phases;
    Skin skin;
    template <class Group>
    GB_FN void operator()(Group& g, Scratch<Group>& near, std::size_t item) const {
        using F = typename Group::F;
        constexpr int parts = kDirections / Group::width;
        const std::size_t row = skin.rows[item];
        const std::uint32_t slot = lists.rows[row];
        const int n = int(lists.count[row]);
        const Vec3<F> at = wide<F>(state.place[slot].xyz());
        g.sync();
        list_slots(g, lists, row, n, near.slot);
        for (int k = 0; k < n; k += Group::width) {
            const Vec3<F> d = period.template shortest<periodic>(g.gather(state.place, near.slot + k).xyz() - at) * F(per_spacing);
            g.store_run(d.x, near.x + k);
            g.store_run(d.y, near.y + k);
            g.store_run(d.z, near.z + k);
            g.store_run(F(0.5f) + F(0.5f) * dot(d, d), near.reach + k);
        }
        g.sync();
        constexpr float margin = 0.5f * kSurelyEmpty * kSurelyEmpty;
        F deep[parts];  // above 0: somebody is in the ball in that direction
        for (int p = 0; p < parts; ++p) deep[p] = F(-1.0f);
        for (int k = 0; k < n; ++k)
            for (int p = 0; p < parts; ++p) {
                const int first = p * Group::width;
                deep[p] = most(deep[p], F(near.x[k]) * g.load_run(directions->x + first) + (F(near.y[k]) * g.load_run(directions->y + first) +
                                        (F(near.z[k]) * g.load_run(directions->z + first) + F(margin - near.reach[k]))));
            }
        std::uint32_t open[kDirections / 32] = {};
        for (int p = 0; p < parts; ++p) open[p * Group::width / 32] |= g.set_of(deep[p] < F(0.0f)) << p * Group::width % 32;
        for (int w = 0; w < kDirections / 32; ++w)
            for (std::uint32_t set = open[w]; set; set &= set - 1)
                if (open_around(g, near, n, directions->finer[32 * w + trailing_zeros(set)])) {
                    if (!g.is_first()) return;
                    for (int v = 0; v < kDirections / 32; ++v) skin.open[v * skin.padded + row] = open[v];
                    skin.place[slot].w = phases[state.phase[slot]].tension;
                    return;
                }
    }

private:
    template <class Group>
    GB_FN static bool open_around(Group& g, const Scratch<Group>& near, int n, const float3 (&directions)[kFiner]) {
        using F = typename Group::F;
        constexpr float margin = 0.5f * kSurelyEmptyFiner * kSurelyEmptyFiner;
        for (int c = 0; c < kFiner; ++c) {
            bool open = true;
            for (int k = 0; k < n && open; k += Group::width) {
                const F along = F(directions[c].x) * g.load_run(near.x + k) + F(directions[c].y) * g.load_run(near.y + k) + F(directions[c].z) * g.load_run(near.z + k);
                open = !g.any(along + F(margin) >= g.load_run(near.reach + k));
            }
            if (open) return true;
        }
        return false;
    }
};

/// The facets around every row's particle, and its normal.  A group's lanes are neighbours, then pairs of them.
template <class Packet, bool periodic>
struct FindFacets {
    static constexpr float kSurely = 1e-4f;  ///< of the squared radius: deeper in a ball than that is within, whatever the rounding
    static constexpr int kAtOnce = 4;        ///< neighbours that are tried before a look at who is left
    template <class Group>
    struct Scratch {
        std::uint32_t slot[kMostAround];  ///< of the neighbours, to a full run of lanes
        float x[kMostAround], y[kMostAround], z[kMostAround];  ///< from the particle
        float reach[kMostAround];  ///< half of their squared distance
        std::uint32_t kept[kMostNear + Group::width];
        Quad near[kMostNear];  ///< place, and tension, of those that a facet may have, in the slots' order
        std::uint32_t near_slot[kMostNear];
        std::uint32_t found[kMostFacets];  ///< whether the ball is below the facet, then its neighbours in `near`, a byte each
        Quad normal[kMostFacets];  ///< of a facet, and what it is taken by
        float angle[kMostFacets];
    };
    /// Circle through three particles, as seen from the first of them.
    template <class F>
    struct Circle {
        Vec3<F> first, middle, across;
        F n2, height2;  ///< of across; of the centers of balls over the middle
        GB_FN Vec3<F> up() const { return across * root(height2 / n2); }
    };
    Lists<Packet> lists;
    Skin skin;
    Period period;
    const Directions* directions;
    float radius;   ///< of the ball

    template <class Group>
    GB_FN void operator()(Group& g, Scratch<Group>& s, std::size_t item) const {
        using F = typename Group::F;
        using B = typename Group::B;
        const std::size_t row = skin.rows[item];
        const std::uint32_t slot = lists.rows[row];
        const Quad mine = skin.place[slot];
        if (!(mine.w > 0.0f)) return;
        const int n = int(lists.count[row]);
        g.sync();
        list_slots(g, lists, row, n, s.slot);
        float3 outwards;
        const int n_near = collect(g, s, row, n, mine.xyz(), outwards);
        const int before = count_before(s, n_near, slot), n_pairs = n_near * (n_near - 1) / 2;
        int n_found = 0;
        for (int p = 0; p < n_pairs; p += Group::width) {
            const Four<F> i = g.gather(s.near, directions->pair_i + p), k = g.gather(s.near, directions->pair_k + p);
            const B i_first = g.before(directions->pair_i + p, std::uint32_t(before)), k_first = g.before(directions->pair_k + p, std::uint32_t(before));
            const Circle<F> c = circle(wide<F>(mine.xyz()), i.xyz(), k.xyz(), i_first, k_first);
            const Vec3<F> between = period.template shortest<periodic>(k.xyz() - i.xyz());
            const B held = (i.w * k.w > F(0.0f)) | (dot(between, between) < F(kReach * kReach * radius * radius));
            const B may = g.first_lanes(n_pairs - p) & held & (c.height2 > F(0.0f));
            if (!g.any(may)) continue;
            const Vec3<F> up = c.up(), middle = c.middle + period.template shortest<periodic>(c.first - wide<F>(mine.xyz()));
            // Balls on the fluid's side go together: a few neighbours close them all.
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
    template <class B, class F>
    GB_FN static Vec3<F> choose(const B& m, const Vec3<F>& p, const Vec3<F>& q) { return {select(m, p.x, q.x), select(m, p.y, q.y), select(m, p.z, q.z)}; }

    /// The neighbours, those that a facet may have, and where there are none.
    template <class Group>
    GB_FN int collect(Group& g, Scratch<Group>& s, std::size_t row, int n, const float3& at, float3& outwards) const {
        using F = typename Group::F;
        using B = typename Group::B;
        constexpr float low = kSurelyEmpty * kSurelyEmpty, high = (2.0f - kSurelyEmpty) * (2.0f - kSurelyEmpty);
        int n_near = 0;
        outwards = {0, 0, 0};
        for (int v = 0; v < kDirections / 32; ++v)
            for (std::uint32_t set = skin.open[v * skin.padded + row]; set; set &= set - 1) {
                const int i = 32 * v + trailing_zeros(set);
                outwards = outwards + float3{directions->x[i], directions->y[i], directions->z[i]};
            }
        for (int k = 0; k < n; k += Group::width) {
            const Four<F> p = g.gather(skin.place, s.slot + k);
            const Vec3<F> d = period.template shortest<periodic>(p.xyz() - wide<F>(at));
            const F d2 = dot(d, d);
            g.store_run(d.x, s.x + k);
            g.store_run(d.y, s.y + k);
            g.store_run(d.z, s.z + k);
            g.store_run(F(0.5f) * d2, s.reach + k);
            const B reaches = (p.w > F(0.0f)) | ((p.w < F(0.0f)) & (d2 < F(kReach * kReach * radius * radius)));
            // A ball that touches the particle in an open direction may touch the neighbour, too.
            const Vec3<F> unit = d * F(1.0f / radius);
            const F both2 = dot(unit, unit) + F(1.0f), least_along = F(0.5f) * (both2 - F(high)), most_along = F(0.5f) * (both2 - F(low));
            B touched = g.none();
            for (int v = 0; v < kDirections / 32; ++v)
                for (std::uint32_t set = skin.open[v * skin.padded + row]; set; set &= set - 1) {
                    const int i = 32 * v + trailing_zeros(set);
                    const F along = unit.x * F(directions->x[i]) + unit.y * F(directions->y[i]) + unit.z * F(directions->z[i]);
                    touched = touched | ((along >= least_along) & (along <= most_along));
                }
            const B taken = reaches & touched;
            if (n_near < kMostNear) g.keep(taken, g.numbers(std::uint32_t(k)), s.kept + n_near);
            n_near += g.count(taken);
        }
        g.sync();
        n_near = least(n_near, kMostNear);
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
        return n_near;
    }
    template <class S>
    GB_FN static int count_before(const S& s, int n_near, std::uint32_t slot) {
        int n = 0;
        while (n < n_near && s.near_slot[n] < slot) ++n;
        return n;
    }

    /// Of the particle and two others, i's slot lower than k's.  From the lowest slot, in the slots' order: the same numbers whoever asks.
    template <class F, class B>
    GB_FN Circle<F> circle(const Vec3<F>& at, const Vec3<F>& i, const Vec3<F>& k, const B& i_first, const B& k_first) const {
        Circle<F> c;
        c.first = choose(i_first, i, at);
        const Vec3<F> u = period.template shortest<periodic>(choose(k_first, k, choose(i_first, at, i)) - c.first);
        const Vec3<F> v = period.template shortest<periodic>(choose(k_first, at, k) - c.first);
        c.across = cross(u, v);
        const F u2 = dot(u, u), v2 = dot(v, v);
        c.n2 = dot(c.across, c.across);
        c.middle = cross(v * u2 - u * v2, c.across) * (F(0.5f) / c.n2);
        c.height2 = select(c.n2 > F(1e-6f) * u2 * v2, F(radius * radius) - dot(c.middle, c.middle), F(0.0f));
        return c;
    }
    template <class S>
    GB_FN Circle<float> circle_of(const S& s, std::uint32_t ball, const float3& at, int before) const {
        const int i = int(ball >> 8 & 255u), k = int(ball & 255u);
        return circle(at, s.near[i].xyz(), s.near[k].xyz(), i < before, k < before);
    }

    /// Those of the balls that nobody is deep in; their centers are seen from the particle.
    template <class Group>
    GB_FN typename Group::B open(Group& g, const Scratch<Group>& s, int n, const typename Group::B& which, const Vec3<typename Group::F>& center) const {
        using F = typename Group::F;
        const F sure = F(0.5f * kSurely * radius * radius);
        F deep = select(which, F(-infinity()), F(infinity()));
        for (int m = 0; m < n && g.any(deep <= sure); m += kAtOnce)
            for (int k = m; k < m + kAtOnce; ++k)
                deep = most(deep, F(s.x[k]) * center.x + (F(s.y[k]) * center.y + (F(s.z[k]) * center.z - F(s.reach[k]))));
        return deep <= sure;
    }
    /// Adds those of the balls that hold nobody.
    template <class Group>
    GB_FN int take(Group& g, Scratch<Group>& s, int n, const typename Group::B& which, int p, std::uint32_t side, const float3& at,
                   int before, int n_found) const {
        g.each(which, [&](int lane) {
            const std::uint32_t ball = side << 16 | directions->pair_i[p + lane] << 8 | directions->pair_k[p + lane];
            if (n_found == kMostFacets || !empty(g, s, n, ball, at, before)) return;
            if (g.is_first()) s.found[n_found] = ball;
            ++n_found;
        });
        return n_found;
    }
    /// Nobody is in the ball but the three it touches.
    template <class Group>
    GB_FN bool empty(Group& g, const Scratch<Group>& s, int n, std::uint32_t ball, const float3& at, int before) const {
        using F = typename Group::F;
        const Circle<float> c = circle_of(s, ball, at, before);
        const float3 center = ball >> 16 ? c.middle - c.up() : c.middle + c.up();
        const std::uint32_t i = s.near_slot[ball >> 8 & 255u], k = s.near_slot[ball & 255u];
        for (int m = 0; m < n; m += Group::width) {
            const Vec3<F> d = period.template shortest<periodic>(g.gather(skin.place, s.slot + m).xyz() - wide<F>(c.first)) - wide<F>(center);
            if (g.any((dot(d, d) < F(radius * radius)) & g.differ(s.slot + m, i) & g.differ(s.slot + m, k))) return false;
        }
        return true;
    }

    /// Writes the facets and the normal, in the order of the neighbours.
    template <class Group>
    GB_FN void finish(Group& g, Scratch<Group>& s, std::size_t row, std::uint32_t slot, const Quad& mine, int before, int n_found) const {
        const auto key = [&](int f) { return (s.found[f] << 1 | s.found[f] >> 16) & 0x1ffffu; };
        g.share(n_found, [&](int f) {
            int place = 0;
            for (int i = 0; i < n_found; ++i) place += key(i) < key(f);
            const std::uint32_t ball = s.found[f], j = ball >> 8 & 255u, k = ball & 255u;
            const std::size_t at = std::size_t(place) * 2 * skin.padded + row;
            skin.facets[at] = s.near_slot[j];
            skin.facets[at + skin.padded] = s.near_slot[k];
            const Circle<float> c = circle_of(s, ball, mine.xyz(), before);
            const float3 e = period.template shortest<periodic>(s.near[j].xyz() - mine.xyz()), o = period.template shortest<periodic>(s.near[k].xyz() - mine.xyz());
            const float angle = atan2f(length(cross(e, o)), dot(e, o));
            s.normal[place] = {c.across.x, c.across.y, c.across.z, (ball >> 16 ? -angle : angle) / root(c.n2)};
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
        const float scale = 1.0f / most(length(normal), 0.5f * angles);
        skin.normal[slot] = {scale * normal.x, scale * normal.y, scale * normal.z, mine.w};
    }
};

/// What the facets' tension adds to the accelerations.  The flow inside of a drop grows with the distance from its middle:
/// what a vertex does is more than what its particle does, as the roots of the facet's areas are.
template <class Packet, bool periodic>
struct PullSurface {
    Lists<Packet> lists;
    const Quad* place;
    Skin skin;
    const float* inverse_rho;
    Period period;
    float offset;  ///< of the surface from its particles
    float per_volume;
    Quad* acceleration;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = lists.rows[row], n = skin.count[row];
        if (n == 0) return;
        const Quad mine = skin.normal[slot];
        float3 pull{0, 0, 0};
        for (std::uint32_t f = 0; f < n; ++f) {
            const std::size_t at = std::size_t(f) * 2 * skin.padded + row;
            const std::uint32_t j = skin.facets[at], k = skin.facets[at + skin.padded];
            const Quad nj = skin.normal[j], nk = skin.normal[k];
            const float3 u = period.template shortest<periodic>(place[j].xyz() - place[slot].xyz());
            const float3 v = period.template shortest<periodic>(place[k].xyz() - place[slot].xyz());
            const float3 p = u + (nj.xyz() - mine.xyz()) * offset, q = v + (nk.xyz() - mine.xyz()) * offset;
            const float3 across = cross(p, q);
            const float outer = length(across), inner = length(cross(u, v));
            if (!(outer > 0.0f)) continue;
            const float share = root(least(most(outer / most(inner, 1e-20f), 0.25f), 4.0f));
            const float sigma = (mine.w + nj.w + nk.w) / (1.0f + (nj.w > 0.0f) + (nk.w > 0.0f));
            pull = pull - cross(across, q - p) * (0.5f * sigma * share / outer);
        }
        const float s = per_volume * inverse_rho[row];
        Quad& a = acceleration[row];
        a = {a.x + s * pull.x, a.y + s * pull.y, a.z + s * pull.z, 0.0f};
    }
};

}  // namespace globule::sim
