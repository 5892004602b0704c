// Boundaries that move as a whole: by key frames, or as rigid bodies that fluids push (Akinci 2012).
// Their particles know their place in the body's own coordinate frame, by id, so that nothing drifts.
#pragma once
#include "sim/boundary.hpp"
#include "sim/pressure.hpp"

namespace globule::core::sim {

/// world_from_body: columns of a rotation, then the origin.
struct Pose {
    float3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1}, origin{0, 0, 0};
    GB_FN float3 to_world(const float3& p) const { return origin + x * p.x + y * p.y + z * p.z; }
    GB_FN float3 to_body(const float3& p) const {
        const float3 v = p - origin;
        return {dot(v, x), dot(v, y), dot(v, z)};
    }
};

/// Where a phase's particles are in its body.
struct Capture {
    State state;
    std::uint8_t phase;
    Pose pose;
    Quad* home;  ///< by id
    GB_FN void operator()(std::size_t i) const {
        if (state.phase[i] != phase) return;
        const float3 p = pose.to_body(state.place[i].xyz());
        home[state.id[i]] = {p.x, p.y, p.z, 0.0f};
    }
};

/// Velocities that take a phase's particles to its next pose within dt: to the nearest copy of their place there, from
/// which they may be any number of periods away.
struct Carry {
    State state;
    std::uint8_t phase;
    Pose pose;
    const Quad* home;
    Period period;
    float dt;
    GB_FN void operator()(std::size_t i) const {
        if (state.phase[i] != phase) return;
        const float3 way = pose.to_world(home[state.id[i]].xyz()) - state.place[i].xyz();
        const float3 v =
            float3{nearest(way.x, period.length.x), nearest(way.y, period.length.y), nearest(way.z, period.length.z)} *
            (1.0f / dt);
        state.velocity[i] = {v.x, v.y, v.z, state.velocity[i].w};
    }
    GB_FN static float nearest(float way, float length) {
        return length > 0.0f ? way - length * floor(way / length + 0.5f) : way;
    }
};

/// Impulse and its moment about a point; float64, added in an order that no thread count changes.
struct Impulse { double p[3] = {}, l[3] = {}; };
struct AddImpulse {
    GB_FN Impulse operator()(Impulse a, const Impulse& b) const {
        for (int k = 0; k < 3; ++k) {
            a.p[k] += b.p[k];
            a.l[k] += b.l[k];
        }
        return a;
    }
};

/// The particles of a body.
struct OfPhase {
    const std::uint8_t* phases;
    std::uint8_t phase;
    GB_FN bool operator()(std::uint32_t j) const { return phases[j] == phase; }
};

/// What the pressure, or the suction, of one row's fluid does to the particles that `Feels` takes: V P g of each pair,
/// at those.
template <class Packet, class Feels> struct PressureImpulse {
    Step<Packet> step;
    Feels feels;
    float3 center;
    GB_FN Impulse operator()(std::size_t row) const {
        Impulse sum;
        if (step.rows.boundary[row] >= step.spline.support) return sum;
        const std::uint32_t slot = step.lists.rows[row];
        if (!(step.state.place[slot].w < 0.0f)) return sum;
        const float s = step.volume * step.sizes.volume(slot) * step.dt * step.state.pressure[slot] /
                        (step.flux * step.spline.support);
        for (std::uint32_t k = 0; k < step.lists.count[row]; ++k) {
            const std::size_t at = step.lists.at(row, k);
            const std::uint32_t j = step.lists.index[at];
            if (j >= step.state.n || step.state.place[j].w < 0.0f || !feels(j)) continue;  // none of the solve's
            const float3 f = step.lists.one_gradient(at) * s;
            const float3 l = cross(step.period.template shortest<true>(step.state.place[j].xyz() - center), f);
            sum.p[0] += f.x, sum.p[1] += f.y, sum.p[2] += f.z;
            sum.l[0] += l.x, sum.l[1] += l.y, sum.l[2] += l.z;
        }
        return sum;
    }
};

