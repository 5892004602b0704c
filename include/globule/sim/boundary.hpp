// What a boundary's particle stands for, so that a single layer of them stops a fluid whatever their
// spacing (Akinci 2012).
#pragma once
#include "globule/octree/query.hpp"
#include "globule/sim/spline.hpp"
#include "globule/sim/state.hpp"

namespace globule::sim {

/// V_b = gamma / sum_b W over the boundary particles of the same phase.  gamma makes a plane of a
/// boundary as dense as a plane of the fluid's lattice, so that a lattice that touches it is at rest.
template <class Tree>
struct BoundaryVolumes {
    Tree tree;
    State state;
    const Phase* phases;
    Spline spline;
    float gamma, margin;
    GB_FN void operator()(std::size_t i) const {
        const std::uint8_t phase = state.phase[i];
        const Kind kind = phases[phase].kind;
        if (kind != Kind::boundary && kind != Kind::rigid) return;
        const Quad p = state.place[i];
        float sum = 0.0f;
        for_each_touching(tree, {p.x - margin, p.y - margin, p.z - margin}, {p.x + margin, p.y + margin, p.z + margin}, [&](std::uint32_t j) {
            if (state.phase[j] != phase) return;
            const Quad q = state.place[j];
            const float x = p.x - q.x, y = p.y - q.y, z = p.z - q.z;
            sum += spline(root(x * x + y * y + z * z));
        });
        state.place[i].w = sum > 0.0f ? gamma / sum : 0.0f;
    }
};

}  // namespace globule::sim
