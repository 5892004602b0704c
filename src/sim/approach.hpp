// How fast a fluid meets what is around it: a drop that falls through the air, or moves along with its stream, needs no
// shorter steps for that.  Speeds alone cannot tell, since they change with the coordinate frame.
#pragma once
#include "exec/bits.hpp"
#include "octree/query.hpp"
#include "sim/sizes.hpp"

namespace globule::core::sim {

/// The step that is ahead if nothing is too fast for it, and how far a particle may move in a step where others stand
/// still.
struct Ahead { float dt = 0.0f, far = 0.0f; };

/// The speed that limits the next step, far / speed, of each particle.  Of tissue and of what is slow, its own.  Of a
/// fluid, what the worst of its pairs allows: two may move by 2 far towards each other, as two that move at full speed
/// could; those further apart until they are a spacing from each other.  Positions are those of the tree.  A spacing of
/// a pair is the mean of both; speeds of what is smaller count as so much faster.
struct OwnSpeed {
    State state;
    const Phase* phases;
    Sizes sizes;
    Ahead ahead;
    float* speed2;
    std::uint32_t *n_fast, *fast;  ///< those whose pairs are to be looked at, in any order

    GB_FN void operator()(std::size_t i) const {
        const float3 v = state.velocity[i].xyz() * (1.0f / sizes.at(i));
        const float slow = ahead.far / ahead.dt;
        const Kind kind = phases[state.phase[i]].kind;
        const float as = kind == Kind::tissue ? state.growth[i] : 0.0f;
        speed2[i] = max(dot(v, v), as * as);
        if (speed2[i] > slow * slow && kind == Kind::fluid) fast[atomic_take(n_fast, 1)] = std::uint32_t(i);
    }
};

/// A group of lanes for each of the fast: they are few, and one thread alone would keep all others waiting.
struct Approach {
    struct Nothing {};
    template <class Group> using Scratch = Nothing;

    Tree tree;
    State state;
    Sizes sizes;
    Ahead ahead;
    float spacing;
    const std::uint32_t* fast;
    float* speed2;

    template <class Group> GB_FN void operator()(Group& g, Nothing&, std::size_t k) const {
        const std::uint32_t i = fast[k];
        const float3 v = state.velocity[i].xyz(), x = state.place[i].xyz(), to = x + v * ahead.dt;
        const float3 lo{min(x.x, to.x), min(x.y, to.y), min(x.z, to.z)},
            hi{max(x.x, to.x), max(x.y, to.y), max(x.z, to.z)};
        typename Group::F counts = typename Group::F(ahead.far / ahead.dt);
        for_each_leaf(g, tree, lo, hi, [&](std::uint32_t begin, std::uint32_t n) {
            for (std::uint32_t at = 0; at < n; at += Group::width)
                g.per_lane(g.first_lanes(int(n - at)), [&](int lane) {
                    Group::put(
                        counts, lane, max(Group::get(counts, lane), pair(x, v, i, begin + at + g.lane_number(lane))));
                });
        });
        const float all = g.largest(counts);
        if (g.is_first()) speed2[i] = min(all * all, speed2[i]);
    }
    GB_FN float pair(const float3& x, const float3& v, std::uint32_t i, std::uint32_t j) const {
        const float per_mean = 2.0f / (sizes.at(i) + sizes.at(j));
        const float3 r = (state.place[j].xyz() - x) * per_mean, u = (v - state.velocity[j].xyz()) * per_mean;
        const float w = length(u), distance = length(r);
        if (w * ahead.dt <= 2.0f * ahead.far) return 0.0f;
        if (distance < 2.0f * spacing) return 0.5f * w;
        const float3 missed = r - u * min(max(dot(r, u) / (w * w), 0.0f), ahead.dt);
        return length(missed) < spacing ? w * ahead.far / max(distance - spacing, ahead.far) : 0.0f;
    }
};

}  // namespace globule::core::sim
