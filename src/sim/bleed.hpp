// Vessels: cut ends that let blood out where there is room, and blood that stains what it wets.
#pragma once
#include "octree/query.hpp"
#include "sim/couple.hpp"

namespace globule::core::tissue {

inline constexpr int kMaxVessels = 32;

/// Speed of the blood that leaves each vessel's cut ends, m/s: its pressure times its conductance; 0 where
/// the pool is empty.  Number 0 is no vessel.
struct Vessels { float speed[kMaxVessels + 1] = {}; };

/// Where a particle of blood comes out, and of which particle's end.
struct Drop {
    float3 at, velocity;
    std::uint32_t t, vessel;
};

/// Collects the blood of each cut end, and lets it seep along the faces of cuts, from particle to particle: where a cut
/// does not gape, it comes out at the lips.
/// A plane that cuts an area A of a lattice breaks 5 A / d² bonds, and both ends bleed: d² / 10 for each, d the
/// tissue's spacing.
struct Seep {
    Bonds bonds;
    const std::uint8_t* hold;
    Vessels vessels;
    float spacing, dt;
    const float* volume;
    const std::uint8_t* vessel;  ///< whose blood it is; 0: none
    float* next_volume;
    std::uint8_t* next_vessel;
    std::uint8_t* open;  ///< per vessel, cleared: whether any end of it is

    static constexpr float kRate = 10.0f;  ///< 1/s, of a difference to one neighbor; and
    static constexpr float kMost = 0.05f;  ///< in a step: 18 neighbors take less than all
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        const float own = volume[t], whole = spacing * spacing * spacing;
        float flow = 0.0f, gain = 0.0f, most = 0.0f;
        std::uint8_t whose = vessel[t], theirs = 0;
        if (bonds.scarred[t] && hold[t] != kGone)
            for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
                const std::uint32_t o = bonds.other[e];
                if (bonds.length[e] == 0.0f || !bonds.scarred[o] || hold[o] == kGone) continue;
                gain += volume[o] - own;
                if (volume[o] > most && vessel[o]) most = volume[o], theirs = vessel[o];
                if (!(bonds.length[e] < 0.0f) || vessels.speed[bonds.vessel[e]] <= 0.0f) continue;
                whose = bonds.vessel[e];
                flow += 0.1f * spacing * spacing * vessels.speed[whose];
                raise_flag(&open[whose]);
            }
        next_volume[t] = own + max(min(flow * dt, 2.0f * whole - own), 0.0f) + min(kRate * dt, kMost) * gain;
        next_vessel[t] = whose ? whose : theirs;
    }
};
/// Who has one particle's worth, with what lies on the cut's faces around it, asks for room.  What it gives before that
/// has come is less than none until then.
struct Bleed {
    Bonds bonds;
    const Quad* at;
    const std::uint8_t* hold;
    Vessels vessels;
    float each;  ///< volume of a particle of blood
    const float* volume;
    const std::uint8_t *vessel, *open;
    std::uint32_t* n_asking;
    Drop* asking;  ///< in any order; velocity: the way outwards

    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        if (!(volume[t] > 0.0f) || hold[t] == kGone || !open[vessel[t]]) return;
        float3 inwards{0, 0, 0};
        float here = volume[t];
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
            const std::uint32_t o = bonds.other[e];
            if (bonds.length[e] > 0.0f) inwards = inwards + normalize(at[o].xyz() - at[t].xyz());
            if (bonds.length[e] != 0.0f && hold[o] != kGone) here += volume[o];
        }
        if (here >= each) asking[atomic_take(n_asking, 1)] = {at[t].xyz(), normalize(inwards) * -1.0f, t, vessel[t]};
    }
};

/// The nearest free place around each end that asks, in any order.  A group of lanes for each: one thread alone waits
/// for memory longer than the rest of the step takes.
struct FindRoom {
    struct Nothing {};
    template <class Group> using Scratch = Nothing;

    Tree tree;
    SortedParticles particles;
    const Drop* asking;
    const Quad* velocity;  ///< of the tissue
    Vessels vessels;
    sim::Sizes sizes;
    float spacing;  ///< of the tissue
    float blood;    ///< size of its particles
    std::uint32_t* n_found;
    Drop* found;

