// Hits to light: Lambert and Blinn-Phong under a headlight, directional and point lights.  Linear
// float32 radiance, and the 8-bit sRGB picture of it.
#pragma once
#include "globule/trace/tile.hpp"

namespace globule {

inline constexpr int kMaxLights = 8;
enum class LightKind : int { head, directional, point };

struct Light {
    LightKind kind;
    float3 place;      ///< directional: direction towards the light; point: position
    float3 radiance;
};

struct Shading {
    Light lights[kMaxLights];
    int n_lights;
    float3 ambient;
    float3 background;
    float specular;    ///< strength of the highlight
    float shininess;
    float exposure;
};

struct Shade {
    RaySource rays;
    Hits hits;
    Shading s;
    float* color;           ///< (n, 3) linear
    std::uint8_t* picture;  ///< (n, 3) sRGB

    GB_FN void operator()(std::size_t i) const {
        const bool hit = hits.t[i] < infinity();
        const float3 c = hit ? surface(i) : s.background;
        const float v[3] = {c.x, c.y, c.z};
        for (int k = 0; k < 3; ++k) {
            color[3 * i + k] = v[k];
            picture[3 * i + k] = display(hit ? shoulder(v[k] * s.exposure) : v[k]);  // background as it is given
        }
    }

    GB_FN float3 surface(std::size_t i) const {
        float3 o, d;
        rays.get(i, o, d);
        const float3 p = o + d * hits.t[i];
        const float3 a{hits.albedo[3 * i], hits.albedo[3 * i + 1], hits.albedo[3 * i + 2]};
        float3 n{hits.normal[3 * i], hits.normal[3 * i + 1], hits.normal[3 * i + 2]};
        if (dot(n, d) > 0.0f) n = n * -1.0f;  // seen from inside
        float3 c{s.ambient.x * a.x, s.ambient.y * a.y, s.ambient.z * a.z};
        for (int k = 0; k < s.n_lights; ++k) {
            const Light& light = s.lights[k];
            const float3 l = light.kind == LightKind::head          ? d * -1.0f
                             : light.kind == LightKind::directional ? normalize(light.place)
                                                                    : normalize(light.place - p);
            const float cosine = dot(n, l);
            if (cosine <= 0.0f) continue;
            const float3 half = normalize(l - d);
            const float shine = s.specular * power(dot(n, half), s.shininess);
            c = c + float3{light.radiance.x * (a.x * cosine + shine), light.radiance.y * (a.y * cosine + shine),
                           light.radiance.z * (a.z * cosine + shine)};
        }
        return c;
    }

    /// Tone curve: linear up to 0.8, then a shoulder that never clips hard.
    GB_FN static float shoulder(float v) {
        return v > 0.8f ? 0.8f + 0.2f * (1.0f - 1.0f / (1.0f + (v - 0.8f) * 5.0f)) : v;
    }
    /// sRGB transfer.
    GB_FN static std::uint8_t display(float v) {
        v = v <= 0.0031308f ? 12.92f * most(v, 0.0f) : 1.055f * power(v, 1.0f / 2.4f) - 0.055f;
        return std::uint8_t(least(v, 1.0f) * 255.0f + 0.5f);
    }
};

/// World positions of the hits (NaN where missed), for the `position` image.
struct HitPositions {
    RaySource rays;
    const float* t;
    float* position;
    GB_FN void operator()(std::size_t i) const {
        float3 o, d;
        rays.get(i, o, d);
        const bool hit = t[i] < infinity();
        position[3 * i] = hit ? o.x + t[i] * d.x : NAN;
        position[3 * i + 1] = hit ? o.y + t[i] * d.y : NAN;
        position[3 * i + 2] = hit ? o.z + t[i] * d.z : NAN;
    }
};

}  // namespace globule
