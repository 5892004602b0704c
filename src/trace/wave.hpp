// One wave of a backward ray tracer (Whitted 1980): all rays of one depth together.  March to the
// nearest surface layer by layer, keep what the nearest looks like, trace shadow and ambient rays,
// add up the light, and send mirrored and transmitted rays on as the next wave.
#pragma once
#include "exec/bits.hpp"
#include "trace/cut.hpp"
#include "trace/looks.hpp"
#include "trace/material.hpp"
#include "trace/sky.hpp"

namespace globule::core {

inline constexpr int kMaxLayers = 4;
inline constexpr std::uint32_t kMissed = 0xff, kGround = 0xfe;
inline constexpr std::uint32_t kBelowGround = 1u << 31;  ///< among a ray's `inside`
inline constexpr int kMaxCrossings = 64;  ///< of a shadow ray through clear media

/// The rays of one wave; origins and directions null in the first, whose rays are the camera's.
struct WaveRays {
    RaySource source;
    float* throughput;          ///< (n, 3); null: 1
    std::uint32_t* pixel;       ///< of the picture; null: the ray's own number
    std::uint32_t* inside;      ///< bit k: begins inside layer k; kBelowGround
    GB_FN bool primary() const { return !source.origins; }
    GB_FN std::uint32_t pixel_of(std::size_t i) const {
        return pixel ? pixel[i] : std::uint32_t(i) + source.first_row * std::uint32_t(source.camera.width);
    }
    GB_FN float3 throughput_of(std::size_t i) const {
        return throughput ? float3{throughput[3 * i], throughput[3 * i + 1], throughput[3 * i + 2]} : float3{1, 1, 1};
    }
};

/// What they meet first.
struct WaveHits {
    float* t;
    float *normal, *albedo;           ///< (n, 3)
    float *reflection, *refraction;   ///< (n,) blended factors
    std::uint32_t* layer;             ///< kMissed, kGround, or the layer
};

/// Rays to their first crossing of one layer.
template <class Tracer, bool clipped>
struct March {
    Cut<Tracer, clipped> cut;
    WaveRays rays;
    int layer;
    LayerHits out;
    struct State {
        typename Cut<Tracer, clipped>::State of;
        Way way;
        std::size_t i;
    };
    GB_FN bool begin(std::size_t k, State& s) const {
        s.i = rays.source.swizzled(k);
        if (s.i >= rays.source.n) return false;
        float3 o, d;
        rays.source.get(s.i, o, d);
        const float sign = rays.primary() ? 0.0f : rays.inside[s.i] >> layer & 1 ? -1.0f : 1.0f;
        s.of.ray.sign = 1.0f;
        s.way = cut.start(s.of, o, d, rays.primary() ? 0.0f : kStart * cut.tracer.tree.header->typical_support, infinity(), sign);
        return true;
    }
    GB_FN bool advance(State& s, bool active) const {
        const Way way = cut.advance(s.of, active && s.way == Way::on);
        if (active && s.way == Way::on) s.way = way;
        return active && s.way == Way::on;
    }
    GB_FN void end(const State& s) const {
        const float t = s.of.ray.t;
        out.t[s.i] = s.way == Way::missed ? infinity() : s.way == Way::doubtful ? undecided(t) : t;
        if (s.way == Way::doubtful) out.undecided.add(s.i);
        out.cap[s.i] = s.way == Way::crossed ? s.of.cap : -1;
        out.sign[s.i] = std::int8_t((s.of.ray.sign > 0.0f) - (s.of.ray.sign < 0.0f));
    }
};

/// The nearest of the layers so far, and what it looks like.
template <class Tracer>
struct Keep {
    Tracer tracer;
    Clips clips;
    Attributes attributes;
    WaveRays rays;
    int layer;
    LayerHits found;
    WaveHits out;
    GB_FN void operator()(std::size_t k) const {
        const std::size_t i = rays.source.swizzled(k);
        if (i >= rays.source.n) return;
        if (rays.primary() && layer == 0) rays.inside[i] = 0;
        const float t = found.t[i];
        // A camera may stand inside.
        if (rays.primary() && found.sign && t < infinity() && found.sign[i] < 0) rays.inside[i] |= 1u << layer;
        if (layer == 0) {
            out.t[i] = infinity();
            out.layer[i] = kMissed;
            if (!(t < infinity())) {
                write3(out.normal, i, {0, 0, 0});
                write3(out.albedo, i, {0, 0, 0});
            }
        }
        if (!(t < out.t[i])) return;
        float3 o, d;
        rays.source.get(i, o, d);
        const Looks looks = looks_at(tracer, attributes, o, d, t);
        const std::int32_t cap = found.cap ? found.cap[i] : -1;
        const float3 normal = cap < 0 ? normalize(looks.gradient) * -1.0f : clips.clips[cap].normal(o + d * t);
        if (rays.primary() && !found.sign && dot(normal, d) > 0.0f) rays.inside[i] |= 1u << layer;
        out.t[i] = t;
        out.layer[i] = std::uint32_t(layer);
        write3(out.normal, i, normal);
        write3(out.albedo, i, looks.color);
        out.reflection[i] = looks.reflection;
        out.refraction[i] = looks.refraction;
    }
};

/// Everything that says how light goes on.
struct Ground {
    bool present;
    float3 normal;
    float offset;           ///< points with dot(normal, p) == offset
    float3 color, other;    ///< of a checkerboard's two kinds of field
    float field;            ///< edge of one, world
    float reflection;

