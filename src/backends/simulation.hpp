// A particle simulation as the bindings see it; sim/simulation.hpp has the one implementation.
#pragma once
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "backends/object.hpp"
#include "backends/scene_access.hpp"
#include "sim/sinks.hpp"
#include "sim/energy.hpp"
#include "sim/rigid.hpp"
#include "backends/tissue.hpp"
#include "globule/values.hpp"

namespace globule::core {

/// How a simulation is run; between steps any of it may change but spacing, fine_fluids and domain.
struct SimulationSettings {
    float spacing = 0.0f;             ///< of particles, world units (m); the kernel's support is twice that
    bool fine_fluids = false;         ///< fluids have half that spacing
    float3 lo{0, 0, 0}, hi{0, 0, 0};  ///< the domain: who leaves it is no longer simulated
    bool periodic[3] = {};            ///< axes along which the domain repeats
    float3 gravity{0, 0, 0};
    float cfl = 1.0f;  ///< dt = 0.4 cfl spacing / v_max
    float longest_step = 0.005f;
    float density_error = 0.001f, divergence_error = 0.001f;  ///< mean, relative
    int least_iterations = 2, most_iterations = 0;            ///< most, 0: kIterations, of velocities as many as layers
    static constexpr int kIterations = 121;
    double viscosity_error = 1e-4;  ///< of the implicit solve, relative
    bool weakly_compressible = false;
    float sound_speed = 0.0f;      ///< of the weakly compressible fluid
    float extra_viscosity = 0.0f;  ///< dynamic, between all fluids
};

/// A particle whose velocity is not a number any more.
struct LostParticle {
    std::uint32_t id;
    int phase;
    float3 position;  ///< the last one
};

struct StepReport : globule::StepReport {
    std::optional<LostParticle> lost;  ///< the step was made, but cannot be trusted
};

struct Scene;

struct Simulation : Object {
    virtual void configure(const SimulationSettings& settings) = 0;
    virtual void set_phase(int which, const sim::Phase& phase) = 0;
    /// The first of the m new ids; velocities may be null.
    virtual std::uint32_t add(
        std::size_t m, const float* positions, const float* velocities, float3 velocity, int phase) = 0;
    virtual void remove(std::size_t m, const std::uint32_t* ids) = 0;
    /// As add, at the end of the next step.
    virtual std::uint32_t emit(std::size_t m, const float* positions, const float* velocities, int phase) = 0;
    virtual void set_sinks(const std::vector<sim::Sink>& sinks) = 0;
    /// Where what is emitted keeps its velocity.
    virtual void set_inlets(const std::vector<sim::Inlet>& inlets) = 0;
    /// A boundary's pose: now (its particles are there already), or at the end of the next step.
    virtual void capture(int phase, const sim::Pose& now) = 0;
    virtual void move_to(int phase, const sim::Pose& next) = 0;
    /// A phase of kind rigid becomes a body of its own; inertia about the center, row by row.
    virtual void make_body(int phase, double mass, const double center[3], const double inertia[9],
        const double velocity[3], const double spin[3]) = 0;
    /// Center, velocity, spin (3 each) and the rotation (9, row by row).
    virtual std::vector<double> body(int phase) = 0;
    /// Bodies, poses, and where particles are in their bodies, as bytes that set_motion takes.
    virtual std::vector<char> motion() = 0;
    virtual void set_motion(const std::vector<char>& bytes) = 0;
    virtual sim::Totals totals() = 0;
    virtual StepReport step(double dt) = 0;
    /// The step that the current speeds allow.
    virtual double next_dt() = 0;
    virtual std::size_t size() = 0;
    /// The state's arrays in slot order, by name: place, velocity, id, phase, pressure, growth, divergence_impulse.
    virtual void read(const std::string& name, void* out) = 0;
    virtual void write(const std::string& name, const void* in) = 0;
    /// n particles whose arrays will be written, then settled: the octree is built.
    virtual void resize(std::size_t n, std::uint32_t next_id, double time, std::uint64_t n_steps) = 0;
    virtual void settle() = 0;
    /// Acceleration times mass of each particle, by slot, until the next step ends; null: none.
    virtual void set_forces(const float* forces) = 0;
    /// Lists of neighbors as compressed rows of slots, one for each solved particle.
    virtual void neighbors(std::vector<std::uint32_t>& rows, Neighbors& out) = 0;
    /// Densities over rest density (n), and vorticities (n, 3), 1/s, by slot.
    virtual void flow(float* density, float* vorticity) = 0;
    /// Force, N, and moment about a point, N m, of fluid and tissue on what a phase is made of: a boundary or a body.
    virtual std::array<double, 6> force_on(int phase, float3 about) = 0;
    /// What the scene draws from now on; balls at first.
    virtual void draw(sim::Drawn what) = 0;
    /// What is seen now, for Scene::take; and where that lies: the simulation's exec.
    virtual std::pair<SceneAccess::Shown, void*> look(sim::Drawn what) = 0;
    /// The tissue, as the particles are now.
    virtual Tissue* tissue() = 0;
    virtual double time() = 0;
    virtual std::uint64_t n_steps() = 0;
    virtual std::uint32_t next_id() = 0;
};

/// A simulation whose octree is the scene's.
std::shared_ptr<Simulation> make_simulation(const std::shared_ptr<Scene>& scene);

}  // namespace globule::core
