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
#include "globule/sim/density.hpp"

namespace globule::sim {

inline constexpr int kMostFacets = 24;        ///< around a particle; about 6 in a surface, 12 in a sheet
inline constexpr int kMostNear = 48;          ///< neighbours at the surface that are looked at
inline constexpr float kSurfaceGradient = 0.1f;  ///< of the density, per spacing: less is not at a surface (with 0.2, some that are)
/// Spacings from the outermost particles to the surface: with this one, facets enclose the fluid's volume (within 1 %
/// in drops of 5 to 10 spacings), for the density solve packs particles closer at the surface than inside.
inline constexpr float kSurfaceOffset = 0.69f;
inline constexpr float kJitter = 1e-3f;       ///< spacings: four of a lattice lie on one ball

/// Spacings from fluid to what is not: fluid that lies against a wall is nearer, and one that is not yet there is not drawn to it.
inline constexpr float kReach = 1.2f;

/// Directions all around, none farther than 16 degrees from one of them.
inline constexpr int kDirections = 96;
struct Directions {
    float x[kDirections], y[kDirections], z[kDirections];
    Directions() {
        for (int k = 0; k < kDirections; ++k) {
            z[k] = 1.0f - float(2 * k + 1) / kDirections;
            const float r = std::sqrt(1.0f - z[k] * z[k]);
            x[k] = r * std::cos(2.399963f * k);
            y[k] = r * std::sin(2.399963f * k);
        }
    }
};
/// Where a ball of one spacing's radius touches a particle in any direction, nobody is in one of this radius
/// that touches it in the nearest of the directions above, at one spacing's distance of their centres.
inline constexpr float kSurelyEmpty = 0.72f;

/// Who may be at the surface of a fluid with tension.
struct Skin {
    Quad* place;        ///< per slot: position (jittered); w: tension, 0 where not at a surface, -1: not fluid
    Quad* normal;       ///< per slot: outwards, at most 1 long; w: tension
    std::uint32_t* facets;  ///< (kMostFacets, 2, padded rows): slots of the other two vertices
    std::uint32_t* count;   ///< per row
    std::uint32_t* open;    ///< (kDirections / 32, padded rows): bits of the directions without anybody
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
/// Particles with a gradient of the density, that a ball may touch.
template <class Packet, bool periodic>
struct MarkTension {
    Lists<Packet> lists;
    State state;
    Period period;
    Directions directions;
    float per_spacing;
    const Phase* phases;
    Rows values;
    float least_gradient;  ///< |G| times the support
    Skin skin;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = lists.rows[row];
        const Phase& phase = phases[state.phase[slot]];
        const float3 g{values.gx[row], values.gy[row], values.gz[row]};
        if (phase.kind != Kind::fluid || !(phase.tension > 0.0f) || !(dot(g, g) > least_gradient * least_gradient)) return;
        if (reached(slot, row)) skin.place[slot].w = phase.tension;
    }
    GB_FN bool reached(std::uint32_t slot, std::size_t row) const {
        float room[kDirections];  // below 0: somebody is in the ball in that direction
        for (int k = 0; k < kDirections; ++k) room[k] = 1.0f;
        const float3 at = state.place[slot].xyz();
        for (std::uint32_t i = 0; i < lists.count[row]; ++i) {
            const float3 d = period.template shortest<periodic>(state.place[lists.index[lists.at(row, i)]].xyz() - at) * per_spacing;
            const float limit = 0.5f * (1.0f + dot(d, d) - kSurelyEmpty * kSurelyEmpty);
            for (int k = 0; k < kDirections; ++k) room[k] = least(room[k], limit - (d.x * directions.x[k] + d.y * directions.y[k] + d.z * directions.z[k]));
        }
        std::uint32_t some = 0;
        for (int w = 0; w < kDirections / 32; ++w) {
            std::uint32_t bits = 0;
            for (int k = 0; k < 32; ++k) bits |= std::uint32_t(room[32 * w + k] > 0.0f) << k;
            skin.open[w * skin.padded + row] = bits;
            some |= bits;
        }
        return some != 0;
    }
};

/// The facets around every row's particle, and its normal.
template <class Packet, bool periodic>
struct FindFacets {
    Lists<Packet> lists;
    Skin skin;
    Period period;
    Directions directions;
    float radius;   ///< of the ball
    GB_FN float3 from(std::uint32_t a, std::uint32_t b) const {
        return period.template shortest<periodic>(skin.place[b].xyz() - skin.place[a].xyz());
    }
    /// Nobody in the ball around `center` seen from slot a, but the three it touches.
    GB_FN bool empty(std::size_t row, std::uint32_t n, std::uint32_t a, std::uint32_t b, std::uint32_t c, const float3& center, std::uint32_t& blocker) const {
        const float most2 = radius * radius;
        for (std::uint32_t k = 0; k <= n; ++k) {
            const std::uint32_t m = k == 0 ? blocker : lists.index[lists.at(row, k - 1)];
            if (m == a || m == b || m == c || m == lists.n) continue;
            const float3 d = from(a, m) - center;
            if (dot(d, d) < most2) {
                blocker = m;
                return false;
            }
        }
        return true;
    }
    /// Whether a facet may have these two vertices.
    GB_FN bool reaches(std::uint32_t a, std::uint32_t b) const {
        if (skin.place[a].w * skin.place[b].w > 0.0f) return true;
        const float3 d = from(a, b);
        return dot(d, d) < kReach * kReach * radius * radius;
    }
    /// Whether a ball that touches row's particle may touch one that is d away, too.
    GB_FN bool touched(std::size_t row, const float3& d) const {
        constexpr float low = kSurelyEmpty * kSurelyEmpty, high = (2.0f - kSurelyEmpty) * (2.0f - kSurelyEmpty);
        for (int w = 0; w < kDirections / 32; ++w) {
            const std::uint32_t bits = skin.open[w * skin.padded + row];
            for (int k = 0; k < 32; ++k) {
                if (!(bits >> k & 1u)) continue;
                const float3 to{d.x - directions.x[32 * w + k], d.y - directions.y[32 * w + k], d.z - directions.z[32 * w + k]};
                const float r2 = dot(to, to);
                if (r2 >= low && r2 <= high) return true;
            }
        }
        return false;
    }
    GB_FN void operator()(std::size_t row) const {
        skin.count[row] = 0;
        const std::uint32_t slot = lists.rows[row], n = lists.count[row];
        if (!(skin.place[slot].w > 0.0f)) return;
        std::uint32_t near[kMostNear], blocker = lists.n;
        int n_near = 0, n_facets = 0;
        for (std::uint32_t k = 0; k < n && n_near < kMostNear; ++k) {
            const std::uint32_t j = lists.index[lists.at(row, k)];
            if (skin.place[j].w != 0.0f && touched(row, from(slot, j) * (1.0f / radius))) near[n_near++] = j;
        }
        float3 normal{0, 0, 0};
        float angles = 0.0f;
        for (int s = 0; s < n_near; ++s)
            for (int t = s + 1; t < n_near; ++t) {
                if (!reaches(slot, near[s]) || !reaches(slot, near[t]) || !reaches(near[s], near[t])) continue;
                // The same numbers whoever asks: from the lowest slot, in the slots' order.
                std::uint32_t a = slot, b = near[s], c = near[t];
                order(a, b);
                order(b, c);
                order(a, b);
                const float3 u = from(a, b), v = from(a, c), across = cross(u, v);
                const float u2 = dot(u, u), v2 = dot(v, v), n2 = dot(across, across);
                if (!(n2 > 1e-6f * u2 * v2)) continue;
                const float3 middle = cross(v * u2 - u * v2, across) * (0.5f / n2);
                const float height2 = radius * radius - dot(middle, middle);
                if (!(height2 > 0.0f)) continue;
                const float3 up = across * root(height2 / n2);
                for (int side = 0; side < 2; ++side) {
                    const float3 center = side ? middle - up : middle + up;
                    if (n_facets == kMostFacets || !empty(row, n, a, b, c, center, blocker)) continue;
                    const std::size_t at = std::size_t(n_facets) * 2 * skin.padded + row;
                    skin.facets[at] = near[s];
                    skin.facets[at + skin.padded] = near[t];
                    ++n_facets;
                    const float3 e = from(slot, near[s]), f = from(slot, near[t]);
                    const float angle = atan2f(length(cross(e, f)), dot(e, f));
                    normal = normal + across * ((side ? -angle : angle) / root(n2));
                    angles += angle;
                }
            }
        if (n_facets == 0) return;
        skin.count[row] = std::uint32_t(n_facets);
        const float s = 1.0f / most(length(normal), 0.5f * angles);
        skin.normal[slot] = {s * normal.x, s * normal.y, s * normal.z, skin.place[slot].w};
    }

private:
    GB_FN static void order(std::uint32_t& a, std::uint32_t& b) {
        const std::uint32_t low = least(a, b);
        b = most(a, b);
        a = low;
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
        const std::uint32_t slot = lists.rows[row];
        const Quad mine = skin.normal[slot];
        float3 pull{0, 0, 0};
        for (std::uint32_t f = 0; f < skin.count[row]; ++f) {
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