    template <class Group> GB_FN void operator()(Group& g, Nothing&, std::size_t k) const {
        const Drop end = asking[k];
        const std::uint32_t free = free_ways(g, end.at, end.velocity);
        if (free == 0 || !g.is_first()) return;
        const float3 way = direction(trailing_zeros(std::uint64_t(free)), end.velocity);
        found[atomic_take(n_found, 1)] = {
            end.at + way * spacing, velocity[end.t].xyz() + way * vessels.speed[end.vessel], end.t, end.vessel};
    }
    static constexpr int kWays = 15;
    /// Spacings to others.  Amid eight particles of a lattice, fine blood would have 0.87 and be shut in.
    static constexpr float kRoom = 0.85f, kRoomOfFine = 0.9f;
    /// Outwards, then faces' and corners' directions of a cube.
    GB_FN static float3 direction(int k, const float3& outwards) {
        if (k-- == 0) return outwards;
        if (k < 6) {
            const float s = k % 2 ? -1.0f : 1.0f;
            return {k / 2 == 0 ? s : 0.0f, k / 2 == 1 ? s : 0.0f, k / 2 == 2 ? s : 0.0f};
        }
        const float a = 0.57735027f;
        return {k & 1 ? a : -a, k & 2 ? a : -a, (k - 6) & 4 ? a : -a};
    }
    /// A bit for each way whose place, a spacing from x, has room: one walk of the tree for all.
    template <class Group> GB_FN std::uint32_t free_ways(Group& g, const float3& x, const float3& outwards) const {
        using F = typename Group::F;
        const float room = (blood < 1.0f ? kRoomOfFine : kRoom) * spacing, reach = 1.001f * (spacing + room);
        const float inner = reach - 2.0f * spacing;  // the boxes of the tree's leaves stand off by the support
        const float3 r{inner, inner, inner};
        std::uint32_t free = (1u << kWays) - 1;
        for_each_leaf(g, tree, x - r, x + r, [&](std::uint32_t begin, std::uint32_t n) {
            for (std::uint32_t at = 0; at < n && free != 0; at += Group::width) {
                const F px = g.load_run(particles.x + begin + at), py = g.load_run(particles.y + begin + at),
                        pz = g.load_run(particles.z + begin + at);
                F apart = F(room);
                if (sizes.of)
                    apart = select(g.load_run(sizes.of + begin + at) < F(1.0f), F(kRoom * blood * spacing), apart);
                const auto within = [&](const float3& p, const F& far) {
                    const F dx = px - F(p.x), dy = py - F(p.y), dz = pz - F(p.z);
                    return g.any(g.first_lanes(int(n - at)) & (dx * dx + dy * dy + dz * dz < far * far));
                };
                if (!within(x, F(reach))) continue;
                for (int k = 0; k < kWays; ++k)
                    if (within(x + direction(k, outwards) * spacing, apart)) free &= ~(1u << k);
            }
        });
        return free;
    }
};

struct Spend {
    const std::uint32_t* who;
    float* volume;
    float each;
    GB_FN void operator()(std::size_t k) const { volume[who[k]] -= each; }
};

/// Blood touches the tissue within reach.
template <class Packet> struct Touch {
    sim::Lists<Packet> lists;
    sim::State state;
    Members members;
    std::uint32_t stains;  ///< bit of each phase that is blood
    float reach;
    std::uint8_t* touched;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t s = lists.rows[row];
        if (!(stains >> state.phase[s] & 1)) return;
        for (std::uint32_t k = 0; k < lists.count[row]; ++k) {
            const std::uint32_t j = lists.index[lists.at(row, k)];
            if (j >= lists.n) continue;
            const float3 r = state.place[j].xyz() - state.place[s].xyz();
            const std::uint32_t t = members(state.id[j]);
            if (t != kNobody && dot(r, r) < reach * reach) raise_flag(&touched[t]);
        }
    }
};
/// Tissue that blood touches gets wet within a fifth of a second and dries within minutes.
struct Wet {
    const std::uint8_t* touched;
    float dt;
    float* wetness;
    GB_FN void operator()(std::size_t t) const {
        wetness[t] = min(max(wetness[t] + (touched[t] ? 5.0f : -0.005f) * dt, 0.0f), 1.0f);
    }
};
/// Wet tissue shows the blood's color through its own.
struct Stain {
    const std::uint32_t *id, *slot_of, *rank;
    const float* wetness;
    float3 blood;
    float *color, *shown_wetness;
    GB_FN void operator()(std::size_t t) const {
        if (id[t] == kNobody || slot_of[id[t]] == sim::kGone || wetness[t] <= 0.0f) return;
        shown_wetness[rank[id[t]]] = wetness[t];
        float* c = color + 3 * std::size_t(rank[id[t]]);
        const float share = kWetShare * wetness[t];
        c[0] += share * (blood.x - c[0]);
        c[1] += share * (blood.y - c[1]);
        c[2] += share * (blood.z - c[2]);
    }
};

}  // namespace globule::core::tissue
