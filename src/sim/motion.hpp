// From accelerations to velocities to positions, the guards, and the order of slots after a rebuild.
#pragma once
#include "sim/density.hpp"
#include "sim/fill.hpp"
#include "sim/sizes.hpp"
#include "sim/split.hpp"

namespace globule::core::sim {

/// Forces that the user asked for, as accelerations.
struct UserForces {
    const std::uint32_t* rows;
    const float* inverse_rho;
    float per_volume;  ///< of size 1
    Sizes sizes;
    const float* forces;  ///< (n, 3) by slot
    Quad* acceleration;
    GB_FN void operator()(std::size_t row) const {
        const float* f = forces + 3 * std::size_t(rows[row]);
        const float s = inverse_rho[row] * per_volume / sizes.volume(rows[row]);
        acceleration[row] = {s * f[0], s * f[1], s * f[2], 0.0f};
    }
};

/// Another density or viscosity for a phase; boundaries keep their volumes.
struct SetMaterial {
    State state;
    std::uint8_t phase;
    float w, viscosity;
    GB_FN void operator()(std::size_t i) const {
        if (state.phase[i] != phase) return;
        if (w < 0.0f && state.place[i].w < 0.0f) state.place[i].w = w;
        state.velocity[i].w = viscosity;
    }
};

/// v += dt a, a: gravity, and what else acts on each row.
struct Kick {
    const std::uint32_t* rows;
    const float* inverse_rho;
    const Quad* acceleration;  ///< per row, or null
    float3 gravity;
    float dt;
    Quad* velocity;
    GB_FN void operator()(std::size_t row) const {
        if (!(inverse_rho[row] > 0.0f)) return;
        float3 a = gravity;
        if (acceleration) a = a + acceleration[row].xyz();
        Quad& v = velocity[rows[row]];
        v = {v.x + dt * a.x, v.y + dt * a.y, v.z + dt * a.z, v.w};
    }
};

/// x += dt v, as the octree takes positions.  Those outside of the domain rest, except for boundaries, which follow
/// their poses and come in; tissue does not come in again on a periodic domain's other side, as its bonds know of one
/// copy.  One whose next place is not a number stays where it
/// was; the highest of their ids is reported.
struct Move {
    State state;
    float dt;
    const TreeHeader* header;
    Period period;
    float3 lo;  ///< of the domain
    const Phase* phases;
    float* positions;             ///< (n, 3)
    std::uint32_t* not_a_number;  ///< id + 1
    GB_FN void operator()(std::size_t i) const {
        const Quad p = state.place[i], v = state.velocity[i];
        float3 to = p.xyz();
        const Kind kind = phases[state.phase[i]].kind;
        const bool led = kind == Kind::boundary && dot(v.xyz(), v.xyz()) > 0.0f;
        if (i >= header->n_outside || led) {
            to = {p.x + dt * v.x, p.y + dt * v.y, p.z + dt * v.z};
            if (kind != Kind::tissue)
                to = {Period::wrap(to.x, lo.x, period.length.x), Period::wrap(to.y, lo.y, period.length.y),
                    Period::wrap(to.z, lo.z, period.length.z)};
            if (!(abs(to.x) + abs(to.y) + abs(to.z) < infinity())) {
                atomic_max(not_a_number, state.id[i] + 1);
                to = p.xyz();
            }
        }
        positions[3 * i] = to.x;
        positions[3 * i + 1] = to.y;
        positions[3 * i + 2] = to.z;
    }
};

struct WritePositions {
    const Quad* place;
    float* positions;
    GB_FN void operator()(std::size_t i) const {
        const Quad p = place[i];
        positions[3 * i] = p.x;
        positions[3 * i + 1] = p.y;
        positions[3 * i + 2] = p.z;
    }
};

struct TakePositions {
    const float* positions;
    Quad* place;
    GB_FN void operator()(std::size_t i) const {
        place[i] = {positions[3 * i], positions[3 * i + 1], positions[3 * i + 2], place[i].w};
    }
};
struct CopyQuads {
    const Quad* from;
    Quad* to;
    GB_FN void operator()(std::size_t i) const { to[i] = from[i]; }
};

/// New particles behind those that are there.
struct Append {
    State state;                          ///< n: before
    const float *positions, *velocities;  ///< (m, 3); velocities may be null
    std::uint8_t phase;
    float w;          ///< of place
    float3 velocity;  ///< where there are no velocities
    std::uint32_t first_id;
    GB_FN void operator()(std::size_t k) const {
        const std::size_t i = state.n + k;
        state.place[i] = {positions[3 * k], positions[3 * k + 1], positions[3 * k + 2], w};
        const float3 v =
            velocities ? float3{velocities[3 * k], velocities[3 * k + 1], velocities[3 * k + 2]} : velocity;
        state.velocity[i] = {v.x, v.y, v.z, 0.0f};
        state.id[i] = first_id + std::uint32_t(k);
        state.phase[i] = phase;
        state.pressure[i] = 0.0f;
        state.growth[i] = 0.0f;
        state.divergence_impulse[i] = 0.0f;
    }
};

/// Slot k of `to` takes what `from` has at index[k]; positions come from the octree or from `from`.
/// Slot n of `to` becomes nobody: far away, at rest.
struct Reorder {
    State from, to;
    const std::uint32_t* index;
    const float *x, *y, *z;  ///< of the new slots, or null
    const Phase* phases;
    std::uint32_t* slot_of;
    GB_FN void operator()(std::size_t k) const {
        if (k == to.n) {
            to.place[k] = {2e18f, 2e18f, 2e18f, 0.0f};
            to.velocity[k] = {0.0f, 0.0f, 0.0f, 0.0f};
            to.growth[k] = to.divergence_impulse[k] = 0.0f;  // rows that pad a packet read them
            return;
        }
        const std::uint32_t i = index[k];
        Quad p = from.place[i];
        if (x) p = {x[k], y[k], z[k], p.w};
        to.place[k] = p;
        const Quad v = from.velocity[i];
        to.velocity[k] = {v.x, v.y, v.z, phases[from.phase[i]].viscosity};
        to.id[k] = from.id[i];
        to.phase[k] = from.phase[i];
        to.pressure[k] = from.pressure[i];
        to.growth[k] = from.growth[i];
        to.divergence_impulse[k] = from.divergence_impulse[i];
        slot_of[from.id[i]] = std::uint32_t(k);
    }
};

/// The first n slots, as they are.
struct CopyState {
    State from, to;
    GB_FN void operator()(std::size_t i) const {
        to.place[i] = from.place[i];
        to.velocity[i] = from.velocity[i];
        to.id[i] = from.id[i];
        to.phase[i] = from.phase[i];
        to.pressure[i] = from.pressure[i];
        to.growth[i] = from.growth[i];
        to.divergence_impulse[i] = from.divergence_impulse[i];
    }
};

/// From flags summed up to an index of those that stay; the others' ids lead nowhere from now on.
struct WriteKept {
    const std::uint32_t* before;
    const std::uint32_t* id;
    std::uint32_t *slot_of, *index;
    GB_FN void operator()(std::size_t i) const {
        if (before[i + 1] > before[i]) index[before[i]] = std::uint32_t(i);
        else slot_of[id[i]] = kGone;
    }
};
/// 0 for the ids that go.
struct FlagGone {
    const std::uint32_t *ids, *slot_of;
    std::uint32_t* flags;
    GB_FN void operator()(std::size_t k) const {
        if (slot_of[ids[k]] != kGone) flags[slot_of[ids[k]]] = 0;
    }
};

/// 1 for slots that the solver moves; those outside of the domain come first and rest, tissue that is held goes where
/// it is led.
struct FlagRows {
    State state;
    const Phase* phases;
    const TreeHeader* header;
    std::uint32_t* flags;
    GB_FN void operator()(std::size_t i) const {
        flags[i] = 0;
        if (i >= state.n || i < header->n_outside) return;
        const Kind kind = phases[state.phase[i]].kind;
        flags[i] = is_solved(kind) && !((kind == Kind::tissue || kind == Kind::fluid) && state.place[i].w > 0.0f);
    }
};
/// rows[before[i]] = i for the flagged ones; padded with n.
struct WriteRows {
    const std::uint32_t* before;
    std::uint32_t n;
    std::uint32_t* rows;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t n_rows = before[n];
        if (i >= n) rows[n_rows + (i - n)] = n;
        else if (before[i + 1] > before[i]) rows[before[i]] = std::uint32_t(i);
    }
};

