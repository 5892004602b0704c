// What one row's fluid does to a rigid body: by viscosity and adhesion, and by a pressure of its own; and what surfaces
// do to a body's row.
#pragma once
#include "sim/pressure.hpp"
#include "sim/rigid.hpp"
#include "sim/surface.hpp"
#include "sim/viscosity.hpp"

namespace globule::core::sim {

/// Force of fluid on a body, and its moment; over the volume of a particle of size 1.
struct Drag {
    Impulse force;
    double weight = 0;  ///< force per speed
};
struct AddDrag {
    GB_FN Drag operator()(const Drag& a, const Drag& b) const {
        return {AddImpulse{}(a.force, b.force), a.weight + b.weight};
    }
};

/// The opposite of what PairForces, or ApplyViscosity, has for a row's fluid from the particles of one body.
template <class Packet, bool periodic, bool mixed> struct DragOf {
    Lists<Packet> lists;
    State state;
    const Quad* velocity;  ///< per slot
    const float* nearest;  ///< per row
    Interaction pair;
    const float* cohesion;  ///< per slot, or null
    std::uint8_t phase;
    float3 center;
    GB_FN Drag operator()(std::size_t row) const {
        Drag sum;
        if (!(nearest[row] < pair.spline.support)) return sum;
        const std::uint32_t slot = lists.rows[row];
        const Quad at = state.place[slot], v = velocity[slot];
        if (!(at.w < 0.0f)) return sum;
        const float wall = pair.mirror(nearest[row]), own = mixed ? pair.sizes.volume(slot) : 1.0f;
        for (std::uint32_t k = 0; k < lists.count[row]; ++k) {
            const std::uint32_t j = lists.index[lists.at(row, k)];
            if (j >= state.n || state.phase[j] != phase) continue;
            const Quad other = state.place[j];
            const float3 d = pair.period.template shortest<periodic>(at.xyz() - other.xyz());
            const float r = length(d);
            float w, slope, reach = r, share = 1.0f;
            if constexpr (mixed) {
                const Pair<float> of = Pair<float>::of(pair.sizes.at(slot), pair.sizes.at(j));
                of.kernel(pair.spline, r, w, slope);
                reach = r * of.inverse;
                share = of.attracts();
            } else {
                pair.spline(r, w, slope);
            }
            const float s = pair.viscous(slope, v.w + pair.extra_viscosity, other.w * wall);
            float3 f = (v.xyz() - velocity[j].xyz()) * s;
            if (cohesion) f = f + d * (share * pair.pull(reach, r) * max(cohesion[slot] * cohesion[j], 0.0f));
            f = f * (0.0f - own);
            const float3 l = cross(pair.period.template shortest<true>(other.xyz() - center), f);
            sum.force.p[0] += f.x, sum.force.p[1] += f.y, sum.force.p[2] += f.z;
            sum.force.l[0] += l.x, sum.force.l[1] += l.y, sum.force.l[2] += l.z;
            sum.weight -= double(own * s);
        }
        return sum;
    }
};

/// What the surface of a fluid with tension does to one row of a body.
template <class Packet, bool periodic> struct PullBody {
    PullOther<Packet, periodic> pull;
    State state;
    Period period;
    std::uint8_t phase;
    float3 center;
    float per_volume;  ///< of a particle of size 1
    GB_FN Drag operator()(std::size_t row) const {
        const std::uint32_t slot = pull.lists.rows[row];
        if (state.phase[slot] != phase) return {};
        const float3 f = pull(row) * per_volume,
                     l = cross(period.template shortest<true>(state.place[slot].xyz() - center), f);
        return {{{f.x, f.y, f.z}, {l.x, l.y, l.z}}, 0.0};
    }
};

/// How a row's pressure holds a body, or what many do at most.
struct Arm { double force = 0, moment = 0; };
struct AddArm {
    GB_FN Arm operator()(const Arm& a, const Arm& b) const { return {a.force + b.force, a.moment + b.moment}; }
};

/// Force of a row's pressure of 1 on a body, and its moment; over its volume, times the support.
template <class Packet> struct HoldOf {
    Lists<Packet> lists;
    State state;
    const float* nearest;
    Period period;
    Sizes sizes;
    float support;
    std::uint8_t phase;
    float3 center;

    struct Hold { float3 force{0, 0, 0}, moment{0, 0, 0}; };
    GB_FN Hold operator()(std::size_t row) const {
        Hold sum;
        if (!(nearest[row] < support) || !(state.place[lists.rows[row]].w < 0.0f)) return sum;
        for (std::uint32_t k = 0; k < lists.count[row]; ++k) {
            const std::size_t at = lists.at(row, k);
            const std::uint32_t j = lists.index[at];
            if (j >= state.n || state.phase[j] != phase) continue;
            const float3 g = lists.one_gradient(at);
            sum.force = sum.force + g;
            sum.moment = sum.moment + cross(period.template shortest<true>(state.place[j].xyz() - center), g);
        }
        return sum;
    }
};
template <class Packet> struct ArmOf {
    HoldOf<Packet> hold;
    GB_FN Arm operator()(std::size_t row) const {
        const auto h = hold(row);
        const double own = hold.sizes.volume(hold.lists.rows[row]);
        return {own * length(h.force), own * length(h.moment)};
    }
};
/// What the last change of P does to a body.
template <class Packet> struct PushOf {
    HoldOf<Packet> hold;
    const float* change;  ///< dP, per slot
    GB_FN Drag operator()(std::size_t row) const {
        const std::uint32_t slot = hold.lists.rows[row];
        const double s = hold.sizes.volume(slot) * double(change[slot]) / hold.support;
        if (!(hold.nearest[row] < hold.support)) return {};
        const auto h = hold(row);
        return {{{s * h.force.x, s * h.force.y, s * h.force.z}, {s * h.moment.x, s * h.moment.y, s * h.moment.z}}, 0.0};
    }
};

}  // namespace globule::core::sim
