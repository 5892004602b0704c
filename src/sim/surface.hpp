// Surface tension, from the area of the fluid's free surface.
//
// The surface is where a ball as large as a spacing can roll over the particles (the boundary of their
// alpha shape; Edelsbrunner & Mücke 1994): a facet is three particles that such a ball touches with nobody in
// it.  Its vertices lie at the surface, outside of their particles.  Tension is what the facets' area
// costs: every vertex is pulled by -sigma dA/dx.  The three pulls of a facet add up to nothing, and so does their
// torque: momentum is kept.  Each particle finds the facets around it by itself, from its own neighbors;
// all three come to the same ones, for they ask the same questions with the same numbers.
// Facets reach to the particles of walls and tissue, which hold them: a surface ends there, it is not drawn away.
#pragma once
#include "exec/bits.hpp"
#include "sim/density.hpp"

namespace globule::core::sim {

inline constexpr int kMostFacets = 32;   ///< around a particle; about 6 in a surface, 12 in a sheet, 30 in spray
inline constexpr int kMostNear = 48;     ///< neighbors at the surface that are looked at
inline constexpr int kMostAround = 192;  ///< neighbors; about 30 are usual, who has more than this is at no surface
inline constexpr float kSurfaceGradient =
    0.1f;  ///< of the density, per spacing: less is not at a surface (with 0.2, some that are)
/// Spacings from the outermost particles to the surface: with this one, facets enclose the fluid's volume (within 1 %
/// in drops of 5 to 10 spacings), for the density solve packs particles closer at the surface than inside.
inline constexpr float kSurfaceOffset = 0.69f;
/// Least viscosity of a fluid with tension, in sqrt(density tension spacing).  Facets come and go as particles move,
/// which is work that no energy knows of: with less viscosity, the outermost particles boil, drops swell and swing too
/// slowly.
inline constexpr float kLeastViscosity = 0.0075f;
inline float least_viscosity(const Phase& phase, float spacing) {
    return phase.tension > 0.0f ? kLeastViscosity * std::sqrt(phase.density * phase.tension * spacing) : 0.0f;
}
inline constexpr float kJitter = 1e-3f;  ///< spacings: four of a lattice lie on one ball

/// Spacings: who is nearer with jitter is nearer than 2 without, and in the list of neighbors.
inline constexpr float kFarthest = 2.0f - 4.0f * kJitter;

/// Spacings from fluid to what is not: fluid that lies against a wall is nearer, and one that is not yet there is not
/// drawn to it.
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
/// that touches it in the nearest of the directions above, at one spacing's distance of their centers.
inline constexpr float kSurelyEmpty = 0.72f;
inline constexpr float kSurelyEmptyFiner = 0.86f;

/// Who may be at the surface of a fluid with tension.
struct Skin {
    Quad* place;            ///< per slot: position (jittered); w: tension, 0 where not at a surface, -1: not fluid
    Quad* normal;           ///< per slot: outwards, at most 1 long; w: tension
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
        skin.place[i] = {p.x + s * jitter(id), p.y + s * jitter(id + 1), p.z + s * jitter(id + 2),
            phases[state.phase[i]].kind == Kind::fluid ? 0.0f : -1.0f};
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
        if (phase.kind != Kind::fluid || !(phase.tension > 0.0f) || !(dot(g, g) > least_gradient * least_gradient))
            return;
        if (neighbors[row] <= std::uint32_t(kMostAround)) skin.rows[atomic_take(skin.n_rows, 1)] = std::uint32_t(row);
    }
};

template <class F> GB_FN Vec3<F> wide(const float3& p) { return {F(p.x), F(p.y), F(p.z)}; }
/// Slots of a row's n neighbors; the last run of lanes is filled up with nobody, who is far away.
template <class Group, class Packet>
GB_FN void list_slots(Group& g, const Lists<Packet>& lists, std::size_t row, int n, std::uint32_t* slots) {
    g.share(ceil_div(n, Group::width) * Group::width,
        [&](int k) { slots[k] = k < n ? lists.index[lists.at(row, std::uint32_t(k))] : lists.n; });
}

/// Of these, the particles that a ball may touch.  A group's lanes are directions, then neighbors.
template <class Packet, bool periodic> struct MarkTension {
    template <class Group> struct Scratch {
        std::uint32_t slot[kMostAround];                       ///< of the neighbors, to a full run of lanes
        float x[kMostAround], y[kMostAround], z[kMostAround];  ///< in spacings from the particle
        float reach[kMostAround];                              ///< half of 1 + their squared distance
    };
    Lists<Packet> lists;
    State state;
    Period period;
    const Directions* directions;
    float per_spacing;
    const Phase* phases;
    Skin skin;
    template <class Group> GB_FN void operator()(Group& g, Scratch<Group>& near, std::size_t item) const {
        using F = typename Group::F;
        constexpr int parts = kDirections / Group::width;
        const std::size_t row = skin.rows[item];
        const std::uint32_t slot = lists.rows[row];
        const int n = int(lists.count[row]);
        const Vec3<F> at = wide<F>(state.place[slot].xyz());
        g.sync();
        list_slots(g, lists, row, n, near.slot);
        for (int k = 0; k < n; k += Group::width) {
            const Vec3<F> d =
                period.template shortest<periodic>(g.gather(state.place, near.slot + k).xyz() - at) * F(per_spacing);
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
                deep[p] = max(
                    deep[p], F(near.x[k]) * g.load_run(directions->x + first) +
                                 (F(near.y[k]) * g.load_run(directions->y + first) +
                                     (F(near.z[k]) * g.load_run(directions->z + first) + F(margin - near.reach[k]))));
            }
        std::uint32_t open[kDirections / 32] = {};
        for (int p = 0; p < parts; ++p)
            open[p * Group::width / 32] |= g.set_of(deep[p] < F(0.0f)) << p * Group::width % 32;
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
                const F along = F(directions[c].x) * g.load_run(near.x + k) +
                                F(directions[c].y) * g.load_run(near.y + k) +
                                F(directions[c].z) * g.load_run(near.z + k);
                open = !g.any(along + F(margin) >= g.load_run(near.reach + k));
            }
            if (open) return true;
        }
        return false;
    }
};

