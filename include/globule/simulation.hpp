// Simulations of fluids, tissue and rigid bodies, on the octree that is also traced; SI units.
#pragma once
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "globule/array.hpp"
#include "globule/error.hpp"
#include "globule/poll.hpp"
#include "globule/scene.hpp"
#include "globule/tissue.hpp"
#include "globule/values.hpp"
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
        sound_speed{};                 ///< of the weakly compressible fluid, m/s; default: 10 falls through the domain
    double extra_viscosity = 0;        ///< between all fluids, Pa s
    bool fine_fluids = false;          ///< fluids have half the spacing
    double least_dt = 1.0 / 30 / 1e6;  ///< s: materials that allow only shorter steps are refused
};

/// tissue: as fluid, held together by bonds.  boundary: at rest, or moved.  rigid: the particles of a floating body.
enum class PhaseKind : int { fluid, tissue, boundary, rigid };

/// A material; every particle has one.
struct Phase {
    std::string name{};
    PhaseKind kind = PhaseKind::fluid;
    double density = 1000;       ///< at rest, kg/m^3
    double viscosity = 0;        ///< dynamic, Pa s
    bool implicit = false;       ///< viscosity that does not shorten the steps
    double surface_tension = 0;  ///< of a fluid, N/m
    double adhesion = 0;         ///< of fluids to a boundary, N/m
    double friction = 0;         ///< coefficient, of tissue and of what it meets; the larger of two counts
    Vec3 color{0.28, 0.52, 0.80};
    double reflection = 0, refraction = 0;  ///< as of particles
    std::optional<bool> shown{};            ///< in images; default: all are but boundaries
};

/// A phase by its name, or by its number in the order in which phases came.
using WhichPhase = std::variant<int, std::string>;

/// A region whose fluid is taken out: a ball, or the box where the radius is 0; m.
struct Sink {
    Box box{};
    Vec3 center{};
    double radius = 0;
};
/// Where fluid that comes in keeps its velocity: a cylinder from a disc on, along the flow; m.
struct Inlet {
    Vec3 center{}, direction{};  ///< direction: of unit length
    double radius = 0, length = 0;
};

/// How a rigid body lies and moves; SI units.
struct BodyMotion {
    Vec3 center{}, velocity{}, spin{};
    std::array<double, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};  ///< since it was made, row by row
};

/// Sums over fluid and tissue; SI units.
struct Totals {
    double mass = 0, kinetic = 0, potential = 0;
    Vec3 momentum{}, angular_momentum{}, center{};
};

/// What a simulation's scene draws: balls of all that is shown, one smooth surface around all, or a smooth surface of
/// tissue, beside which fluids and other things are scenes of their own.
enum class Drawn : int { balls, smooth, tissue };

struct SimulationOptions {
    std::vector<Phase> phases{Phase{"fluid"}};  ///< at most 32, walls included, with different names
    bool walls = false;                         ///< the domain's faces become a boundary phase "walls"
    std::string device = "auto";
    int threads = 0;       ///< of the CPU; 0: all
    Poll* poll = nullptr;  ///< asked while images of its scene are made; steps are whole
};

/// A simulation of fluids (DFSPH, or weakly compressible SPH), tissue and rigid bodies.  Copies are handles of the same
/// simulation.
///
/// Any thread may call any method; calls on one simulation, its tissue and its scenes wait for each other.  Arrays are
/// in host memory.
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
    std::uint32_t add(const ArrayView& positions, const WhichPhase& phase = 0, const Property<Vec3>& velocities = {});
    /// As add, at the end of the next step; within inlets the particles keep their velocity.
    std::uint32_t emit(const ArrayView& positions, const WhichPhase& phase = 0, const Property<Vec3>& velocities = {});
    /// Removes particles by id.
    void remove(const std::vector<std::uint32_t>& ids);
    void set_inlets(const std::vector<Inlet>& inlets);
    void set_sinks(const std::vector<Sink>& sinks);  ///< at most 32

    /// world_from_body of a boundary, a rotation and a translation: now, where its particles are already; or at the end
    /// of the next step.
    void capture(const WhichPhase& phase, const Matrix4& now);
    void move_to(const WhichPhase& phase, const Matrix4& next);
    /// Makes one body of the particles of a rigid phase, kg, kg m^2 about its center, row by row.
    void make_body(const WhichPhase& phase, double mass, const std::array<double, 9>& inertia, const BodyMotion& start);
    BodyMotion body(const WhichPhase& phase) const;

    /// The tissue, to bond and to operate on; it keeps the simulation alive.
    Tissue tissue() const;

    /// One step of dt seconds; by default as long as the speeds allow.
    StepReport step(std::optional<double> dt = {});
    /// Whole steps until so many seconds have passed, the last two of equal length; returns the last report.  each:
    /// called after every step, on this thread; false ends the run.
    std::optional<StepReport> run(double seconds, const std::function<bool(const StepReport&)>& each = {});
    /// From any thread, without waiting: a run that is in progress stops after its present step and throws Error:
    /// cancelled.
    void cancel() const noexcept;

    /// Settings and materials between steps; spacing, fine_fluids and domain stay.  A phase of a new name is added.
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
    Totals totals() const;

    /// The simulation's particles as a scene, always in their present state: it can be rendered and queried, but not
    /// updated. Kernel murakami; the surface of the fluids is smooth, or that of the tissue where some is shown.  The
    /// scene keeps the simulation alive.
    Scene scene() const;
    /// As scene(), and beside tissue the fluids and other things: for render().
    std::vector<Layer> layers() const;
    /// As layers(), in memory of their own on this or, "cuda:1", another GPU: they show the particles as they are now,
    /// so that an image can be made while the simulation goes on.  into: layers that an earlier call returned, whose
    /// memory and device are used again.
    std::vector<Layer> snapshot(const std::string& device = {}, const std::vector<Layer>& into = {}) const;
    /// What the scene draws from now on.
    void draw(Drawn what);

    // The solver's own order: row i of all arrays is one particle, until particles move, come or go.
    /// Arrays of the state: "place" (N, 4), "velocity" (N, 4), "id" uint32, "phase" uint8, "pressure", "growth",
    /// "divergence_impulse"; float32, (N,), but where said.
    void read(const std::string& name, const MutableArrayView& out) const;
    void write(const std::string& name, const ArrayView& values);
    /// Acceleration times mass of each particle (N, 3), until the next step ends; no array: none.
    void set_forces(const ArrayView& forces);
    /// Solved particles, (R,), and the neighbors of each.
    void neighbors(std::vector<std::uint32_t>& rows, Neighbors& lists) const;
    /// (N,) density over rest density; (N, 3) vorticity, 1/s.
    void flow(const MutableArrayView& density, const MutableArrayView& vorticity) const;
    /// Force, N, and moment about a point, N m, of fluid and tissue on the particles of a phase, a boundary or a rigid
    /// body: by the pressures of the last step, and by the viscosity of the present velocities.
    std::array<double, 6> force_on(int phase, const std::array<double, 3>& about = {}) const;

    // A checkpoint: resize, write all arrays, settle, set_motion, and the tissue's.
    std::uint32_t next_id() const;
    void resize(std::size_t n, std::uint32_t next_id, double time, std::uint64_t n_steps);
    void settle();
    std::vector<char> motion() const;  ///< of boundaries and bodies
    void set_motion(const std::vector<char>& bytes);

private:
    friend struct Inside;
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

}  // namespace globule
