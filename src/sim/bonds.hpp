// Elastic bonds that break: one pass of XPBD (Macklin 2016) per small substep (Macklin 2019), all
// bonds at once.  docs/design/tissue.md derives what is stated here.
#pragma once
#include "base/quad.hpp"
#include "exec/bits.hpp"
#include "sim/contact.hpp"
#include "sim/grasp.hpp"

namespace globule::core::tissue {

inline constexpr int kMaxPhases = 32;
inline constexpr int kBlock = 32;         ///< particles whose bonds lie interleaved
inline constexpr float kNotSlid = -1.0f;  ///< in the place of a density

/// Every bond is entered at both of its ends, so that each particle sums up its own bonds in one fixed
/// order and nobody writes to another's.  Entry k of particle t lies in its block's row k: neighboring
/// particles' entries are neighbors in memory.
struct Bonds {
    std::uint32_t n = 0;                   ///< particles, in the tissue's own order
    const std::uint32_t* first = nullptr;  ///< (n_blocks + 1,) entry where a block begins
    const std::uint32_t* other = nullptr;  ///< particle at the other end
    float* length = nullptr;               ///< at rest; negative: cut, only a contact; 0: no bond
    const float* stiffness = nullptr;      ///< 1 / compliance, N/m
    const std::uint8_t* vessel = nullptr;  ///< number of the vessel, 0: none
    std::uint8_t* scarred = nullptr;       ///< per particle: whether any of its bonds went
    float* spared = nullptr;               ///< per particle of a solid: as in OwnPairs; null: springs

    GB_FN std::uint32_t begin(std::uint32_t t) const { return first[t / kBlock] + t % kBlock; }
    GB_FN std::uint32_t end(std::uint32_t t) const { return first[t / kBlock + 1]; }

