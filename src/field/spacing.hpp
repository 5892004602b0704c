// Spacing of a fluid's particles, the cube root of a particle's volume, in bodies and in sheets (docs/design/surface.md).
#pragma once
#include "field/surface_kernels.hpp"

namespace globule::core {

/// Matter that fills a slab through the middle of the neighbours' ball, h: half its thickness over the radius.
namespace slab {
/// Weighted volume over that of the ball, weights 1 - (r / radius)^4.
GB_FN float filled(float h) {
    const float h2 = h * h;
    return h * (1.75f - 0.875f * h2 + 0.125f * h2 * h2 * h2);
}
/// Weighted variance across the slab, over that in a full ball.
GB_FN float variance(float h) {
    const float h2 = h * h;
    return h2 * (15.0f - 13.5f * h2 + 2.5f * h2 * h2 * h2) / (7.0f * (1.0f - 0.5f * h2 + h2 * h2 * h2 / 14.0f));
}
GB_FN float half_thickness(float variance_across) {
    float lo = 0.0f, hi = 1.0f;
    for (int i = 0; i < 20; ++i) {
        const float h = 0.5f * (lo + hi);
        (variance(h) < variance_across ? lo : hi) = h;
    }
    return 0.5f * (lo + hi);
}
}  // namespace slab

/// Spacing around sampled particles, from what their neighbours within surface::kRadius guesses add up to. Where the matter is
/// thin, it is taken for a slab as thick as its particles' variance across it tells.
template <class Tree>
struct FluidSpacing {
    Tree tree;
    SortedParticles particles;
    std::size_t begin, stride;
    float guess;
    float* out;
    GB_FN void operator()(std::size_t s) const {
        const float3 p = particles.position(begin + s * stride);
        const float r = surface::kRadius * guess;
        surface::Moments<float> moments;
        for_each_touching(tree, {p.x - r, p.y - r, p.z - r}, {p.x + r, p.y + r, p.z + r}, [&](std::uint32_t j) {
            const float3 v = (particles.position(j) - p) * (1.0f / r);
            const float d2 = dot(v, v);
            if (d2 < 1.0f) moments.add(1.0f - d2 * d2, Vec3<float>{v.x, v.y, v.z});
        });
        const Eigen3<float> e = eigen(moments.covariance());
        const float between = slab::half_thickness(min(min(e.value[0], e.value[1]), e.value[2])), filled = moments.filled();
        // Layers of points reach half a spacing further than the points: t^2 = 12 variance + spacing^2.
        float spacing = guess;
        for (int i = 0; i < 5; ++i) {
            const float beyond = 0.5f * spacing / r, h = min(sqrt(between * between + beyond * beyond), 1.0f);
            spacing = guess * pow(slab::filled(h) / filled, 1.0f / 3.0f);
        }
        out[s] = spacing;
    }
};

}  // namespace globule::core
