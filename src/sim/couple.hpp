// Where tissue meets the simulation's state: out of the slots before the bonds take their substeps, and
// back into them before the density solve.
#pragma once
#include "exec/bits.hpp"
#include "sim/bonds.hpp"
#include "sim/rigid.hpp"
#include "sim/step.hpp"

namespace globule::core::tissue {

inline constexpr std::uint32_t kNobody = 0xffffffffu;
inline constexpr float kSlid =
    0.95f;  ///< of the distance at rest: particles on both sides of a cut that are closer have slid along it
inline constexpr float kAnyDensity = 1e30f;
inline constexpr float kClose = 1.5f;  ///< spacings: what is farther from each other does not press
inline constexpr float kLiftShare = 0.1f, kLiftRate = 0.1f;  ///< of the height that lacks, in a step; spacings a second
inline constexpr float kWallHeight =
    1.1f;  ///< above a wall's particles, spacings, a little more than where it leaves a lattice at rest (1.055)

/// Finds each tissue particle's slot, position and velocity.  Who has left the simulation is gone.  What is
/// held stands in the density solve like a boundary: it pushes, and is not pushed.
struct Gather {
    sim::State state;
    const sim::Phase* phases;
    const std::uint32_t *id, *slot_of;
    std::uint32_t* slot;
    Quad *at, *velocity;
    std::uint8_t* hold;
    float volume;  ///< of a particle
    std::uint32_t* n_lost;
    std::uint32_t* n_changed;  ///< held since the last time, or let go
    GB_FN void operator()(std::size_t t) const {
        const std::uint32_t s = id[t] == kNobody ? sim::kGone : slot_of[id[t]];
        slot[t] = hold[t] == kGone ? sim::kGone : s;
        if (slot[t] == sim::kGone) {
            if (hold[t] != kGone) atomic_take(n_lost, 1);
            hold[t] = kGone;
            velocity[t] = {0, 0, 0, velocity[t].w};
            return;
        }
        const Quad p = state.place[s];
        const sim::Phase& phase = phases[state.phase[s]];
        const bool is_tissue = phase.kind == sim::Kind::tissue, stands = is_tissue && hold[t] == kFixed;
        if (is_tissue) {
            if ((hold[t] == kFree) != (p.w < 0.0f)) atomic_take(n_changed, 1);
            state.place[s].w = hold[t] == kFree ? -1.0f / phase.density : volume;
        }
        const float3 v = stands ? float3{0, 0, 0} : state.velocity[s].xyz();
        at[t] = {p.x, p.y, p.z, at[t].w};
        velocity[t] = {v.x, v.y, v.z, velocity[t].w};
    }
};

/// Velocities free of divergence, before the forces.
struct TakeVelocity {
    sim::State state;
    const std::uint32_t* slot;
    const std::uint8_t* hold;
    Quad* velocity;
    GB_FN void operator()(std::size_t t) const {
        if (hold[t] != kFree) return;
        const float3 v = state.velocity[slot[t]].xyz();
        velocity[t] = {v.x, v.y, v.z, velocity[t].w};
    }
};

/// What each free particle is near to, within the lists' reach.
enum Beside : std::uint8_t {
    kAlone,
    kFluid,   ///< or a face of a cut that slid along this one
    kOther,   ///< body
    kWet = 4  ///< a bit: near to a fluid, whatever else
};

/// How much of an impulse a particle of a solid shows within the step.  Its neighbors take up the rest meanwhile: a
/// particle on springs of the stiffness k answers to an impulse of a step as one with the mass m + k dt^2 would.
struct Response {
    const float* of;         ///< (n,) 1: all of it; null: everybody shows all
    float share, wet_share;  ///< of the last pressure, that acts in the substeps
    GB_FN float operator()(std::size_t t) const { return of ? of[t] : 1.0f; }
    GB_FN float pressure(std::size_t t) const { return (*this)(t) < 1.0f ? wet_share : share; }
};

/// Beside a fluid, a solid meets pressure and forces with that mass.  What its particles are owed of the impulses then
/// acts in the next step's substeps.
struct Weigh {
    static constexpr float kLent =
        0.3f;  ///< of the stiffness: more makes masses differ by more than the pressure solve bears

