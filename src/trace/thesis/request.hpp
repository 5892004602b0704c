// What can be chosen about the thesis's own tracing.
#pragma once
#include <cstdint>

namespace globule::core {

enum class ThesisRoot : int { march, bezier };

/// What one ray cost.
struct ThesisWork {
    std::uint32_t leaves = 0;
    std::uint32_t sums = 0;  ///< of the candidates: evaluations of f, or polynomials
};

struct ThesisRequest {
    ThesisRoot root = ThesisRoot::march;
    float step = 0.25f;             ///< of the march, in typical supports, where no threshold is passed
    int n_thresholds = 4;           ///< below tau; each one passed halves the step
    bool ghosts = true;             ///< a leaf sees its 26 neighbors' particles (Fig. 5.6 without)
    bool face_rule = true;          ///< nine neighbors across the entry face are not fetched again (Fig. 5.7)
    bool exterior = true;           ///< spheres of radius a bound the search (Figs 5.3, 5.4)
    bool refine = true;             ///< of the march: the sign change is refined; terraces without (Fig. 5.1)
    bool averaged_normals = false;  ///< Fig. 5.8a
    bool count = false;             ///< keep each ray's ThesisWork
};

}  // namespace globule::core