    /// Where a ray that begins above or below it meets it.  It lets nothing through: the side is the primary ray's,
    /// and no rounding lets a ray meet it where that has been mirrored, or pass where a cut face lies in it.
    GB_FN float meet(const float3& o, const float3& d, std::uint32_t inside) const {
        const float speed = dot(normal, d);
        return (inside & kBelowGround ? speed > 0.0f : speed < 0.0f) ? max((offset - dot(normal, o)) / speed, 0.0f) : infinity();
    }
};
struct Lighting {
    Light lights[kMaxLights];
    int n_lights;
    bool shadows;
    int ambient_rays;         ///< per sample
    float ambient_distance;   ///< world
    bool sky_light;           ///< ambient light is the sky's, else `ambient`
    float3 ambient;
    float3 background;
    bool show_sky;            ///< behind the scene, instead of the background
    Sky sky;
    Ground ground;
    Material materials[kMaxLayers];
    int depth;                ///< mirrored and transmitted generations
    float cutoff;             ///< smallest weight that is followed
    float exposure;

    GB_FN bool casts(int k) const { return shadows && lights[k].kind != LightKind::head; }
    GB_FN int n_visibilities() const {
        int n = ambient_rays;
        for (int k = 0; k < n_lights; ++k) n += casts(k);
        return n;
    }
    /// Direction and distance from p to light k, somewhere on its face.
    GB_FN void towards(int k, const float3& p, const Pair& at, float3& l, float& distance) const {
        const Light& light = lights[k];
        float3 to = light.kind == LightKind::point ? light.place - p : light.place;
        distance = light.kind == LightKind::point ? length(to) : infinity();
        l = normalize(to);
        if (light.size > 0.0f) {
            float3 s, t;
            frame_of(l, s, t);
            const Pair on = disc(at);
            const float radius = light.kind == LightKind::point ? light.size / max(distance, 1e-20f) : light.size;
            l = normalize(l + s * (on.u * radius) + t * (on.v * radius));
        }
    }
};

/// The ground, which lies behind all layers in the order of tests.
struct MeetGround {
    Ground ground;
    WaveRays rays;
    WaveHits out;
    GB_FN void operator()(std::size_t i) const {
        float3 o, d;
        rays.source.get(i, o, d);
        if (rays.primary() && dot(ground.normal, o) < ground.offset) rays.inside[i] |= kBelowGround;
        const float t = ground.meet(o, d, rays.inside[i]);
        if (!(t < out.t[i])) return;
        const float3 p = o + d * t;
        float3 s, u;
        frame_of(ground.normal, s, u);
        const bool odd = ground.field > 0.0f &&
                         (int(floorf(dot(p, s) / ground.field)) + int(floorf(dot(p, u) / ground.field))) & 1;
        out.t[i] = t;
        out.layer[i] = kGround;
        write3(out.normal, i, ground.normal);
        write3(out.albedo, i, odd ? ground.other : ground.color);
        out.reflection[i] = ground.reflection;
        out.refraction[i] = 0.0f;
    }
};

/// A hit, as the kernels below see it.
struct Point {
    float3 d, p, normal;  ///< normal against d
    bool entering;
    float3 albedo;
    Split split;
    const Material* material;
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
    } else {
        if (h.material->color.x >= 0.0f) h.albedo = h.material->color;
        h.split = split(*h.material, h.albedo, hits.reflection[i], hits.refraction[i], cosine, h.entering);
    }
    return h;
}

