// What a picture's light is made of: lights, sky, ground, and how surfaces send it on.
#pragma once
#include <algorithm>

#include "trace/light.hpp"
#include "trace/material.hpp"
#include "trace/random.hpp"
#include "trace/sky.hpp"

namespace globule::core {

inline constexpr int kMaxLayers = 4;
inline constexpr std::uint32_t kBelowGround = 1u << 31;  ///< among a ray's `inside`

/// A plane below the scene.
struct Ground {
    bool present;
    float3 normal;
    float offset;         ///< points with dot(normal, p) == offset
    float3 color, other;  ///< of a checkerboard's two kinds of field
    float field;          ///< edge of one, world
    float reflection;

    /// Where a ray that begins above or below it meets it.  It lets nothing through: the side is the primary ray's,
    /// and no rounding lets a ray meet it where that has been mirrored, or pass where a cut face lies in it.
    GB_FN float meet(const float3& o, const float3& d, std::uint32_t inside) const {
        const float speed = dot(normal, d);
        return (inside & kBelowGround ? speed > 0.0f : speed < 0.0f) ? max((offset - dot(normal, o)) / speed, 0.0f)
                                                                     : infinity();
    }
};

/// Everything that says how light goes on.
struct Lighting {
    Light lights[kMaxLights];
    int n_lights;
    bool shadows;
    int ambient_rays;        ///< per sample
    float ambient_distance;  ///< world
    bool sky_light;          ///< ambient light is the sky's, else `ambient`
    float3 ambient;
    float3 background;
    bool show_sky;  ///< behind the scene, instead of the background
    Sky sky;
    Ground ground;
    Material materials[kMaxLayers];
    std::uint32_t closed = 0;   ///< bit k: layer k is a mesh with an inside, which displaces the fields there
    std::uint32_t sheets = 0;   ///< bit k: layer k is a mesh without
    int bounces;                ///< mirrored and transmitted generations
    int edge_samples = 0;       ///< more samples at edges of an image of one sample
    bool edge_contrast = true;  ///< whether contrasts are edges, where light makes turns
    float cutoff;               ///< smallest weight that is followed
    float exposure;

    /// Of the layers that a ray is inside of, those whose media are there.
    GB_FN std::uint32_t media(std::uint32_t inside) const { return inside & closed ? inside & closed : inside; }
    /// What lies at a layer's surface for a ray inside of these layers, and the index of refraction outside of it.
    GB_FN Border border(std::uint32_t layer, std::uint32_t inside, float& around) const {
        const std::uint32_t own = 1u << layer, others = media(inside & ~own);
        around = 1.0f;
        if (sheets & own) return Border::pane;
        if (!(closed & own)) return others & closed ? Border::displaced : Border::medium;
        for (int k = 0; k < kMaxLayers; ++k)
            if ((others & ~closed) >> k & 1) around *= index_of(materials[k]);
        return Border::medium;
    }
    GB_FN bool casts(int k) const { return shadows && lights[k].kind != LightKind::head; }
    /// Whether shadows are soft.
    bool has_size() const {
        return std::any_of(lights, lights + n_lights, [](const Light& light) { return light.size > 0.0f; });
    }
    GB_FN int n_visibilities() const {
        int n = ambient_rays;
        for (int k = 0; k < n_lights; ++k) n += casts(k);
        return n;
    }
    /// Direction and distance from p to the middle of light k.
    GB_FN void towards(int k, const float3& p, float3& l, float& distance) const {
        const Light& light = lights[k];
        const float3 to = light.kind == LightKind::point ? light.place - p : light.place;
        distance = light.kind == LightKind::point ? length(to) : infinity();
        l = normalize(to);
    }
    /// Of its face, a disc, at distance 1.
    GB_FN float radius(int k, float distance) const {
        const Light& light = lights[k];
        return light.kind == LightKind::point ? light.size / max(distance, 1e-20f) : light.size;
    }
    /// Direction to a place on its face, from the direction to its middle.
    GB_FN float3 on_face(int k, const float3& l, float distance, const Pair& at) const {
        if (!(lights[k].size > 0.0f)) return l;
        float3 s, t;
        tangents(l, s, t);
        const Pair on = disc(at);
        const float radius = this->radius(k, distance);
        return normalize(l + s * (on.u * radius) + t * (on.v * radius));
    }
};

}  // namespace globule::core
