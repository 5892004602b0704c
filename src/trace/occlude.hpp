// How much of each light comes through to a wave's hits.
#pragma once
#include "trace/cut.hpp"
#include "trace/looks.hpp"
#include "trace/wave_rays.hpp"

namespace globule::core {

inline constexpr int kMaxCrossings = 64;  ///< of a shadow ray through clear media

/// A ray from a hit to a light, or into the open.
struct ShadowRay {
    float3 o, d;
    float distance;
    std::uint32_t inside;
    float* out;  ///< its share of light so far

    /// The k-th of n_visibilities * n_items; false: nothing to find out.  Layer 0 begins the share and tests the
    /// ground.
    GB_FN bool start(std::size_t k, const Lighting& lighting, const WaveRays& rays, const WaveHits& hits, int layer,
        float* visibility) {
        const std::size_t items = rays.source.n_items(), i = rays.source.swizzled(k % items);
        return i < rays.source.n && start(i, int(k / items), lighting, rays, hits, layer, visibility);
    }
    /// Ray i's, to ambient light or light number `which`.
    GB_FN bool start(std::size_t i, int which, const Lighting& lighting, const WaveRays& rays, const WaveHits& hits,
        int layer, float* visibility) {
        out = visibility + std::size_t(which) * rays.source.n + i;
        if (layer == 0) *out = 1.0f;
        if (hits.layer[i] == kMissed || *out == 0.0f) return false;
        const Point h = point_of(lighting, rays, hits, i);
        if (which < lighting.ambient_rays) {
            if (h.split.matte * largest(rays.throughput_of(i)) < 0.25f * lighting.cutoff) return false;
            d = cosine_direction(
                h.normal, sample(rays.pixel_of(i), 8, rays.pass_of(i) * std::uint32_t(lighting.ambient_rays) + which));
            distance = lighting.ambient_distance;
        } else {
            const Pair on = rays.light_sample(i, std::uint32_t(which));
            which -= lighting.ambient_rays;
            int light = 0;
            for (;; ++light)
                if (lighting.casts(light) && which-- == 0) break;
            float3 middle;
            lighting.towards(light, h.p, middle, distance);
            d = lighting.on_face(light, middle, distance, on);
            // From behind, or too little to matter even in full view.
            const float3 full = rays.throughput_of(i) *
                                reflected_light(h.albedo * h.split.matte, h.specular, h.shininess, h.normal, h.d,
                                    rays.shades_by_sample(i) ? d : middle, lighting.lights[light].radiance);
            if (largest(full) * lighting.exposure < 0.125f * lighting.cutoff) return false;
        }
        if (dot(d, h.normal) <= 0.0f) {  // behind the surface
            *out = 0.0f;
            return false;
        }
        if (layer == 0 && lighting.ground.present && lighting.ground.meet(h.p, d, rays.inside[i]) < distance) {
            *out = 0.0f;
            return false;
        }
        o = h.p;
        inside = rays.inside[i];
        return true;
    }
};

/// Shadow and ambient rays through one layer: what part of the light comes through, (n_visibilities, n).
template <class Tracer, bool clipped> struct Occlude {
    Cut<Tracer, clipped> cut;
    Attributes attributes;
    Lighting lighting;
    WaveRays rays;
    WaveHits hits;
    int layer;
    float* visibility;
    struct State {
        typename Cut<Tracer, clipped>::State of;
        Way way;
        float distance, left, from;
        int crossings;
        float* out;
    };
    GB_FN bool begin(std::size_t k, State& s) const {
        ShadowRay ray;
        if (!ray.start(k, lighting, rays, hits, layer, visibility)) return false;
        s.out = ray.out;
        s.distance = ray.distance;
        s.left = 1.0f;
        s.crossings = 0;
        s.from = kStart * cut.tracer.tree.header->typical_support;
        s.of.ray.sign = 1.0f;
        s.way = cut.start(s.of, ray.o, ray.d, s.from, s.distance, ray.inside >> layer & 1 ? -1.0f : 1.0f);
        return true;
    }
    GB_FN bool advance(State& s, bool active) const {
        const Way way = cut.advance(s.of, active && s.way == Way::on);
        if (!active) return false;
        if (s.way == Way::on) s.way = way;
        return s.way == Way::on || settle(s);
    }
    GB_FN void end(const State& s) const { *s.out *= s.left; }

    static constexpr float kDoubt =
        0.05f;  ///< in typical supports: so much further float32 tells which side a ray is on
protected:
    /// At a crossing, in doubt or at the end; whether the ray goes on.
    GB_FN bool settle(State& s) const {
        const CellRay& ray = s.of.ray;
        const float3 o = ray.o, l = ray.walk.d;
        const float typical = cut.tracer.tree.header->typical_support;
        const float sign = ray.sign;
        float t = ray.t;
        if (s.way == Way::doubtful) {  // a graze, or a cell without a list
            t += kDoubt * typical;
            if (cut.holds_by_tree(o + l * t) == (sign < 0.0f)) return go_on(s, o, l, t, sign);
        }
        const bool ends = s.way == Way::missed || !(t < s.distance);
        if (ends) t = s.distance;
        const Material& m = lighting.materials[layer];
        if (sign < 0.0f && t < infinity()) s.left *= m.mean_beer(t - s.from);
        if (ends) return false;
        s.left *= m.transmission >= 0.0f       ? m.transmission
                  : attributes.refraction.data ? looks_at(cut.tracer, attributes, o, l, t, false).refraction
                                               : attributes.refraction.uniform;
        if (s.left < 0.004f) {
            s.left = 0.0f;
            return false;
        }
        return go_on(s, o, l, t + kStart * typical, -sign);
    }

private:
    GB_FN bool go_on(State& s, const float3& o, const float3& l, float from, float sign) const {
        s.from = from;
        s.of.ray.sign = sign;
        if (++s.crossings > kMaxCrossings) return false;
        s.way = from < s.distance ? cut.start(s.of, o, l, from, s.distance, sign) : Way::missed;
        return s.way != Way::missed;
    }
};

}  // namespace globule::core
