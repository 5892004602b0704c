// What a simulation knows of each particle, in slot order: the octree's order of the positions that
// the last step ended with.  Only `id` stays with a particle; slot_of[id] finds it.
#pragma once
#include "base/quad.hpp"
#include "octree/types.hpp"

namespace globule::core::sim {

enum class Kind : std::int32_t {
    fluid,
    tissue,    ///< as fluid in the density solve, held together by bonds
    boundary,  ///< at rest, or moved by key frames
    rigid      ///< particles of a rigid body, moved by what meets it
};
/// What the scene of a simulation draws: balls of all that is shown, one smooth surface around all, or a smooth surface
/// of tissue, beside which fluids and other things are scenes of their own.
enum class Drawn : std::int32_t { balls, smooth, tissue };
inline constexpr int kMaxPhases = 32;
inline constexpr std::uint32_t kGone = 0xffffffffu;

/// A material; every particle names one.  SI units.
struct Phase {
    Kind kind = Kind::fluid;
    float density = 1000.0f;  ///< at rest
    float viscosity = 0.0f;   ///< dynamic
    float tension = 0.0f;     ///< of the surface
    float adhesion = 0.0f;  ///< of fluids to this boundary, N/m: a pair attracts as fluids of the two's geometric mean
    float friction =
        0.0f;  ///< coefficient, of tissue and of what it meets; a contact has the larger one of its two sides
    float color[3] = {0.28f, 0.52f, 0.80f};
    float reflection = 0.0f, refraction = 0.0f;
    std::int32_t implicit_viscosity = 0;
    std::int32_t shown = 1;
};

/// Whether particles of a phase are rows of the solver: they have lists of neighbors.
GB_FN bool is_solved(Kind k) { return k != Kind::boundary; }

/// Everything that a functor may need to read or write of the particles.
/// place.w tells who takes part in the density solve: below 0 minus the inverse rest density of fluid or
/// tissue, whose volume is the same for all; above 0 the volume that a boundary's particle stands for.
struct State {
    std::size_t n;
    Quad* place;     ///< position, w as above
    Quad* velocity;  ///< w: dynamic viscosity
    std::uint32_t* id;
    std::uint8_t* phase;
    float* pressure;  ///< of the last step, Pa
    float* growth;    ///< how much faster it became in the last step, m/s^2; of tissue whose steps go by approach, the
                      ///< least speed that it counts as, m/s
    float* divergence_impulse;  ///< pressure of the solve for velocities, from which the next one starts
};

}  // namespace globule::core::sim
