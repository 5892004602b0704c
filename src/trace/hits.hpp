// What the tracers write.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

/// Per ray, caller's memory; t is infinite where nothing is hit.
struct Hits {
    float* t;        ///< distance along the ray; undecided(t): no root before t, the rest is open
    float* normal;   ///< (n, 3) -grad f / |grad f|; null: distances alone are wanted
    float* albedo;   ///< (n, 3) blended colour
};

/// Marks a ray that only float64 can decide, from t on; its own inverse.
GB_FN float undecided(float t) { return -1.0f - t; }

GB_FN void write3(float* to, std::size_t i, const float3& v) {
    to[3 * i] = v.x;
    to[3 * i + 1] = v.y;
    to[3 * i + 2] = v.z;
}

inline constexpr float kWindow = 0.5f;  ///< over which march() bounds f'', in the list's smallest support

}  // namespace globule::core