/// Slots of the other two vertices of a row's facet.
GB_FN void vertices(const Skin& skin, std::size_t row, std::uint32_t facet, std::uint32_t& j, std::uint32_t& k) {
    const std::size_t at = std::size_t(facet) * 2 * skin.padded + row;
    j = skin.facets[at];
    k = skin.facets[at + skin.padded];
}

/// What the facets' tension adds to the accelerations.  The flow inside of a drop grows with the distance from its
/// middle: what a vertex does is more than what its particle does, as the roots of the facet's areas are.
struct Tension {
    const Quad* place;
    Skin skin;
    Period period;
    float offset;  ///< of the surface from its particles
    /// Takes from `pull` what a facet does to its vertex i, whose normal is `mine`; `fluid`: is that fluid.
    template <bool periodic, bool fluid>
    GB_FN void take(std::uint32_t i, const Quad& mine, std::uint32_t j, std::uint32_t k, float3& pull) const {
        const Quad nj = skin.normal[j], nk = skin.normal[k];
        const float3 u = period.template shortest<periodic>(place[j].xyz() - place[i].xyz());
        const float3 v = period.template shortest<periodic>(place[k].xyz() - place[i].xyz());
        const float3 p = u + (nj.xyz() - mine.xyz()) * offset, q = v + (nk.xyz() - mine.xyz()) * offset;
        const float3 across = cross(p, q);
        const float outer = length(across), inner = length(cross(u, v));
        if (!(outer > 0.0f)) return;
        const float share = sqrt(min(max(outer / max(inner, 1e-20f), 0.25f), 4.0f));
        const float sigma = (mine.w + nj.w + nk.w) / ((fluid ? 1.0f : 0.0f) + (nj.w > 0.0f) + (nk.w > 0.0f));
        pull = pull - cross(across, q - p) * (0.5f * sigma * share / outer);
    }
};

template <class Packet, bool periodic> struct PullSurface {
    Lists<Packet> lists;
    Tension tension;
    const float* inverse_rho;
    float per_volume;
    Quad* acceleration;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = lists.rows[row], n = tension.skin.count[row];
        if (n == 0) return;
        const Quad mine = tension.skin.normal[slot];
        float3 pull{0, 0, 0};
        for (std::uint32_t f = 0; f < n; ++f) {
            std::uint32_t j, k;
            vertices(tension.skin, row, f, j, k);
            tension.template take<periodic, true>(slot, mine, j, k, pull);
        }
        const float s = per_volume * inverse_rho[row];
        Quad& a = acceleration[row];
        a = {a.x + s * pull.x, a.y + s * pull.y, a.z + s * pull.z, 0.0f};
    }
};

struct RowOf {
    const std::uint32_t* rows;
    std::uint32_t* row_of;  ///< per slot
    GB_FN void operator()(std::size_t row) const { row_of[rows[row]] = std::uint32_t(row); }
};

/// What facets do to tissue or a rigid body that they reach to, so that momentum is kept, N.  These find no facets;
/// they ask those of the fluid beside them, each facet at the first of its vertices that are fluid.
template <class Packet, bool periodic> struct PullOther {
    Lists<Packet> lists;
    Tension tension;
    const std::uint32_t* row_of;
    GB_FN float3 operator()(std::size_t row) const {
        const Skin& skin = tension.skin;
        const std::uint32_t slot = lists.rows[row];
        float3 pull{0, 0, 0};
        if (!(skin.place[slot].w < 0.0f)) return pull;
        for (std::uint32_t l = 0, n = lists.count[row]; l < n; ++l) {
            const std::uint32_t i = lists.index[lists.at(row, l)];
            if (i >= lists.n || !(skin.place[i].w > 0.0f)) continue;
            const std::size_t other = row_of[i];
            for (std::uint32_t f = 0, n_facets = skin.count[other]; f < n_facets; ++f) {
                std::uint32_t j, k;
                vertices(skin, other, f, j, k);
                if (j != slot && k != slot) continue;
                const std::uint32_t third = j == slot ? k : j;
                if (skin.place[third].w > 0.0f && third < i) continue;
                tension.template take<periodic, false>(slot, {0.0f, 0.0f, 0.0f, 0.0f}, i, third, pull);
            }
        }
        return pull;
    }
};
template <class Packet, bool periodic> struct PullTissue {
    PullOther<Packet, periodic> pull;
    const float* inverse_rho;
    float per_volume;
    Quad* acceleration;
    GB_FN void operator()(std::size_t row) const {
        if (!(inverse_rho[row] > 0.0f)) return;
        const float3 p = pull(row) * (per_volume * inverse_rho[row]);
        Quad& a = acceleration[row];
        a = {a.x + p.x, a.y + p.y, a.z + p.z, 0.0f};
    }
};

}  // namespace globule::core::sim
