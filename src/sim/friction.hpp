// Coulomb friction of tissue: between cut faces in the substeps, and between what the density solve presses together.
//
// Both sides of a pair compute the same impulse with opposite signs.  It is at most the coefficient times the pair's
// normal impulse.  It is also at most c |sliding|, where the sum of the c of all pairs of a particle is at most half
// its mass (its whole mass, against what does not give way).  So the matrix of all c is at most that of the masses:
// sliding never turns round, and energy never grows.
#pragma once
#include "sim/couple.hpp"
#include "sim/pressure.hpp"
#include "sim/rigid.hpp"

namespace globule::core::tissue {

/// Between cut faces: for each particle the impulse of a substep.  A pair's normal is its own direction.
struct Rub {
    Bonds bonds;
    const Quad* at;  ///< that the contacts' forces came from; w: inverse mass times the largest eigenvalue, of springs
    const Quad* velocity;  ///< after these; w: inverse mass
    const std::uint8_t* hold;
    const std::uint8_t* phase;
    Materials materials;
    float dt, contact;
    bool is_solid;
    float3* impulse;

    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        float3 sum{0, 0, 0};
        if (bonds.scarred[t] && hold[t] != kGone) {
            const float own = pressing(t);
            for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end && own > 0.0f; e += kBlock) {
                const std::uint32_t o = bonds.other[e];
                const float press = presses(t, e), mu = max(materials.friction[phase[t]], materials.friction[phase[o]]);
                if (!(press > 0.0f && mu > 0.0f)) continue;
                const float3 along =
                    sliding(velocity[t].xyz() - velocity[o].xyz(), normalize(at[t].xyz() - at[o].xyz()));
                const float speed = length(along), all = press / own, others = press / pressing(o);
                const float a = hold[t] == kFree ? all / velocity[t].w : 0.0f,
                            b = hold[o] == kFree ? others / velocity[o].w : 0.0f;
                const float c = a > 0.0f && b > 0.0f ? 0.5f * min(a, b) : max(a, b);
                if (speed > 0.0f) sum = sum - along * min(c, mu * press / speed);
            }
        }
        impulse[t] = sum;
    }
    /// Normal impulse of a cut pair.
    GB_FN float presses(std::uint32_t t, std::uint32_t e) const {
        const std::uint32_t o = bonds.other[e];
        if (!(bonds.length[e] < 0.0f) || hold[o] == kGone || (hold[t] != kFree && hold[o] != kFree)) return 0.0f;
        const float deep = contact - length(at[t].xyz() - at[o].xyz()), k = bonds.stiffness[e] * dt;
        return deep > 0.0f && deep < contact ? deep * k / (is_solid ? 1.0f : max(1.0f, k * dt * (at[t].w + at[o].w)))
                                             : 0.0f;
    }
    GB_FN float pressing(std::uint32_t t) const {
        float sum = 0.0f;
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) sum += presses(t, e);
        return sum;
    }
};
/// What it does; `ahead`: for how long the velocities have led the positions.
struct TakeRub {
    const std::uint8_t *scarred, *hold;
    const float3* impulse;
    Quad *at, *velocity;
    Motions motions;
    Felt felt;
    float ahead;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        if (!scarred[t]) return;
        const float3 p = impulse[t];
        Quad &x = at[t], &v = velocity[t];
        if (hold[t] != kFree) return felt.add_held(t, hold[t], x.xyz(), p, v.w, 0.0f, motions);
        const float3 change = p * v.w;
        v = {v.x + change.x, v.y + change.y, v.z + change.z, v.w};
        x = {x.x + change.x * ahead, x.y + change.y * ahead, x.z + change.z * ahead, x.w};
    }
};

/// Where tissue is pressed against others, in units of P |g|.
struct Loads {
    Quad* of_slot;  ///< of tissue's rows: the normal towards its inside, as long as the share of the pushes that pulls
                    ///< leave; Σ pushes
    double* of_rigid;                  ///< per phase: Σ pushes
    float mass[sim::kMaxPhases] = {};  ///< of rigid bodies
};

struct RigidMass {
    float mass;
    float3 center;
};