    /// The entry of the same bond at its other end.
    GB_FN std::uint32_t twin(std::uint32_t t, std::uint32_t o) const {
        std::uint32_t e = begin(o);
        while (other[e] != t) e += kBlock;
        return e;
    }
    GB_FN void set_length(std::uint32_t t, std::uint32_t e, float value) const {
        length[e] = value;
        length[twin(t, other[e])] = value;
        if (!(value < 0.0f)) return;
        scar(t);
        scar(other[e]);
    }
    GB_FN void scar(std::uint32_t t) const {
        scarred[t] = 1;
        if (spared) spared[t] = kNotSlid;
    }
};

/// What tissue of one phase does, per phase.
struct Materials {
    float damping[kMaxPhases] = {};       ///< 1/s: velocities fall by exp(-damping dt)
    float tear_strain[kMaxPhases] = {};   ///< bonds longer than (1 + this) of their rest length break; 0: never
    float yield_strain[kMaxPhases] = {};  ///< beyond it bonds creep; 0: purely elastic
    float creep_rate[kMaxPhases] = {};    ///< 1/s, share of the strain beyond the yield that becomes permanent
    float friction[kMaxPhases] = {};      ///< coefficient of what it meets
};

/// Where particles add up what instruments feel of them; the first of the arrays (2, n) is for grasps, then one for
/// each shape.
struct Felt {
    float3* felt = nullptr;  ///< null: nobody asks
    std::uint32_t n = 0;
    float3 gravity{0, 0, 0};
    GB_FN void add(int which, std::uint32_t t, const float3& impulse, const float3& arm) const {
        float3* own = felt + std::size_t(which) * 2 * n + t;
        own[0] = own[0] + impulse;
        own[n] = own[n] + cross(arm, impulse);
    }
    /// `impulse`: of the bonds.
    GB_FN void add_held(std::uint32_t t, std::uint8_t hold, const float3& x, const float3& impulse, float inverse_mass,
        float dt, const Motions& motions) const {
        if (!felt || hold < kGrasped) return;
        const float3 weight = inverse_mass > 0.0f ? gravity * (dt / inverse_mass) : float3{0, 0, 0};
        add(0, t, impulse + weight, x - motions.center[hold - kGrasped]);
    }
    /// x and u leave the shapes, which feel it.
    GB_FN void keep_out(const Shapes& shapes, std::uint32_t t, float3& x, float3& u, float inverse_mass, float friction,
        float dt) const {
        shapes.keep_out(t, x, u, friction, dt, [&](int s, const float3& change) {
            if (felt && inverse_mass > 0.0f) add(1 + s, t, change * (-1.0f / inverse_mass), x - shapes.shape[s].a);
        });
    }
};

/// One iteration over all bonds: λ of each from the same positions, positions and velocities from all λ.
///
/// With one iteration from λ = 0, XPBD's Δλ = -C / (Σw + α̃) acts like a compliance of α̃ + Σw: too soft by
/// an amount that depends on dt.  Here the first λ is -C / max(α̃, κ), where κ = p_i + p_j bounds the matrix
/// A W Aᵀ by its diagonal (p = w times the largest eigenvalue of Σ n nᵀ).  So the static stiffness is exact as
/// long as α̃ >= κ, which decides the number of substeps, and beyond that the solve stays stable and softens.
/// Later iterations, Δλ = -(C + α̃λ) / (α̃ + κ), lead to the implicit solution.
template <bool single>  ///< iteration: nothing is written among the loads of the bonds, so that they need not wait for
                        ///< each other
struct Relax {
    Bonds bonds;
    const Quad* at;  ///< predicted position, p
    Quad* next;
    Quad* velocity;  ///< velocity, inverse mass
    const float3* acceleration;
    const std::uint8_t* hold;
    const std::uint8_t* phase;
    float* lambda;  ///< per entry, where there are more
    Materials materials;
    Motions motions;
    Shapes shapes;
    Walls walls;
    Felt felt;
    float dt, contact;       ///< contact: distance that cut faces keep
    bool is_first, is_last;  ///< iteration of the substep
    bool predicts;           ///< another substep follows

    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        std::uint32_t own[Packet::width];  // rows side by side; those past the end do the last one's work again
        for (int lane = 0; lane < Packet::width; ++lane) own[lane] = min(std::uint32_t(row) + lane, bonds.n - 1);
        bool any_asks = false;
        for (int lane = 0; lane < Packet::width; ++lane)
            any_asks |= hold[own[lane]] == kFree || (felt.felt && hold[own[lane]] >= kGrasped);
        const Four<F> here = Packet::gather(at, own);
        const F zero = F(0.0f), one = F(1.0f), k_to_step = F(dt * dt), touching = F(contact);
        F x = zero, y = zero, z = zero;
        const std::uint32_t end = any_asks ? bonds.end(std::uint32_t(row)) : 0;  // what is held goes where it is led
        for (std::uint32_t e = bonds.begin(std::uint32_t(row)); e < end; e += kBlock) {
            const F l = Packet::load(bonds.length + e), k = Packet::load(bonds.stiffness + e) * k_to_step;
            const Four<F> there = Packet::gather(at, bonds.other + e);
            const F rx = here.x - there.x, ry = here.y - there.y, rz = here.z - there.z;
            const F distance = sqrt(rx * rx + ry * ry + rz * rz);
            const F stretch = select(l > zero, distance - l, select(l < zero, min(distance - touching, zero), zero));
            const F k_kappa = k * (here.w + there.w);
            F step = zero - stretch * k / max(one, k_kappa);
            if constexpr (!single) {
                const F before = Packet::load(lambda + e);
                if (!is_first) {
                    step = zero - (stretch * k + before) / (one + k_kappa);
                    step = select(l < zero, max(step, zero - before), step);  // a contact never pulls
                    step = select(l > zero, step, select(l < zero, step, zero));
                }
                Packet::store(lambda + e, is_first ? step : before + step);
            }
            const F per_distance = select(distance > zero, step / distance, zero);
            x = x + rx * per_distance;
            y = y + ry * per_distance;
            z = z + rz * per_distance;
        }
        for (int lane = 0; lane < Packet::width && row + lane < bonds.n; ++lane)
            move(std::uint32_t(row) + lane, {Packet::get(x, lane), Packet::get(y, lane), Packet::get(z, lane)});
    }

