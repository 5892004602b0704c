// Rays of a wave whose particles lie elsewhere, from the outside: as arrays that the host sends to the pieces that hold
// the particles (docs/design/pieces.md), and what a piece makes of its part of them.
#pragma once
#include "trace/nearest.hpp"
#include "trace/occlude.hpp"

namespace globule::core {

inline constexpr std::int8_t kNoRay = 2;  ///< a side that no ray has

// ---- at home: rays to arrays, answers back ----

/// The rays of a wave, and on which side of a layer each begins.
struct ListRays {
    WaveRays rays;
    int layer;
    float* ray;         ///< (n, 6) origin, direction
    std::int8_t* side;  ///< (n,) +1 outside, -1 inside, 0 not known, kNoRay
    GB_FN void operator()(std::size_t i) const {
        if (!rays.source.has(i)) {
            side[i] = kNoRay;
            return;
        }
        float3 o, d;
        rays.source.get(i, o, d);
        write3(ray, 2 * i, o);
        write3(ray, 2 * i + 1, d);
        side[i] = rays.primary() ? std::int8_t(0) : rays.inside[i] >> layer & 1 ? std::int8_t(-1) : std::int8_t(1);
    }
};

/// What Keep asks about a surface that others have found.
struct RemoteSurface {
    const float* found;  ///< (n, 8) normal, color, reflection, refraction
    GB_FN Looks looks(const float3&, const float3&, float, const LayerHits&, std::size_t i) const {
        const float* v = found + 8 * i;
        return {{v[0], v[1], v[2]}, {v[3], v[4], v[5]}, v[6], v[7]};
    }
    GB_FN static float3 normal(const Looks& looks) { return looks.gradient; }
};

/// Shadow and ambient rays of some of a wave's visibilities; those without a ray have a negative distance.
struct ListShadowRays {
    Lighting lighting;
    WaveRays rays;
    WaveHits hits;
    int layer;
    float* visibility;
    std::size_t first;  ///< of the n_visibilities * n_items
    float* ray;         ///< (items, 7) origin, direction, distance
    std::int8_t* side;
    std::uint32_t* place;  ///< in `visibility`
    GB_FN void operator()(std::size_t k) const {
        ShadowRay shadow;
        float* to = ray + 7 * k;
        to[6] = -1.0f;
        if (!shadow.start(first + k, lighting, rays, hits, layer, visibility)) return;
        const float v[7] = {shadow.o.x, shadow.o.y, shadow.o.z, shadow.d.x, shadow.d.y, shadow.d.z, shadow.distance};
        for (int j = 0; j < 7; ++j) to[j] = v[j];
        side[k] = shadow.inside >> layer & 1 ? std::int8_t(-1) : std::int8_t(1);
        place[k] = std::uint32_t(shadow.out - visibility);
    }
};
struct Dim {
    float* visibility;
    const std::uint32_t* place;
    const float* left;
    GB_FN void operator()(std::size_t k) const { visibility[place[k]] *= left[k]; }
};

// ---- at a piece: parts of rays ----

/// Parts of rays: from where, or below 0: from the surface on; to where; on which side.
struct Parts {
    const float* ray;        ///< (n, 6) origin, direction
    const float *from, *to;  ///< (n,) distances along the ray
    std::int8_t* side;       ///< (n,) in and out: +1 outside, -1 inside, 0 not known
    GB_FN void get(std::size_t i, float3& o, float3& d) const {
        const float* v = ray + 6 * i;
        o = {v[0], v[1], v[2]};
        d = {v[3], v[4], v[5]};
    }
    GB_FN float begin(std::size_t i, float typical) const { return from[i] < 0.0f ? kStart * typical : from[i]; }
};

struct SplitRays {
    const float* ray;
    float *origins, *directions;
    GB_FN void operator()(std::size_t i) const {
        for (int k = 0; k < 3; ++k) {
            origins[3 * i + k] = ray[6 * i + k];
            directions[3 * i + k] = ray[6 * i + 3 + k];
        }
    }
};

/// To the first crossing in each part.
template <class Tracer> struct MarchPart : ToCrossing<Tracer, true> {
    Parts parts;
    using State = typename ToCrossing<Tracer, true>::State;
    GB_FN bool begin(std::size_t i, State& s) const {
        s.i = i;
        float3 o, d;
        parts.get(i, o, d);
        s.of.ray.sign = 1.0f;
        s.way = this->cut.start(s.of, o, d, parts.begin(i, this->cut.tracer.tree.header->typical_support), parts.to[i],
            float(parts.side[i]));
        return true;
    }
};

/// What the crossings look like.
template <class Tracer> struct LookAtParts {
    FieldSurface<Tracer> surface;
    Parts parts;
    LayerHits found;
    float* looks;  ///< (n, 8) as RemoteSurface's
    GB_FN void operator()(std::size_t i) const {
        float& t = found.t[i];
        if (!(t < infinity() && t <= parts.to[i])) {  // past the part, which may have no end
            t = infinity();
            return;
        }
        float3 o, d;
        parts.get(i, o, d);
        const Looks at = surface.looks(o, d, t, found, i);
        write3(looks + 8 * i, 0, surface.normal(at));
        write3(looks + 8 * i, 1, at.color);
        looks[8 * i + 6] = at.reflection;
        looks[8 * i + 7] = at.refraction;
    }
};

/// Shadow rays through their parts; what is left of the light, and where each goes on.
template <class Tracer> struct OccludePart : Occlude<Tracer, true> {
    using Whole = Occlude<Tracer, true>;
    Parts parts;
    const float* distance;    ///< (n,) of the whole ray
    float *left, *on;         ///< (n,) light, in and out; where the ray goes on
    std::int32_t* crossings;  ///< (n,) in and out
    std::int8_t*
        test;  ///< (n,) in and out: whether the ray stopped in doubt, and its medium has to be looked at at `from`
    struct State : Whole::State {
        std::size_t i;
        bool tests, stops;
    };
    GB_FN bool begin(std::size_t i, State& s) const {
        const float typical = this->cut.tracer.tree.header->typical_support;
        float3 o, d;
        parts.get(i, o, d);
        s.i = i;
        s.stops = false;
        s.distance = min(distance[i], parts.to[i]);
        s.left = left[i];
        s.crossings = crossings[i];
        s.from = parts.begin(i, typical);
        s.tests = test[i];
        s.of.ray.sign = 1.0f;
        if (s.tests) {
            s.of.ray.sign = float(parts.side[i]);
            s.of.ray.o = o;
            s.of.ray.walk.d = d;
            s.of.ray.t = s.from - Whole::kDoubt * typical;
            s.way = Way::doubtful;
        } else {
            s.way = this->cut.start(s.of, o, d, s.from, s.distance, float(parts.side[i]));
        }
        return true;
    }
    GB_FN bool advance(State& s, bool active) const {
        const Way way = this->cut.advance(s.of, active && s.way == Way::on);
        if (!active) return false;
        if (s.way == Way::on) s.way = way;
        if (s.way == Way::on) return true;
        const float further = s.of.ray.t + Whole::kDoubt * this->cut.tracer.tree.header->typical_support;
        if (s.way == Way::doubtful && !s.tests && further > parts.to[s.i]) {  // another piece knows the field there
            s.left *= s.of.ray.sign < 0.0f ? this->lighting.materials[0].mean_beer(further - s.from) : 1.0f;
            s.from = further;
            s.stops = true;
            return false;
        }
        s.tests = false;
        return this->settle(s);
    }
    GB_FN void end(const State& s) const {
        left[s.i] = s.left;
        on[s.i] = max(s.from, parts.to[s.i]);
        crossings[s.i] = s.crossings;
        parts.side[s.i] = s.of.ray.sign < 0.0f ? std::int8_t(-1) : std::int8_t(1);
        test[s.i] = s.stops;
    }
};

}  // namespace globule::core
