// The one implementation of Scene, over any Exec.
#pragma once
#include <algorithm>
#include <deque>
#include <cmath>

#include "backends/backend.hpp"
#include "octree/query.hpp"
#include "trace/build_cells.hpp"
#include "trace/resolve.hpp"
#include "trace/shade.hpp"
#include "trace/tile.hpp"
#include "pipeline/frame_trees.hpp"
#include "pipeline/waves.hpp"
#include "pipeline/thesis.hpp"

namespace globule::core {

inline std::uint64_t hash_bytes(const void* data, std::size_t n, std::uint64_t h = 1469598103934665603ull) {
    const unsigned char* p = static_cast<const unsigned char*>(data);  // FNV-1a, 64 bit
    for (std::size_t i = 0; i < n; ++i) h = (h ^ p[i]) * 1099511628211ull;
    return h;
}

template <class Tree>
struct CountLeaf {
    Tree tree;
    GB_FN std::uint32_t operator()(std::size_t i) const { return Node::is_leaf(tree.node(std::uint32_t(i)).meta); }
};
struct Add {
    GB_FN std::uint32_t operator()(std::uint32_t a, std::uint32_t b) const { return a + b; }
};

template <class Exec>
class SceneOf final : public Scene {
public:
    template <class... Args>
    explicit SceneOf(Args&&... args)
        : exec_(std::make_shared<Exec>(std::forward<Args>(args)...)), trees_(exec_), positions_(*exec_),
          support_(*exec_), weight_(*exec_), stretch_(*exec_), color_(*exec_), points_(*exec_), more_points_(*exec_),
          values_(*exec_), results_(*exec_), offsets_(*exec_), indices_(*exec_), count_(*exec_),
          hits_(*exec_), reflection_(*exec_), refraction_(*exec_), sky_(*exec_), spare_(*exec_), grid_(*exec_), bricks_(*exec_),
          lists_(*exec_), blocks_(*exec_), near_(*exec_), work_(*exec_), undecided_(*exec_) {}

    void build(const SceneArrays& in, const TreeRequest& request) override {
        ParticleInput input;
        input.n = in.n;
        Exec& exec = trees_.next_exec();
        input.positions = bring(exec, positions_, in.positions, 3 * in.n);
        input.support = {bring(exec, support_, in.support, in.n), in.one_support};
        input.weight = {bring(exec, weight_, in.weight, in.n), in.one_weight};
        input.stretch = bring(exec, stretch_, in.stretch, 6 * in.n);
        input.most_stretch = in.most_stretch;
        attributes_.color = bring(color_, in.color, 3 * in.n);
        attributes_.one_color = in.one_color;
        attributes_.reflection = {bring(reflection_, in.reflection, in.n), in.one_reflection};
        attributes_.refraction = {bring(refraction_, in.refraction, in.n), in.one_refraction};
        cells_stale_ = true;
        TreeParams params{request.key_bits, request.depth, request.dense, request.fixed_space, request.lo, request.hi};
        trees_.build(input, params);
    }

    TreeFacts facts(bool with_hashes) override {
        TreeFacts f{};
        f.header = octree().header();
        f.n_inside = octree().size() - f.header.n_outside;
        f.n_nodes = octree().params().dense ? octree().n_dense_nodes() : f.header.n_nodes;
        std::uint32_t* count = count_.reserve(1);
        with_tree([&](auto tree) { exec_->reduce(f.n_nodes, CountLeaf<decltype(tree)>{tree}, Add{}, 0u, count); });
        std::uint32_t leaves;
        exec_->download(&leaves, count, sizeof leaves);
        f.n_leaves = leaves;
        f.bytes = octree().bytes();
        f.build_seconds = trees_.build_seconds();
        if (with_hashes) {
            const std::size_t key_bytes = octree().size() * octree().params().key_bits / 8;
            f.key_hash = hash_device(octree().keys(), key_bytes);
            f.key_hash = hash_device(octree().particles().index, octree().size() * 4, f.key_hash);
            if (octree().params().dense) {
                f.node_hash = hash_device(octree().dense_nodes(), f.n_nodes * sizeof(DenseNode));
            } else {
                const NodeArrays nodes = octree().node_arrays();
                f.node_hash = hash_device(nodes.first, f.n_nodes * 4);
                f.node_hash = hash_device(nodes.meta, f.n_nodes * 4, f.node_hash);
                for (float* side : nodes.box) f.node_hash = hash_device(side, f.n_nodes * 4, f.node_hash);
            }
        }
        return f;
    }

