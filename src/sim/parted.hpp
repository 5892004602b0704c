// Which pairs of one body the density solve sees.  Springs: all but those whose bond was cut.  Solids: only those that cuts have parted;
// the body's stress acts between the others.
#pragma once
#include "sim/couple.hpp"

namespace globule::core::tissue {

/// Pairs whose bond was cut leave each other's neighbour lists: no density across a cut.
template <class Packet>
struct Veto {
    sim::Lists<Packet> lists;
    sim::State state;
    Members members;
    Bonds bonds;
    const std::uint32_t* slot;  ///< of each tissue particle
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t t = members(state.id[lists.rows[row]]);
        if (t == kNobody || !bonds.scarred[t]) return;
        const std::uint32_t n = lists.count[row];
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
            if (!(bonds.length[e] < 0.0f)) continue;
            const std::uint32_t other = slot[bonds.other[e]];
            std::uint32_t found = n;  // looked for without stores: then the loads need not wait for each other
            for (std::uint32_t k = 0; k < n; ++k)
                if (lists.index[lists.at(row, k)] == other) found = k;
            if (found < n) lists.index[lists.at(row, found)] = lists.n;
        }
    }
};

/// Whether cuts have taken every way from t to o along one bond, or two.  Pairs without such a way from the beginning are not parted.
/// The same from both ends.
GB_FN bool parted(const Bonds& bonds, std::uint32_t t, std::uint32_t o) {
    if (!bonds.scarred[t] && !bonds.scarred[o]) return false;
    const std::uint32_t end = bonds.end(t), its_end = bonds.end(o);
    bool was_one = false;
    for (std::uint32_t e = bonds.begin(t); e < end; e += kBlock) {
        if (bonds.other[e] != o) continue;
        if (bonds.length[e] > 0.0f) return false;
        was_one = true;
    }
    for (std::uint32_t e = bonds.begin(t); e < end; e += kBlock) {
        const std::uint32_t m = bonds.other[e];
        const bool whole = bonds.length[e] > 0.0f;
        if (m == t || m == o || (was_one && !whole)) continue;  // t: no bond
        for (std::uint32_t f = bonds.begin(o); f < its_end; f += kBlock) {
            if (bonds.other[f] != m) continue;
            if (whole && bonds.length[f] > 0.0f) return false;
            was_one = true;
        }
    }
    return was_one;
}

/// Pairs of one solid body leave its lists: the body's stress acts between them, and the density solve would act once more.  What they
/// are of the density stays, as at rest, so that others meet a body of full density.
///
/// Parted pairs stay, as those of two bodies.  But faces of a fresh cut lie together as they did before it, and what is strained is denser
/// than at rest: it would fly apart.  Until faces slide (FindContacts), cut bonds alone keep them apart, and parted pairs do not count.  From
/// then on, a particle is spared the density that it has too much, as long as it has it.
template <class Packet>
struct LeaveOut {
    sim::Lists<Packet> lists;
    sim::State state;
    Members members;
    Bonds bonds;                ///< spared: that density, or kNotSlid
    const Quad* rest;
    const std::uint32_t* body;
    sim::Period period;
    sim::Spline spline;
    float volume, reach2;       ///< squared, at rest
    float* within;              ///< density, per row; not 0
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = lists.rows[row], t = members(state.id[slot]);
        if (t == kNobody) return;
        float sum = 0.0f, across = 0.0f;
        const float3 here = rest[t].xyz();
        for (std::uint32_t k = 0, n = lists.count[row]; k < n; ++k) {
            std::uint32_t& j = lists.index[lists.at(row, k)];
            if (j >= lists.n) continue;
            const std::uint32_t o = members(state.id[j]);
            if (o == kNobody || body[o] != body[t]) continue;
            const float3 r = rest[o].xyz() - here;
            const float r2 = dot(r, r);
            const bool far = !(r2 < reach2);
            if (far && !bonds.scarred[t]) continue;
            if (far || parted(bonds, t, o)) {
                const float3 now = period.template shortest<true>(state.place[slot].xyz() - state.place[j].xyz());
                across += volume * spline(length(now));
                continue;
            }
            sum += volume * spline(sqrt(r2));
            j = lists.n;
        }
        within[row] = across > 0.0f ? spare(t, sum, across) : sum;
    }
    /// `sum`, changed so that the density with what is across the cut is the one that counts.
    GB_FN float spare(std::uint32_t t, float sum, float across) const {
        float& spared = bonds.spared[t];
        if (spared >= 0.0f) spared = min(spared, max(volume * spline(0.0f) + sum + across - 1.0f, 0.0f));
        const float left = sum - (spared >= 0.0f ? spared : across);
        return left != 0.0f ? left : kSolid;
    }
    static constexpr float kSolid = 1e-20f;  ///< nothing, but not 0
};

}  // namespace globule::core::tissue
