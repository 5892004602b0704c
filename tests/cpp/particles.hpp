// Particles and their octree, for tests that run kernels without any library.
#pragma once
#include <vector>

#include "exec/cpu.hpp"
#include "octree/build.hpp"
#include "octree/query.hpp"
#include "random.hpp"

inline std::vector<float3> cloud(std::size_t n, std::uint64_t seed = 1, double lo = 0.0, double hi = 1.0) {
    Random random(seed);
    std::vector<float3> points(n);
    for (float3& p : points) p = random.point(lo, hi);
    return points;
}
/// n^3 points of a cubic lattice.
inline std::vector<float3> lattice(int n, float spacing) {
    std::vector<float3> points;
    for (int z = 0; z < n; ++z)
        for (int y = 0; y < n; ++y)
            for (int x = 0; x < n; ++x) points.push_back({x * spacing, y * spacing, z * spacing});
    return points;
}
inline double distance(const float3& a, const float3& b) {
    return std::hypot(double(a.x) - b.x, double(a.y) - b.y, double(a.z) - b.z);
}

/// Points and the octree of a processor around them.
struct Built {
    std::vector<float3> points;
    std::vector<float> support, weight, stretch;  ///< empty: 0.1, 1, balls
    core::Cpu cpu{core::kHost, 2, nullptr};
    core::Octree<core::Cpu> octree{cpu};

    explicit Built(std::vector<float3> p, core::TreeParams params = {}, std::vector<float> supports = {},
        std::vector<float> weights = {}, std::vector<float> matrices = {}, int threads = 2)
        : points(std::move(p)),
          support(std::move(supports)),
          weight(std::move(weights)),
          stretch(std::move(matrices)),
          cpu(core::kHost, threads, nullptr) {
        core::ParticleInput in;
        in.n = points.size();
        in.positions = reinterpret_cast<const float*>(points.data());  // there may be none
        in.support = {support.empty() ? nullptr : support.data(), 0.1f};
        in.weight = {weight.empty() ? nullptr : weight.data(), 1.0f};
        in.stretch = stretch.empty() ? nullptr : stretch.data();
        octree.build(in, params);
    }
    core::Tree tree() { return octree.view(); }
    core::SortedParticles sorted() const { return octree.particles(); }
    std::vector<core::Node> nodes() {
        std::vector<core::Node> all;
        for (std::uint32_t i = 0; i < tree().header->n_nodes; ++i) all.push_back(tree().node(i));
        return all;
    }
};
