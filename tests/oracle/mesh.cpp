// First hits of rays on triangles by brute force in float64 (Möller & Trumbore 1997).
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/vec.hpp"

/// vertices (·, 3), faces (n, 3), origins and directions (m, 3); t (m,) infinite where missed; face (m,) the nearest's
/// number, ties to the lower; edge (m,): how near the ray passes to any triangle's edge, as the smallest |barycentric
/// coordinate| of a triangle that it meets or just misses.
extern "C" void oracle_mesh_first_hit(const float* vertices, std::size_t n, const std::uint32_t* faces, std::size_t m,
    const float* origins, const float* directions, double* t, std::uint32_t* face, double* edge) {
    using V = globule::core::Vec3<double>;
    const auto at = [](const float* p, std::size_t i) { return V{p[3 * i], p[3 * i + 1], p[3 * i + 2]}; };
#pragma omp parallel for schedule(dynamic, 64)
    for (std::size_t i = 0; i < m; ++i) {
        const V o = at(origins, i), d = at(directions, i);
        t[i] = INFINITY;
        face[i] = 0xffffffffu;
        edge[i] = INFINITY;
        for (std::size_t k = 0; k < n; ++k) {
            const V a = at(vertices, faces[3 * k]), e = at(vertices, faces[3 * k + 1]) - a,
                    f = at(vertices, faces[3 * k + 2]) - a;
            const V p = cross(d, f), s = o - a, q = cross(s, e);
            const double det = dot(e, p);
            if (det == 0) continue;
            const double u = dot(s, p) / det, v = dot(d, q) / det, least = std::min({u, v, 1 - u - v}),
                         away = dot(f, q) / det;
            if (least > -1e-3 && away > 0) edge[i] = std::min(edge[i], std::abs(least));
            if (least < 0 || away < 0 || !(away < t[i])) continue;
            t[i] = away;
            face[i] = std::uint32_t(k);
        }
    }
}
