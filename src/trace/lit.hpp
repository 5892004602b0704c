// The light that a wave's hits send to their pixels.
#pragma once
#include "exec/bits.hpp"
#include "trace/wave_rays.hpp"

namespace globule::core {

/// Radiance of a pixel in units of 2^-32, so that the order of additions cannot change a bit.
GB_FN void accumulate(std::uint64_t* sum, std::uint32_t pixel, const float3& c) {
    const float v[3] = {c.x, c.y, c.z};
    for (int k = 0; k < 3; ++k)
        if (v[k] > 0.0f)
            atomic_add(sum + std::size_t(3) * pixel + k, std::uint64_t(min(v[k], 1048576.0f) * 4294967296.0f));
}

/// The light that leaves each hit towards its ray, and how many rays go on from there.
struct Lit {
    Lighting lighting;
    WaveRays rays;
    WaveHits hits;
    const float* visibility;
    int generation;
    std::uint64_t* sum;
    std::uint32_t first_pixel;  ///< that `sum` begins with; packed rays have a sum each
    std::uint32_t* n_children;  ///< (2 items,) mirrored, then transmitted: rays of a kind stay together

    GB_FN void operator()(std::size_t item) const {
        const std::size_t i = rays.source.swizzled(item), items = rays.source.n_items();
        n_children[item] = n_children[items + item] = 0;
        if (i >= rays.source.n) return;
        float3 o, d;
        rays.source.get(i, o, d);
        float3 weight = rays.throughput_of(i);
        const std::uint32_t pixel = rays.source.packed ? std::uint32_t(i) : rays.pixel_of(i) - first_pixel;
        if (hits.layer[i] == kMissed) {
            accumulate(
                sum, pixel, weight * (rays.primary() && !lighting.show_sky ? lighting.background : lighting.sky(d)));
            return;
        }
        const Point h = point_of(lighting, rays, hits, i);
        weight = weight * attenuation(lighting, rays, hits, i);
        accumulate(sum, pixel, weight * matte(h, i));
        if (h.split.mirror > 0.0f) go_on(weight * h.split.mirror, mirrored(h.d, h.normal), pixel, item);
        if (largest(h.split.through) > 0.0f)
            go_on(weight * h.split.through, refracted(h.d, h.normal, h.split.eta), pixel, items + item);
    }

    /// What Beer's law leaves of the light on the way to the hit.
    GB_FN static float3 attenuation(
        const Lighting& lighting, const WaveRays& rays, const WaveHits& hits, std::size_t i) {
        float3 left{1, 1, 1};
        const std::uint32_t media = lighting.media(rays.inside[i]);
        for (int k = 0; k < kMaxLayers; ++k) {
            if (media >> k & 1) left = left * beer(lighting.materials[k], hits.t[i]);
        }
        return left;
    }

private:
    GB_FN float3 matte(const Point& h, std::size_t i) const {
        const std::size_t n = rays.source.n;
        const std::uint32_t pixel = rays.pixel_of(i);
        const float share = h.split.matte;
        float3 c{0, 0, 0};
        int which = 0;
        if (lighting.ambient_rays == 0)
            c = (lighting.sky_light ? lighting.sky.blurred(h.normal) : lighting.ambient) * h.albedo * share;
        for (; which < lighting.ambient_rays; ++which) {
            float3 light = lighting.ambient;
            if (lighting.sky_light)
                light = lighting.sky(cosine_direction(
                    h.normal, sample(pixel, 8, rays.pass_of(i) * std::uint32_t(lighting.ambient_rays) + which)));
            c = c + light * h.albedo * (share * visibility[which * n + i] / float(lighting.ambient_rays));
        }
        for (int k = 0; k < lighting.n_lights; ++k) {
            float3 l = h.d * -1.0f;
            float seen = 1.0f, matte = share, wide = 1.0f, distance;
            if (lighting.lights[k].kind != LightKind::head) {
                lighting.towards(k, h.p, l, distance);
                const float radius = lighting.radius(k, distance), square = radius * radius;
                if (rays.shades_by_sample(i)) {
                    l = lighting.on_face(k, l, distance, rays.light_sample(i, std::uint32_t(which)));
                } else {
                    // In an image of one sample, the mean over a soft light's face, without noise: of the directions to
                    // it, a unit long each; and a highlight, as a power of a cosine nearly a Gaussian of variance
                    // 1 / shininess, widened by the half vectors' radius^2 / 16.  It takes all of the face to be as
                    // hidden as the place that is looked at: further samples have their own directions.
                    matte *= 2.0f / (1.0f + sqrt(1.0f + square));
                    wide = 1.0f / (1.0f + h.shininess * square * 0.0625f);
                }
            } else if (!rays.primary()) {
                const CameraRays& camera = rays.source.camera;
                l = camera.orthographic ? camera.forward * -1.0f : normalize(camera.eye - h.p);
            }
            if (lighting.casts(k)) seen = visibility[which++ * n + i];
            c = c + reflected_light(h.albedo * matte, h.specular * wide, h.shininess * wide, h.normal, h.d, l,
                        lighting.lights[k].radiance) *
                        seen;
        }
        return c;
    }
    /// Counts a child, or where it is not worth following ends it in the sky.
    GB_FN void go_on(const float3& weight, const float3& d, std::uint32_t pixel, std::size_t child) const {
        if (generation < lighting.bounces && largest(weight) >= lighting.cutoff) n_children[child] = 1;
        else accumulate(sum, pixel, weight * lighting.sky(d));
    }
};

}  // namespace globule::core
