// A scene: particles in an octree on one device, and the field that they make.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "globule/array.hpp"
#include "globule/camera.hpp"
#include "globule/error.hpp"
#include "globule/frame.hpp"
#include "globule/mesh.hpp"
#include "globule/particles.hpp"
#include "globule/poll.hpp"
#include "globule/render_settings.hpp"
#include "globule/values.hpp"

namespace globule {

/// The basis function b(r); docs/understand/conventions.md has their formulas and defaults.
enum class Kernel : int { murakami, nishimura, wyvill, blinn, cubic_spline, wendland_c2, solid };
enum class OctreeKind : int { sparse, dense };
/// balls: each particle's kernel is a ball, or its anisotropy.  smooth: an ellipsoid and a weight for each particle are
/// found from its neighbors, so that one surface encloses the particles' volume and lies half a spacing outside of the
/// outermost ones; for particles of one fluid with one spacing.
enum class Surface : int { balls, smooth };

struct SceneOptions {
    Kernel kernel = Kernel::murakami;
    std::optional<double> threshold{};  ///< iso-value of the raw sum of weight * b(r); default by kernel, smooth: 0.5
    /// Radius of all particles' supports, world, instead of Particles::support.  Without either it is the kernel's
    /// default number of spacings, measured at the first update and kept.
    std::optional<double> support{};
    int key_bits = 32;           ///< 32 (10 levels) or 64 (21 levels)
    std::optional<int> level{};  ///< deepest level; default: all that the keys have (dense: 6 of at most 8)
    OctreeKind octree = OctreeKind::sparse;
    Surface surface = Surface::balls;  ///< smooth: with the kernel murakami, the sparse octree and no support
    /// Of the particles of a smooth surface, world: the cube root of a particle's volume.  Default: measured at the
    /// first update.
    std::optional<double> spacing{};
    std::string device = "auto";  ///< "auto", "cpu", "cuda" or "cuda:N"
    int threads = 0;              ///< of the CPU; 0: all
    /// The octree's space: the cube whose low corner is that of this box and whose edge is the box's longest.  Default:
    /// the particles' own box, at every update.  Particles outside are counted and have no influence.
    std::optional<Box> bounds{};
    /// Where the scene holds one piece of several, as on a rank of many: geometric mean of the smallest and the largest
    /// support, and largest |weight|, of all pieces.  With `bounds`, pieces then trace rays as the whole would.  0: of
    /// this scene.
    double typical_support = 0, most_weight = 0;
    Poll* poll = nullptr;
};

/// The octree as built last.
struct OctreeFacts {
    std::uint64_t n_nodes = 0, n_leaves = 0;
    std::uint64_t n_inside = 0;  ///< particles in the octree's space
    int level = 0;               ///< deepest level with a node
    std::uint64_t bytes = 0;
    Vec3 low{0, 0, 0};  ///< corner of the cube that keys refer to, world
    double extent = 0;  ///< its edge, world
    double build_seconds = 0;
    double typical_support = 0;                 ///< geometric mean of the smallest and the largest support, world
    double most_weight = 0;                     ///< largest |weight|
    std::uint64_t key_hash = 0, node_hash = 0;  ///< the same on every device; 0 unless asked for
};

/// Where rays meet the surface.
struct Intersections {
    std::vector<float> distance{};  ///< (M,) along the ray, world; infinite where missed
    std::vector<float> normal{};    ///< (M, 3)
    std::vector<float> albedo{};    ///< (M, 3)
};

/// Particles sorted into an octree, ready to be traced.  Copies are handles of the same scene.
///
/// Any thread may call any method.  Calls on one scene wait for each other; calls on different scenes run in parallel.
///
/// All methods throw Error: invalid for an argument (nothing was changed), cancelled, memory, device; stale where an
/// update was cancelled or failed and no other one has succeeded since.  (An update that is refused only when its nodes
/// were counted is stale, too.)
class GLOBULE_API Scene {
public:
    /// An empty handle.
    Scene() noexcept = default;
    /// Without particles: update it before anything else.
    explicit Scene(const SceneOptions& options);
    explicit Scene(const Particles& particles, const SceneOptions& options = {});
    explicit operator bool() const noexcept { return impl_ != nullptr; }

    /// Other particles, any number of them; the octree is built anew.  Particles says how long arrays have to stay.
    void update(const Particles& particles);