/// Shadow and ambient rays through one layer: what part of the light comes through, (n_visibilities, n).
template <class Tracer, bool clipped>
struct Occlude {
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
        const std::size_t n = rays.source.n, items = rays.source.n_items();
        const std::size_t i = rays.source.swizzled(k % items);
        if (i >= n) return false;
        int which = int(k / items);
        s.out = visibility + std::size_t(which) * n + i;
        if (layer == 0) *s.out = 1.0f;
        if (hits.layer[i] == kMissed || *s.out == 0.0f) return false;
        const Point h = point_of(lighting, rays, hits, i);
        const std::uint32_t pixel = rays.pixel_of(i), stream = 16 + std::uint32_t(which);
        float3 l;
        if (which < lighting.ambient_rays) {
            if (h.split.matte * largest(rays.throughput_of(i)) < 0.25f * lighting.cutoff) return false;
            l = cosine_direction(h.normal, sample(pixel, 8, rays.source.pass * std::uint32_t(lighting.ambient_rays) + which));
            s.distance = lighting.ambient_distance;
        } else {
            which -= lighting.ambient_rays;
            int light = 0;
            for (;; ++light)
                if (lighting.casts(light) && which-- == 0) break;
            lighting.towards(light, h.p, sample(pixel, stream, rays.source.pass), l, s.distance);
            // From behind, or too little to matter even in full view.
            const float specular = hits.layer[i] == kGround ? 0.0f : h.material->specular;
            const float3 full = rays.throughput_of(i) * reflected_light(h.albedo * h.split.matte, specular, h.material->shininess,
                                                                        h.normal, h.d, l, lighting.lights[light].radiance);
            if (largest(full) * lighting.exposure < 0.125f * lighting.cutoff) return false;
        }
        if (dot(l, h.normal) <= 0.0f) return false;
        if (layer == 0 && lighting.ground.present && lighting.ground.meet(h.p, l, rays.inside[i]) < s.distance) {
            *s.out = 0.0f;
            return false;
        }
        s.left = 1.0f;
        s.crossings = 0;
        s.from = kStart * cut.tracer.tree.header->typical_support;
        s.of.ray.sign = 1.0f;
        s.way = cut.start(s.of, h.p, l, s.from, s.distance, rays.inside[i] >> layer & 1 ? -1.0f : 1.0f);
        return true;
    }
    GB_FN bool advance(State& s, bool active) const {
        const Way way = cut.advance(s.of, active && s.way == Way::on);
        if (!active) return false;
        if (s.way == Way::on) s.way = way;
        if (s.way == Way::on) return true;
        const RayState& ray = s.of.ray;
        const float3 o = ray.o, l = ray.walk.d;
        const float typical = cut.tracer.tree.header->typical_support;
        const float sign = ray.sign;
        float t = ray.t;
        if (s.way == Way::doubtful) {  // a graze, or a cell without a list
            t += 0.05f * typical;
            if (cut.holds_by_tree(o + l * t) == (sign < 0.0f)) return go_on(s, o, l, t, sign);
        }
        const bool ends = s.way == Way::missed || !(t < s.distance);
        if (ends) t = s.distance;
        const Material& m = lighting.materials[layer];
        if (sign < 0.0f && m.absorption.x >= 0.0f && t < infinity())
            s.left *= expf(-(m.absorption.x + m.absorption.y + m.absorption.z) * (1.0f / 3.0f) * (t - s.from));
        if (ends) return false;
        s.left *= m.transmission >= 0.0f       ? m.transmission
                  : attributes.refraction.data ? looks_at(cut.tracer, attributes, o, l, t).refraction
                                               : attributes.refraction.uniform;
        if (s.left < 0.004f) {
            s.left = 0.0f;
            return false;
        }
        return go_on(s, o, l, t + kStart * typical, -sign);
    }
    GB_FN void end(const State& s) const { *s.out *= s.left; }

