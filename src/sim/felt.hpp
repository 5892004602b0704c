// What instruments feel of tissue: impulses of a step, and their moments.
//
// A grasp feels what bonds do to the particles that it holds, their weight, and what pressure does to them; not their own
// inertia.  A shape feels what it takes from the particles that meet it.  Each particle adds up its own substeps.
#pragma once
#include "sim/bonds.hpp"
#include "sim/couple.hpp"
#include "sim/rigid.hpp"

namespace globule::core::tissue {

/// Of one instrument, over all particles.
struct FeltOf {
    const float3* felt;       ///< (2, n): impulses and moments
    const std::uint8_t* hold; ///< null: of a shape
    std::uint8_t number;      ///< of those that are held so
    std::uint32_t n;
    GB_FN sim::Impulse operator()(std::size_t t) const {
        sim::Impulse sum;
        if (hold && hold[t] != number) return sum;
        const float3 p = felt[t], l = felt[n + t];
        sum.p[0] = p.x, sum.p[1] = p.y, sum.p[2] = p.z;
        sum.l[0] = l.x, sum.l[1] = l.y, sum.l[2] = l.z;
        return sum;
    }
};

/// What the pressure of one row does to the particles that a grasp holds: V P g of each pair, at the held one.
template <class Packet>
struct PressureOnHeld {
    sim::Lists<Packet> lists;
    sim::State state;
    const float* nearest;
    Members members;
    const std::uint8_t* hold;
    std::uint8_t number;
    sim::Period period;
    float volume, support, dt, flux;
    float3 center;
    GB_FN sim::Impulse operator()(std::size_t row) const {
        sim::Impulse sum;
        if (nearest[row] >= support) return sum;
        const std::uint32_t slot = lists.rows[row];
        if (!(state.place[slot].w < 0.0f)) return sum;
        const float s = volume * dt * state.pressure[slot] / (flux * support);
        if (!(s > 0.0f)) return sum;
        for (std::uint32_t k = 0; k < lists.count[row]; ++k) {
            const std::size_t at = lists.at(row, k);
            const std::uint32_t j = lists.index[at];
            if (j >= state.n) continue;
            const std::uint32_t t = members(state.id[j]);
            if (t == kNobody || hold[t] != number) continue;
            const float3 f = float3{Packet::one(lists.gx + at), Packet::one(lists.gy + at), Packet::one(lists.gz + at)} * s;
            const float3 l = cross(period.template shortest<true>(state.place[j].xyz() - center), f);
            sum.p[0] += f.x, sum.p[1] += f.y, sum.p[2] += f.z;
            sum.l[0] += l.x, sum.l[1] += l.y, sum.l[2] += l.z;
        }
        return sum;
    }
};

}  // namespace globule::core::tissue
