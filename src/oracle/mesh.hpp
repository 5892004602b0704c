// First hits of rays on triangles by brute force in float64 (Möller & Trumbore 1997): the reference of the tests.
#pragma once
#include <cstddef>
#include <cstdint>

namespace globule::core::oracle {

/// vertices (·, 3), faces (n, 3), origins and directions (m, 3); t (m,) infinite where missed; face (m,) the nearest's
/// number, ties to the lower; edge (m,): how near the ray passes to any triangle's edge, as the smallest |barycentric
/// coordinate| of a triangle that it meets or just misses.
void mesh_first_hit(const float* vertices, std::size_t n, const std::uint32_t* faces, std::size_t m,
    const float* origins, const float* directions, double* t, std::uint32_t* face, double* edge);

}  // namespace globule::core::oracle
