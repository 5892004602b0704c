// Rays of a tile taken together: at distance t every ray of the bundle lies within r0 + r1 t of the
// axis o + t d.  What that cone does not touch, no ray of the tile does.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

struct Bundle {
    float3 o, d;
    float r0, r1;
    GB_FN float3 axis_point(float z) const { return {o.x + z * d.x, o.y + z * d.y, o.z + z * d.z}; }
};

/// A bundle around (o, d), a little wider than r0 + r1 t: by what rounding may move a point at t.
GB_FN Bundle bundle_around(const float3& o, const float3& d, float r0, float r1) {
    return {o, d, r0 + 1e-6f * (abs(o.x) + abs(o.y) + abs(o.z)), r1 + 2e-6f};
}

/// The bundle's radius near distance t.
template <class F> GB_FN F radius_at(const Bundle& b, F t) {
    // 1.06: the widest point may lie a bundle radius further on; r1 < 0.05 (flock.hpp sees to it).
    return F(1.06f) * (F(b.r0) + F(b.r1) * max(t, F(0.0f)));
}

}  // namespace globule::core
