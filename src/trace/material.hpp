// How a surface splits the light that meets it: mirrored, transmitted, or scattered.
//
// A particle's reflection factor rho is the mirror's weight at normal incidence; it grows towards
// grazing by Schlick's rule.  Its refraction factor kappa is the share of the rest that goes through,
// and 1 + kappa / 3 the index of refraction (1: water).  A material may fix each of these instead.
#pragma once
#include "trace/light.hpp"

namespace globule::core {

struct Material {
    float reflection;    ///< negative: the particles' own
    float transmission;  ///< negative: the particles' own
    float index;         ///< of refraction; 0: from the transmission
    float roughness;     ///< of mirrored and transmitted directions, 0 to 1
    float3 color;        ///< x negative: the particles' own
    float3 absorption;   ///< per world unit (Beer); x negative: the color filters on entry instead
    float specular, shininess;

    /// What Beer's law leaves of white light after a length inside.
    GB_FN float mean_beer(float length) const {
        return absorption.x < 0.0f ? 1.0f
                                   : expf(-(absorption.x + absorption.y + absorption.z) * (1.0f / 3.0f) * length);
    }
};

/// The index of refraction of a medium whose particles' own factors are not known here.
GB_FN float index_of(const Material& m) {
    return m.index > 0.0f ? m.index : m.transmission > 0.0f ? 1.0f + m.transmission / 3.0f : 1.0f;
}

/// What Beer's law leaves of light after a length inside.
GB_FN float3 beer(const Material& m, float length) {
    const float3& a = m.absorption;
    return a.x < 0.0f ? float3{1, 1, 1} : float3{expf(-a.x * length), expf(-a.y * length), expf(-a.z * length)};
}

/// Unpolarised reflectance of a boundary; eta: index of the far side over the near side's.
GB_FN float fresnel(float cosine, float eta) {
    const float g2 = eta * eta - 1.0f + cosine * cosine;
    if (g2 <= 0.0f) return 1.0f;  // total internal reflection
    const float g = sqrt(g2), a = (g - cosine) / (g + cosine),
                b = (cosine * (g + cosine) - 1.0f) / (cosine * (g - cosine) + 1.0f);
    return 0.5f * a * a * (1.0f + b * b);
}

GB_FN float3 mirrored(const float3& d, const float3& n) { return d - n * (2.0f * dot(d, n)); }
/// Snell; n against d, total internal reflection excluded by the caller.
GB_FN float3 refracted(const float3& d, const float3& n, float eta) {
    const float cosine = -dot(d, n), inside = 1.0f - (1.0f - cosine * cosine) / (eta * eta);
    return normalize(d * (1.0f / eta) + n * (cosine / eta - sqrt(max(inside, 0.0f))));
}

/// Shares of the incoming light; they add up to 1 (transmission per color: less where a color filters).
struct Split {
    float mirror;
    float3 through;
    float matte;
    float eta;
};
/// What lies at a surface: a medium; a medium that another one displaces there, so that nothing bends or mirrors; a
/// thin pane.
enum class Border { medium, displaced, pane };

/// entering: from outside into the medium; around: index of refraction of what lies outside of it.
GB_FN Split split(const Material& m, const float3& albedo, float reflection, float refraction, float cosine,
    bool entering, Border border = Border::medium, float around = 1.0f) {
    const float rho = m.reflection >= 0.0f ? m.reflection : reflection;
    const float kappa = m.transmission >= 0.0f ? m.transmission : refraction;
    const bool filters = entering && m.absorption.x < 0.0f;
    const float3 tint = filters ? albedo : float3{1, 1, 1};
    if (border == Border::displaced) return {0.0f, tint * kappa, 1.0f - kappa, 1.0f};
    const float own = m.index > 0.0f ? m.index : 1.0f + kappa / 3.0f;
    const float index = own != 1.0f || kappa > 0.0f ? own / around : own;
    const float away = 1.0f - cosine;
    float mirror = rho > 0.0f ? rho + (1.0f - rho) * away * away * away * away * away : 0.0f;
    float eta = entering ? index : 1.0f / index;
    if (index != 1.0f) {
        const float once = fresnel(cosine, eta);
        mirror +=
            (1.0f - mirror) * (border == Border::pane ? 2.0f * once / (1.0f + once) : once);  // a pane's two faces
    }
    if (border == Border::pane) eta = 1.0f;
    const float rest = 1.0f - mirror;
    return {mirror, tint * (rest * kappa), rest * (1.0f - kappa), eta};
}

}  // namespace globule::core
