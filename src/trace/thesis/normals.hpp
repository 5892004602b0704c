// What a hit looks like: gradient normal (5.2, corrected) or the averaged centres' (Fig. 5.8a), and the
// blended colour (§6.0.2).
#pragma once
#include "trace/thesis/candidates.hpp"

namespace globule::core::thesis {

struct Look {
    float3 normal, albedo;
};

template <class Kernel>
GB_FN Look look(const Candidates& candidates, const Kernel& kernel, const float* color, const float3& one_color,
                bool averaged, float t) {
    const SortedParticles& particles = candidates.particles();
    const float3 p = candidates.ray().at(t);
    float3 gradient{0, 0, 0}, rgb = gradient, centres = gradient;
    float total = 0.0f, n = 0.0f;
    candidates.each([&](const Candidate& s) {
        const float a = particles.support[s.slot], i2 = 1.0f / (a * a), c = particles.weight[s.slot];
        const float3 v = p - particles.position(s.slot);
        const float x = dot(v, v) * i2;
        if (!(x < 1.0f)) return;
        float b, slope;
        kernel(x, b, slope);
        gradient = gradient + v * (c * slope * i2);
        centres = centres + v;
        n += 1.0f;
        const float w = max(c * b, 0.0f);
        total += w;
        if (!color) return;
        const float* own = color + std::size_t(3) * particles.index[s.slot];
        rgb = rgb + float3{own[0], own[1], own[2]} * w;
    });
    // p less the mean of the centres is the mean of p less each; all reach alike, the far as the near.
    const float3 normal = averaged ? normalize(centres * (1.0f / max(n, 1.0f))) : normalize(gradient) * -1.0f;
    return {normal, color ? rgb * (1.0f / max(total, 1e-30f)) : one_color};
}

}  // namespace globule::core::thesis
