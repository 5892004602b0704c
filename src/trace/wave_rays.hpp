// The rays of one wave, and what they meet.
#pragma once
#include "trace/camera.hpp"
#include "trace/lighting.hpp"

namespace globule::core {

inline constexpr std::uint32_t kMissed = 0xff, kGround = 0xfe;

/// The rays of one wave; origins and directions null in the first, whose rays are the camera's, unless they are packed.
struct WaveRays {
    RaySource source;
    float* throughput;      ///< (n, 3); null: 1
    std::uint32_t* pixel;   ///< of the picture; null: the ray's own number
    std::uint32_t* inside;  ///< bit k: begins inside layer k; kBelowGround
    GB_FN bool primary() const { return !source.origins || source.packed; }
    GB_FN std::uint32_t pixel_of(std::size_t i) const {
        return pixel ? pixel[i] : std::uint32_t(i) + source.first_row * std::uint32_t(source.camera.width);
    }
    /// Of a ray's random numbers.
    GB_FN std::uint32_t pass_of(std::size_t i) const {
        return source.packed ? source.pass + std::uint32_t(i % source.packed) : source.pass;
    }
    /// Of a light that has a size, the point that ray i's shadow ray goes to.  Tiles of shadow rays need few
    /// directions: those of a pass share one that a pattern of pixels moves, samples at edges share it as it is.
    GB_FN Pair light_sample(std::size_t i, std::uint32_t light) const {
        const Pair at = sample(0, 16 + light, pass_of(i));
        const std::uint32_t pixel = pixel_of(i), width = std::uint32_t(source.camera.width);
        return source.dithered ? dithered(at, pixel % width, pixel / width) : at;
    }
    /// Whether a soft light's shading is that of this point: of further samples, which converge to the integral over
    /// its face.  Else it is the mean over the face, without noise.
    GB_FN bool shades_by_sample(std::size_t i) const { return source.dithered && pass_of(i) > 0; }
    GB_FN float3 throughput_of(std::size_t i) const {
        return throughput ? float3{throughput[3 * i], throughput[3 * i + 1], throughput[3 * i + 2]} : float3{1, 1, 1};
    }
};

/// What they meet first.
struct WaveHits {
    float* t;
    float *normal, *albedo;                    ///< (n, 3)
    float *reflection, *refraction, *wetness;  ///< (n,) blended factors
    std::uint32_t* layer;                      ///< kMissed, kGround, or the layer
};

/// A hit, as light sees it.
struct Point {
    float3 d, p, normal;  ///< normal against d
    bool entering;
    float3 albedo;
    Split split;
    const Material* material;
    float specular, shininess;  ///< of the lights' highlight
};
GB_FN Point point_of(const Lighting& lighting, const WaveRays& rays, const WaveHits& hits, std::size_t i) {
    Point h;
    float3 o;
    rays.source.get(i, o, h.d);
    h.p = o + h.d * hits.t[i];
    const float3 n{hits.normal[3 * i], hits.normal[3 * i + 1], hits.normal[3 * i + 2]};
    h.entering = dot(n, h.d) < 0.0f;
    h.normal = h.entering ? n : n * -1.0f;
    const std::uint32_t layer = hits.layer[i];
    h.material = &lighting.materials[layer < kMaxLayers ? layer : 0];
    h.albedo = {hits.albedo[3 * i], hits.albedo[3 * i + 1], hits.albedo[3 * i + 2]};
    const float cosine = min(abs(dot(h.normal, h.d)), 1.0f);
    if (layer == kGround) {
        h.split = {hits.reflection[i], {0, 0, 0}, 1.0f - hits.reflection[i], 1.0f};
        h.specular = 0.0f;
        h.shininess = 1.0f;
    } else {
        h.specular = h.material->specular;
        h.shininess = h.material->shininess;
        if (h.specular > 0.0f) {  // a film of liquid is smooth
            h.specular += hits.wetness[i] * max(kWetSpecular - h.specular, 0.0f);
            h.shininess += hits.wetness[i] * max(kWetShininess - h.shininess, 0.0f);
        }
        if (h.material->color.x >= 0.0f) h.albedo = h.material->color;
        float around;
        const Border border = lighting.border(layer, rays.inside[i], around);
        h.split =
            split(*h.material, h.albedo, hits.reflection[i], hits.refraction[i], cosine, h.entering, border, around);
    }
    return h;
}

}  // namespace globule::core
