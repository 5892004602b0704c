// What a picture needs: particles known by their rank among the ids that are left, phases as colors.
#pragma once
#include "sim/state.hpp"

namespace globule::core::sim {

struct IsThere {
    const std::uint32_t* slot_of;
    std::uint32_t n;
    std::uint32_t* flags;
    GB_FN void operator()(std::size_t id) const { flags[id] = id < n && slot_of[id] != kGone; }
};

struct Show {
    State state;
    const Phase* phases;
    const std::uint32_t* rank;  ///< of each id
    std::uint32_t* index;       ///< per slot
    float* weight;              ///< per slot; null: all are shown
    float *places, *fluids,
        *things;   ///< by rank (n, 3): places of those that a surface is of, NaN for the others; null: not asked for
    bool apart;    ///< fluids and things are not in `places`
    float* color;  ///< by rank
    float *reflection, *refraction;
    GB_FN void operator()(std::size_t i) const {
        const Phase& p = phases[state.phase[i]];
        const std::uint32_t r = rank[state.id[i]];
        index[i] = r;
        if (weight) weight[i] = p.shown ? 1.0f : 0.0f;
        const Quad& at = state.place[i];
        const float place[3] = {at.x, at.y, at.z};
        const bool fluid = p.kind == Kind::fluid, thing = !fluid && p.kind != Kind::tissue;
        for (int k = 0; k < 3; ++k) {
            color[3 * std::size_t(r) + k] = p.color[k];
            const auto put = [&](float* all, bool is_of) {
                if (all) all[3 * std::size_t(r) + k] = p.shown && is_of ? place[k] : NAN;
            };
            put(places, !apart || p.kind == Kind::tissue);
            put(fluids, fluid);
            put(things, thing);
        }
        if (reflection) {
            reflection[r] = p.reflection;
            refraction[r] = p.refraction;
        }
    }
};

}  // namespace globule::core::sim
