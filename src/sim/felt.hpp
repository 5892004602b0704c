// What instruments feel of tissue: impulses of a step, and their moments.
//
// A grasp feels what bonds do to the particles that it holds, their weight, and what pressure does to them; not their
// own inertia.  A shape feels what it takes from the particles that meet it.  Each particle adds up its own substeps.
#pragma once
#include "sim/bonds.hpp"
#include "sim/couple.hpp"
#include "sim/rigid.hpp"

namespace globule::core::tissue {

/// Of one instrument, over all particles.
struct FeltOf {
    const float3* felt;        ///< (2, n): impulses and moments
    const std::uint8_t* hold;  ///< null: of a shape
    std::uint8_t number;       ///< of those that are held so
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

/// Of a step; nobody feels what is 0.
struct FeltSums {
    sim::Impulse of[kMaxGrasps + kMaxShapes], pressed[2 * kMaxGrasps];  ///< of pressure and of its friction
};

/// The particles that a grasp holds.
struct Held {
    Members members;
    const std::uint32_t* id;
    const std::uint8_t* hold;
    std::uint8_t number;
    GB_FN bool operator()(std::uint32_t j) const {
        const std::uint32_t t = members(id[j]);
        return t != kNobody && hold[t] == number;
    }
};

}  // namespace globule::core::tissue
