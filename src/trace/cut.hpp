// Rays through what the clips keep of a layer, to its surface or to a cut face.
#pragma once
#include "trace/clip.hpp"
#include "trace/cell_tracer.hpp"

namespace globule::core {

/// Where a ray meets one layer, while that is being found out.
struct LayerHits {
    float* t;           ///< infinity: nowhere; of undecided rays: only float64 can tell from there on
    std::int32_t* cap;  ///< the clip whose cut face it is, -1: the surface itself; null: never
    std::int8_t*
        sign;  ///< +1: outside before t, or where it is undecided; -1: inside; 0: only float64 can tell; null: not kept
    std::uint32_t* item;  ///< of a solid: 2 * item, and 1 where the ray enters
    UndecidedRays undecided{};
};

/// A tracer that goes through what the clips keep; rays that meet none have launches of their own, with fewer
/// registers.
template <class Tracer, bool clipped> struct Cut {
    Tracer tracer;
    Clips clips;

    /// Whether the medium is at a point of the ray.
    GB_FN_APART bool holds(const float3& o, const float3& d, float t) const {
        const CellWalk walk(*tracer.cells.grid, o, d, t);
        if (!walk.inside() || walk.distance() > t) return false;
        bool whole_brick;
        const CellList list = tracer.list_of(walk, whole_brick);
        if (list.n == 0 && list.first != kUnlisted) return list.first == kFull;
        if (list.n == 0) return holds_by_tree(o + d * t);
        const Limits<float> none{};
        return tracer.source(list, tracer.in_cell(walk, o), d).template at<false>(0.0f, none).f > tracer.tau;
    }
    GB_FN_APART bool holds_by_tree(const float3& p) const {
        float f = 0.0f;
        for_each_reaching(
            tracer.tree, tracer.particles, p, [&](std::uint32_t j, const float3& v, const SortedShape<float>& shape) {
                f += influence(tracer.kernel, shape, v, Tracer::PerParticle ? tracer.particles.weight[j] : 1.0f).value;
            });
        return f > tracer.tau;
    }

    /// A ray's way through the kept intervals.
    struct State {
        CellRay ray;
        float to, end;     ///< of the whole ray, of the present interval
        std::int32_t cap;  ///< where a cut face was met, its clip, else -1; on the way, the clip at the interval's end
    };
    GB_FN Way start(State& s, const float3& o, const float3& d, float from, float to, float sign) const {
        s.to = s.end = to;
        s.cap = -1;
        if (tracer.tree.empty()) return Way::missed;
        if constexpr (clipped)
            return sign != 0.0f && begins_at_face(s, o, d, from, sign) ? Way::crossed
                                                                       : next_interval(s, o, d, from, sign);
        tracer.start(s.ray, o, d, from, to, sign);
        return Way::on;
    }
    /// As CellTracer::advance; the distance is in s.ray.t, the clip of a cut face in s.cap.
    GB_FN Way advance(State& s, bool active) const {
        const Way way = tracer.advance(s.ray, active);
        if (!clipped || !active || way == Way::on) return way;
        if (way != Way::missed) {
            s.cap = -1;
            return way;
        }
        if (s.end >= s.to) return Way::missed;
        if (s.ray.sign < 0.0f) {  // out through a cut face
            s.ray.t = s.end;
            return Way::crossed;
        }
        return next_interval(s, s.ray.o, s.ray.walk.d, s.end, 1.0f);
    }

private:
    /// A clip may cut several layers: whether the surface that a ray begins at, of another layer, lies in a cut face of
    /// this one, which the ray passes too.
    GB_FN_APART bool begins_at_face(State& s, const float3& o, const float3& d, float from, float sign) const {
        const float beside = kStart * tracer.tree.header->typical_support, before = from - 2.0f * beside;
        float begin, end;
        int at_begin, at_end;
        if (!clips.next(o, d, before, begin, end, at_begin, at_end)) return false;
        const bool leaves = begin == before && end <= from, enters = begin > before && begin <= from && end > from;
        if (sign < 0.0f ? !leaves : !(enters && holds(o, d, from))) return false;
        s.ray.o = o;
        s.ray.walk.d = d;
        s.ray.t = max(sign < 0.0f ? end : begin, from - beside);
        s.ray.sign = sign;
        s.cap = sign < 0.0f ? at_end : at_begin;
        return true;
    }
    GB_FN_APART Way next_interval(State& s, const float3& o, const float3& d, float from, float sign) const {
        float begin, end;
        int at_begin, at_end;
        if (!clips.next(o, d, from, begin, end, at_begin, at_end) || begin >= s.to) return Way::missed;
        if (begin > from) {
            if (holds(o, d, begin)) {  // before the tracer has seen this ray
                s.ray.o = o;
                s.ray.walk.d = d;
                s.ray.t = begin;
                s.ray.sign = 1.0f;
                s.cap = at_begin;
                return Way::crossed;
            }
            sign = 1.0f;
        }
        s.end = min(end, s.to);
        s.cap = at_end;
        tracer.start(s.ray, o, d, begin, s.end, sign);
        return Way::on;
    }
};

}  // namespace globule::core