    /// Traces the rays of an image of width x height pixels.  clips: what is removed.  On a GPU the call returns before
    /// the image is finished; reading the frame waits.
    Frame render(const Camera& camera, int width = 1024, int height = 782, const RenderSettings& settings = {},
        const std::vector<Clip>& clips = {}) const;

    /// The field at points ((M, 3) or flat, world): sum of weight * b(r), (M,).
    std::vector<float> field(const ArrayView& points) const;
    /// Its gradient, (M, 3), per world unit; it points inwards.
    std::vector<float> gradient(const ArrayView& points) const;
    /// Values of particles, (N,) or (N, K) float32, blended at points with the weights weight * b(r): (M,) or (M, K);
    /// NaN where no particle reaches.
    std::vector<float> blend(const ArrayView& points, const ArrayView& values) const;
    /// Along rays (origins (M, 3) world, directions (M, 3)) from their origins on: sum of values of particles, (N,) or
    /// (N, K) float32, each times the integral of weight * b(r) over the ray: (M,) or (M, K).
    std::vector<float> integrate(const ArrayView& origins, const ArrayView& directions, const ArrayView& values) const;
    /// Particles within a radius (world, inclusive) of each point.
    Neighbors neighbors(const ArrayView& points, double radius) const;
    /// First intersections of rays with the surface; origins (M, 3) world, directions (M, 3) unit vectors; one that is
    /// zero or not finite meets nothing.
    Intersections intersect(const ArrayView& origins, const ArrayView& directions) const;

    // The same into arrays of the caller's, float32: in host memory, or in that of a GPU in the order of its stream.
    void field(const ArrayView& points, const MutableArrayView& out) const;
    void gradient(const ArrayView& points, const MutableArrayView& out) const;
    void blend(const ArrayView& points, const ArrayView& values, const MutableArrayView& out) const;
    void integrate(const ArrayView& origins, const ArrayView& directions, const ArrayView& values,
        const MutableArrayView& out) const;
    /// offsets (M + 1,) uint64; indices uint32, as many as there are: returns their number, and writes none where the
    /// array has no room for all.
    std::size_t neighbors(const ArrayView& points, double radius, const MutableArrayView& offsets,
        const MutableArrayView& indices = {}) const;
    /// Each of them may be left out.
    void intersect(const ArrayView& origins, const ArrayView& directions, const MutableArrayView& distance,
        const MutableArrayView& normal = {}, const MutableArrayView& albedo = {}) const;

    /// Spacing of the particles, world; 0 where all are at one place.  Of fewer than 1000, and of those in a plane or
    /// line, from their tessellation; of more balls the median around up to 1024 of them; of a smooth surface the one
    /// given or measured.
    double spacing() const;
    OctreeFacts octree(bool with_hashes = false) const;
    /// Keys in ascending order, (N,), and the particle that each belongs to, (N,).
    void sorted_keys(std::vector<std::uint64_t>& keys, std::vector<std::uint32_t>& index) const;

    std::size_t size() const;  ///< particles
    double threshold() const;
    /// The support of all particles, world; 0 where each has its own.
    double support() const;
    /// How far outside of the particles the surface may lie, world: for FitOptions::margin.  Where particles on a GPU
    /// have a support each, it is the typical support that counts, not the largest.
    double margin() const;
    const std::string& device() const;  ///< "cpu" or "cuda:N"

    /// From any thread, without waiting: the call that is running on this scene (of several layers: on the first one),
    /// if any, is to stop; it throws Error: cancelled soon.  A cancelled update leaves the scene stale.  Calls that
    /// begin later are not affected.
    void cancel() const noexcept;
    /// Waits until the device has finished all that it was asked for.
    void synchronize() const;

private:
    friend struct Inside;
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

/// One scene or mesh of an image that shows several, with its own material and clips.  Where a solid mesh and a field
/// overlap, the mesh counts: water whose particles reach into glass touches it without a gap.
struct Layer {
    Scene scene{};
    std::optional<Material> material{};  ///< default: the settings'
    std::vector<Clip> clips{};
    Mesh mesh{};  ///< instead of a scene
};

/// An image of 1 to 4 scenes of one device; a ray may be inside several at once.  clips: removed from every scene.
GLOBULE_API Frame render(const std::vector<Layer>& layers, const Camera& camera, int width = 1024, int height = 782,
    const RenderSettings& settings = {}, const std::vector<Clip>& clips = {});

}  // namespace globule
