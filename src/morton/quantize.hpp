// Positions to keys.  Only subtraction, multiplication and truncation, in an order that no compiler
// may contract, so that the CPU and the GPU give the same key bit for bit.
#pragma once
#include "base/vec.hpp"
#include "morton/code.hpp"

namespace globule::core::morton {

/// Coordinates past this magnitude count as outside: their squares would overflow float32.
inline constexpr float kFarthest = 1e18f;

/// The octree's space, world units.  Cubic: one extent for all axes keeps cells cubic.
struct Space {
    float3 lo;
    float extent;
};

GB_FN bool is_inside(const float3& p, const float3& lo, const float3& hi) {
    return p.x >= lo.x && p.x <= hi.x && p.y >= lo.y && p.y <= hi.y && p.z >= lo.z && p.z <= hi.z;
}

/// Truncation makes cell membership exact; the maximum itself is clamped into the last cell.
template <class Key> GB_FN Key quantize(float u, float lo, float scale) {
    const float cells = float(1 << Traits<Key>::levels);
    const float q = (u - lo) * scale;
    return q >= cells ? Key(1 << Traits<Key>::levels) - 1 : Key(q > 0.0f ? q : 0.0f);
}

template <class Key> GB_FN Key key_of(const float3& p, const Space& space) {
    const float cells = float(1 << Traits<Key>::levels);
    const float scale = space.extent > 0.0f ? cells / space.extent : 0.0f;
    return Traits<Key>::inside | encode(quantize<Key>(p.x, space.lo.x, scale), quantize<Key>(p.y, space.lo.y, scale),
                                     quantize<Key>(p.z, space.lo.z, scale));
}

}  // namespace globule::core::morton
