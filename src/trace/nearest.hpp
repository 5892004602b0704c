// From a wave's rays to its hits: the nearest of all layers and the ground, and what it looks like.
#pragma once
#include "trace/cut.hpp"
#include "trace/looks.hpp"
#include "trace/wave_rays.hpp"

namespace globule::core {

/// Rays to their first crossing of one layer. A work that begins with `cut.start`.
template <class Tracer, bool clipped> struct ToCrossing {
    Cut<Tracer, clipped> cut;
    LayerHits out;
    struct State {
        typename Cut<Tracer, clipped>::State of;
        Way way;
        std::size_t i;
    };
    GB_FN bool advance(State& s, bool active) const {
        const Way way = cut.advance(s.of, active && s.way == Way::on);
        if (active && s.way == Way::on) s.way = way;
        return active && s.way == Way::on;
    }
    GB_FN void end(const State& s) const {
        out.t[s.i] = s.way == Way::missed ? infinity() : s.of.ray.t;
        if (s.way == Way::doubtful) out.undecided.add(s.i);
        out.cap[s.i] = s.way == Way::crossed ? s.of.cap : -1;
        out.sign[s.i] = std::int8_t((s.of.ray.sign > 0.0f) - (s.of.ray.sign < 0.0f));
    }
};

/// The rays of a wave.
template <class Tracer, bool clipped> struct March : ToCrossing<Tracer, clipped> {
    WaveRays rays;
    int layer;
    using State = typename ToCrossing<Tracer, clipped>::State;
    GB_FN bool begin(std::size_t k, State& s) const {
        s.i = rays.source.swizzled(k);
        if (s.i >= rays.source.n) return false;
        float3 o, d;
        rays.source.get(s.i, o, d);
        const float sign = rays.primary() ? 0.0f : rays.inside[s.i] >> layer & 1 ? -1.0f : 1.0f;
        s.of.ray.sign = 1.0f;
        s.way = this->cut.start(s.of, o, d,
            rays.primary() ? 0.0f : kStart * this->cut.tracer.tree.header->typical_support, infinity(), sign);
        return true;
    }
};

/// What Keep asks about the surface of a field.
template <class Tracer> struct FieldSurface {
    Tracer tracer;
    Attributes attributes;
    bool exact =
        true;  ///< crossings are moved to where float64 has them; false: a tracer of another kind has found them
    GB_FN Looks looks(const float3& o, const float3& d, float& t, const LayerHits& found, std::size_t i) const {
        return looks_at(tracer, attributes, o, d, t, exact && !(found.cap && found.cap[i] >= 0));
    }
    GB_FN static float3 normal(const Looks& looks) { return normalize(looks.gradient) * -1.0f; }
};

/// The nearest of the layers so far, and what it looks like.
template <class Surface> struct Keep {
    Surface surface;
    Clips clips;
    WaveRays rays;
    int layer;
    LayerHits found;
    WaveHits out;
    GB_FN void operator()(std::size_t k) const {
        const std::size_t i = rays.source.swizzled(k);
        if (i >= rays.source.n) return;
        if (rays.primary() && layer == 0) rays.inside[i] = 0;
        float t = found.t[i];
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
        if (!(t < infinity())) return;
        float3 o, d;
        rays.source.get(i, o, d);
        const Looks looks = surface.looks(o, d, t, found, i);  // may move t a little
        if (!(t < out.t[i])) return;
        const std::int32_t cap = found.cap ? found.cap[i] : -1;
        const float3 normal = cap < 0 ? surface.normal(looks) : clips.clips[cap].normal(o + d * t);
        if (rays.primary() && !found.sign && dot(normal, d) > 0.0f) rays.inside[i] |= 1u << layer;
        out.t[i] = t;
        out.layer[i] = std::uint32_t(layer);
        write3(out.normal, i, normal);
        write3(out.albedo, i, looks.color);
        out.reflection[i] = looks.reflection;
        out.refraction[i] = looks.refraction;
        out.wetness[i] = looks.wetness;
    }
};

/// The ground, which lies behind all layers in the order of tests.
struct MeetGround {
    Ground ground;
    WaveRays rays;
    WaveHits out;
    int margin;  ///< around a share's own pixels
    GB_FN void operator()(std::size_t i) const {
        if (!rays.source.has(i, margin)) return;
        float3 o, d;
        rays.source.get(i, o, d);
        if (rays.primary() && dot(ground.normal, o) < ground.offset) rays.inside[i] |= kBelowGround;
        const float t = ground.meet(o, d, rays.inside[i]);
        if (!(t < out.t[i])) return;
        const float3 p = o + d * t;
        float3 s, u;
        tangents(ground.normal, s, u);
        const bool odd =
            ground.field > 0.0f && (int(floorf(dot(p, s) / ground.field)) + int(floorf(dot(p, u) / ground.field))) & 1;
        out.t[i] = t;
        out.layer[i] = kGround;
        write3(out.normal, i, ground.normal);
        write3(out.albedo, i, odd ? ground.other : ground.color);
        out.reflection[i] = ground.reflection;
        out.refraction[i] = 0.0f;
        out.wetness[i] = 0.0f;
    }
};

}  // namespace globule::core