/// Contacts of a row of tissue in its list, where there is friction.
template <class Packet> struct PressedPairs {
    sim::Step<Packet> step;
    Members members;
    const std::uint32_t* body;  ///< null: solids, which have in the lists only pairs that a cut has parted
    Loads loads;

    struct Pair {
        std::uint32_t j;
        float mu;
        float3 out;  ///< -g, away from j
        float p;
        GB_FN float push() const { return max(p, 0.0f) * length(out); }
    };
    /// fn(pair) for each of them.
    template <class Fn> GB_FN void each(std::size_t row, const Fn& fn) const {
        const std::uint32_t i = step.lists.rows[row], t = members(step.state.id[i]);
        if (t == kNobody) return;
        for (std::uint32_t k = 0, n = step.lists.count[row]; k < n; ++k) {
            const std::size_t at = step.lists.at(row, k);
            const std::uint32_t j = step.lists.index[at];
            if (j >= step.state.n) continue;
            const sim::Phase& other = step.phases[step.state.phase[j]];
            const float mu = max(step.phases[step.state.phase[i]].friction, other.friction);
            if (!(mu > 0.0f) || other.kind == sim::Kind::fluid) continue;
            if (other.kind == sim::Kind::tissue) {
                const std::uint32_t o = members(step.state.id[j]);
                if (o == kNobody || (body && body[o] == body[t])) continue;
            }
            const float p = step.state.pressure[i] + (step.state.place[j].w < 0.0f ? step.state.pressure[j] : 0.0f);
            fn(Pair{j, mu, step.lists.one_gradient(at) * -1.0f, p});
        }
    }
    /// Impulse over P |g|.
    GB_FN float per_pressure() const { return step.volume * step.dt / (step.flux * step.spline.support); }
    GB_FN float mass(std::uint32_t i) const { return -step.volume / step.state.place[i].w; }
    /// Impulse on the row's particle.
    GB_FN float3 rub(std::uint32_t i, const Pair& pair) const {
        const Quad own = loads.of_slot[i];
        const float size = pair.push();
        if (!(size > 0.0f)) return {0, 0, 0};
        float3 normal = own.xyz();
        float c = size / own.w * mass(i), left = length(normal);
        if (step.state.place[pair.j].w < 0.0f) {
            const Quad others = loads.of_slot[pair.j];
            normal = normal - others.xyz();
            left = 0.5f * (left + length(others.xyz()));
            c = 0.5f * min(c, size / others.w * mass(pair.j));
        } else if (step.phases[step.state.phase[pair.j]].kind == sim::Kind::rigid) {
            const int r = step.state.phase[pair.j];
            c = 0.5f * min(c, kGivesByTurning * float(size / loads.of_rigid[r]) * loads.mass[r]);
        }
        if (!(dot(normal, normal) > 0.0f)) return {0, 0, 0};
        normal = normalize(normal);
        const float3 along = sliding(step.state.velocity[i].xyz() - step.state.velocity[pair.j].xyz(), normal);
        const float speed = length(along),
                    most = pair.mu * per_pressure() * left * pair.p * max(dot(pair.out, normal), 0.0f);
        return speed > 0.0f ? along * -min(c, most / speed) : float3{0, 0, 0};
    }
    /// A body that turns gives way more easily at its rim than its mass tells.
    static constexpr float kGivesByTurning = 0.25f;
};

template <class Packet> struct FindLoads {
    PressedPairs<Packet> pairs;
    GB_FN void operator()(std::size_t row) const {
        float3 out{0, 0, 0}, pushes{0, 0, 0}, all{0, 0, 0};
        float size = 0.0f;
        pairs.each(row, [&](const auto& pair) {  // the normal does not know the pressure, whose noise would tilt it
            out = out + pair.out;
            pushes = pushes + pair.out * max(pair.p, 0.0f);
            all = all + pair.out * pair.p;
            size += pair.push();
        });
        const float pushed = dot(pushes, out), left = pushed > 0.0f ? max(dot(all, out), 0.0f) / pushed : 0.0f;
        if (left > 0.0f) out = normalize(out) * min(left, 1.0f);
        else out = {0, 0, 0};
        pairs.loads.of_slot[pairs.step.lists.rows[row]] = {out.x, out.y, out.z, size};
    }
};
/// How hard tissue presses a rigid body.
template <class Packet> struct LoadOf {
    PressedPairs<Packet> pairs;
    std::uint8_t phase;
    GB_FN double operator()(std::size_t row) const {
        double sum = 0.0;
        pairs.each(row, [&](const auto& pair) {
            if (pairs.step.state.phase[pair.j] == phase) sum += pair.push();
        });
        return sum;
    }
};
/// Change of each row's velocity.
template <class Packet> struct RubPressed {
    PressedPairs<Packet> pairs;
    Quad* change;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t i = pairs.step.lists.rows[row];
        float3 sum{0, 0, 0};
        pairs.each(row, [&](const auto& pair) { sum = sum + pairs.rub(i, pair); });
        const float s = -pairs.step.state.place[i].w / pairs.step.volume;
        change[row] = {sum.x * s, sum.y * s, sum.z * s, 0.0f};
    }
};
/// What it does to those that `Feels` takes, about a center.
template <class Packet, class Feels> struct RubImpulse {
    PressedPairs<Packet> pairs;
    Feels feels;
    float3 center;
    GB_FN sim::Impulse operator()(std::size_t row) const {
        sim::Impulse sum;
        const std::uint32_t i = pairs.step.lists.rows[row];
        pairs.each(row, [&](const auto& pair) {
            if (!feels(pair.j)) return;
            const float3 f = pairs.rub(i, pair) * -1.0f;
            const float3 l =
                cross(pairs.step.period.template shortest<true>(pairs.step.state.place[pair.j].xyz() - center), f);
            sum.p[0] += f.x, sum.p[1] += f.y, sum.p[2] += f.z;
            sum.l[0] += l.x, sum.l[1] += l.y, sum.l[2] += l.z;
        });
        return sum;
    }
};
struct TakeChange {
    const std::uint32_t* rows;
    const Quad* change;
    Quad* velocity;
    GB_FN void operator()(std::size_t row) const {
        const Quad c = change[row];
        Quad& v = velocity[rows[row]];
        v = {v.x + c.x, v.y + c.y, v.z + c.z, v.w};
    }
};

}  // namespace globule::core::tissue