private:
    GB_FN bool go_on(State& s, const float3& o, const float3& l, float from, float sign) const {
        s.from = from;
        if (++s.crossings > kMaxCrossings) return false;
        s.way = from < s.distance ? cut.start(s.of, o, l, from, s.distance, sign) : Way::missed;
        return s.way != Way::missed;
    }
};

/// Radiance of a pixel in units of 2^-32, so that the order of additions cannot change a bit.
GB_FN void accumulate(std::uint64_t* sum, std::uint32_t pixel, const float3& c) {
    const float v[3] = {c.x, c.y, c.z};
    for (int k = 0; k < 3; ++k)
        if (v[k] > 0.0f) atomic_add(sum + std::size_t(3) * pixel + k, std::uint64_t(min(v[k], 1048576.0f) * 4294967296.0f));
}

/// The light that leaves each hit towards its ray, and how many rays go on from there.
struct Lit {
    Lighting lighting;
    WaveRays rays;
    WaveHits hits;
    const float* visibility;
    int generation;
    std::uint64_t* sum;
    std::uint32_t first_pixel;   ///< that `sum` begins with
    std::uint32_t* n_children;   ///< (2 items,) mirrored, then transmitted: rays of a kind stay together

    GB_FN void operator()(std::size_t item) const {
        const std::size_t i = rays.source.swizzled(item), items = rays.source.n_items();
        n_children[item] = n_children[items + item] = 0;
        if (i >= rays.source.n) return;
        float3 o, d;
        rays.source.get(i, o, d);
        float3 weight = rays.throughput_of(i);
        const std::uint32_t pixel = rays.pixel_of(i) - first_pixel;
        if (hits.layer[i] == kMissed) {
            accumulate(sum, pixel, weight * (rays.primary() && !lighting.show_sky ? lighting.background : lighting.sky(d)));
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
    GB_FN static float3 attenuation(const Lighting& lighting, const WaveRays& rays, const WaveHits& hits, std::size_t i) {
        float3 left{1, 1, 1};
        for (int k = 0; k < kMaxLayers; ++k) {
            if (rays.inside[i] >> k & 1) left = left * beer(lighting.materials[k], hits.t[i]);
        }
        return left;
    }

private:
    GB_FN float3 matte(const Point& h, std::size_t i) const {
        const std::size_t n = rays.source.n;
        const std::uint32_t pixel = rays.pixel_of(i);
        const bool ground = hits.layer[i] == kGround;
        const float specular = ground ? 0.0f : h.material->specular, share = h.split.matte;
        float3 c{0, 0, 0};
        int which = 0;
        if (lighting.ambient_rays == 0) c = (lighting.sky_light ? lighting.sky.blurred(h.normal) : lighting.ambient) * h.albedo * share;
        for (; which < lighting.ambient_rays; ++which) {
            float3 light = lighting.ambient;
            if (lighting.sky_light)
                light = lighting.sky(cosine_direction(h.normal, sample(pixel, 8, rays.source.pass * std::uint32_t(lighting.ambient_rays) + which)));
            c = c + light * h.albedo * (share * visibility[which * n + i] / float(lighting.ambient_rays));
        }
        for (int k = 0; k < lighting.n_lights; ++k) {
            float3 l = h.d * -1.0f;
            float seen = 1.0f, distance;
            if (lighting.lights[k].kind != LightKind::head) {
                lighting.towards(k, h.p, sample(pixel, 16 + which, rays.source.pass), l, distance);
            } else if (!rays.primary()) {
                const CameraRays& camera = rays.source.camera;
                l = camera.orthographic ? camera.forward * -1.0f : normalize(camera.eye - h.p);
            }
            if (lighting.casts(k)) seen = visibility[which++ * n + i];
            c = c + reflected_light(h.albedo * share, specular, h.material->shininess, h.normal, h.d, l, lighting.lights[k].radiance) * seen;
        }
        return c;
    }
    /// Counts a child, or where it is not worth following ends it in the sky.
    GB_FN void go_on(const float3& weight, const float3& d, std::uint32_t pixel, std::size_t child) const {
        if (generation < lighting.depth && largest(weight) >= lighting.cutoff) n_children[child] = 1;
        else accumulate(sum, pixel, weight * lighting.sky(d));
    }
};

/// Writes the next wave; `place` (2 items + 1,): where each ray's children go.
struct Spawn {
    Lighting lighting;
    WaveRays rays;
    WaveHits hits;
    int generation;
    const std::uint32_t* place;
    WaveRays out;
    float *origin, *direction;   ///< of `out`
    GB_FN void operator()(std::size_t item) const {
        const std::size_t i = rays.source.swizzled(item), through = rays.source.n_items() + item;
        if (place[item + 1] == place[item] && place[through + 1] == place[through]) return;
        const Point h = point_of(lighting, rays, hits, i);
        const float3 weight = rays.throughput_of(i) * Lit::attenuation(lighting, rays, hits, i);
        if (h.split.mirror > 0.0f)
            send(item, weight * h.split.mirror, mirrored(h.d, facet(h, i, 0)), h, i, rays.inside[i]);
        if (largest(h.split.through) > 0.0f) {
            const std::uint32_t bit = 1u << hits.layer[i];
            send(through, weight * h.split.through, refracted(h.d, facet(h, i, 1), h.split.eta), h, i,
                 h.entering ? rays.inside[i] | bit : rays.inside[i] & ~bit);
        }
    }

private:
    /// The normal, or of a rough surface that of one of its facets (GGX, Walter et al. 2007), against d.
    GB_FN float3 facet(const Point& h, std::size_t i, std::uint32_t branch) const {
        const float rough = hits.layer[i] == kGround ? 0.0f : h.material->roughness * h.material->roughness;
        if (rough <= 0.0f) return h.normal;
        const Pair at = sample(rays.pixel_of(i), 64 + 2 * generation + branch, rays.source.pass);
        const float tangent = rough * sqrt(at.u / max(1.0f - at.u, 1e-6f)), angle = 6.2831853f * at.v;
        float3 s, t;
        frame_of(h.normal, s, t);
        const float3 n = normalize(h.normal + s * (tangent * cosf(angle)) + t * (tangent * sinf(angle)));
        const bool usable = dot(n, h.d) < 0.0f && dot(mirrored(h.d, n), h.normal) > 0.0f;
        return usable ? n : h.normal;
    }
    GB_FN void send(std::size_t child, const float3& weight, const float3& d, const Point& h, std::size_t i, std::uint32_t inside) const {
        const std::uint32_t at = place[child];
        if (place[child + 1] == at) return;
        write3(origin, at, h.p);
        write3(direction, at, d);
        write3(out.throughput, at, weight);
        out.pixel[at] = rays.pixel_of(i);
        out.inside[at] = inside;
    }
};

/// One pass more into the picture.
struct Finish {
    const std::uint64_t* sum;       ///< (n, 3) of this pass, of the pixels from `first` on
    const std::uint32_t* layer;     ///< (n,) what the pass's primary rays met
    std::size_t first;
    float exposure;
    int passes;                     ///< with this one
    float *total, *shown;           ///< (all pixels, 3) sums over passes, as light and as displayed
    float* color;
    std::uint8_t* picture;
    std::uint8_t* seen;             ///< (all pixels,) what the first pass met: kMissed, kGround, or the layer
    GB_FN void operator()(std::size_t i) const {
        if (passes == 1) seen[first + i] = std::uint8_t(layer[i]);
        const bool hit = layer[i] != kMissed;
        for (int k = 0; k < 3; ++k) {
            const std::size_t at = 3 * (first + i) + k;
            const float c = float(double(sum[3 * i + k]) * (1.0 / 4294967296.0));
            const float s = hit ? shoulder(c * exposure) : c;  // background as it is given
            total[at] = passes > 1 ? total[at] + c : c;
            shown[at] = passes > 1 ? shown[at] + s : s;
            color[at] = total[at] / float(passes);
            picture[at] = display(shown[at] / float(passes));
        }
    }
};

}  // namespace globule::core
