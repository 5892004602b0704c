// Which pairs of one body the density solve sees.  Springs: all but those whose bond was cut.  Solids: only those that
// cuts have parted; the body's stress acts between the others.
#pragma once
#include "sim/couple.hpp"

namespace globule::core::tissue {

/// Pairs whose bond was cut leave each other's neighbor lists: no density across a cut.
template <class Packet> struct Veto {
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

/// Whether cuts have taken every way from t to o along one bond, or two.  Pairs without such a way from the beginning
/// are not parted. The same from both ends.
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

/// Pairs of one solid body leave its lists: the body's stress acts between them, and the density solve would act once
/// more.  What they are of the density stays, as at rest, so that others meet a body of full density.
///
/// Parted pairs stay, as those of two bodies.  But faces of a fresh cut lie together as they did before it, and what is
/// strained is denser than at rest: it would fly apart.  Until faces slide (FindContacts), cut bonds alone keep them
/// apart, and parted pairs do not count.  From then on, a particle is spared the density that it has too much, as long
/// as it has it.
///
/// Which pairs are parted takes hundreds of loads each, and only rows beside a cut ask: they are listed, and taken by a
/// group of lanes each.
template <class Packet> struct OwnPairs {
    sim::Lists<Packet> lists;
    sim::State state;
    Members members;
    const Quad* rest;
    const std::uint32_t* body;
    float reach2;  ///< squared, at rest

    GB_FN std::uint32_t member(std::size_t row) const { return members(state.id[lists.rows[row]]); }
    /// The tissue particle in slot j, where it is of t's body.
    GB_FN std::uint32_t other(std::uint32_t j, std::uint32_t t) const {
        const std::uint32_t o = j < lists.n ? members(state.id[j]) : kNobody;
        return o != kNobody && body[o] == body[t] ? o : kNobody;
    }
    GB_FN float apart2(std::uint32_t t, std::uint32_t o) const {
        const float3 r = rest[o].xyz() - rest[t].xyz();
        return dot(r, r);
    }

    /// fn(k, tissue particle) of each of n neighbors that is of t's body, until it returns false; false then.  Each
    /// takes loads that wait for the one before: those of some neighbors go side by side.
    template <class Fn> GB_FN bool each_of_body(std::size_t row, std::uint32_t t, std::uint32_t n, const Fn& fn) const {
        constexpr std::uint32_t kAtOnce = 8;
        const std::uint32_t mine = body[t];
        for (std::uint32_t k = 0; k < n; k += kAtOnce) {
            std::uint32_t j[kAtOnce], o[kAtOnce], its[kAtOnce];
            for (std::uint32_t m = 0; m < kAtOnce; ++m) j[m] = lists.index[lists.at(row, min(k + m, n - 1))];
            for (std::uint32_t m = 0; m < kAtOnce; ++m) o[m] = members(state.id[min(j[m], lists.n - 1)]);
            for (std::uint32_t m = 0; m < kAtOnce; ++m) its[m] = body[o[m] != kNobody ? o[m] : t];
            for (std::uint32_t m = 0; m < kAtOnce; ++m)
                if (k + m < n && j[m] < lists.n && o[m] != kNobody && its[m] == mine && !fn(k + m, o[m])) return false;
        }
        return true;
    }
};

/// Rows away from cuts; the others are listed.
template <class Packet> struct LeaveOut {
    OwnPairs<Packet> pairs;
    const std::uint8_t* scarred;  ///< null: nobody
    sim::Spline spline;
    float volume;
    float* within;                     ///< density, per row; not 0
    std::uint32_t *n_beside, *beside;  ///< rows beside cuts, in any order
    GB_FN void operator()(std::size_t row) const {
        const sim::Lists<Packet>& lists = pairs.lists;
        const std::uint32_t t = pairs.member(row), n = lists.count[row];
        if (t == kNobody) return;
        if (scarred && is_beside(row, t, n)) {
            beside[atomic_take(n_beside, 1)] = std::uint32_t(row);
            return;
        }
        float sum = 0.0f;
        pairs.each_of_body(row, t, n, [&](std::uint32_t k, std::uint32_t o) {
            const float r2 = pairs.apart2(t, o);
            if (!(r2 < pairs.reach2)) return true;
            sum += volume * spline(sqrt(r2));
            lists.index[lists.at(row, k)] = lists.n;
            return true;
        });
        within[row] = sum;
    }
    GB_FN bool is_beside(std::size_t row, std::uint32_t t, std::uint32_t n) const {
        return scarred[t] ||
               !pairs.each_of_body(row, t, n, [&](std::uint32_t, std::uint32_t o) { return !scarred[o]; });
    }
};

/// Rows beside cuts: a lane to each pair.  The sums are in the lists' order.
template <class Packet> struct LeaveOutBeside {
    template <class Group> struct Scratch { float within[Group::width], across[Group::width]; };
    OwnPairs<Packet> pairs;
    Bonds bonds;  ///< spared: that density, or kNotSlid
    sim::Period period;
    sim::Spline spline;
    float volume;
    float* within;  ///< density, per row; not 0
    const std::uint32_t* beside;

    template <class Group> GB_FN void operator()(Group& g, Scratch<Group>& s, std::size_t item) const {
        const std::size_t row = beside[item];
        const std::uint32_t t = pairs.member(row), n = pairs.lists.count[row];
        float sum = 0.0f, across = 0.0f;
        for (std::uint32_t first = 0; first < n; first += Group::width) {
            const int m = int(min(n - first, std::uint32_t(Group::width)));
            g.share(m, [&](int l) { take(row, t, first + std::uint32_t(l), s.within[l], s.across[l]); });
            for (int l = 0; l < m; ++l) sum += s.within[l], across += s.across[l];
            g.sync();
        }
        if (g.is_first()) within[row] = across > 0.0f ? spare(t, sum, across) : sum;
    }

private:
    /// What a pair is of the density: within the body, or across a cut.
    GB_FN void take(std::size_t row, std::uint32_t t, std::uint32_t k, float& inside, float& across) const {
        inside = across = 0.0f;
        const sim::Lists<Packet>& lists = pairs.lists;
        std::uint32_t& j = lists.index[lists.at(row, k)];
        const std::uint32_t o = pairs.other(j, t);
        if (o == kNobody) return;
        const float r2 = pairs.apart2(t, o);
        const bool far = !(r2 < pairs.reach2);
        if (far && !bonds.scarred[t]) return;
        if (far || parted(bonds, t, o)) {
            const sim::State& state = pairs.state;
            const float3 now =
                period.template shortest<true>(state.place[lists.rows[row]].xyz() - state.place[j].xyz());
            across = volume * spline(length(now));
            return;
        }
        inside = volume * spline(sqrt(r2));
        j = lists.n;
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
