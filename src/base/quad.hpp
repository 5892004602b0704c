// Four floats that are read together: a position or velocity with one more value.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

struct alignas(16) Quad {
    float x, y, z, w;
    GB_FN float3 xyz() const { return {x, y, z}; }
};

/// The same for a packet of lanes, structure of arrays.
template <class F> struct Four {
    F x, y, z, w;
    GB_FN Vec3<F> xyz() const { return {x, y, z}; }
};

}  // namespace globule::core