/// Squared: the speed, the one that limits the next step, and the one that pressure can give (p / rho).
struct Speeds { float most2, limiting2, pressing2; };
/// Of those inside.
struct SpeedsOf {
    const Quad* velocity;
    const float* limiting2;  ///< or null: their own, and how they grow
    const float* growth;
    const Quad* place;
    const float* pressure;
    Sizes sizes;         ///< what is smaller counts as so much faster
    float gravity, far;  ///< m/s^2, which the step allows for; how far a step may lead
    const TreeHeader* header;
    GB_FN Speeds operator()(std::size_t i) const {
        if (i < header->n_outside) return {0.0f, 0.0f, 0.0f};
        const float3 v = velocity[i].xyz();
        const float v2 = dot(v, v);
        if (limiting2) return {v2, limiting2[i], 0.0f};
        // v dt + a dt^2 / 2 = far
        const float size = sizes.at(i), per_size2 = 1.0f / (size * size);
        const float a = max(growth[i] - gravity, 0.0f), limit = 0.5f * (sqrt(v2) + sqrt(v2 + 2.0f * a * (far * size)));
        return {v2, (a > 0.0f ? limit * limit : v2) * per_size2,
            max(pressure[i], 0.0f) * max(-place[i].w, 0.0f) * per_size2};
    }
};
struct Fastest {
    GB_FN Speeds operator()(const Speeds& a, const Speeds& b) const {
        return {max(a.most2, b.most2), max(a.limiting2, b.limiting2), max(a.pressing2, b.pressing2)};
    }
};

/// What the host learns after a step.
struct Summary {
    Speeds speeds;
    std::uint32_t n_rows, n_outside, not_a_number;
    std::uint32_t n_nodes, n_wanted;  ///< of the octree: it had less room than it needed where they differ
    Compression compression;          ///< of the positions that the step began with
    Outcome solves[2];                ///< of velocities, of places
};
struct Summarize {
    const Speeds* speeds;
    const std::uint32_t *n_rows, *not_a_number;
    const TreeHeader* header;
    const Compression* compression;  ///< or null
    const Outcome* solves;           ///< or null
    Summary* out;
    GB_FN void operator()(std::size_t) const {
        *out = {*speeds, *n_rows, header->n_outside, *not_a_number, header->n_nodes, header->n_wanted,
            compression ? *compression : Compression{}, {}};
        for (int k = 0; k < 2 && solves; ++k) out->solves[k] = solves[k];
    }
};

}  // namespace globule::core::sim
