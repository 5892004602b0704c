// Simulations of fluids, on the octree that is also traced; SI units.
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "globule/array.hpp"
#include "globule/error.hpp"
#include "globule/scene.hpp"
#include "globule/vector.hpp"

namespace globule {

struct SimulationSettings {
    double spacing = 0;                        ///< of particles, m; the kernel's support is twice that
    Box domain{};                              ///< m; particles that leave it are no longer simulated
    std::array<bool, 3> periodic{};            ///< axes along which the domain repeats; at least 8 spacings long
    Vec3 gravity{0, 0, -9.81};                 ///< m/s^2; z is up
    double cfl = 1;                            ///< dt = 0.4 cfl spacing / v_max
    double max_dt = 0.005;                     ///< longest step, s
    double max_error = 0.001;                  ///< mean compression that the density solver leaves, a share
    std::optional<double> divergence_error{};  ///< the same of the divergence solver; default: max_error
    int min_iterations = 2;                    ///< of both solvers
    std::optional<int> max_iterations{};       ///< default: 121; of velocities one for each layer, if that is more
    double viscosity_error = 1e-4;             ///< relative residual of implicit viscosity
    bool weakly_compressible = false;          ///< Tait's equation instead of a pressure solve
    std::optional<double>
        sound_speed{};           ///< of the weakly compressible fluid, m/s; default: 10 falls through the domain
    double extra_viscosity = 0;  ///< between all fluids, Pa s
};

enum class PhaseKind : int { fluid = 0, boundary = 2 };

/// A material; every particle has one.
struct Phase {
    std::string name{};
    PhaseKind kind = PhaseKind::fluid;
    double density = 1000;       ///< at rest, kg/m^3
    double viscosity = 0;        ///< dynamic, Pa s
    bool implicit = false;       ///< viscosity that does not shorten the steps
    double surface_tension = 0;  ///< of a fluid, N/m
    double adhesion = 0;         ///< of fluids to a boundary, N/m
    Vec3 color{0.28, 0.52, 0.80};
    double reflection = 0, refraction = 0;  ///< as of particles
    std::optional<bool> shown{};            ///< in images; default: fluids are, boundaries are not
};

/// What a step did.
struct StepReport {
    double time = 0, dt = 0;  ///< s
    std::uint64_t step = 0;
    int iterations = 0, divergence_iterations = 0, viscosity_iterations = 0;
    double error = 0, divergence_error = 0;            ///< that the solvers left, mean and relative
    double most_error = 0, most_divergence_error = 0;  ///< the largest
    double compression = 0, high_compression = 0,
           most_compression = 0;  ///< max(density / rest density - 1, 0) before the step: mean, what 0.1 % of the
                                  ///< particles exceed, largest
    int n_halved = 0;             ///< how often the solver halved the step because it gave kinetic energy
    std::uint64_t n = 0, n_solved = 0, n_escaped = 0;
    double most_speed = 0;                                  ///< m/s
    std::vector<std::pair<std::string, double>> seconds{};  ///< per stage
};

struct SimulationOptions {
    std::vector<Phase> phases{Phase{"fluid"}};  ///< at most 31, with different names
    bool walls = false;                         ///< the domain's faces become a boundary phase "walls"
    std::string device = "auto";
    int threads = 0;  ///< of the CPU; 0: all
};

/// A fluid simulation (DFSPH, or weakly compressible SPH).  Copies are handles of the same simulation.
///
/// Any thread may call any method; calls on one simulation and on its scene wait for each other.
///
/// All methods throw Error: invalid for an argument, memory, device; diverged where a step made a velocity that is not
/// a number; stale after a call that failed half way.
class GLOBULE_API Simulation {
public:
    /// An empty handle.
    Simulation() noexcept = default;
    explicit Simulation(const SimulationSettings& settings, const SimulationOptions& options = {});
    explicit operator bool() const noexcept { return impl_ != nullptr; }

    /// Adds particles of a phase, by default the first: positions (M, 3) or flat, m; velocities of the same shape, or
    /// one for all, m/s.  Returns the first of their ids, which are consecutive.
    std::uint32_t add(const ArrayView& positions, const std::string& phase = "", const Property<Vec3>& velocities = {});
    /// Removes particles by id.
    void remove(const std::vector<std::uint32_t>& ids);

    /// One step of dt seconds; by default as long as the speeds allow.
    StepReport step(std::optional<double> dt = {});
    /// Whole steps until so many seconds have passed, the last two of equal length; returns the last report.
    std::optional<StepReport> run(double seconds);
    /// From any thread, without waiting: a run that is in progress stops after its present step and throws Error:
    /// cancelled.
    void cancel() const noexcept;

    /// Settings and materials between steps; spacing and domain stay.
    void configure(const SimulationSettings& settings);
    void set_phase(const Phase& phase);

    std::size_t size() const;  ///< particles, those of walls and other boundaries included
    double time() const;       ///< s
    std::uint64_t n_steps() const;
    double next_dt() const;  ///< of the step that comes next, s
    const std::string& device() const;

    // All particles, those of boundaries included, in ascending order of their ids.
    std::vector<std::uint32_t> ids() const;   ///< (N,)
    std::vector<float> positions() const;     ///< (N, 3), m
    std::vector<float> velocities() const;    ///< (N, 3), m/s
    std::vector<float> pressure() const;      ///< (N,), Pa, of the last step
    std::vector<std::uint8_t> phase() const;  ///< (N,) number of the phase

    /// The simulation's particles as a scene, always in their present state: it can be rendered and queried, but not
    /// updated. Kernel murakami, its default threshold, support of two spacings.  The scene keeps the simulation alive.
    Scene scene() const;

private:
    friend struct Inside;
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

}  // namespace globule
