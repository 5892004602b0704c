// Questions at points: the field, attributes, neighbors, the particles' spacing; and facts about the octree itself.
#pragma once
#include <algorithm>
#include <vector>

#include "field/spacing.hpp"
#include "pipeline/trace.hpp"

namespace globule::core {

inline std::uint64_t hash_bytes(const void* data, std::size_t n, std::uint64_t h = 1469598103934665603ull) {
    const unsigned char* p = static_cast<const unsigned char*>(data);  // FNV-1a, 64 bit
    for (std::size_t i = 0; i < n; ++i) h = (h ^ p[i]) * 1099511628211ull;
    return h;
}

struct CountLeaf {
    Tree tree;
    GB_FN std::uint32_t operator()(std::size_t i) const { return Node::is_leaf(tree.node(std::uint32_t(i)).meta); }
};
struct Add {
    GB_FN std::uint32_t operator()(std::uint32_t a, std::uint32_t b) const { return a + b; }
};

template <class Exec> class Questions {
public:
    explicit Questions(Exec& exec)
        : exec_(exec),
          points_(exec),
          more_points_(exec),
          values_(exec),
          results_(exec),
          offsets_(exec),
          indices_(exec),
          count_(exec) {}

    TreeFacts facts(Octree<Exec>& octree, bool with_hashes) {
        TreeFacts f{};
        const Tree tree = octree.view();
        f.header = octree.header();
        f.n_inside = octree.size() - f.header.n_outside;
        f.n_nodes = octree.params().dense ? octree.n_dense_nodes() : f.header.n_nodes;
        std::uint32_t* count = count_.reserve(1);
        exec_.reduce(f.header.n_nodes, CountLeaf{tree}, Add{}, 0u, count);
        std::uint32_t leaves;
        exec_.download(&leaves, count, sizeof leaves);
        f.n_leaves = leaves;
        f.bytes = octree.bytes();
        if (with_hashes) hash(octree, f);
        return f;
    }

    /// Median distance to the nearest neighbors, around up to 1024 particles; 0 where there are too few.
    float spacing(Octree<Exec>& octree) {
        return share_of_samples(octree, 0.5, [&](std::size_t begin, std::size_t stride, float* out) {
            return LocalSpacing{octree.view(), octree.particles(), begin, octree.size(), stride, out};
        });
    }

    /// Cube root of a particle's volume, if they are those of one fluid, which is nowhere denser than at rest, but for
    /// noise.
    float fluid_spacing(Octree<Exec>& octree) {
        float guess = spacing(octree);
        for (int i = 0; i < 3 && guess > 0.0f; ++i)
            guess = share_of_samples(octree, 0.15, [&](std::size_t begin, std::size_t stride, float* out) {
                return FluidSpacing{octree.view(), octree.particles(), begin, stride, guess, out};
            });
        return guess;
    }

    void sorted(Octree<Exec>& octree, std::uint64_t* keys, std::uint32_t* index) {
        const std::size_t n = octree.size();
        if (octree.params().key_bits == 64) {
            exec_.download(keys, octree.keys(), n * 8);
        } else {
            std::vector<std::uint32_t> narrow(n);
            exec_.download(narrow.data(), octree.keys(), n * 4);
            std::copy(narrow.begin(), narrow.end(), keys);
        }
        exec_.download(index, octree.particles().index, n * 4);
    }

    void intersect(const Traced<Exec>& scene, const FieldRequest& field, std::size_t n, const FloatArray& origins,
        const FloatArray& directions, float* t, float* normal, float* albedo) {
        const RaySource rays{
            {}, bring(exec_, points_, origins, 3 * n), bring(exec_, more_points_, directions, 3 * n), n};
        float* out = results_.reserve(7 * n);
        std::uint32_t* undecided = indices_.reserve(n + 1);
        const Hits hits{out, out + n, out + 4 * n, {undecided, undecided + 1}};
        scene.trace(exec_, field, rays, hits);
        scene.resolve(exec_, field, rays, hits);
        exec_.download(t, hits.t, n * sizeof(float));
        exec_.download(normal, hits.normal, 3 * n * sizeof(float));
        exec_.download(albedo, hits.albedo, 3 * n * sizeof(float));
    }

    void evaluate(Octree<Exec>& octree, KernelName kernel, std::size_t n, const FloatArray& points, float* value,
        float* gradient) {
        const float* p = bring(exec_, points_, points, 3 * n);
        float* out = results_.reserve(4 * n);
        const Attribute& support = octree.particles().support;
        const std::size_t first = octree.header().n_outside;
        float near = 2.0f * support.uniform;
        if (support.data && first < octree.size()) {
            exec_.download(&near, support.data + first, sizeof near);
            near *= 2.0f;
        }
        exec_.for_each_packet(n, EvaluateField{octree.view(), octree.particles(), {kernel}, n, near, p,
                                     value ? out : nullptr, gradient ? out + n : nullptr});
        if (value) exec_.download(value, out, n * sizeof(float));
        if (gradient) exec_.download(gradient, out + n, 3 * n * sizeof(float));
    }

    void blend(Octree<Exec>& octree, KernelName kernel, std::size_t n, const FloatArray& points,
        const FloatArray& values, int channels, float* result) {
        const float* p = bring(exec_, points_, points, 3 * n);
        const float* v = bring(exec_, values_, values, octree.size() * channels);
        float* out = results_.reserve(n * channels);
        exec_.for_each(n, Blend{octree.view(), octree.particles(), {kernel}, p, v, channels, out});
        exec_.download(result, out, n * channels * sizeof(float));
    }

    void integrate(Octree<Exec>& octree, KernelName kernel, std::size_t n, const FloatArray& origins,
        const FloatArray& directions, const FloatArray& values, int channels, float* result) {
        const float *o = bring(exec_, points_, origins, 3 * n), *d = bring(exec_, more_points_, directions, 3 * n);
        const float* v = bring(exec_, values_, values, octree.size() * channels);
        float* out = results_.reserve(n * channels);
        for (int first = 0; first < channels; first += IntegrateLines::most_channels)
            exec_.for_each(n, IntegrateLines{octree.view(), octree.particles(), {kernel}, o, d, v, channels, first,
                                  min(channels - first, IntegrateLines::most_channels), out});
        exec_.download(result, out, n * channels * sizeof(float));
    }

    Neighbors neighbors(Octree<Exec>& octree, std::size_t n, const FloatArray& points, float radius) {
        const float* p = bring(exec_, points_, points, 3 * n);
        std::uint64_t* offsets = offsets_.reserve(n + 1);
        exec_.clear(offsets, (n + 1) * sizeof(std::uint64_t));
        Neighbors out;
        out.offsets.resize(n + 1);
        FindNeighbors find{octree.view(), octree.particles(), p, radius, offsets, nullptr};
        exec_.for_each(n, find);
        exec_.exclusive_scan(n + 1, offsets);
        exec_.download(out.offsets.data(), offsets, (n + 1) * sizeof(std::uint64_t));
        out.indices.resize(out.offsets[n]);
        find.indices = indices_.reserve(out.indices.size());
        exec_.for_each(n, find);
        exec_.download(out.indices.data(), indices_.data(), out.indices.size() * sizeof(std::uint32_t));
        return out;
    }

private:
    /// Of what up to 1024 particles answer, the value that a share of them is below; 0 where nobody has an answer.
    template <class Make> float share_of_samples(Octree<Exec>& octree, double share, const Make& make) {
        const std::size_t begin = octree.header().n_outside, n_inside = octree.size() - begin;
        if (n_inside == 0) return 0.0f;
        const std::size_t stride = max<std::size_t>(1, n_inside / 1024);
        const std::size_t samples = ceil_div<std::size_t>(n_inside, stride);
        float* out = results_.reserve(samples);
        exec_.for_each(samples, make(begin, stride, out));
        std::vector<float> all(samples);
        exec_.download(all.data(), out, samples * sizeof(float));
        all.erase(std::remove_if(all.begin(), all.end(), [](float s) { return !(s > 0.0f); }), all.end());
        if (all.empty()) return 0.0f;
        const std::size_t place = std::size_t(share * double(all.size()));
        std::nth_element(all.begin(), all.begin() + place, all.end());
        return all[place];
    }
    void hash(Octree<Exec>& octree, TreeFacts& f) {
        f.key_hash = hash_device(octree.keys(), octree.size() * octree.params().key_bits / 8);
        f.key_hash = hash_device(octree.particles().index, octree.size() * 4, f.key_hash);
        if (octree.params().dense) {
            f.node_hash = hash_device(octree.dense_nodes(), f.n_nodes * sizeof(DenseNode));
            return;
        }
        const NodeArrays nodes = octree.node_arrays();
        f.node_hash = hash_device(nodes.first, f.n_nodes * 4);
        f.node_hash = hash_device(nodes.meta, f.n_nodes * 4, f.node_hash);
        for (float* side : nodes.box) f.node_hash = hash_device(side, f.n_nodes * 4, f.node_hash);
    }
    std::uint64_t hash_device(const void* data, std::size_t bytes, std::uint64_t h = 1469598103934665603ull) {
        std::vector<char> host(bytes);
        exec_.download(host.data(), data, bytes);
        return hash_bytes(host.data(), bytes, h);
    }

    Exec& exec_;
    Buffer<float, Exec> points_, more_points_, values_, results_;
    Buffer<std::uint64_t, Exec> offsets_;
    Buffer<std::uint32_t, Exec> indices_, count_;
};

}  // namespace globule::core
