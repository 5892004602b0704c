// What a compiled backend offers to the bindings.  Each backend (one CPU library per SIMD level, one
// CUDA library) is a shared library of its own, opened when asked for: code compiled for AVX-512
// never mixes with the baseline's, and a machine without an NVIDIA driver never loads CUDA.
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "field/kernels.hpp"
#include "octree/types.hpp"
#include "trace/camera.hpp"
#include "trace/clip.hpp"
#include "trace/thesis/request.hpp"
#include "trace/camera.hpp"
#include "trace/clip.hpp"
#include "trace/lighting.hpp"
#include "backends/reconstructor.hpp"
#include "backends/scene_access.hpp"

namespace globule::core {

/// Floats in host memory, or in the backend's device memory.
struct FloatArray {
    const float* data = nullptr;
    bool on_device = false;
};

struct SceneArrays {
    std::size_t n = 0;
    FloatArray positions;                 // (n, 3)
    FloatArray support, weight, color;    // (n,), (n,), (n, 3); null: the one value below
    FloatArray reflection, refraction;    // (n,)
    FloatArray stretch;                   // (n, 6) xx yy zz xy xz yz, 1 / world; null: balls; sparse octree only
    float most_stretch = 1.0f;
    float one_support = 0.0f, one_weight = 1.0f;
    float3 one_color{0, 0, 0};
    float one_reflection = 0.0f, one_refraction = 0.0f;
};

struct TreeRequest {
    int key_bits = 32, depth = 10;
    bool dense = false, fixed_space = false;
    float3 lo{0, 0, 0}, hi{0, 0, 0};
};

struct TreeFacts {
    TreeHeader header;
    std::uint64_t n_inside, n_nodes, n_leaves, bytes;
    std::uint64_t key_hash, node_hash;    // filled only when asked
    double build_seconds;
};

struct FieldRequest {
    KernelName kernel;
    float threshold;
};

/// A finished picture in the backend's memory; taken out piece by piece.
struct Frame {
    virtual ~Frame() = default;
    virtual void depth(float* out) = 0;              // (h, w)
    virtual void normal(float* out) = 0;             // (h, w, 3)
    virtual void albedo(float* out) = 0;
    virtual void color(float* out) = 0;
    virtual void position(float* out) = 0;
    virtual void picture(std::uint8_t* out) = 0;     // (h, w, 3)
    virtual void layer(std::uint8_t* out) = 0;       // (h, w): of what is hit; other than a layer's number: the ground
    virtual double trace_seconds() = 0;
    virtual int passes() = 0;
};

struct Scene;
struct Tissue;

/// One scene of a picture.
struct LayerRequest {
    Scene* scene;
    FieldRequest field;
    std::vector<Clip> clips;
};

struct PictureRequest {
    std::vector<LayerRequest> layers;   // all of one backend and device
    CameraRays camera;
    Lighting lighting;                  // its sky's image and the layers' materials included
    const float* sky_image = nullptr;   // (height, width, 3) in host memory
    std::uint64_t sky_id = 0;           // another number for another image
    int passes = 1;
};

struct Neighbors {
    std::vector<std::uint64_t> offsets;
    std::vector<std::uint32_t> indices;
};

struct Scene {
    virtual ~Scene() = default;
    virtual void build(const SceneArrays& arrays, const TreeRequest& request) = 0;
    virtual TreeFacts facts(bool with_hashes) = 0;
    virtual float spacing() = 0;  // of the particles built last; 0 where there are too few
    virtual void sorted(std::uint64_t* keys, std::uint32_t* index) = 0;
    /// The picture; passes are added to those of `before`, a frame of the same size, if given.
    virtual std::shared_ptr<Frame> render(const PictureRequest& request, std::shared_ptr<Frame> before) = 0;
    virtual void intersect(const FieldRequest& field, std::size_t n, FloatArray origins, FloatArray directions,
                           float* t, float* normal, float* albedo) = 0;
    virtual void evaluate(const FieldRequest& field, std::size_t n, FloatArray points, float* value, float* gradient) = 0;
    virtual void blend(const FieldRequest& field, std::size_t n, FloatArray points, FloatArray values, int channels, float* out) = 0;
    virtual Neighbors neighbors(std::size_t n, FloatArray points, float radius) = 0;
    virtual void synchronize() = 0;
    /// How the rays that follow are traced: the thesis's way (dense octree only), or ours.
    virtual void trace_like(const std::optional<ThesisRequest>& thesis) = 0;
    /// For a simulation that works on this scene's octree.
    virtual SceneAccess share() = 0;
    /// Of the n rays traced last, by a request that counts.
    virtual void thesis_work(std::size_t n, ThesisWork* out) = 0;
};

/// Polled during long work; true asks to stop (then the call throws Cancelled).
using Poll = bool (*)();
struct Cancelled {};

struct Simulation;

/// Exported by every backend library as "globule_backend".
struct BackendApi {
    std::unique_ptr<Scene> (*make_scene)(int device_index, int threads, Poll poll);
    /// One line naming the device, or why it cannot be used (then ok is false).
    std::string (*describe)(int device_index, bool& ok);
    std::unique_ptr<Reconstructor> (*make_reconstructor)(int device_index, int threads, Poll poll);
    std::unique_ptr<Simulation> (*make_simulation)(std::shared_ptr<Scene> scene);
    std::unique_ptr<Tissue> (*make_tissue)(int device_index, int threads, Poll poll);
};

}  // namespace globule::core