    float spacing() override {
        const TreeHeader h = octree().header();
        const std::size_t begin = h.n_outside, n_inside = octree().size() - begin;
        if (n_inside == 0) return 0.0f;
        const std::size_t stride = max<std::size_t>(1, n_inside / 1024);
        const std::size_t samples = ceil_div<std::size_t>(n_inside, stride);
        float* out = results_.reserve(samples);
        with_tree([&](auto tree) {
            exec_->for_each(samples, LocalSpacing<decltype(tree)>{tree, octree().particles(), begin, octree().size(), stride, out});
        });
        std::vector<float> all(samples);
        exec_->download(all.data(), out, samples * sizeof(float));
        all.erase(std::remove_if(all.begin(), all.end(), [](float s) { return !(s > 0.0f); }), all.end());
        if (all.empty()) return 0.0f;
        std::nth_element(all.begin(), all.begin() + all.size() / 2, all.end());
        return all[all.size() / 2];
    }

    void sorted(std::uint64_t* keys, std::uint32_t* index) override {
        const std::size_t n = octree().size();
        if (octree().params().key_bits == 64) {
            exec_->download(keys, octree().keys(), n * 8);
        } else {
            std::vector<std::uint32_t> narrow(n);
            exec_->download(narrow.data(), octree().keys(), n * 4);
            std::copy(narrow.begin(), narrow.end(), keys);
        }
        exec_->download(index, octree().particles().index, n * 4);
    }

    std::shared_ptr<Frame> render(const PictureRequest& request, std::shared_ptr<Frame> before) override {
        const CameraRays& camera = request.camera;
        const std::size_t n = std::size_t(camera.width) * camera.height;
        std::shared_ptr<FrameOf> frame = before ? std::static_pointer_cast<FrameOf>(before) : take_frame(n);
        frame->rays = {camera, nullptr, nullptr, n};
        frame->exec->mark(2);
        if (!before && request.passes == 1 && is_plain(request)) {
            frame->n_passes = 1;
            frame->plain = true;
            trace(request.layers[0].field, frame->rays, frame->hits());
            exec_->for_each(n, Shade{frame->rays, frame->hits(), request.lighting, frame->color_data(), frame->picture_data()});
        } else {
            // A plain picture has no sums to add to: its pass is made again.
            const int again = frame->plain ? frame->n_passes : 0;
            frame->n_passes -= again;
            frame->plain = false;
            render_waves(request, *frame, request.passes + again);
        }
        frame->exec->mark(3);
        check_cancelled();
        return frame;
    }

    void intersect(const FieldRequest& field, std::size_t n, FloatArray origins, FloatArray directions, float* t,
                   float* normal, float* albedo) override {
        RaySource rays{{}, bring(points_, origins, 3 * n), bring(more_points_, directions, 3 * n), n};
        float* out = hits_.reserve(7 * n);
        const Hits hits{out, out + n, out + 4 * n};
        trace(field, rays, hits);
        check_cancelled();
        exec_->download(t, hits.t, n * sizeof(float));
        exec_->download(normal, hits.normal, 3 * n * sizeof(float));
        exec_->download(albedo, hits.albedo, 3 * n * sizeof(float));
    }

    void evaluate(const FieldRequest& field, std::size_t n, FloatArray points, float* value, float* gradient) override {
        const float* p = bring(points_, points, 3 * n);
        float* out = results_.reserve(4 * n);
        with_tree([&](auto tree) {
            exec_->for_each(n, EvaluateField<decltype(tree)>{tree, octree().particles(), {field.kernel}, p,
                                                            value ? out : nullptr, gradient ? out + n : nullptr});
        });
        if (value) exec_->download(value, out, n * sizeof(float));
        if (gradient) exec_->download(gradient, out + n, 3 * n * sizeof(float));
    }

