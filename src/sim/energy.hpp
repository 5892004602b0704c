// Sums over the moved particles: mass, momenta, energies.  float64, in an order that no thread count changes.
#pragma once
#include "sim/sizes.hpp"

namespace globule::core::sim {

struct Totals { double mass = 0, kinetic = 0, potential = 0, momentum[3] = {}, angular[3] = {}, center[3] = {}; };
struct TotalsOf {
    State state;
    const std::uint32_t* rows;
    Sizes sizes;
    float volume;  ///< of a particle of size 1
    float3 gravity;
    GB_FN Totals operator()(std::size_t row) const {
        const std::uint32_t i = rows[row];
        const Quad p = state.place[i], v = state.velocity[i];
        Totals t;
        if (!(p.w < 0.0f)) return t;
        const double m = -double(volume * sizes.volume(i)) / p.w;
        t.mass = m;
        t.kinetic = 0.5 * m * (double(v.x) * v.x + double(v.y) * v.y + double(v.z) * v.z);
        t.potential = -m * (double(gravity.x) * p.x + double(gravity.y) * p.y + double(gravity.z) * p.z);
        const double x[3] = {p.x, p.y, p.z}, u[3] = {v.x, v.y, v.z};
        for (int k = 0; k < 3; ++k) {
            t.momentum[k] = m * u[k];
            t.center[k] = m * x[k];
            t.angular[k] = m * (x[(k + 1) % 3] * u[(k + 2) % 3] - x[(k + 2) % 3] * u[(k + 1) % 3]);
        }
        return t;
    }
};
struct AddTotals {
    GB_FN Totals operator()(Totals a, const Totals& b) const {
        a.mass += b.mass;
        a.kinetic += b.kinetic;
        a.potential += b.potential;
        for (int k = 0; k < 3; ++k) {
            a.momentum[k] += b.momentum[k];
            a.angular[k] += b.angular[k];
            a.center[k] += b.center[k];
        }
        return a;
    }
};

}  // namespace globule::core::sim
