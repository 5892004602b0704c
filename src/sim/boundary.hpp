// What a boundary's particle stands for, so that a single layer of them stops a fluid whatever their
// spacing (Akinci 2012).
#pragma once
#include "octree/query.hpp"
#include "sim/step.hpp"

namespace globule::core::sim {

/// A plane of a boundary as dense as a plane of the fluid's lattice would leave a lattice that touches it
/// at rest; a fluid without order comes nearer.  With this share more, a tank keeps its height.
inline constexpr float kWallShare = 1.2f;

/// V_b = gamma / sum_b W over the boundary particles of the same phase; gamma: the plane's share of the
/// lattice's sum, times the above.
struct BoundaryVolumes {
    Tree tree;
    State state;
    const Phase* phases;
    Spline spline;
    Period period;
    float gamma;
    GB_FN void operator()(std::size_t i) const {
        const std::uint8_t phase = state.phase[i];
        const Kind kind = phases[phase].kind;
        if (kind != Kind::boundary && kind != Kind::rigid) return;
        const Quad p = state.place[i];
        float sum = 0.0f;
        period.each_image([&](const float3& shift) {
            const float3 at = p.xyz() - shift;
            for_each_touching(tree, at, at, [&](std::uint32_t j) {
                if (state.phase[j] != phase) return;
                sum += spline(length(at - state.place[j].xyz()));
            });
        });
        state.place[i].w = sum > 0.0f ? gamma / sum : 0.0f;
    }
};

/// The last word before particles move: what is within 0.8 spacings of a boundary comes no nearer at full
/// speed, at 0.5 not at all.  The density solve alone would let a single drop through, which does not
/// reach rest density on its way.  Amid four particles of a wall, the nearest is 0.71 spacings away in the wall's very
/// plane: nobody comes nearer to the plane than kLeastHeight.  Along an edge the walls' mean normal tells too little:
/// what is within kTouching of any particle of a wall does not approach that one.
inline constexpr float kTouching = 0.5f, kLeastHeight = 0.15f, kHeightReach = 1.1f;  // spacings

template <class Packet> struct Contact {
    Step<Packet> step;
    const float* share;  ///< per phase, of the change that its bodies' masses allow; null: all

    struct Kept {
        bool out = false;          ///< of a boundary, whose particle `by` is the nearest
        float3 velocity{0, 0, 0};  ///< then
        std::uint32_t by = 0;
    };

    GB_FN void operator()(std::size_t row) const {
        const Kept k = keep(row);
        if (!k.out) return;
        Quad& v = step.state.velocity[step.lists.rows[row]];
        const float3 u = share ? v.xyz() + (k.velocity - v.xyz()) * share[step.state.phase[k.by]] : k.velocity;
        v = {u.x, u.y, u.z, v.w};
    }
    GB_FN Kept keep(std::size_t row) const {
        Kept kept;
        const std::uint32_t slot = step.lists.rows[row];
        const float spacing = step.spacing * (0.5f + 0.5f * step.sizes.at(slot));  // from one to the wall's
        float r = step.rows.boundary[row] / spacing;
        if (!(r < kHeightReach)) return kept;
        const Quad p = step.state.place[slot];
        if (!(p.w < 0.0f)) return kept;
        float3 normal{0, 0, 0}, wall{0, 0, 0};
        float total = 0.0f, most = 0.0f;
        bool led = false;
        each_of_walls(row, led, [&](std::uint32_t j, const Quad& q) {
            const float3 away = step.period.template shortest<true>(p.xyz() - q.xyz());
            const float d2 = dot(away, away) / (spacing * spacing), s = q.w / (d2 * d2 + 1e-3f);  // the nearest rule
            normal = normal + away * s;
            wall = wall + step.state.velocity[j].xyz() * s;
            total += s;
            if (s > most) most = s, kept.by = j;
        });
        if (!(total > 0.0f)) return kept;
        if (led) r = length(step.period.template shortest<true>(p.xyz() - step.state.place[kept.by].xyz())) / spacing;
        const float3 mean = normal * (1.0f / total);
        normal = normalize(normal);
        wall = wall * (1.0f / total);
        const Quad before = step.state.velocity[slot];
        Quad v = before;
        const float approach = dot(v.xyz() - wall, normal);
        if (approach < 0.0f && r < 0.8f) {
            const float s = approach * min((0.8f - r) * (1.0f / 0.3f), 1.0f);
            v = {v.x - s * normal.x, v.y - s * normal.y, v.z - s * normal.z, v.w};
        }
        const float room = max(dot(mean, normal) - kLeastHeight * spacing, 0.0f),
                    rest = dot(v.xyz() - wall, normal) * step.dt + room;
        if (rest < 0.0f) {
            const float s = rest / step.dt;
            v = {v.x - s * normal.x, v.y - s * normal.y, v.z - s * normal.z, v.w};
        }
        if (r < kTouching)
            each_of_walls(row, led, [&](std::uint32_t j, const Quad& q) {
                const float3 away = step.period.template shortest<true>(p.xyz() - q.xyz());
                const float d2 = dot(away, away);
                if (!(d2 < kTouching * kTouching * spacing * spacing)) return;
                const float s = dot(v.xyz() - step.state.velocity[j].xyz(), away) / max(d2, 1e-12f * spacing * spacing);
                if (s < 0.0f) v = {v.x - s * away.x, v.y - s * away.y, v.z - s * away.z, v.w};
            });
        kept.out = v.x != before.x || v.y != before.y || v.z != before.z;
        kept.velocity = v.xyz();
        return kept;
    }

private:
    /// fn(slot, place) of each neighbor that is a boundary's; whether there is fluid of an inlet, too.  Places are
    /// asked for some at once: few rows are near a wall, and each waits for memory.
    template <class Fn> GB_FN void each_of_walls(std::size_t row, bool& led, const Fn& fn) const {
        constexpr std::uint32_t kAtOnce = 8;
        const std::uint32_t n = step.lists.count[row];
        for (std::uint32_t k = 0; k < n; k += kAtOnce) {
            std::uint32_t j[kAtOnce];
            Quad q[kAtOnce];
            for (std::uint32_t m = 0; m < kAtOnce; ++m) j[m] = step.lists.index[step.lists.at(row, min(k + m, n - 1))];
            for (std::uint32_t m = 0; m < kAtOnce; ++m) q[m] = step.state.place[j[m]];
            for (std::uint32_t m = 0; m < kAtOnce; ++m)
                if (k + m < n && q[m].w > 0.0f) {
                    if (step.phases[step.state.phase[j[m]]].kind == Kind::fluid) led = true;
                    else fn(j[m], q[m]);
                }
        }
    }
};

}  // namespace globule::core::sim
