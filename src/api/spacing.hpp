// The measured spacing of particles: one rule for all handles and for Python.
#pragma once
#include <cstddef>
#include <vector>

#include "api/guard.hpp"

namespace globule::core {

constexpr std::size_t kFewParticles = 1000;

/// Orthonormal axes, the longest first, of the line, plane or space that holds the positions (n, 3); none where all are
/// at one place. Positions outside of any octree do not count. One particle far away does not make the others flat:
/// thickness is compared with the distance of most from the middle.
GLOBULE_API std::vector<Vec3<double>> axes_of(const float* positions, std::size_t n);

/// Spacing s of fewer than 1000 particles, or of more in a plane or line: s^3, s^2 or s is the volume, area or length
/// of a particle. 0 for all others, and where all are at one place.
GLOBULE_API double few_or_flat_spacing(const float* positions, std::size_t n);

/// Spacing of the n particles that a scene was built with last: the one above; of a body of many by neighbors, and for
/// a smooth surface by a particle's volume. positions: null where they are not in host memory; then it is that of a
/// body.
GLOBULE_API double measured_spacing(
    const Handle<Scene>& scene, const Gates& inside, const float* positions, std::size_t n, bool smooth);

}  // namespace globule::core
