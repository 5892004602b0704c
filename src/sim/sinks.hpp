// Sinks: regions whose fluid is taken out.
#pragma once
#include "sim/state.hpp"

namespace globule::core::sim {

/// A ball, or a box where radius is 0.
struct Sink {
    float3 lo, hi;
    float3 center;
    float radius;
    GB_FN bool holds(const float3& p) const {
        if (radius > 0.0f) {
            const float3 v = p - center;
            return dot(v, v) <= radius * radius;
        }
        return p.x >= lo.x && p.x <= hi.x && p.y >= lo.y && p.y <= hi.y && p.z >= lo.z && p.z <= hi.z;
    }
};
inline constexpr int kMaxSinks = 32;

/// Flags all but the fluid in a sink, as the octree's positions have it.
struct FlagKept {
    State state;
    const Phase* phases;
    const float* positions;
    const Sink* sinks;
    int n_sinks;
    std::uint32_t* flags;
    GB_FN void operator()(std::size_t i) const {
        flags[i] = i < state.n;
        if (i >= state.n || phases[state.phase[i]].kind != Kind::fluid) return;
        const float3 p{positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]};
        for (int k = 0; k < n_sinks; ++k)
            if (sinks[k].holds(p)) {
                flags[i] = 0;
                return;
            }
    }
};

/// Where fluid that comes in keeps its velocity: a cylinder from a disc on, along the flow.
struct Inlet {
    float3 center, direction;
    float radius, length;
    GB_FN bool holds(const float3& p) const {
        const float3 r = p - center;
        const float along = dot(r, direction);
        return along <= length && dot(r, r) - along * along <= radius * radius;
    }
};

/// Beyond its inlet, fluid is a row of the solves like any other.
struct LetGo {
    State state;
    const Phase* phases;
    const float* positions;
    const Inlet* inlets;
    int n_inlets;
    GB_FN void operator()(std::size_t i) const {
        Quad& place = state.place[i];
        const Phase& phase = phases[state.phase[i]];
        if (phase.kind != Kind::fluid || !(place.w > 0.0f)) return;
        const float3 p{positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]};
        for (int k = 0; k < n_inlets; ++k)
            if (inlets[k].holds(p)) return;
        place.w = -1.0f / phase.density;
    }
};

}  // namespace globule::core::sim
