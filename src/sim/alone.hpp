// Tissue that has nobody in its list: matter inside of a solid, whose own pairs are not there.  No pressure acts on it,
// and the solves go without it; most of a brain is of that kind.
#pragma once
#include "sim/density.hpp"

namespace globule::core::sim {

/// 1 for the rows that stay.
template <class Packet> struct FlagTouching {
    Lists<Packet> lists;
    State state;
    const Phase* phases;
    std::uint32_t* flags;  ///< (rows + 1,)
    GB_FN void operator()(std::size_t row) const {
        flags[row] = 0;
        if (row >= lists.n_rows) return;
        bool touches = phases[state.phase[lists.rows[row]]].kind != Kind::tissue;
        for (std::uint32_t k = 0, n = lists.count[row]; k < n && !touches; ++k)
            touches = lists.index[lists.at(row, k)] < lists.n;
        flags[row] = touches;
    }
};

/// Their lists, one after the other and without gaps, in their order; behind the last one nobody, as far as a packet
/// may read.
template <class Packet> struct KeepTouching {
    Lists<Packet> from, to;
    const std::uint32_t* before;  ///< how many of the rows before each stay
    const float* within;
    std::uint32_t* rows;
    float* kept_within;
    GB_FN void operator()(std::size_t i) const {
        const bool is_row = i < from.n_rows;
        if (is_row && before[i + 1] == before[i]) return;
        const std::size_t row = is_row ? before[i] : before[from.n_rows] + (i - from.n_rows);
        rows[row] = is_row ? from.rows[i] : from.n;
        if (!is_row && row >= (to.n_rows + 63) / 64 * 64) return;
        std::uint32_t n = 0;
        for (std::uint32_t k = 0, all = is_row ? from.count[i] : 0; k < all; ++k)
            if (const std::uint32_t j = from.index[from.at(i, k)]; j < from.n) to.index[to.at(row, n++)] = j;
        to.count[row] = n;
        for (; n < to.places; ++n) to.index[to.at(row, n)] = to.n;
        kept_within[row] = is_row ? within[i] : 0.0f;
    }
};

/// What the others feel: gravity, and what the user asked for.
struct Fall {
    const std::uint32_t *rows, *before;
    State state;
    float3 gravity;
    const float* forces;  ///< (n, 3) by slot, or null
    float per_volume, dt;
    GB_FN void operator()(std::size_t row) const {
        if (before[row + 1] > before[row]) return;
        const std::uint32_t slot = rows[row];
        float3 a = gravity;
        if (forces) {
            const float* f = forces + 3 * std::size_t(slot);
            a = a + float3{f[0], f[1], f[2]} * (per_volume * max(-state.place[slot].w, 0.0f));
        }
        Quad& v = state.velocity[slot];
        v = {v.x + dt * a.x, v.y + dt * a.y, v.z + dt * a.z, v.w};
        state.pressure[slot] = state.divergence_impulse[slot] = 0.0f;
    }
};

}  // namespace globule::core::sim
