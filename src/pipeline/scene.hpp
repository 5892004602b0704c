// The one implementation of Scene, over any Exec: it owns the stages and says who calls which.
//   build       pipeline/build.hpp     particles to octree
//   a frame     pipeline/frame.hpp     trace → resolve → shade, where light makes no more turns
//               pipeline/picture.hpp   waves of rays through all layers, else
//   questions   pipeline/questions.hpp at points
#pragma once
#include <functional>

#include "pipeline/frame.hpp"
#include "pipeline/parts.hpp"
#include "pipeline/picture.hpp"
#include "pipeline/questions.hpp"

namespace globule::core {

template <class Exec> class SceneImpl final : public Scene {
public:
    SceneImpl(int device, int threads, Poll* poll) : SceneImpl(std::make_shared<Exec>(device, threads, poll)) {}

    int device() const noexcept override { return exec_->device(); }
    void begin() override {
        exec_->interrupt().clear();
        if (before_use_) before_use_();
    }
    void invalidate() noexcept override { cells_.forget(); }
    void cancel() noexcept override { exec_->interrupt().request(); }

    void build(const SceneArrays& in, const TreeRequest& request) override {
        if (shared_) throw Refused("update: the scene of a simulation follows its particles");
        check_room(in.n, request);
        cells_.forget();
        ++state_;
        frames_->keep(Exec::on_device || !in.given_up);  // where memory is scarce
        builder_.build(in, request);
    }

    void build_mesh(const MeshArrays& in) override {
        ++state_;
        mesh_.build(*exec_, in);
    }
    void place_mesh(const Pose& pose) override {
        if (!mesh_.is_there()) throw Stale("scene: expected a mesh, got none");
        ++state_;
        mesh_.place(pose);
    }

    void intersect_mesh(std::size_t n, const FloatArray& origins, const FloatArray& directions, float* t, float* normal,
        std::uint32_t* face) override {
        if (!mesh_.is_there()) throw Stale("scene: expected a mesh, got none");
        mesh_.intersect(*exec_, n, origins, directions, t, normal, face);
    }

    float extent() override { return mesh_.is_there() ? mesh_.extent(*exec_) : octree().header().space.extent; }
    TreeFacts facts(bool with_hashes) override {
        TreeFacts f = questions_.facts(octree(), with_hashes);
        f.build_seconds = builder_.build_seconds();
        return f;
    }
    float spacing() override { return questions_.spacing(octree()); }
    float fluid_spacing() override { return questions_.fluid_spacing(octree()); }
    void sorted(std::uint64_t* keys, std::uint32_t* index) override { questions_.sorted(octree(), keys, index); }
    void surface_kernels(float* stretch, float* weight) override {
        const SortedParticles& p = octree().particles();
        if (!p.stretch || !p.weight.data) throw Refused("surface_kernels: expected a smooth surface");
        exec_->download(stretch, p.stretch, 6 * octree().size() * sizeof(float));
        exec_->download(weight, p.weight.data, octree().size() * sizeof(float));
    }
    void intersect(const FieldRequest& field, std::size_t n, const FloatArray& origins, const FloatArray& directions,
        float* t, float* normal, float* albedo) override {
        octree();
        questions_.intersect(traced(), field, n, origins, directions, t, normal, albedo);
    }
    void evaluate(
        const FieldRequest& field, std::size_t n, const FloatArray& points, float* value, float* gradient) override {
        questions_.evaluate(octree(), field.kernel, n, points, value, gradient);
    }
    void blend(const FieldRequest& field, std::size_t n, const FloatArray& points, const FloatArray& values,
        std::size_t n_rows, int channels, float* out) override {
        if (n_rows != octree().size())
            throw Refused(
                "values: expected " + std::to_string(octree().size()) + " rows, got " + std::to_string(n_rows));
        questions_.blend(octree(), field.kernel, n, points, values, channels, out);
    }
    void integrate(const FieldRequest& field, std::size_t n, const FloatArray& origins, const FloatArray& directions,
        const FloatArray& values, std::size_t n_rows, int channels, float* out) override {
        if (n_rows != octree().size())
            throw Refused(
                "values: expected " + std::to_string(octree().size()) + " rows, got " + std::to_string(n_rows));
        questions_.integrate(octree(), field.kernel, n, origins, directions, values, channels, out);
    }
    Neighbors neighbors(std::size_t n, const FloatArray& points, float radius) override {
        return questions_.neighbors(octree(), n, points, radius);
    }

    void march_parts(const FieldRequest& field, const std::vector<Clip>& clips, const RayParts& parts, float* t,
        std::int32_t* cap, float* looks) override {
        octree();
        traced().prepare_cells(*exec_, field, true, {0, 0, 0});
        parts_.march(*exec_, traced(), field, pictures_.bring_clips(0, clips), parts, t, cap, looks);
    }
    void occlude_parts(const FieldRequest& field, const std::vector<Clip>& clips, const Material& material,
        const RayParts& parts, const ShadowParts& shadow) override {
        octree();
        traced().prepare_cells(*exec_, field, true, {0, 0, 0});
        parts_.occlude(*exec_, traced(), field, pictures_.bring_clips(0, clips), material, parts, shadow);
    }

    std::shared_ptr<Frame> render(const PictureRequest& request, const std::shared_ptr<Frame>& before) override {
        auto frame = std::make_shared<FinishedFrame<Exec>>(frames_, device());
        FrameImages<Exec>& images = frame->images();
        const auto* older = before ? &static_cast<const FinishedFrame<Exec>&>(*before).images() : nullptr;
        const std::vector<std::uint64_t> states = states_of(request);
        if (older && older->states != states)
            throw Refused("refine: expected the scene as it was rendered, but it was updated since: render it again");
        const bool plain =
            !older && request.passes == 1 && !mesh_.is_there() && is_plain(request, traced().attributes());
        Exec& exec = plain ? builder_.next_lane() : *exec_;
        images.timer.let_follow(exec);  // another frame had this memory
        images.resize({request.camera, nullptr, nullptr, std::size_t(request.camera.width) * request.camera.height});
        images.n_passes = plain ? 1 : 0;
        images.plain = plain;
        images.has_edges = false;
        images.states = states;
        images.timer.begin(exec);
        const OnFailure ends([&] { images.timer.end(exec); });  // the next to have this memory waits for what was begun
        if (plain) {
            make_frame(exec, traced(), request.layers[0].field, request.lighting, images);
        } else {
            // A plain picture has no sums to add to, and edges have their own: its passes are made again.
            const int again = older && (older->plain || older->has_edges) ? older->n_passes : 0;
            if (older && !again) copy(*older, images);
            make_picture(request, images, request.passes + again);
        }
        images.timer.end(exec);
        return frame;
    }

    void synchronize() override { builder_.synchronize(); }

    SceneAccess share() override {
        shared_ = true;
        return {exec_.get(), &builder_.share(), [this](const SceneAccess::Shown& s) { show(s); },
            [this](std::function<void()> before_use) {
                if (before_use) before_use_ = std::move(before_use);
                else before_use_ = [] { throw Stale("scene: its simulation is gone"); };
            }};
    }

    void take(const SceneAccess::Shown& shown, void* exec) override {
        Exec& from = *static_cast<Exec*>(exec);
        SceneAccess::Shown mine = shown;
        struct Part {
            const float** data;
            std::size_t n;
        };
        const Part parts[] = {{&mine.places, 3 * mine.n}, {&mine.fluids, 3 * mine.n}, {&mine.things, 3 * mine.n},
            {&mine.color, 3 * mine.n}, {&mine.reflection, mine.n}, {&mine.refraction, mine.n}, {&mine.wetness, mine.n}};
        std::size_t n = 0;
        for (const Part& p : parts) n += *p.data ? p.n : 0;
        shared_ = true;
        float* to = reinterpret_cast<float*>(copies_.reserve(n * sizeof(float), device()));
        exec_->follow(from);
        for (const Part& p : parts) {
            if (!*p.data) continue;
            exec_->copy_from(from, to, *p.data, p.n * sizeof(float));
            *p.data = to;
            to += p.n;
        }
        from.follow(*exec_);
        show(mine);
    }

    Scene* beside(int which) override {
        if (!beside_[which]) {
            beside_[which].reset(new SceneImpl(exec_));
            beside_[which]->shared_ = true;
            beside_[which]->before_use_ = [this] {
                if (before_use_) before_use_();
            };
        }
        return beside_[which].get();
    }

    void thesis_work(std::size_t n, ThesisWork* out) override {
        if (n > work_.capacity()) throw Refused("thesis_work: expected a trace that counts first");
        exec_->download(out, work_.data(), n * sizeof(ThesisWork));
    }

private:
    explicit SceneImpl(std::shared_ptr<Exec> exec)
        : exec_(std::move(exec)),
          builder_(exec_),
          cells_(*exec_),
          mesh_(*exec_),
          near_(*exec_),
          work_(*exec_),
          questions_(*exec_),
          parts_(*exec_),
          pictures_(exec_),
          frames_(std::make_shared<FramePool<Exec>>(exec_)) {}

    Octree<Exec>& octree() const {
        if (!builder_.is_whole()) throw Stale("scene: its octree was not finished: update the scene first");
        return builder_.now().octree;
    }
    /// A simulation's particles.
    void show(const SceneAccess::Shown& s) {
        if (s.places) builder_.draw_own(s.n, s.places, s.spacing, s.smooth);
        else builder_.draw_shared();
        look_like(s, {s.wetness, 0.0f});
        const float* positions[2] = {s.fluids, s.things};
        for (int k = 0; k < 2; ++k) {
            if (!positions[k] || !beside_[k]) continue;
            beside_[k]->builder_.draw_own(s.n, positions[k], k == 0 ? s.fluid_spacing : s.spacing, k == 0);
            beside_[k]->look_like(s, {nullptr, k == 0 ? 1.0f : 0.0f});
        }
    }
    /// Colors and factors of a simulation's particles.
    void look_like(const SceneAccess::Shown& s, const Attribute& wetness) {
        Attributes& a = builder_.now().attributes;
        a.color = s.color;
        a.reflection = {s.reflection, 0.0f};
        a.refraction = {s.refraction, 0.0f};
        a.wetness = wetness;
        a.wet = s.wet;
        cells_.forget();
        ++state_;
    }
    Traced<Exec> traced() { return {builder_, cells_, near_, work_, mesh_}; }

    /// Refuses what cannot fit before anything is taken.
    void check_room(std::size_t n, const TreeRequest& request) const {
        if (n > kMaxParticles)
            throw Refused("positions: expected at most " + std::to_string(kMaxParticles) + " particles, got " +
                          std::to_string(n));
        const std::uint64_t needed = Octree<Exec>::least_bytes(n, request.key_bits, request.depth),
                            there = n > kWorthAsking ? exec_->free_bytes() : 0;
        if (there && needed > there + builder_.bytes())
            throw Refused("positions: an octree of " + std::to_string(n) + " particles takes at least " +
                          gibibytes(needed) + ", got " + gibibytes(there) + " of free memory");
    }
    static std::string gibibytes(std::uint64_t bytes) {
        const std::uint64_t tenths = (bytes * 10) >> 30;
        return std::to_string(tenths / 10) + "." + std::to_string(tenths % 10) + " GiB";
    }

    /// Other layers' scenes are brought up to date here, where their gates are held.
    std::vector<std::uint64_t> states_of(const PictureRequest& request) {
        std::vector<std::uint64_t> states;
        for (const LayerRequest& layer : request.layers) {
            SceneImpl& scene = *static_cast<SceneImpl*>(layer.scene);
            if (&scene != this) scene.begin();
            if (!scene.mesh_.is_there()) scene.octree();
            states.push_back(scene.state_);
        }
        return states;
    }

    void copy(const FrameImages<Exec>& from, FrameImages<Exec>& to) {
        const std::size_t n = to.rays.n;
        if (from.rays.n != n) throw Refused("refine: expected a frame of the same size");
        from.timer.let_follow(*exec_);
        exec_->copy(to.block.data(), from.block.data(), 7 * n * sizeof(float));
        exec_->copy(to.layer(), from.layer(), n);
        exec_->copy(to.sums.reserve(to.floats_of_sums(n)), from.sums.data(), 6 * n * sizeof(float));
        to.n_passes = from.n_passes;
    }

    void make_picture(const PictureRequest& request, FrameImages<Exec>& images, int passes) {
        Lighting lighting = request.lighting;
        std::vector<PictureLayer<Exec>> layers;
        const auto let_others_go_on = [&] {  // no scene must change before the picture is made
            for (const LayerRequest& layer : request.layers)
                if (auto& exec = static_cast<SceneImpl*>(layer.scene)->exec_; exec != exec_) exec->follow(*exec_);
        };
        const OnFailure let_go([&] { let_others_go_on(); });
        bool inside = request.camera.orthographic;  // whose rays may begin there
        bool by_tiles = lighting.ambient_rays == 0 &&
                        (lighting.bounces == 0 || !lighting.ground.present || lighting.ground.reflection == 0.0f);
        for (std::size_t k = 0; k < request.layers.size(); ++k) {
            const LayerRequest& layer = request.layers[k];
            const Attributes& attributes = static_cast<SceneImpl*>(layer.scene)->builder_.now().attributes;
            inside = inside || !layer.clips.empty() || acts(lighting.materials[k].transmission, attributes.refraction);
            by_tiles = by_tiles && !layer.field.thesis && !layer.remote && layer.clips.empty() &&
                       ends_light(lighting, lighting.materials[k], attributes);
        }
        for (std::size_t k = 0; k < request.layers.size(); ++k) {
            const LayerRequest& layer = request.layers[k];
            SceneImpl& scene = *static_cast<SceneImpl*>(layer.scene);
            layers.push_back({scene.traced(), layer.field, pictures_.bring_clips(k, layer.clips),
                pictures_.remote(k, layer.remote)});
            if (layer.remote) continue;
            if (!by_tiles) scene.traced().prepare_cells(*scene.exec_, layer.field, inside, request.camera.eye);
            if (scene.mesh_.is_there()) (scene.mesh_.is_closed() ? lighting.closed : lighting.sheets) |= 1u << k;
            if (scene.exec_ != exec_) exec_->follow(*scene.exec_);
        }
        lighting.sky.image = pictures_.bring_sky(request);
        pictures_.add_passes(layers, lighting, images, passes, by_tiles);
        let_others_go_on();
    }

    static constexpr std::size_t kWorthAsking = 10'000'000;  ///< below, memory is not asked for

    std::shared_ptr<Exec> exec_;
    Builder<Exec> builder_;
    CellStore<Exec> cells_;
    MeshStore<Exec> mesh_;
    Buffer<std::uint8_t, Exec> near_;
    Buffer<ThesisWork, Exec> work_;
    Questions<Exec> questions_;
    PartTracer<Exec> parts_;
    PictureMaker<Exec> pictures_;
    std::shared_ptr<FramePool<Exec>> frames_;
    std::function<void()> before_use_;
    std::unique_ptr<SceneImpl> beside_[2];  ///< fluids; boundaries and bodies
    typename Exec::Lent copies_;            ///< of what take() shows
    std::uint64_t state_ = 0;               ///< counts what changes the picture
    bool shared_ = false;
};

}  // namespace globule::core