    void blend(const FieldRequest& field, std::size_t n, FloatArray points, FloatArray values, int channels, float* result) override {
        const float* p = bring(points_, points, 3 * n);
        const float* v = bring(values_, values, octree().size() * channels);
        float* out = results_.reserve(n * channels);
        with_tree([&](auto tree) {
            exec_->for_each(n, Blend<decltype(tree)>{tree, octree().particles(), {field.kernel}, p, v, channels, out});
        });
        exec_->download(result, out, n * channels * sizeof(float));
    }

    Neighbors neighbors(std::size_t n, FloatArray points, float radius) override {
        const float* p = bring(points_, points, 3 * n);
        std::uint64_t* offsets = offsets_.reserve(n + 1);
        exec_->clear(offsets, (n + 1) * sizeof(std::uint64_t));
        Neighbors out;
        out.offsets.resize(n + 1);
        with_tree([&](auto tree) {
            FindNeighbors<decltype(tree)> find{tree, octree().particles(), p, radius, offsets, nullptr};
            exec_->for_each(n, find);
            exec_->exclusive_scan(n + 1, offsets);
            exec_->download(out.offsets.data(), offsets, (n + 1) * sizeof(std::uint64_t));
            out.indices.resize(out.offsets[n]);
            find.indices = indices_.reserve(out.indices.size());
            exec_->for_each(n, find);
        });
        exec_->download(out.indices.data(), indices_.data(), out.indices.size() * sizeof(std::uint32_t));
        return out;
    }

    void synchronize() override { exec_->synchronize(); }

    void trace_like(const std::optional<ThesisRequest>& thesis) override { thesis_ = thesis; }

    SceneAccess share() override {
        return {exec_.get(), &octree(), [this](const float* color, const float* reflection, const float* refraction) {
                    attributes_.color = color;
                    attributes_.reflection = {reflection, 0.0f};
                    attributes_.refraction = {refraction, 0.0f};
                    cells_stale_ = true;
                }};
    }

    void thesis_work(std::size_t n, ThesisWork* out) override { exec_->download(out, work_.data(), n * sizeof(ThesisWork)); }

private:
    /// A frame's images live in one block that goes back to the scene's pool when the frame dies.
    struct FrameOf final : Frame {
        std::shared_ptr<Exec> exec;
        Buffer<float, Exec> block;
        RaySource rays;
        Buffer<float, Exec> sums;  ///< over passes: light, and as displayed
        int n_passes = 0;
        bool plain = false;        ///< made in one go, without sums
        explicit FrameOf(std::shared_ptr<Exec> e) : exec(std::move(e)), block(*exec), sums(*exec) {}

        Hits hits() const { return {block.data(), block.data() + rays.n, block.data() + 4 * rays.n}; }
        float* color_data() const { return block.data() + 7 * rays.n; }
        std::uint8_t* picture_data() const { return reinterpret_cast<std::uint8_t*>(block.data() + 10 * rays.n); }
        std::uint8_t* layer_data() const { return picture_data() + 3 * rays.n; }
        void depth(float* out) override { exec->download(out, hits().t, rays.n * sizeof(float)); }
        void normal(float* out) override { exec->download(out, hits().normal, 3 * rays.n * sizeof(float)); }
        void albedo(float* out) override { exec->download(out, hits().albedo, 3 * rays.n * sizeof(float)); }
        void color(float* out) override { exec->download(out, color_data(), 3 * rays.n * sizeof(float)); }
        void picture(std::uint8_t* out) override { exec->download(out, picture_data(), 3 * rays.n); }
        void layer(std::uint8_t* out) override {
            if (plain) std::fill_n(out, rays.n, std::uint8_t(0));
            else exec->download(out, layer_data(), rays.n);
        }
        void position(float* out) override {
            Buffer<float, Exec> room(*exec);
            float* p = room.reserve(3 * rays.n);
            exec->for_each(rays.n, HitPositions{rays, hits().t, p});
            exec->download(out, p, 3 * rays.n * sizeof(float));
        }
        int passes() override { return n_passes; }
        double trace_seconds() override { return exec->elapsed(2, 3); }
    };