/// What one row's fluid or tissue does to a body that it may not enter, and the mass that does so.
struct Bump {
    Impulse impulse;
    double mass = 0;
};
struct AddBump {
    GB_FN Bump operator()(const Bump& a, const Bump& b) const {
        return {AddImpulse{}(a.impulse, b.impulse), a.mass + b.mass};
    }
};
template <class Packet> struct BumpOf {
    Contact<Packet> contact;
    std::uint8_t phase;
    float volume;  ///< of a particle of size 1
    float3 center;
    GB_FN Bump operator()(std::size_t row) const {
        const typename Contact<Packet>::Kept kept = contact.keep(row);
        const State& state = contact.step.state;
        if (!kept.out || state.phase[kept.by] != phase) return {};
        const std::uint32_t slot = contact.step.lists.rows[row];
        const float mass = volume * contact.step.sizes.volume(slot) / -state.place[slot].w;
        const float3 p = (state.velocity[slot].xyz() - kept.velocity) * mass,
                     l = cross(contact.step.period.template shortest<true>(state.place[slot].xyz() - center), p);
        return {{{p.x, p.y, p.z}, {l.x, l.y, l.z}}, mass};
    }
};

struct PhaseSet {
    std::uint64_t bits[4] = {};
    GB_FN bool has(std::uint8_t phase) const { return bits[phase / 64] >> phase % 64 & 1; }
    void add(int phase) { bits[phase / 64] |= std::uint64_t(1) << phase % 64; }
};

/// How deep a body's particles are in other boundaries, and where from its center.  One point stands for all that are
/// in one octant: a box stands on four, and does not rock.
inline constexpr int kOctants = 8;
struct Touch {
    double weight = 0, arm[3] = {}, normal[3] = {}, velocity[3] = {};
    double depth = 0;
};
struct AddTouch {
    GB_FN Touch operator()(Touch a, const Touch& b) const {
        a.weight += b.weight;
        for (int k = 0; k < 3; ++k) {
            a.arm[k] += b.arm[k];
            a.normal[k] += b.normal[k];
            a.velocity[k] += b.velocity[k];
        }
        a.depth = a.depth > b.depth ? a.depth : b.depth;
        return a;
    }
};
template <class Packet> struct TouchOf {
    Lists<Packet> lists;
    State state;
    std::uint8_t phase;
    PhaseSet others;
    Period period;
    float spacing;
    float3 center;
    int octant;  ///< or -1: all
    GB_FN Touch operator()(std::size_t row) const {
        Touch sum;
        const std::uint32_t slot = lists.rows[row];
        if (state.phase[slot] != phase) return sum;
        const float3 p = state.place[slot].xyz(), arm = period.template shortest<true>(p - center);
        if (octant >= 0 && octant != (arm.x > 0.0f) + 2 * (arm.y > 0.0f) + 4 * (arm.z > 0.0f)) return sum;
        for (std::uint32_t k = 0; k < lists.count[row]; ++k) {
            const std::uint32_t j = lists.index[lists.at(row, k)];
            if (j >= state.n || !others.has(state.phase[j]) || !(state.place[j].w > 0.0f)) continue;
            const float3 away = period.template shortest<true>(p - state.place[j].xyz());
            const float r = length(away), deep = spacing - r;
            if (!(deep > 0.0f) || !(r > 0.0f)) continue;
            const float3 v = state.velocity[j].xyz();
            sum.weight += deep;
            sum.depth = sum.depth > deep ? sum.depth : double(deep);
            const float pv[3] = {arm.x, arm.y, arm.z}, av[3] = {away.x / r, away.y / r, away.z / r},
                        vv[3] = {v.x, v.y, v.z};
            for (int c = 0; c < 3; ++c) {
                sum.arm[c] += double(deep) * pv[c];
                sum.normal[c] += double(deep) * av[c];
                sum.velocity[c] += double(deep) * vv[c];
            }
        }
        return sum;
    }
};

}  // namespace globule::core::sim