    sim::State state;
    const std::uint32_t* slot;
    const std::uint8_t *beside, *hold;
    const Quad* velocity;  ///< w: inverse mass
    const float* lame;     ///< (2, stride) as in Solid
    std::uint32_t stride;
    float ahead2;  ///< (dt / spacing)^2
    float* response;
    GB_FN void operator()(std::size_t t) const {
        response[t] = 1.0f;
        if (!(beside[t] & kWet) || hold[t] != kFree) return;
        const float stiff = 2.0f * lame[t] + lame[stride + t];
        response[t] = 1.0f / (1.0f + kLent * max(stiff, 0.0f) * velocity[t].w * ahead2);
        state.place[slot[t]].w *= response[t];
    }
};

/// What the forces added to the velocity since then, as an acceleration for the substeps.  What pressure and its
/// friction did in the last step acts there, too: what rests is at rest within the step.
struct TakeAcceleration {
    sim::State state;
    const std::uint32_t* slot;
    const Quad* velocity;
    const float3 *pressed, *owed;  ///< acceleration by pressure; velocity, null: nobody is owed any
    Response response;
    float per_dt;
    float3 gravity;
    float3* acceleration;
    GB_FN void operator()(std::size_t t) const {
        if (slot[t] == sim::kGone) {
            acceleration[t] = {0, 0, 0};
            return;
        }
        float3 a = (state.velocity[slot[t]].xyz() - velocity[t].xyz()) * per_dt;
        if (response(t) < 1.0f) a = gravity + (a - gravity) * (1.0f / response(t));
        if (owed) a = a + owed[t] * per_dt;
        acceleration[t] = a + pressed[t] * response.pressure(t);
    }
};

/// The density solve sees the velocity that led through all substeps, without what the last pressure did there: that
/// was no impulse of anybody's.  What it differs from the last substep's is kept, and added when the particles have
/// moved.
struct GiveVelocity {
    sim::State state;
    const std::uint32_t* slot;
    const Quad *at, *velocity;
    const std::uint8_t* hold;
    Response response;
    float dt, per_dt;
    float3 *rest, *pressed;
    GB_FN void operator()(std::size_t t) const {
        const std::uint32_t s = slot[t];
        if (s == sim::kGone) return;
        const float3 led = (at[t].xyz() - state.place[s].xyz()) * per_dt;
        rest[t] = velocity[t].xyz() - led;
        const float3 v = hold[t] == kFree ? led - pressed[t] * (response.pressure(t) * dt) : led;
        pressed[t] = v;
        state.velocity[s] = {v.x, v.y, v.z, state.velocity[s].w};
    }
};
/// What pressure has changed since then.
struct TakePressed {
    sim::State state;
    const std::uint32_t* slot;
    const std::uint8_t* hold;
    Response response;
    float per_dt;
    float3 *pressed, *owed;
    GB_FN void operator()(std::size_t t) const {
        const std::uint32_t s = slot[t];
        const float3 change =
            s == sim::kGone || hold[t] != kFree ? float3{0, 0, 0} : state.velocity[s].xyz() - pressed[t];
        pressed[t] = change * per_dt;
        if (owed) owed[t] = change * (1.0f / response(t) - 1.0f);
    }
};
/// What is held goes where it is led, whatever the pressure.
struct HoldOn {
    sim::State state;
    const std::uint32_t* slot;
    const Quad* at;
    const std::uint8_t* hold;
    float per_dt;
    GB_FN void operator()(std::size_t t) const {
        const std::uint32_t s = slot[t];
        if (s == sim::kGone || hold[t] == kFree) return;
        const float3 v = (at[t].xyz() - state.place[s].xyz()) * per_dt;
        state.velocity[s] = {v.x, v.y, v.z, state.velocity[s].w};
    }
};
/// Momentum that velocities do not show yet, about the world's origin.
struct OwedMomentum {
    const Quad *at, *velocity;  ///< w: inverse mass
    const float3* owed;
    GB_FN sim::Impulse operator()(std::size_t t) const {
        if (!(velocity[t].w > 0.0f)) return {};
        const double m = 1.0 / double(velocity[t].w), x[3] = {at[t].x, at[t].y, at[t].z},
                     u[3] = {m * owed[t].x, m * owed[t].y, m * owed[t].z};
        sim::Impulse sum{};
        for (int k = 0; k < 3; ++k) {
            sum.p[k] = u[k];
            sum.l[k] = x[(k + 1) % 3] * u[(k + 2) % 3] - x[(k + 2) % 3] * u[(k + 1) % 3];
        }
        return sum;
    }
};
struct AddRest {
    sim::State state;
    const sim::Phase* phases;
    const std::uint32_t* slot;
    const float3* rest;
    Response response;
    GB_FN void operator()(std::size_t t) const {
        const std::uint32_t s = slot[t];
        if (s == sim::kGone) return;
        if (response(t) < 1.0f) state.place[s].w = -1.0f / phases[state.phase[s]].density;
        const float3 v = state.velocity[s].xyz() + rest[t];
        state.velocity[s] = {v.x, v.y, v.z, state.velocity[s].w};
    }
};

/// The tissue particle of an id.
struct Members {
    const std::uint32_t* of_id;
    std::uint32_t n_ids;
    GB_FN std::uint32_t operator()(std::uint32_t id) const { return id < n_ids ? of_id[id] : kNobody; }
};

/// What stands before each free particle.  Pressure acts once a step, on tissue whose substeps have not felt it.  Walls
/// are therefore planes that the substeps know: no particle comes nearer than it is, or than it would be at rest.  What
/// else it meets shortens the steps.
template <class Packet> struct FindContacts {
    sim::Step<Packet> step;
    Members members;
    const std::uint32_t* body;
    const Quad* rest;  ///< of solids, else null
    const std::uint8_t* scarred;
    float* spared;  ///< as in OwnPairs
    Quad* plane;
    float* speed;
    Quad* rub;  ///< as in Walls; null: nothing has friction
    std::uint8_t* beside;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = step.lists.rows[row], t = members(step.state.id[slot]);
        if (t == kNobody) return;
        const float3 here = step.state.place[slot].xyz();
        Smooth smooth;
        std::uint8_t near = kAlone, wet = 0;
        for (std::uint32_t k = 0, n = step.lists.count[row]; k < n; ++k) {
            const std::uint32_t j = step.lists.index[step.lists.at(row, k)];
            if (j >= step.lists.n) continue;
            const sim::Kind kind = step.phases[step.state.phase[j]].kind;
            if (kind != sim::Kind::boundary) {
                const std::uint32_t o = members(step.state.id[j]);
                if (kind == sim::Kind::rigid || other_body(t, o)) near = kOther;
                else if (kind == sim::Kind::fluid) near = max(near, std::uint8_t(kFluid)), wet = kWet;
                else if (slid(t, o, here - step.state.place[j].xyz())) {
                    near = max(near, std::uint8_t(kFluid));
                    if (spared[t] < 0.0f) spared[t] = kAnyDensity;  // contact begins with the next step, which is short
                }
                continue;
            }
            const Quad q = step.state.place[j];
            smooth.add(step.period.template shortest<true>(here - q.xyz()), step.state.velocity[j].xyz(),
                max(step.phases[step.state.phase[slot]].friction, step.phases[step.state.phase[j]].friction), q.w,
                step.spline);
        }
        beside[t] = near | wet;
        if (!(smooth.total > 0.0f)) return;
        const float by = 1.0f / smooth.total;
        const float3 u = smooth.velocity * by, out = normalize(smooth.sum);
        if (rub) rub[t] = {u.x, u.y, u.z, smooth.friction * by};
        const float height = dot(smooth.sum, out) * by;
        plane[t] = {
            out.x, out.y, out.z, dot(here, out) + lifted(kWallHeight * step.spacing - height, smooth.friction > 0.0f)};
        speed[t] = dot(u, out);
    }
    /// How far a plane is beyond the particle, which lacks `low` of the height at rest: what has sunk, as into a wall's
    /// hollows, comes back by and by, unless friction keeps it out of these.
    GB_FN float lifted(float low, bool rubs) const {
        return low > 0.0f && rest && !rubs ? min(kLiftShare * low, kLiftRate * step.dt * step.spacing) : min(low, 0.0f);
    }
    /// Of a pair of one solid that its list still has.
    GB_FN bool slid(std::uint32_t t, std::uint32_t o, const float3& apart) const {
        if (!rest || o == kNobody || !(scarred[t] || scarred[o])) return false;
        const float3 r = step.period.template shortest<true>(apart), at_rest = rest[t].xyz() - rest[o].xyz();
        return dot(r, r) < min(kSlid * kSlid * dot(at_rest, at_rest), kClose * kClose * step.spacing * step.spacing);
    }
    GB_FN bool other_body(std::uint32_t t, std::uint32_t o) const { return o != kNobody && body[o] != body[t]; }

