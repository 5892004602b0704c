// Velocities and places apart.
//
// A step solves twice.  The first solve makes velocities that compress nothing further; they are kept.  The second one
// moves what is too dense apart, by velocities of one move that are given back: density that was lost comes back
// without becoming speed (Cornelis et al. 2019).  With one solve for both, a column of 160 layers whose lowest are
// compressed by a sixth in some steps of 5 ms gets (delta - 1) / dt of them as a velocity: shorter steps make it
// faster, without end.
#pragma once
#include "sim/pressure.hpp"

namespace globule::core::sim {

/// Keeps the rows' velocities.
struct KeepVelocity {
    const std::uint32_t* rows;
    const Quad* velocity;
    Quad* kept;
    GB_FN void operator()(std::size_t row) const { kept[row] = velocity[rows[row]]; }
};

/// Nobody is moved apart farther than this.
struct LimitPush {
    const std::uint32_t* rows;
    const Quad* kept;
    float most_of_one;  ///< of a particle of size 1
    Sizes sizes;
    Quad* velocity;
    GB_FN void operator()(std::size_t row) const {
        Quad& v = velocity[rows[row]];
        const float most = most_of_one * sizes.at(rows[row]);
        const float3 k = kept[row].xyz(), u = v.xyz() - k;
        const float s = most / max(length(u), most);
        v = {k.x + s * u.x, k.y + s * u.y, k.z + s * u.z, v.w};
    }
};

/// The velocities that the move did not see; and how much faster each became in the step, m/s^2.
struct EndSplit {
    const std::uint32_t* rows;
    const Quad *kept, *before;  ///< of this step, of the last
    float per_dt;
    Quad* velocity;
    float* growth;  ///< per slot
    GB_FN void operator()(std::size_t row) const {
        const Quad v = kept[row];
        velocity[rows[row]] = v;
        growth[rows[row]] = max(length(v.xyz()) - length(before[row].xyz()), 0.0f) * per_dt;
    }
};

/// Velocities of the last step again, and no pressure.
struct Undo {
    const std::uint32_t* rows;
    const Quad* before;
    Quad* velocity;
    float* pressure;
    GB_FN void operator()(std::size_t row) const {
        velocity[rows[row]] = before[row];
        pressure[rows[row]] = 0.0f;
    }
};

/// Kinetic energy before and after what is to take energy only.
struct Kinetic {
    double before = 0, after = 0, mass = 0;  ///< over the volume of a particle
};
struct KineticOf {
    const float* inverse_rho;
    const Quad *before, *after;
    GB_FN Kinetic operator()(std::size_t row) const {
        const float r = inverse_rho[row];
        if (!(r > 0.0f)) return {};
        const float3 a = before[row].xyz(), b = after[row].xyz();
        return {0.5 * dot(a, a) / r, 0.5 * dot(b, b) / r, 1.0 / r};
    }
};
struct AddKinetic {
    GB_FN Kinetic operator()(const Kinetic& a, const Kinetic& b) const {
        return {a.before + b.before, a.after + b.after, a.mass + b.mass};
    }
};

/// The solves of a step; where a fluid fills its space, the first one alone.
enum class Solved : int { velocities, places };
/// What the host learns of a solve.
struct Outcome {
    Progress progress;
    Kinetic kinetic;
};

}  // namespace globule::core::sim