    /// push: Σ n λ over the particle's bonds.
    GB_FN void move(std::uint32_t t, const float3& push) const {
        const Quad here = at[t], v = velocity[t];
        float3 x = here.xyz(), u = v.xyz();
        if (hold[t] != kFree) {
            felt.add_held(t, hold[t], x, push * (1.0f / dt), v.w, is_last ? dt : 0.0f, motions);
            u = motions.velocity_at(hold[t], x, u);
            if (is_last && predicts) x = x + u * dt;
        } else {
            u = u + push * (v.w / dt);
            x = x + push * v.w;
            if (is_last) {
                felt.keep_out(shapes, t, x, u, v.w, materials.friction[phase[t]], dt);
                walls.keep_out(t, x, u, dt);
                const float damping = materials.damping[phase[t]];
                if (damping > 0.0f) u = u * exp(-damping * dt);
                if (predicts) {
                    u = u + acceleration[t] * dt;
                    x = x + u * dt;
                }
            }
        }
        velocity[t] = {u.x, u.y, u.z, v.w};
        next[t] = {x.x, x.y, x.z, here.w};
    }
};

/// Velocities take up the acceleration, positions move on: where the first substep looks at the bonds.
struct Predict {
    Quad* at;
    Quad* velocity;
    const float3* acceleration;
    const std::uint8_t* hold;
    Motions motions;
    float dt;
    GB_FN void operator()(std::size_t t) const {
        const Quad x = at[t], v = velocity[t];
        const float3 u =
            hold[t] == kFree ? v.xyz() + acceleration[t] * dt : motions.velocity_at(hold[t], x.xyz(), v.xyz());
        const float3 y = x.xyz() + u * dt;
        velocity[t] = {u.x, u.y, u.z, v.w};
        at[t] = {y.x, y.y, y.z, x.w};
    }
};

struct Accelerate {
    float3* acceleration;
    const float3* pull;  ///< beside gravity, or null
    float3 gravity;
    GB_FN void operator()(std::size_t t) const { acceleration[t] = pull ? gravity + pull[t] : gravity; }
};
struct Remember {
    const Quad* at;
    float3* before;
    GB_FN void operator()(std::size_t t) const { before[t] = at[t].xyz(); }
};

/// Half of each whole bond's energy stands at either end.
struct EnergyOf {
    Bonds bonds;
    const Quad* at;
    GB_FN double operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        double sum = 0.0;
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
            if (bonds.length[e] <= 0.0f) continue;
            const double stretch = double(length(at[t].xyz() - at[bonds.other[e]].xyz())) - bonds.length[e];
            sum += 0.25 * bonds.stiffness[e] * stretch * stretch;
        }
        return sum;
    }
};

/// Once a step: overstretched bonds break, strained ones creep.  A bond is judged at its lesser end.
struct TearAndCreep {
    Bonds bonds;
    const Quad* at;
    const std::uint8_t* phase;
    Materials materials;
    float dt;
    std::uint32_t* n_torn;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
            const std::uint32_t o = bonds.other[e];
            const float l = bonds.length[e];
            if (o <= t || l <= 0.0f) continue;
            const float strain = length(at[t].xyz() - at[o].xyz()) / l - 1.0f;
            const float tear = lesser(materials.tear_strain, t, o);
            if (tear > 0.0f && strain > tear) {
                bonds.set_length(t, e, -l);
                atomic_take(n_torn, 1);
                continue;
            }
            const float yield = lesser(materials.yield_strain, t, o), beyond = abs(strain) - yield;
            if (yield > 0.0f && beyond > 0.0f) {
                const float creep = beyond * (1.0f - exp(-lesser(materials.creep_rate, t, o) * dt));
                bonds.set_length(t, e, l * (1.0f + (strain > 0.0f ? creep : -creep)));
            }
        }
    }
    /// Of the two ends' values the lesser that is not 0.
    GB_FN float lesser(const float* of_phase, std::uint32_t t, std::uint32_t o) const {
        const float a = of_phase[phase[t]], b = of_phase[phase[o]];
        return a > 0.0f && b > 0.0f ? min(a, b) : max(a, b);
    }
};

}  // namespace globule::core::tissue
