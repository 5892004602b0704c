// The one implementation of Scene, over any Exec.
#pragma once
#include <algorithm>
#include <cmath>

#include "backend.hpp"
#include "globule/octree/build.hpp"
#include "globule/octree/query.hpp"
#include "globule/trace/resolve.hpp"
#include "thesis.hpp"

namespace globule {

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
        : exec_(std::make_shared<Exec>(std::forward<Args>(args)...)), tree_(*exec_), positions_(*exec_),
          support_(*exec_), weight_(*exec_), color_(*exec_), points_(*exec_), more_points_(*exec_),
          values_(*exec_), results_(*exec_), offsets_(*exec_), indices_(*exec_), count_(*exec_),
          hits_(*exec_), near_(*exec_), work_(*exec_) {}

    void build(const SceneArrays& in, const TreeRequest& request) override {
        ParticleInput input;
        input.n = in.n;
        input.positions = bring(positions_, in.positions, 3 * in.n);
        input.support = {bring(support_, in.support, in.n), in.one_support};
        input.weight = {bring(weight_, in.weight, in.n), in.one_weight};
        color_data_ = bring(color_, in.color, 3 * in.n);
        one_color_ = in.one_color;
        TreeParams params{request.key_bits, request.depth, request.dense, request.fixed_space, request.lo, request.hi};
        exec_->mark(0);
        tree_.build(input, params);
        exec_->mark(1);
    }

    TreeFacts facts(bool with_hashes) override {
        TreeFacts f{};
        f.header = tree_.header();
        f.n_inside = tree_.size() - f.header.n_outside;
        f.n_nodes = tree_.params().dense ? tree_.n_dense_nodes() : f.header.n_nodes;
        std::uint32_t* count = count_.reserve(1);
        with_tree([&](auto tree) { exec_->reduce(f.n_nodes, CountLeaf<decltype(tree)>{tree}, Add{}, 0u, count); });
        std::uint32_t leaves;
        exec_->download(&leaves, count, sizeof leaves);
        f.n_leaves = leaves;
        f.bytes = tree_.bytes();
        f.build_seconds = exec_->elapsed(0, 1);
        if (with_hashes) {
            const std::size_t key_bytes = tree_.size() * tree_.params().key_bits / 8;
            f.key_hash = hash_device(tree_.keys(), key_bytes);
            f.key_hash = hash_device(tree_.particles().index, tree_.size() * 4, f.key_hash);
            if (tree_.params().dense) {
                f.node_hash = hash_device(tree_.dense_nodes(), f.n_nodes * sizeof(DenseNode));
            } else {
                const NodeArrays nodes = tree_.node_arrays();
                f.node_hash = hash_device(nodes.first, f.n_nodes * 4);
                f.node_hash = hash_device(nodes.meta, f.n_nodes * 4, f.node_hash);
                for (float* side : nodes.box) f.node_hash = hash_device(side, f.n_nodes * 4, f.node_hash);
            }
        }
        return f;
    }

    float spacing() override {
        const TreeHeader h = tree_.header();
        const std::size_t begin = h.n_outside, n_inside = tree_.size() - begin;
        if (n_inside == 0) return 0.0f;
        const std::size_t stride = most<std::size_t>(1, n_inside / 1024);
        const std::size_t samples = ceil_div<std::size_t>(n_inside, stride);
        float* out = results_.reserve(samples);
        with_tree([&](auto tree) {
            exec_->for_each(samples, LocalSpacing<decltype(tree)>{tree, tree_.particles(), begin, tree_.size(), stride, out});
        });
        std::vector<float> all(samples);
        exec_->download(all.data(), out, samples * sizeof(float));
        all.erase(std::remove_if(all.begin(), all.end(), [](float s) { return !(s > 0.0f); }), all.end());
        if (all.empty()) return 0.0f;
        std::nth_element(all.begin(), all.begin() + all.size() / 2, all.end());
        return all[all.size() / 2];
    }

    void sorted(std::uint64_t* keys, std::uint32_t* index) override {
        const std::size_t n = tree_.size();
        if (tree_.params().key_bits == 64) {
            exec_->download(keys, tree_.keys(), n * 8);
        } else {
            std::vector<std::uint32_t> narrow(n);
            exec_->download(narrow.data(), tree_.keys(), n * 4);
            std::copy(narrow.begin(), narrow.end(), keys);
        }
        exec_->download(index, tree_.particles().index, n * 4);
    }

