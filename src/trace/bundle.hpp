// Rays of a tile taken together: at distance t every ray of the bundle lies within r0 + r1 t of the
// axis o + t d.  What that cone does not touch, no ray of the tile does.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

struct Bundle {
    float3 o, d;
    float r0, r1;
};

/// The bundle's radius near distance t.
template <class F>
GB_FN F radius_at(const Bundle& b, F t) {
    // 1.06: the widest point may lie a bundle radius further on; r1 < 0.05 (tile.hpp sees to it).
    return F(1.06f) * (F(b.r0) + F(b.r1) * max(t, F(0.0f)));
}

}  // namespace globule::core
