// How fast a fluid meets what is around it: a drop that falls through the air, or moves along with its stream, needs no shorter
// steps for that.  Speeds alone cannot tell, since they change with the frame of reference.
#pragma once
#include "globule/octree/query.hpp"
#include "globule/sim/state.hpp"

namespace globule::sim {

/// The step that is ahead if nothing is too fast for it, and how far a particle may move in a step where others stand still.
struct Ahead {
    float dt = 0.0f, far = 0.0f;
};

/// The speed that limits the next step, far / speed, of each particle.  Of tissue and of what is slow, its own.  Of a fluid, what the worst of
/// its pairs allows: two may move by 2 far towards each other, as two that move at full speed could; those
/// further apart until they are a spacing from each other.  Positions are those of the tree.
template <class Tree>
struct Approach {
    Tree tree;
    State state;
    const Phase* phases;
    Ahead ahead;
    float spacing;
    float* speed2;

    GB_FN void operator()(std::size_t i) const {
        const float3 v = state.velocity[i].xyz();
        const float own = dot(v, v), slow = ahead.far / ahead.dt;
        if (own <= slow * slow || phases[state.phase[i]].kind != Kind::fluid) {
            speed2[i] = own;
            return;
        }
        const float3 x = state.place[i].xyz(), to = x + v * ahead.dt;
        const float3 lo{least(x.x, to.x), least(x.y, to.y), least(x.z, to.z)}, hi{most(x.x, to.x), most(x.y, to.y), most(x.z, to.z)};
        float counts = slow;
        for_each_touching(tree, lo, hi, [&](std::uint32_t j) { counts = most(counts, pair(x, v, j)); });
        speed2[i] = least(counts * counts, own);
    }
    GB_FN float pair(const float3& x, const float3& v, std::uint32_t j) const {
        const float3 r = state.place[j].xyz() - x, u = v - state.velocity[j].xyz();
        const float w = length(u), distance = length(r);
        if (w * ahead.dt <= 2.0f * ahead.far) return 0.0f;
        if (distance < 2.0f * spacing) return 0.5f * w;
        const float3 missed = r - u * least(most(dot(r, u) / (w * w), 0.0f), ahead.dt);
        return length(missed) < spacing ? w * ahead.far / most(distance - spacing, ahead.far) : 0.0f;
    }
};

}  // namespace globule::sim
