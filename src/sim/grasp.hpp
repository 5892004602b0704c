// Particles that are held: fixed parts of the tissue, and what a grasping instrument carries along.
#pragma once
#include "base/vec.hpp"

namespace globule::core::tissue {

/// How a particle is held: free, fixed (keeping whatever velocity it has: mostly 0), gone, or by grasp
/// number value - kGrasped.
inline constexpr std::uint8_t kFree = 0, kFixed = 1, kGone = 2, kGrasped = 3;
inline constexpr int kMaxGrasps = 8;

/// Rigid motions of the grasps during a step: velocity + spin × (x - center).
struct Motions {
    float3 velocity[kMaxGrasps] = {}, spin[kMaxGrasps] = {}, center[kMaxGrasps] = {};
    GB_FN float3 velocity_at(std::uint8_t hold, const float3& x, const float3& own) const {
        if (hold < kGrasped) return own;
        const int g = hold - kGrasped;
        return velocity[g] + cross(spin[g], x - center[g]);
    }
};

/// Takes hold of the free particles within a ball, and lets go of what `number` held before.
template <class At> struct Grasp {
    const At* at;
    std::uint8_t* hold;
    float3 center;
    float radius;
    std::uint8_t number;  ///< 0 ...
    GB_FN void operator()(std::size_t t) const {
        if (hold[t] == kGrasped + number) hold[t] = kFree;
        const float3 r = at[t].xyz() - center;
        if (hold[t] == kFree && dot(r, r) <= radius * radius) hold[t] = std::uint8_t(kGrasped + number);
    }
};

}  // namespace globule::core::tissue
