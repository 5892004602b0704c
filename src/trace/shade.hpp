// The picture where light makes no more turns: Lambert and Blinn-Phong, no shadows.  One pass over
// the hits; trace/wave.hpp does everything else.
#pragma once
#include "trace/camera.hpp"
#include "trace/hits.hpp"
#include "trace/lighting.hpp"

namespace globule::core {

struct Shade {
    RaySource rays;
    Hits hits;
    Lighting s;
    float* color;           ///< (n, 3) linear
    std::uint8_t* picture;  ///< (n, 3) sRGB

    GB_FN void operator()(std::size_t i) const {
        const bool hit = hits.t[i] < infinity();
        const float3 c = light(i, hit);
        const float v[3] = {c.x, c.y, c.z};
        for (int k = 0; k < 3; ++k) {
            color[3 * i + k] = v[k];
            picture[3 * i + k] = display(shown(v[k], hit));
        }
    }
    GB_FN float3 light(std::size_t i, bool hit) const { return hit ? surface(i) : s.background; }
    /// Background as it is given.
    GB_FN float shown(float v, bool hit) const { return hit ? shoulder(v * s.exposure) : v; }

    GB_FN float3 surface(std::size_t i) const {
        float3 o, d;
        rays.get(i, o, d);
        const float3 p = o + d * hits.t[i];
        const Material& m = s.materials[0];
        const float3 a =
            m.color.x >= 0.0f ? m.color : float3{hits.albedo[3 * i], hits.albedo[3 * i + 1], hits.albedo[3 * i + 2]};
        float3 n{hits.normal[3 * i], hits.normal[3 * i + 1], hits.normal[3 * i + 2]};
        const bool from_inside = dot(n, d) > 0.0f;
        if (from_inside) n = n * -1.0f;
        float3 c = s.ambient * a;
        for (int k = 0; k < s.n_lights; ++k) {
            const Light& light = s.lights[k];
            const float3 l = light.kind == LightKind::head          ? d * -1.0f
                             : light.kind == LightKind::directional ? normalize(light.place)
                                                                    : normalize(light.place - p);
            c = c + reflected_light(a, m.specular, m.shininess, n, d, l, light.radiance);
        }
        return from_inside ? c * beer(m, hits.t[i]) : c;
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

}  // namespace globule::core