    /// A frame that nobody holds any more, or a new one; no more than two wait for their turn.
    std::shared_ptr<FrameOf> take_frame(std::size_t n) {
        std::shared_ptr<FrameOf> frame;
        int n_idle = 0;
        std::erase_if(pool_, [&](const auto& f) { return f.use_count() == 1 && ++n_idle > 3; });
        for (auto& f : pool_)
            if (f.use_count() == 1) frame = f;
        if (!frame) pool_.push_back(frame = std::make_shared<FrameOf>(exec_));
        frame->block.reserve(11 * n);
        frame->n_passes = 0;
        frame->plain = false;
        return frame;
    }

    /// Whether light makes no more than one turn.
    bool is_plain(const PictureRequest& request) const {
        const Lighting& l = request.lighting;
        const Material& m = l.materials[0];
        const bool mirrors = m.reflection > 0.0f || (m.reflection < 0.0f && (attributes_.reflection.data || attributes_.reflection.uniform > 0.0f));
        const bool transmits = m.transmission > 0.0f || (m.transmission < 0.0f && (attributes_.refraction.data || attributes_.refraction.uniform > 0.0f));
        return request.layers.size() == 1 && request.layers[0].clips.empty() && !mirrors && !transmits && m.index == 0.0f &&
               l.n_visibilities() == 0 && !l.sky_light && !l.show_sky && !l.ground.present;
    }

