// Spacing of a fluid's particles, the cube root of a particle's volume, in bodies and in sheets
// (docs/design/surface.md).
#pragma once
#include "field/surface_kernels.hpp"

namespace globule::core {

/// Matter that fills a slab of the neighbors' ball, with weights (1 - (r / radius)^2)^2; lengths over the radius, z
/// from the ball's middle. A plane of matter at z weighs 35/32 (1 - z^2)^3 of the ball.
namespace slab {
/// Weighted volume between the middle and z, over half of the ball's.
GB_FN float filled(float z) {
    const float z2 = z * z;
    return z * (35.0f / 16.0f) * (1.0f - z2 * (1.0f - z2 * (0.6f - z2 * (1.0f / 7.0f))));
}
/// What planes of points, each in the middle of its share of the slab, weigh more than the slab: the term of Euler and
/// Maclaurin at z, for planes a distance of 1 apart.
GB_FN float planes(float z) {
    const float rest = 1.0f - z * z;
    return (35.0f / 64.0f) * z * rest * rest;
}
/// Weighted variance across a slab through the middle, over that in a full ball. h: half its thickness.
GB_FN float variance(float h) {
    const float h2 = h * h;
    return h2 * (3.0f - h2 * (5.4f - h2 * (27.0f / 7.0f - h2))) /
           (1.0f - h2 * (1.0f - h2 * (0.6f - h2 * (1.0f / 7.0f))));
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

/// Spacing around sampled particles, from what their neighbors within surface::kRadius guesses add up to. Where the
/// matter is thin, it is taken for a slab as thick as its particles' variance across it tells, off the middle by their
/// mean.
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
            const float rest = 1.0f - dot(v, v);
            if (rest > 0.0f) moments.add(rest * rest, Vec3<float>{v.x, v.y, v.z});
        });
        // Over those of a ball that is full of points, one in each cube of a guess.
        constexpr float kSum =
            1.0f / (32.0f * 3.14159265f / 105.0f * surface::kRadius * surface::kRadius * surface::kRadius);
        constexpr float kVariance = 9.0f * 7.0f / 45.0f;  // 1/9 with these weights, 7/45 with those of the kernels
        const Eigen3<float> e = eigen(moments.covariance());
        int thin = 0;
        for (int k = 1; k < 3; ++k)
            if (e.value[k] < e.value[thin]) thin = k;
        const float between = slab::half_thickness(kVariance * e.value[thin]), filled = kSum * moments.sum;
        const float off = abs(dot(moments.first, e.axis[thin])) / moments.sum;
        // Layers of points reach half a spacing further than the points: t^2 = 12 variance + spacing^2.
        float spacing = guess;
        for (int i = 0; i < 5; ++i) {
            const float apart = spacing / r, h = min(sqrt(between * between + 0.25f * apart * apart), 1.0f);
            const float a = min(off, 1.0f - h) - h, b = min(off, 1.0f - h) + h;
            const float held =
                0.5f * (slab::filled(b) - slab::filled(a)) + 0.5f * apart * apart * (slab::planes(b) - slab::planes(a));
            spacing = guess * pow(held / filled, 1.0f / 3.0f);
        }
        out[s] = spacing;
    }
};

}  // namespace globule::core
