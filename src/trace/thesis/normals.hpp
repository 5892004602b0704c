// What a hit looks like: gradient normal (5.2, corrected) or the averaged centers' (Fig. 5.8a), and the
// blended color (§6.0.2).
#pragma once
#include "field/influence.hpp"
#include "trace/thesis/candidates.hpp"

namespace globule::core::thesis {

struct Look { float3 normal, albedo; };

template <class Kernel>
GB_FN Look look(const Candidates& candidates, const Kernel& kernel, const float* color, const float3& one_color,
    bool averaged, float t) {
    const SortedParticles& particles = candidates.particles();
    const float3 p = candidates.ray().at(t);
    float3 gradient{0, 0, 0}, centers = gradient;
    BlendedColor<float> blended;
    float n = 0.0f;
    candidates.each([&](const Candidate& s) {
        const float a = particles.support[s.slot];
        const Ball<float> ball{1.0f / (a * a)};
        const float3 v = p - particles.position(s.slot);
        if (!(ball.x(v) < 1.0f)) return;
        const Influence<float> of = influence(kernel, ball, v, particles.weight[s.slot]);
        gradient = gradient + of.half_gradient;
        centers = centers + v;
        n += 1.0f;
        blended.add(color, particles.index[s.slot], max(of.value, 0.0f));
    });
    // p less the mean of the centers is the mean of p less each; all reach alike, the far as the near.
    const float3 normal = averaged ? normalize(centers * (1.0f / max(n, 1.0f))) : normalize(gradient) * -1.0f;
    return {normal, color ? blended.mean() : one_color};
}

}  // namespace globule::core::thesis