    void render_waves(const PictureRequest& request, FrameOf& frame, int passes) {
        const CameraRays& camera = request.camera;
        Lighting lighting = request.lighting;
        const int n_layers = int(request.layers.size());
        std::vector<SceneOf*> scenes;
        std::vector<Clips> clips;
        while (int(clips_.size()) < n_layers) clips_.emplace_back(*exec_);
        for (int k = 0; k < n_layers; ++k) {
            const LayerRequest& layer = request.layers[k];
            SceneOf& scene = *static_cast<SceneOf*>(layer.scene);
            scenes.push_back(&scene);
            scene.prepare(layer.field);
            if (&scene != this) exec_->follow(*scene.exec_);
            Clip* room = clips_[k].reserve(layer.clips.size() + 1);
            if (!layer.clips.empty()) exec_->upload(room, layer.clips.data(), layer.clips.size() * sizeof(Clip));
            clips.push_back({room, int(layer.clips.size())});
        }
        if (request.sky_image) {
            const std::size_t floats = std::size_t(lighting.sky.width) * lighting.sky.height * 3;
            float* image = sky_.reserve(floats);
            if (request.sky_id != sky_id_) exec_->upload(image, request.sky_image, floats * sizeof(float));
            sky_id_ = request.sky_id;
            lighting.sky.image = image;
        }
        const std::size_t n = frame.rays.n;
        float* sums = frame.sums.reserve(6 * n);
        // A band of rows at a time, so that the waves' memory does not grow with the picture; some at once, so
        // that one works while another's last rays are on their way.
        while (waves_.size() < Exec::n_streams) waves_.emplace_back(waves_.empty() ? exec_ : exec_->sibling());
        const std::size_t n_streams = thesis_ ? 1 : Exec::n_streams;
        const std::size_t most_rows = Exec::wave_size / n_streams / camera.width, share = ceil_div<std::size_t>(camera.height, n_streams);
        constexpr std::size_t kRows = 16;  // a band is whole tiles high
        const std::uint32_t band = std::uint32_t(max<std::size_t>(kRows, min(most_rows / kRows, ceil_div<std::size_t>(share, kRows)) * kRows));
        const auto march = [&](Exec& exec, const WaveRays& rays, int k, LayerHits& found) {
            scenes[k]->march(exec, request.layers[k].field, clips[k], rays, k, found, n_layers == 1);
        };
        const auto keep = [&](Exec& exec, const WaveRays& rays, int k, const LayerHits& found, const WaveHits& hits) {
            scenes[k]->with_tracer(request.layers[k].field, [&](const auto& tracer) {
                using Tracer = std::decay_t<decltype(tracer)>;
                exec.for_each_uneven(rays.source.n_items(), Keep<Tracer>{tracer, clips[k], scenes[k]->attributes_, rays, k, found, hits});
            });
        };
        const auto occlude = [&](Exec& exec, const WaveRays& rays, const WaveHits& hits, int k, float* visibility) {
            scenes[k]->with_tracer(request.layers[k].field, [&](const auto& tracer) {
                using Tracer = std::decay_t<decltype(tracer)>;
                with_clips(clips[k], [&]<bool clipped>(std::bool_constant<clipped>) {
                    exec.for_each_walk(rays.source.n_items() * lighting.n_visibilities(),
                                       Occlude<Tracer, clipped>{{tracer, clips[k]}, scenes[k]->attributes_, lighting, rays, hits, k, visibility});
                });
            });
        };
        for (std::size_t k = 1; k < n_streams; ++k) waves_[k].exec().follow(*exec_);
        for (int p = 0; p < passes && !exec_->cancelled(); ++p) {
            const int pass = frame.n_passes++;
            float* spare = pass ? spare_.reserve(7 * n) : nullptr;  // later passes must not change depth and normals
            const Hits first = pass ? Hits{spare, spare + n, spare + 4 * n} : frame.hits();
            for (std::uint32_t next_row = 0; next_row < std::uint32_t(camera.height);) {
                struct Band {
                    Waves<Exec>* waves;
                    std::size_t at, n;
                };
                std::vector<Band> bands;
                for (std::size_t k = 0; k < n_streams && next_row < std::uint32_t(camera.height); ++k) {
                    const std::uint32_t rows = min(band, std::uint32_t(camera.height) - next_row);
                    const std::size_t at = std::size_t(next_row) * camera.width;
                    waves_[k].start(camera, next_row, rows, std::uint32_t(pass), {first.t + at, first.normal + 3 * at, first.albedo + 3 * at});
                    waves_[k].trace(lighting, n_layers, march, keep, occlude);
                    bands.push_back({&waves_[k], at, std::size_t(rows) * camera.width});
                    next_row += rows;
                }
                while (!bands.empty())
                    std::erase_if(bands, [&](const Band& b) {
                        if (b.waves->go_on(lighting)) {
                            b.waves->trace(lighting, n_layers, march, keep, occlude);
                            return false;
                        }
                        b.waves->exec().for_each(b.n, Finish{b.waves->sum(), b.waves->first_hits().layer, b.at, lighting.exposure, frame.n_passes,
                                                             sums, sums + 3 * n, frame.color_data(), frame.picture_data(), frame.layer_data()});
                        return true;
                    });
            }
        }
        for (std::size_t k = 1; k < n_streams; ++k) exec_->follow(waves_[k].exec());
        for (SceneOf* scene : scenes)
            if (scene != this) scene->exec_->follow(*exec_);  // it must not change before its picture is made
    }

    /// Distances to one layer's first crossing, on the picture's own stream.
    void march(Exec& exec, const FieldRequest& field, const Clips& clips, const WaveRays& rays, int layer, LayerHits& found, bool alone) {
        if (alone && rays.primary() && clips.n == 0) {  // neighbours: by tiles
            found.sign = nullptr;
            found.cap = nullptr;
            return trace_with(exec, field, rays.source, {found.t, nullptr, nullptr, found.undecided});
        }
        with_tracer(field, [&](const auto& tracer) {
            using Tracer = std::decay_t<decltype(tracer)>;
            exec.clear(found.undecided.n, sizeof *found.undecided.n);
            with_clips(clips, [&]<bool clipped>(std::bool_constant<clipped>) {
                exec.for_each_walk(rays.source.n_items(), March<Tracer, clipped>{{tracer, clips}, rays, layer, found});
            });
            using Tree = std::decay_t<decltype(tracer.tree)>;
            const ResolveRays<Tree, Tracer::PerParticle> rest{tracer.tree, octree().particles(), {field.kernel}, field.threshold, nullptr, {},
                                                             rays.source, {found.t, nullptr, nullptr, found.undecided}, clips, found.sign, found.cap};
            exec.for_each_tile_of(found.undecided.n, rest);
        });
    }

