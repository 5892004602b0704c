// What a compiled backend offers.  Each backend (one CPU library per SIMD level, one
// CUDA library) is a shared library of its own, opened when asked for: code compiled for AVX-512
// never mixes with the baseline's, and a machine without an NVIDIA driver never loads CUDA.
// Methods may throw; they are called by way of BackendApi::run, which does not.
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "backends/object.hpp"
#include "backends/reconstructor.hpp"
#include "backends/scene_access.hpp"
#include "backends/simulation.hpp"
#include "backends/status.hpp"
#include "backends/tissue.hpp"
#include "base/device.hpp"
#include "exec/lent.hpp"
#include "field/kernels.hpp"
#include "mesh/types.hpp"
#include "octree/types.hpp"
#include "trace/camera.hpp"
#include "trace/clip.hpp"
#include "trace/thesis/request.hpp"
#include "trace/lighting.hpp"

namespace globule::core {

struct SceneArrays {
    std::size_t n = 0;
    FloatArray positions;               // (n, 3)
    FloatArray support, weight, color;  // (n,), (n,), (n, 3); null: the one value below
    FloatArray reflection, refraction;  // (n,)
    FloatArray stretch;                 // (n, 6) xx yy zz xy xz yz, 1 / world; null: balls; sparse octree only
    float most_stretch = 1.0f;
    float one_support = 0.0f, one_weight = 1.0f;
    float spacing =
        0.0f;  // of particles that make one smooth surface, in place of supports; 0: balls or ellipsoids as given
    float3 one_color{0, 0, 0};
    float one_reflection = 0.0f, one_refraction = 0.0f;
    bool given_up = false;  // the host's pages of `positions` may go as soon as they are read
};

/// A triangle mesh, or capsules, which rays meet instead of a field.
struct MeshArrays {
    std::size_t n_vertices = 0, n_faces = 0;
    FloatArray vertices;                 // (n_vertices, 3)
    ArrayAt<const std::uint32_t> faces;  // (n_faces, 3), of capsules (n_faces, 2), all below n_vertices
    // Normals between triangles that meet at less than an angle.  Corners are numbered 3 face + k; null: the triangles'
    // own.
    ArrayAt<const std::uint32_t> place_of_corner;  // (3 n_faces,) corners at one place have the same number
    ArrayAt<const std::uint32_t> corners;          // (3 n_faces,) by place
    ArrayAt<const std::uint32_t> corners_begin;    // (n_places + 1,) where each place's begin; host
    std::size_t n_places = 0;
    float smooth_cosine = 1.0f;
    FloatArray color;  // (n_vertices, 3) or (n_faces, 3); null: the one below
    bool color_of_faces = false;
    float3 one_color{0, 0, 0};
    bool closed = false;    // it has an inside, and all normals point out of it
    bool capsules = false;  // a face joins two vertices, which may be one, with a radius
    FloatArray radius;      // (n_faces,); null: the one below
    float one_radius = 0.0f;
};

struct TreeRequest {
    int key_bits = 32, depth = 10;
    bool dense = false, fixed_space = false;
    float3 lo{0, 0, 0}, hi{0, 0, 0};
    // Of all particles, where this scene is one piece of several; 0: of its own.
    float typical_support = 0.0f, most_weight = 0.0f;
};

struct TreeFacts {
    TreeHeader header;
    std::uint64_t n_inside, n_nodes, n_leaves, bytes;
    std::uint64_t key_hash, node_hash;  // filled only when asked
    double build_seconds;
};

struct FieldRequest {
    KernelName kernel;
    float threshold;
    std::optional<ThesisRequest> thesis;  ///< traced the thesis's way (dense octree only); none: exactly
};

/// The images of a frame: (h, w) floats, (h, w, 3) floats or bytes, (h, w) bytes.
enum class Image : int { depth, normal, albedo, color, position, picture, layer };

/// A finished picture in the backend's memory.  It never changes, and may be read by several threads at once.
struct Frame : Object {
    /// out: host memory, or of this device (complete in the order of its stream).
    /// layer: of what is hit; other than a layer's number: the ground.
    virtual void read(Image image, const ArrayAt<void>& out) = 0;
    virtual double trace_seconds() = 0;
    virtual int passes() = 0;
    /// Of several ranks on one host, each of which has made a frame of the same picture: copies images (1 << Image for
    /// each) to where the others' frames reach them, until the scene lends others.
    virtual LentPlace lend(unsigned images) = 0;
    /// Rank 0's frame becomes that of all, of what every rank lends: of each pixel the nearest (with Image::depth), or
    /// as dealt.  False: this device does not reach them all.
    virtual bool take(unsigned images, const std::vector<LentPlace>& places, const Share* dealt) = 0;
};

struct Scene;

/// Rays, in host memory, as the scenes of a picture ask others about them.
struct RemoteRays {
    std::size_t n;
    const float* ray;         ///< (n, 6) origin, unit direction
    const float* distance;    ///< (n,) of shadow rays: how far they look; null: rays to what they meet first
    const std::int8_t* side;  ///< (n,) +1: outside of the medium, -1: inside, 0: not known
};
/// What they meet.
struct RemoteHits {
    float* t;           ///< (n,) infinite: nothing
    std::int8_t* side;  ///< (n,) before t: +1, -1; unknown sides alone are read
    std::int32_t* cap;  ///< (n,) of a cut face its clip, else -1
    float* looks;       ///< (n, 8) normal, color, reflection, refraction
};
/// Who answers for a scene whose particles lie elsewhere.  False: the caller's thread has the reason.
struct Remote {
    void* who = nullptr;
    bool (*march)(void* who, const RemoteRays& rays, const RemoteHits& hits) = nullptr;
    bool (*occlude)(void* who, const RemoteRays& rays, float* left) = nullptr;  ///< left: (n,) share of the light
    explicit operator bool() const { return march != nullptr; }
};

/// One scene of a picture.
struct LayerRequest {
    Scene* scene;
    FieldRequest field;
    std::vector<Clip> clips;
    Remote remote{};  ///< where the scene itself is empty
};

/// Parts of rays through a scene that is one piece of several, in host memory; all (n,) but the first.
struct RayParts {
    std::size_t n;
    const float* ray;        ///< (n, 6) origin, unit direction
    const float *from, *to;  ///< along the ray; from below 0: from the surface on
    std::int8_t* side;       ///< in and out
};
/// Of shadow rays: see trace/segment.hpp.
struct ShadowParts {
    const float* distance;
    float *left, *on;
    std::int32_t* crossings;
    std::int8_t* test;
};

struct PictureRequest {
    std::vector<LayerRequest> layers;  // all of one backend and device
    CameraRays camera;
    Lighting lighting;                 // its sky's image and the layers' materials included
    const float* sky_image = nullptr;  // (height, width, 3) in host memory
    std::uint64_t sky_id = 0;          // another number for another image
    int passes = 1;
};

/// Particles as rays see them; implemented by SceneImpl, pipeline/scene.hpp.
struct Scene : Object {
    virtual void build(const SceneArrays& arrays, const TreeRequest& request) = 0;
    /// A scene is of particles or of a mesh.
    virtual void build_mesh(const MeshArrays& arrays) = 0;
    virtual void place_mesh(const Pose& pose) = 0;
    virtual void intersect_mesh(std::size_t n, const FloatArray& origins, const FloatArray& directions, float* t,
        float* normal, std::uint32_t* face) = 0;
    virtual float extent() = 0;  // longest edge of the box of what it holds
    virtual TreeFacts facts(bool with_hashes) = 0;
    virtual float spacing() = 0;  // of the particles built last; 0 where there are too few
    virtual float fluid_spacing() = 0;
    virtual void sorted(std::uint64_t* keys, std::uint32_t* index) = 0;
    /// Of a smooth surface, in key order: (n, 6) as SceneArrays::stretch, and (n,).
    virtual void surface_kernels(float* stretch, float* weight) = 0;
    /// The picture; passes are added to those of `before`, a frame of the same size, if given, which stays as it is.
    virtual std::shared_ptr<Frame> render(const PictureRequest& request, const std::shared_ptr<Frame>& before) = 0;
    virtual void intersect(const FieldRequest& field, std::size_t n, const FloatArray& origins,
        const FloatArray& directions, float* t, float* normal, float* albedo) = 0;
    virtual void evaluate(
        const FieldRequest& field, std::size_t n, const FloatArray& points, float* value, float* gradient) = 0;
    /// values: (n_rows, channels), a row a particle.
    virtual void blend(const FieldRequest& field, std::size_t n, const FloatArray& points, const FloatArray& values,
        std::size_t n_rows, int channels, float* out) = 0;
    /// Along rays from their origins on: sum of value times the integral of the kernel; values as for blend.
    virtual void integrate(const FieldRequest& field, std::size_t n, const FloatArray& origins,
        const FloatArray& directions, const FloatArray& values, std::size_t n_rows, int channels, float* out) = 0;
    virtual Neighbors neighbors(std::size_t n, const FloatArray& points, float radius) = 0;
    virtual void synchronize() = 0;
    /// Where parts of rays meet the surface first: t (infinite: not in the part), cap, looks as RemoteHits.
    virtual void march_parts(const FieldRequest& field, const std::vector<Clip>& clips, const RayParts& parts, float* t,
        std::int32_t* cap, float* looks) = 0;
    virtual void occlude_parts(const FieldRequest& field, const std::vector<Clip>& clips, const Material& material,
        const RayParts& parts, const ShadowParts& shadow) = 0;
    /// For a simulation that works on this scene's octree.
    virtual SceneAccess share() = 0;
    /// Shows copies of what another scene's exec holds, its simulation's; void*: that exec, of the same backend.
    virtual void take(const SceneAccess::Shown& shown, void* exec) = 0;
    /// What its pictures show beside tissue as layers of their own: fluids (0), boundaries and rigid bodies (1). Owned
    /// by this scene.
    virtual Scene* beside(int which) = 0;
    /// Of the n rays traced last, by a request that counts.
    virtual void thesis_work(std::size_t n, ThesisWork* out) = 0;
};

/// Exported by every backend library as "globule_backend", beside "globule_interface" (backends/interface.cpp).
struct BackendApi {
    Status (*make_scene)(int device, int threads, Poll* poll, std::shared_ptr<Scene>* out) noexcept;
    /// One line naming the device, or why it cannot be used (then ok is false).
    Status (*describe)(int device, bool* ok, std::string* out) noexcept;
    Status (*make_reconstructor)(int device, int threads, Poll* poll, std::shared_ptr<Reconstructor>* out) noexcept;
    Status (*make_simulation)(const std::shared_ptr<Scene>& scene, std::shared_ptr<Simulation>* out) noexcept;
    Status (*make_tissue)(int device, int threads, Poll* poll, std::shared_ptr<Tissue>* out) noexcept;
    /// Whose memory an address is: a GPU's number, or kHost.
    Status (*locate)(const void* address, int* device) noexcept;
    /// A GPU's array to host memory; complete when it returns.
    Status (*fetch)(void* to, const AnyArray& from, std::size_t bytes) noexcept;
    /// The reverse, in the order of the array's stream; complete when it returns where it has none.
    Status (*deliver)(const ArrayAt<void>& to, const void* from, std::size_t bytes) noexcept;
    /// What is given to a caller's stream from now on finds all done that objects on the device were asked for.
    Status (*let_wait)(int device, std::uintptr_t stream) noexcept;
    /// Host memory that this backend's devices write by themselves, null where there is none; kept for the next that
    /// wants it.
    void* (*take_pinned)(std::size_t bytes) noexcept;
    void (*give_pinned_back)(void* room, std::size_t bytes) noexcept;
    /// Calls function(context), which calls a method of the object, on its device; what the method throws becomes a
    /// status.
    Status (*run)(Object& object, void (*function)(void* context), void* context) noexcept;
};

}  // namespace globule::core
