// The octree of the present particles, and what they look like.  On a device the next frame's is built beside it, on a
// stream of its own, while the present one is still being traced: a build is many short steps that leave most of the
// device idle.  Frames then take turns on two streams, so that one begins while another's last rays are on their way; a
// build waits for the frame that reads its tree, so there are three.
#pragma once
#include <memory>
#include <vector>

#include "backends/backend.hpp"
#include "field/surface_kernels.hpp"
#include "octree/build.hpp"
#include "pipeline/arrays.hpp"
#include "trace/looks.hpp"

namespace globule::core {

/// One build: sorted particles, tree, and their attributes in the caller's order.
template <class Exec> struct Built {
    Octree<Exec> octree;
    Attributes attributes{};
    Buffer<float, Exec> color, reflection, refraction;

    explicit Built(Exec& exec) : octree(exec), color(exec), reflection(exec), refraction(exec) {}
};

template <class Exec> class Builder {
public:
    explicit Builder(std::shared_ptr<Exec> exec)
        : lanes_{exec},
          builder_(exec),
          positions_(*exec),
          support_(*exec),
          weight_(*exec),
          stretch_(*exec),
          counts_(*exec) {
        built_[0] = std::make_unique<Built<Exec>>(*exec);
    }

    bool is_whole() const { return whole_; }
    Built<Exec>& now() const { return *built_[now_]; }

    /// The stream for the next frame.
    Exec& next_lane() { return *lanes_[turn_++ % lanes_.size()]; }

    void build(const SceneArrays& in, const TreeRequest& request) {
        const typename Exec::Stage stage("build");
        whole_ = false;
        if (n_builds_ == 1) build_beside();
        const bool beside = builder_ != lanes_[0];
        if (beside) {
            for (auto& lane : lanes_) lane->mark(kRead + now_);  // what reads the present tree has been asked for
            now_ = (now_ + 1) % kTrees;
            if (n_builds_ <= kTrees)
                built_[now_] = std::make_unique<Built<Exec>>(*builder_);  // the first one was on another stream
            for (auto& lane : lanes_) builder_->follow(*lane, kRead + now_);
        }
        Exec& exec = *builder_;
        ParticleInput input;
        input.n = in.n;
        input.positions = bring(exec, positions_, in.positions, 3 * in.n);
        const bool smooth = in.spacing > 0.0f;
        input.support = smooth ? Attribute{nullptr, surface::kAxis * in.spacing}
                               : Attribute{bring(exec, support_, in.support, in.n), in.one_support};
        input.weight = {bring(exec, weight_, in.weight, in.n), in.one_weight};
        input.stretch = bring(exec, stretch_, in.stretch, 6 * in.n);
        input.most_stretch = in.most_stretch;
        input.given_up = in.given_up;
        Built<Exec>& b = now();
        b.attributes.color = bring(exec, b.color, in.color, 3 * in.n);
        b.attributes.one_color = in.one_color;
        b.attributes.reflection = {bring(exec, b.reflection, in.reflection, in.n), in.one_reflection};
        b.attributes.refraction = {bring(exec, b.refraction, in.refraction, in.n), in.one_refraction};
        exec.mark(0);
        b.octree.build(input, {request.key_bits, request.depth, request.dense, request.fixed_space, request.lo,
                                  request.hi, request.typical_support, request.most_weight});
        if (smooth && in.n) make_smooth(exec, b.octree, in.spacing);
        exec.mark(1);
        let_callers_go_on(exec, in.positions, in.support, in.weight, in.stretch);
        if (beside)
            for (auto& lane : lanes_) lane->follow(exec);
        const bool measures = !smooth && !in.support.data && in.one_support == 0.0f;  // another build follows at once
        if (!measures) ++n_builds_;
        whole_ = true;
    }
    void synchronize() {
        for (auto& lane : lanes_) lane->synchronize();
    }
    std::uint64_t bytes() const {
        std::uint64_t sum = 0;
        for (const auto& b : built_) sum += b ? b->octree.bytes() : 0;
        return sum;
    }
    /// Waits for the last build; 0 where somebody else built the tree.
    double build_seconds() { return shared_ && now_ == 0 ? 0.0 : builder_->elapsed(0, 1); }

    /// Somebody else builds the tree, on the scene's own stream.
    Octree<Exec>& share() {
        shared_ = whole_ = true;
        return now().octree;
    }
    /// Instead of the shared tree, one smooth surface around particles of one spacing is drawn, or their balls; those
    /// at NaN are left out.
    void draw_own(std::size_t n, const float* positions, float spacing, bool smooth) {
        const typename Exec::Stage stage("build");
        Exec& exec = *lanes_[0];
        whole_ = false;
        if (!built_[1]) built_[1] = std::make_unique<Built<Exec>>(exec);
        now_ = 1;
        exec.mark(0);
        ParticleInput input;
        input.n = n;
        input.positions = positions;
        input.support = {nullptr, (smooth ? surface::kAxis : kBall) * spacing};
        input.weight = {nullptr, 1.0f};
        now().octree.build(input, {});
        if (n && smooth) make_smooth(exec, now().octree, spacing);
        whole_ = true;
        exec.mark(1);
    }
    void draw_shared() { now_ = 0; }

private:
    /// Ellipsoids and weights from the particles' neighbors, in place of their supports.
    void make_smooth(Exec& exec, Octree<Exec>& octree, float spacing) {
        const typename Exec::Stage stage("surface kernels");
        const auto shapes = octree.shapes();
        const Tree tree = octree.view();
        const std::size_t n = octree.size();
        FullCells full{tree.header, octree.keys(), octree.params().key_bits == 64, n, spacing, 0, nullptr, nullptr};
        if (n >= kSome) {
            while (full.most_level < FullCells::kMostLevel && std::size_t(1) << 3 * full.most_level <= n)
                ++full.most_level;
            const std::size_t n_cells = std::size_t(1) << 3 * full.most_level;
            full.counts = counts_.reserve(2 * n_cells);
            full.blocks = full.counts + n_cells;
            exec.clear(full.counts, n_cells);
            exec.for_each(n, CountCells{full});
            exec.for_each(std::size_t(1) << 2 * full.most_level, FindFullBlocks{full});
        }
        const FindSurfaceKernels find{
            tree, octree.particles(), n, spacing, full, shapes.support, shapes.weight, shapes.stretch, shapes.shortest};
        exec.for_each_tile(ceil_div<std::size_t>(n, Exec::Group::width), find);
        octree.reshape(shapes, surface::kThin * spacing, surface::kMostStretch, surface::kFace);
    }

    /// From the second build on there are more trees, where memory allows: a scene that is built once needs but one.
    void build_beside() {
        if constexpr (Exec::on_device) {
            Exec& first = *lanes_[0];
            if (shared_ || builder_ != lanes_[0] || first.free_bytes() / 8 <= now().octree.bytes()) return;
            std::shared_ptr<Exec> builder = first.sibling(true), lane = first.sibling();
            builder->follow(first);
            lane->follow(first);
            lanes_.push_back(std::move(lane));
            builder_ = std::move(builder);
        }
    }

    static constexpr float kBall = 2.0f;           ///< support, spacings
    static constexpr std::size_t kSome = 1 << 16;  ///< particles of a smooth surface, many of them deep inside
    static constexpr int kTrees = 3;
    static constexpr int kRead = 4;  ///< and the marks behind, one a tree; marks 0 and 1: build

    std::vector<std::shared_ptr<Exec>> lanes_;  ///< the first is the scene's own
    std::shared_ptr<Exec> builder_;
    std::unique_ptr<Built<Exec>> built_[kTrees];
    Buffer<float, Exec> positions_, support_, weight_,
        stretch_;                        ///< copies of what lies elsewhere, in use until the build is done
    Buffer<std::uint8_t, Exec> counts_;  ///< of FullCells
    std::size_t n_builds_ = 0;
    unsigned turn_ = 0;
    int now_ = 0;
    bool whole_ = false, shared_ = false;
};

}  // namespace globule::core