    /// Sums over a wall's particles, weighted by the kernel's slope, the nearest less.  The weights of sim::Contact
    /// give a wall bumps of 5 degrees, which slow what slides by a tenth and throw it to and fro.
    struct Smooth {
        float3 sum{0, 0, 0}, velocity{0, 0, 0};
        float total = 0.0f, friction = 0.0f;
        GB_FN void add(const float3& away, const float3& v, float mu, float volume, const sim::Spline& spline) {
            float w, slope;
            spline(length(away), w, slope);
            const float s = volume * max(-slope, 0.0f) * max(spline.support - length(away), 0.0f);
            sum = sum + away * s;
            velocity = velocity + v * s;
            total += s;
            friction += mu * s;
        }
    };
};

/// Tissue beside others counts as faster than it is in the choice of the next step.
struct CountAs {
    sim::State state;
    const std::uint32_t* slot;
    const std::uint8_t* beside;
    Response response;
    float speed[3], wet, springs;  ///< by what it is beside, m/s; of a solid and of springs beside a fluid
    GB_FN void operator()(std::size_t t) const {
        if (slot[t] == sim::kGone) return;
        const bool is_wet = beside[t] & kWet, is_springs = !(response(t) < 1.0f);
        const float other = beside[t] == (kFluid | kWet) ? 0.0f : speed[beside[t] & ~kWet];
        state.growth[slot[t]] = max(other, !is_wet ? 0.0f : is_springs ? springs : wet);
    }
};

}  // namespace globule::core::tissue
