// What the handles hold.
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "api/checks.hpp"
#include "api/device.hpp"
#include "api/limits.hpp"
#include "globule/frame.hpp"
#include "globule/mesh.hpp"
#include "globule/scene.hpp"
#include "globule/simulation.hpp"
#include "globule/tissue.hpp"

namespace globule {

/// Everything of a Lighting but the materials, and what materials take from the settings.
struct Look {
    core::Lighting lighting{};
    const float* sky_image = nullptr;
    std::uint64_t sky_id = 0;
    float specular = 0, shininess = 0;
};
/// Checked; ambient rays without a distance have 0.
Look look(const RenderSettings& settings);
core::Material material(const Material& m, const Look& look);
core::Clip clip(const Clip& c);
core::CameraRays rays(const Camera& camera, int width, int height);

/// The way into the handles.
struct Inside {
    using SceneImpl = Scene::Impl;
    using FrameImpl = Frame::Impl;

    template <class H> static const auto& of(const H& handle, const char* what) {
        if (!handle.impl_) refuse(what, std::string("a ") + what, "an empty handle (default-made or moved from)");
        return *handle.impl_;
    }
    static const std::shared_ptr<SceneImpl>& shared(const Scene& scene) {
        of(scene, "scene");
        return scene.impl_;
    }
    using MeshImpl = Mesh::Impl;
    static const std::shared_ptr<MeshImpl>& shared(const Mesh& mesh) {
        of(mesh, "mesh");
        return mesh.impl_;
    }
    static Scene scene(std::shared_ptr<SceneImpl> impl) {
        Scene s;
        s.impl_ = std::move(impl);
        return s;
    }
    static Frame frame(std::shared_ptr<const FrameImpl> impl) {
        Frame f;
        f.impl_ = std::move(impl);
        return f;
    }
    static Tissue tissue(core::Handle<core::Tissue> core);
    /// A scene that can take a simulation's particles; chosen: null, or where its device goes.
    GLOBULE_API static core::Handle<core::Scene> snapshot(
        const Simulation& simulation, const std::string& device, Chosen* chosen = nullptr);
    GLOBULE_API static void take(
        const Simulation& simulation, const core::Handle<core::Scene>& to, core::sim::Drawn what);
};

struct Scene::Impl {
    core::Handle<core::Scene> core;
    Chosen chosen;
    core::KernelName kernel{};
    double threshold = 0;

    // Behind the gate.
    core::TreeRequest tree;
    double own_support = 0;       ///< of the options; 0: none
    bool smooth = false;          ///< one smooth surface, measured_support belongs to it
    double measured_support = 0;  ///< for particles that come without one; 0: not yet known
    bool whole = false;           ///< an update went through and nothing broke since
    std::size_t n = 0;
    std::vector<float> few_or_flat;           ///< positions whose spacing is measured without the octree, or none
    double support = 0, largest_support = 0;  ///< of all; 0 where each has its own, or where an array on a GPU tells it
    std::shared_ptr<const void> held;  ///< copies that the scene still reads, also for frames that outlive its handle

    bool of_snapshot = false;
    /// Of a simulation, which it keeps alive, or of a snapshot: its number of particles, behind the same gate.
    std::shared_ptr<const std::size_t> n_of_owner;

    void update(const Particles& particles);
    /// Throws unless there is something to ask.
    void check_whole() const;
    std::size_t size() const { return n_of_owner ? *n_of_owner : n; }
    core::FieldRequest field() const { return {kernel, float(threshold), {}}; }
    core::Gates gates() const { return core::Gates({core.gate().get()}); }

    template <auto Method, class... A> auto ask(A&&... arguments) const {
        const core::Gates inside({core.gate().get()});
        check_whole();
        return core.call_inside<Method>(inside, std::forward<A>(arguments)...);
    }
};

/// A scene whose core holds triangles.
struct Mesh::Impl {
    /// What images of the mesh read; the scene keeps it.
    struct Held {
        std::vector<std::uint32_t> faces, order,
            begins;  ///< order: corners by vertex; begins: where each vertex's begin
        std::vector<float> radius{};
        Inputs inputs;
    };
    std::shared_ptr<Inside::SceneImpl> scene;
    MeshOptions options;
    std::size_t n_vertices = 0;
    core::FloatArray color;
    core::float3 one_color{};
    std::size_t corners = 3;  ///< of a face; 2: capsules
    float one_radius = 0;
    std::shared_ptr<const Held> held;

    void build(const core::FloatArray& vertices);
    void make(const ArrayView& vertices, const ArrayView& faces, const char* name, const Colors& color,
        const Scalars& radius);
};

struct Tissue::Impl { core::Handle<core::Tissue> core; };

/// A frame, and what refines it.
struct Frame::Impl {
    core::Handle<core::Frame> core;
    std::string device;
    int device_number = core::kHost;
    int width = 0, height = 0;
    std::vector<std::shared_ptr<Inside::SceneImpl>> scenes;
    core::PictureRequest request;     ///< its passes are not used
    std::shared_ptr<const void> sky;  ///< keeps the request's image alive
};

}  // namespace globule
