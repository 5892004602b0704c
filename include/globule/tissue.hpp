// Elastic tissue: bonds that are pulled, held, cut and torn, by itself or in a simulation; SI units.
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "globule/array.hpp"
#include "globule/error.hpp"
#include "globule/poll.hpp"
#include "globule/values.hpp"
#include "globule/vector.hpp"

namespace globule {

/// One body: N particles, of which those that are close should stand close, and the bonds between them.  Arrays are in
/// host memory.  docs/design/tissue.md derives what bonds and solids are.
struct TissueBody {
    ArrayView positions{};     ///< (N, 3) float32 m, at rest
    ArrayView ids{};           ///< (N,) uint32, in a simulation those of its particles; default: 0, 1, ...
    ArrayView inverse_mass{};  ///< (N,) float32 1/kg; 0 for what never moves by itself
    ArrayView hold{};          ///< (N,) uint8: 0 free, 1 fixed; default: free
    ArrayView phase{};         ///< (N,) uint8 number of the material; default: the first
    ArrayView offsets{};       ///< (N + 1,) uint64: particle i's bonds are offsets[i] to offsets[i + 1] - 1; every bond
                               ///< stands at both ends
    ArrayView other{};         ///< (B,) uint32 particle at the other end
    ArrayView length{};        ///< (B,) float32 m, at rest
    ArrayView stiffness{};     ///< (B,) float32 N/m
    ArrayView bound{};   ///< (N,) float32 largest eigenvalue of the sum of n n^T over a particle's bonds, with a margin
    double contact = 0;  ///< m, distance that cut faces keep: the spacing
    ArrayView lame{};    ///< (2, N) float32 J, of a solid: volume times mu, then times lambda; none: bonds alone
    double frequency = 0;    ///< 1/s, of the solid's stiffest motion
    ArrayView relaxation{};  ///< (K, 2) float32, up to two: share of mu that relaxes, and its rate, 1/s
};

/// What tissue of one phase does.
struct TissueMaterial {
    double damping = 0;   ///< 1/s: velocities fall by exp(-damping t)
    double tear = 0;      ///< strain beyond which bonds break; 0: never
    double plastic = 0;   ///< strain beyond which a part of it stays; 0: never
    double creep = 0;     ///< 1/s, rate at which the excess stays
    double friction = 0;  ///< coefficient of its contacts
};

/// How what a grasp holds moves: velocity + spin x (p - center).
struct GraspMotion { Vec3 velocity{}, spin{}, center{}; };

/// What tissue cannot enter, or what is taken out of it.
struct TissueShape {
    enum Kind : int { ball, capsule, half_space };
    Kind kind = ball;
    Vec3 a{}, b{};      ///< center; both ends of the axis; a point of the plane and its outward normal
    double radius = 0;  ///< m; of a half-space how far the surface stands off the plane
    Vec3 velocity{};
    double friction = 0;  ///< coefficient; the larger one of two sides counts
};

/// Triangles that cut every bond whose segment crosses them, as an edge sweeps them between two poses.
struct Blade {
    ArrayView vertices{};        ///< (V, 3) float64 m, world
    ArrayView triangles{};       ///< (T, 3) uint32
    std::uint32_t n_moving = 0;  ///< the first so many vertices are seen from where bonds were at follow()
};

struct TissueOptions {
    std::string device = "auto";
    int threads = 0;  ///< of the CPU; 0: all
    Poll* poll = nullptr;
};

/// Elastic tissue.  Copies are handles of the same tissue.
///
/// Any thread may call any method.  All methods throw Error: invalid for an argument, memory, device; stale after a
/// call that failed half way.
class GLOBULE_API Tissue {
public:
    /// An empty handle.
    Tissue() noexcept = default;
    explicit Tissue(const TissueOptions& options);
    explicit operator bool() const noexcept { return impl_ != nullptr; }

    void add(const TissueBody& body);
    void set_materials(const std::vector<TissueMaterial>& by_phase);
    /// Of the next steps: up to 8 grasps by number, and up to 8 shapes.
    void set_instruments(const std::vector<GraspMotion>& grasps, const std::vector<TissueShape>& shapes = {});

    /// Moves tissue that is in no simulation; 0 substeps: as many as it needs.  Returns their number.
    int advance(double dt, const Vec3& gravity = {}, int substeps = 0, int iterations = 1);
    std::uint32_t tear(double dt);          ///< breaks overstretched bonds, lets others creep; returns how many broke
    void follow();                          ///< keeps positions, which a blade's moving vertices are relative to
    std::uint32_t cut(const Blade& blade);  ///< returns how many bonds
    void grasp(
        const Vec3& center, double radius, int number = 0);  ///< holds what is free in a ball, in place of before
    std::uint32_t remove(const TissueShape& region);         ///< returns how many particles

    std::size_t size() const;       ///< rows of its arrays; between bodies some are nobody's
    std::uint32_t n_bonds() const;  ///< whole ones
    std::uint32_t n_pieces() const;
    double elastic_energy() const;  ///< J
    int substeps(double dt) const;  ///< that keep the static stiffness exact
    std::vector<double> felt()
        const;  ///< 6 each of 8 grasps, then of the shapes: force N, moment N m; mean of the step
    std::vector<float> positions() const;  ///< (N, 3) m
    /// Host arrays, each of which may be left out: positions (N, 3) m and velocities (N, 3) m/s float32; piece (N,)
    /// uint32, its least id; hold (N,) uint8: 0 free, 1 fixed, 2 gone, 3 + number of the grasp; ids (N,) uint32.
    void get(const MutableArrayView& positions, const MutableArrayView& velocities = {},
        const MutableArrayView& piece = {}, const MutableArrayView& hold = {}, const MutableArrayView& ids = {}) const;
    void set(const ArrayView& positions, const ArrayView& velocities = {});
    /// (N, 3) float32 m/s^2 beside gravity, until others are set; no array: none.
    void accelerate(const ArrayView& accelerations);

    /// number: from 1; the state's array "vessel" says whose bonds are which.
    void set_vessel(std::size_t number, const BloodVessel& vessel);
    std::vector<BloodVessel> vessels() const;

    /// The state, for checkpoints and to change bonds: names and bytes of its arrays.  Nothing checks that they fit
    /// together.  Write "hold" first, then
    /// "other".
    std::vector<std::pair<std::string, std::size_t>> arrays() const;
    std::vector<std::uint8_t> read(const std::string& name) const;
    void write(const std::string& name, const ArrayView& bytes);

private:
    friend struct Inside;
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

}  // namespace globule