    /// The cells of this field, built if they are not there yet.
    void prepare(const FieldRequest& field) {
        if (cells_for_.kernel == field.kernel && cells_for_.threshold == field.threshold && !cells_stale_) return;
        with_tracer(field, [&](const auto& tracer) {
            using Tracer = std::decay_t<decltype(tracer)>;
            using Tree = std::decay_t<decltype(tracer.tree)>;
            using Lanes = typename Exec::Lanes;
            constexpr std::size_t block = Lanes::width * block_stride(Tracer::PerParticle);
            CellGrid* grid = grid_.reserve(1);
            std::uint32_t* bricks = bricks_.reserve(kMaxBricks);
            for (bool enough = false; !enough;) {
                exec_->for_each(1, PlanCells<Tree>{tracer.tree, grid});
                exec_->clear(bricks, kMaxBricks * sizeof *bricks);
                exec_->for_each(octree().max_nodes(), MarkBricks<Tree>{tracer.tree, octree().max_nodes(), grid, bricks});
                exec_->for_each_tile_of(&grid->n_bricks,
                                        BuildCells<Lanes, Tree, std::decay_t<decltype(tracer.kernel)>, Tracer::PerParticle>{
                                            tracer.tree, octree().particles(), tracer.kernel, tracer.tau, grid, bricks, lists_.data(),
                                            blocks_.data(), std::uint32_t(lists_.capacity() / kBrickCells), std::uint32_t(blocks_.capacity() / block)});
                CellGrid g;
                exec_->download(&g, grid, sizeof g);
                enough = std::size_t(g.n_lists) * kBrickCells <= lists_.capacity() && std::size_t(g.n_blocks) * block <= blocks_.capacity();
                if (enough) break;
                lists_.reserve(std::size_t(g.n_lists + g.n_lists / 4 + 16) * kBrickCells);
                blocks_.reserve(std::size_t(g.n_blocks + g.n_blocks / 4 + 64) * block);
            }
        });
        cells_for_ = field;
        cells_stale_ = false;
    }

    /// fn(tracer) with the tracer that fits the tree, the kernel and the particles.
    template <class Fn>
    void with_tracer(const FieldRequest& field, const Fn& fn) {
        with_kinds(field, [&]<class Tree, class Kernel, bool PerParticle>(const Tree& tree, const Kernel& kernel, std::bool_constant<PerParticle>) {
            const SortedParticles& p = octree().particles();
            const float tau = PerParticle ? field.threshold : field.threshold / p.weight.uniform;
            fn(CellTracer<typename Exec::Lanes, Tree, Kernel, PerParticle>{
                tree, p, kernel, tau, {grid_.data(), bricks_.data(), lists_.data(), blocks_.data()}});
        });
    }
    template <class Fn>
    static void with_clips(const Clips& clips, const Fn& fn) {
        if (clips.n) fn(std::true_type{});
        else fn(std::false_type{});
    }
    template <class Fn>
    void with_kinds(const FieldRequest& field, const Fn& fn) {
        const SortedParticles& p = octree().particles();
        const bool alike = !p.support.data && !p.weight.data && p.weight.uniform > 0.0f;
        if (octree().params().dense) fn(octree().dense(), AnyKernel{field.kernel}, std::true_type{});
        else if (p.stretch) fn(octree().sparse(), StretchedKernel{{field.kernel}, p.stretch, octree().sparse().header}, std::true_type{});
        else if (alike && field.kernel == KernelName::murakami) fn(octree().sparse(), Murakami{}, std::false_type{});
        else fn(octree().sparse(), AnyKernel{field.kernel}, std::true_type{});
    }

