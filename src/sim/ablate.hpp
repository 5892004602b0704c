// Taking tissue away: what a suction tip or an ablating instrument removes, and the bonds that go with it.
#pragma once
#include "exec/bits.hpp"
#include "sim/bonds.hpp"

namespace globule::core::tissue {

struct TakeAway {
    const Quad* at;
    std::uint8_t* hold;
    Shape region;
    std::uint32_t* n_removed;
    GB_FN void operator()(std::size_t t) const {
        float3 out;
        if (hold[t] == kFixed || hold[t] == kGone || region.distance(at[t].xyz(), out) >= 0.0f) return;
        hold[t] = kGone;
        atomic_take(n_removed, 1);
    }
};

/// No bond is left where either end is gone, not even a contact.
struct DropBonds {
    Bonds bonds;
    const std::uint8_t* hold;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock)
            if (hold[t] == kGone || hold[bonds.other[e]] == kGone) {
                if (bonds.length[e] != 0.0f) bonds.scar(t);
                bonds.length[e] = 0.0f;
            }
    }
};

struct CountBonds {
    Bonds bonds;
    std::uint32_t* n;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        std::uint32_t whole = 0;
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock)
            whole += bonds.length[e] > 0.0f && bonds.other[e] > t;
        if (whole) atomic_take(n, whole);
    }
};

}  // namespace globule::core::tissue