    std::shared_ptr<Frame> render(const FieldRequest& field, const CameraRays& camera, const Shading& shading) override {
        const std::size_t n = std::size_t(camera.width) * camera.height;
        std::shared_ptr<FrameOf> frame = take_frame(n);
        frame->rays = {camera, nullptr, nullptr, n};
        frame->exec->mark(2);
        trace(field, frame->rays, frame->hits());
        frame->exec->for_each(n, Shade{frame->rays, frame->hits(), shading, frame->color_data(), frame->picture_data()});
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
            exec_->for_each(n, EvaluateField<decltype(tree)>{tree, tree_.particles(), {field.kernel}, p,
                                                            value ? out : nullptr, gradient ? out + n : nullptr});
        });
        if (value) exec_->download(value, out, n * sizeof(float));
        if (gradient) exec_->download(gradient, out + n, 3 * n * sizeof(float));
    }

    void blend(const FieldRequest& field, std::size_t n, FloatArray points, FloatArray values, int channels, float* result) override {
        const float* p = bring(points_, points, 3 * n);
        const float* v = bring(values_, values, tree_.size() * channels);
        float* out = results_.reserve(n * channels);
        with_tree([&](auto tree) {
            exec_->for_each(n, Blend<decltype(tree)>{tree, tree_.particles(), {field.kernel}, p, v, channels, out});
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
            FindNeighbors<decltype(tree)> find{tree, tree_.particles(), p, radius, offsets, nullptr};
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

    void thesis_work(std::size_t n, ThesisWork* out) override { exec_->download(out, work_.data(), n * sizeof(ThesisWork)); }

private:
    /// A frame's images live in one block that goes back to the scene's pool when the frame dies.
    struct FrameOf final : Frame {
        std::shared_ptr<Exec> exec;
        Buffer<float, Exec> block;
        RaySource rays;
        explicit FrameOf(std::shared_ptr<Exec> e) : exec(std::move(e)), block(*exec) {}

        Hits hits() const { return {block.data(), block.data() + rays.n, block.data() + 4 * rays.n}; }
        float* color_data() const { return block.data() + 7 * rays.n; }
        std::uint8_t* picture_data() const { return reinterpret_cast<std::uint8_t*>(block.data() + 10 * rays.n); }
        void depth(float* out) override { exec->download(out, hits().t, rays.n * sizeof(float)); }
        void normal(float* out) override { exec->download(out, hits().normal, 3 * rays.n * sizeof(float)); }
        void albedo(float* out) override { exec->download(out, hits().albedo, 3 * rays.n * sizeof(float)); }
        void color(float* out) override { exec->download(out, color_data(), 3 * rays.n * sizeof(float)); }
        void picture(std::uint8_t* out) override { exec->download(out, picture_data(), 3 * rays.n); }
        void position(float* out) override {
            Buffer<float, Exec> room(*exec);
            float* p = room.reserve(3 * rays.n);
            exec->for_each(rays.n, HitPositions{rays, hits().t, p});
            exec->download(out, p, 3 * rays.n * sizeof(float));
        }
        double trace_seconds() override { return exec->elapsed(2, 3); }
    };

    std::shared_ptr<FrameOf> take_frame(std::size_t n) {
        std::shared_ptr<FrameOf> frame;
        for (auto& f : pool_)
            if (f.use_count() == 1) frame = f;
        if (!frame) pool_.push_back(frame = std::make_shared<FrameOf>(exec_));
        frame->block.reserve(11 * n);
        return frame;
    }

    /// The array in this backend's memory: itself, or a copy in `room`.
    const float* bring(Buffer<float, Exec>& room, const FloatArray& array, std::size_t n) {
        if (!array.data || n == 0) return array.data;
        if (array.on_device == Exec::on_device) return array.data;
        float* to = room.reserve(n);
        exec_->upload(to, array.data, n * sizeof(float));
        return to;
    }

    template <class Fn>
    void with_tree(const Fn& fn) {
        if (tree_.params().dense) fn(tree_.dense());
        else fn(tree_.sparse());
    }

    void trace(const FieldRequest& field, const RaySource& rays, const Hits& hits) {
        if (thesis_) return ThesisTracer<Exec>{*exec_, tree_, near_, work_, *thesis_, field, color_data_, one_color_}(rays, hits);
        const SortedParticles& p = tree_.particles();
        const bool alike = !p.support.data && !p.weight.data && p.weight.uniform > 0.0f;
        if (tree_.params().dense) run<DenseTree, AnyKernel, true>(tree_.dense(), {field.kernel}, field, rays, hits);
        else if (alike && field.kernel == KernelName::murakami) run<SparseTree, Murakami, false>(tree_.sparse(), {}, field, rays, hits);
        else run<SparseTree, AnyKernel, true>(tree_.sparse(), {field.kernel}, field, rays, hits);
    }
    template <class Tree, class Kernel, bool PerParticle>
    void run(const Tree& tree, const Kernel& kernel, const FieldRequest& field, const RaySource& rays, const Hits& hits) {
        const SortedParticles& p = tree_.particles();
        const float tau = PerParticle ? field.threshold : field.threshold / p.weight.uniform;
        const TraceTiles<Tree, Kernel, PerParticle> tiles{tree, p, kernel, tau, color_data_, one_color_, rays, hits};
        exec_->for_each_tile(tiles.template n_tiles<typename Exec::Group>(), tiles);
        const ResolveRays<Tree, PerParticle> rest{tree, p, {field.kernel}, field.threshold, color_data_, one_color_, rays, hits};
        exec_->for_each_tile(rest.template n_tiles<typename Exec::Group>(), rest);
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

    std::shared_ptr<Exec> exec_;
    Octree<Exec> tree_;
    Buffer<float, Exec> positions_, support_, weight_, color_, points_, more_points_, values_, results_;
    Buffer<std::uint64_t, Exec> offsets_;
    Buffer<std::uint32_t, Exec> indices_, count_;
    Buffer<float, Exec> hits_;
    const float* color_data_ = nullptr;
    float3 one_color_{0, 0, 0};
    std::vector<std::shared_ptr<FrameOf>> pool_;
    std::optional<ThesisRequest> thesis_;
    Buffer<std::uint8_t, Exec> near_;
    Buffer<ThesisWork, Exec> work_;
};

}  // namespace globule