    /// The array in this backend's memory: itself, or a copy in `room`.
    const float* bring(Buffer<float, Exec>& room, const FloatArray& array, std::size_t n) { return bring(*exec_, room, array, n); }
    const float* bring(Exec& exec, Buffer<float, Exec>& room, const FloatArray& array, std::size_t n) {
        if (!array.data || n == 0) return array.data;
        if (array.on_device == Exec::on_device) return array.data;
        float* to = room.reserve(n);
        exec.upload(to, array.data, n * sizeof(float));
        return to;
    }

    template <class Fn>
    void with_tree(const Fn& fn) {
        if (octree().params().dense) fn(octree().dense());
        else fn(octree().sparse());
    }

    void trace(const FieldRequest& field, const RaySource& rays, Hits hits) {
        std::uint32_t* undecided = undecided_.reserve(rays.n + 1);
        hits.undecided = {undecided, undecided + 1};
        trace_with(*exec_, field, rays, hits);
    }
    void trace_with(Exec& exec, const FieldRequest& field, const RaySource& rays, const Hits& hits) {
        if (thesis_)
            return ThesisTracer<Exec>{exec, octree(), near_, work_, *thesis_, field, attributes_.color, attributes_.one_color}(rays, hits);
        with_kinds(field, [&]<class Tree, class Kernel, bool PerParticle>(const Tree& tree, const Kernel& kernel, std::bool_constant<PerParticle>) {
            const SortedParticles& p = octree().particles();
            const float tau = PerParticle ? field.threshold : field.threshold / p.weight.uniform;
            const TraceTiles<Tree, Kernel, PerParticle> tiles{tree, p, kernel, tau, attributes_.color, attributes_.one_color, rays, hits};
            exec.clear(hits.undecided.n, sizeof *hits.undecided.n);
            exec.for_each_tile(tiles.template n_tiles<typename Exec::Group>(), tiles);
            const ResolveRays<Tree, PerParticle> rest{tree, p, {field.kernel}, field.threshold, attributes_.color, attributes_.one_color, rays, hits};
            exec.for_each_tile_of(hits.undecided.n, rest);
        });
    }

    std::uint64_t hash_device(const void* data, std::size_t bytes, std::uint64_t h = 1469598103934665603ull) {
        std::vector<char> host(bytes);
        exec_->download(host.data(), data, bytes);
        return hash_bytes(host.data(), bytes, h);
    }
    void check_cancelled() {
        if (exec_->cancelled()) {
            exec_->reset_cancelled();
            throw Cancelled{};
        }
    }

    Octree<Exec>& octree() const { return trees_.now(); }

    std::shared_ptr<Exec> exec_;
    FrameTrees<Exec> trees_;
    Buffer<float, Exec> positions_, support_, weight_, stretch_, color_, points_, more_points_, values_, results_;
    Buffer<std::uint64_t, Exec> offsets_;
    Buffer<std::uint32_t, Exec> indices_, count_;
    Buffer<float, Exec> hits_;
    Attributes attributes_{};
    Buffer<float, Exec> reflection_, refraction_, sky_, spare_;
    std::uint64_t sky_id_ = 0;
    // Cells for secondary rays, made when first needed.
    Buffer<CellGrid, Exec> grid_;
    Buffer<std::uint32_t, Exec> bricks_;
    Buffer<CellList, Exec> lists_;
    Buffer<float, Exec> blocks_;
    FieldRequest cells_for_{};
    bool cells_stale_ = true;
    std::deque<Waves<Exec>> waves_;  ///< one a stream
    std::deque<Buffer<Clip, Exec>> clips_;
    std::vector<std::shared_ptr<FrameOf>> pool_;
    std::optional<ThesisRequest> thesis_;
    Buffer<std::uint8_t, Exec> near_;
    Buffer<ThesisWork, Exec> work_;
    Buffer<std::uint32_t, Exec> undecided_;
};

}  // namespace globule::core
