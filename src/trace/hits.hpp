// What the tracers write.
#pragma once
#include "base/vec.hpp"
#include "exec/bits.hpp"

namespace globule::core {

/// The rays that a trace leaves to trace/resolve.hpp, in no particular order: each is decided by itself.
struct UndecidedRays {
    std::uint32_t* n = nullptr;    ///< how many so far; cleared by the caller
    std::uint32_t* ray = nullptr;  ///< room for all rays of the trace
    GB_FN void add(std::size_t i) const { ray[atomic_take(n, 1)] = std::uint32_t(i); }
};

/// Per ray, caller's memory; t is infinite where nothing is hit.
struct Hits {
    float* t;       ///< distance along the ray; of undecided rays: no root lies before, the rest is open
    float* normal;  ///< (n, 3) -grad f / |grad f|; null: distances alone are wanted
    float* albedo;  ///< (n, 3) blended color
    UndecidedRays undecided{};
    std::int8_t* sign = nullptr;  ///< -1: the ray came to t from inside; else +1; 0: only float64 can tell
    float* wetness = nullptr;     ///< (n,) blended, of tracers that are told the particles'
};

/// A distance no farther than t was before its two roundings: where a support is small against the distance, a root may
/// lie between them.
GB_FN float before(float t) { return t * (1.0f - 3e-7f); }

GB_FN void write3(float* to, std::size_t i, const float3& v) {
    to[3 * i] = v.x;
    to[3 * i + 1] = v.y;
    to[3 * i + 2] = v.z;
}

inline constexpr float kWindow = 0.5f;  ///< over which march() bounds f'', in the list's smallest support
inline constexpr float kStart = 1e-4f;  ///< in typical supports: secondary rays begin so far on, on a known side

}  // namespace globule::core
