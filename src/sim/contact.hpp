// What tissue cannot enter: instruments (balls, capsules, half-spaces) and walls; and Coulomb friction,
// docs/design/tissue.md.
#pragma once
#include "base/quad.hpp"
#include "base/vec.hpp"

namespace globule::core::tissue {

inline constexpr int kMaxShapes = 8;

/// What friction does to a velocity along a contact: at most `most`, and never more than stops it.
GB_FN float3 rubbed(const float3& along, float most) {
    const float speed = length(along);
    return along * (speed > most ? -most / speed : -1.0f);
}
/// The velocity along a contact of normal n.
GB_FN float3 sliding(const float3& u, const float3& n) { return u - n * dot(u, n); }

/// What presses a contact, over some tens of substeps.  An elastic body that trembles presses its floor by fits and
/// starts, and slides between them; with the load of the substep alone, it creeps down slopes on which it should stay.
struct MeanLoads {
    Quad* of = nullptr;     ///< per particle: mean acceleration into the contact; share of the time that this is the
                            ///< mean of; velocity into it that no friction has answered yet; null: nothing has friction
    float per_time = 0.0f;  ///< 1/s: over 1 / this the mean goes
    float gap = 0.0f;       ///< what is farther away has left the contact

    GB_FN void leave(std::uint32_t t) const {
        if (of[t].y > 0.0f) of[t] = {0, 0, 0, 0};
    }
    /// Change of a velocity `along` the contact, in a substep that took `into` from that into it.  No more than μ times
    /// what all substeps took.
    GB_FN float3 rub(std::uint32_t t, const float3& along, float into, float mu, float dt) const {
        Quad& load = of[t];
        if (!(into > 0.0f || load.y > 0.0f)) return {0, 0, 0};
        const float k = min(per_time * dt, 1.0f), mean = load.x + k * (into / dt - load.x),
                    age = load.y + k * (1.0f - load.y), left = min(load.z + into, mean / per_time);
        const float3 change = rubbed(along, mu * min(mean / age * dt, left));
        load = {mean, age, max(left - length(change) / mu, 0.0f), 0.0f};
        return change;
    }
};

struct Shape {
    enum Kind : std::int32_t { ball, capsule, half_space };
    Kind kind;
    float3 a, b;   ///< center; both ends of the axis; a point of the plane and its outward normal
    float radius;  ///< half-space: how far the surface stands off the plane
    float3 velocity;
    float friction = 0.0f;  ///< coefficient; a contact has the larger one of its two sides

    /// Signed distance of x from the surface; `out` is the outward normal.
    GB_FN float distance(const float3& x, float3& out) const {
        if (kind == half_space) {
            out = b;
            return dot(x - a, b) - radius;
        }
        float3 foot = a;
        if (kind == capsule) {
            const float3 axis = b - a;
            const float along = dot(x - a, axis), whole = dot(axis, axis);
            foot = a + axis * (whole > 0.0f ? min(max(along / whole, 0.0f), 1.0f) : 0.0f);
        }
        const float3 r = x - foot;
        const float d = length(r);
        out = d > 0.0f ? r * (1.0f / d) : float3{0, 0, 1};
        return d - radius;
    }
};

struct Shapes {
    Shape shape[kMaxShapes] = {};
    int n = 0;
    MeanLoads loads;

    /// Moves x out of every shape; u loses what of it goes in, and what friction with the nearest takes: met(shape, its
    /// change).  `dt` has led u to x.
    template <class Met>
    GB_FN void keep_out(std::uint32_t t, float3& x, float3& u, float friction, float dt, const Met& met) const {
        float pressed = 0.0f, nearest = loads.gap;
        float3 normal{0, 0, 0};
        int by = -1;
        for (int s = 0; s < n; ++s) {
            float3 out;
            const float depth = shape[s].distance(x, out);
            if (loads.of && depth < nearest) nearest = depth, normal = out, by = s;
            if (depth >= 0.0f) continue;
            x = x - out * depth;
            const float into = dot(u - shape[s].velocity, out);
            if (!(into < 0.0f)) continue;
            u = u - out * into;
            pressed -= into;
            met(s, out * (0.0f - into));
        }
        if (!loads.of) return;
        if (by < 0) return loads.leave(t);
        const float mu = max(friction, shape[by].friction);
        if (!(mu > 0.0f)) return;
        const float3 rub = loads.rub(t, sliding(u - shape[by].velocity, normal), pressed, mu, dt);
        u = u + rub;
        x = x + rub * dt;
        met(by, rub);
    }
    bool any_friction() const {
        bool any = false;
        for (int s = 0; s < n; ++s) any |= shape[s].friction > 0.0f;
        return any;
    }
    /// Where the shapes are after dt.
    void move(float dt) {
        for (int s = 0; s < n; ++s) {
            shape[s].a = shape[s].a + shape[s].velocity * dt;
            if (shape[s].kind == Shape::capsule) shape[s].b = shape[s].b + shape[s].velocity * dt;
        }
    }
};

/// Walls that a step's particles stand before, as planes, while the substeps last.
struct Walls {
    const Quad* plane = nullptr;   ///< per particle: normal, and how far along it the particle may go at the step's
                                   ///< start; null: no walls
    const float* speed = nullptr;  ///< of the plane along its normal
    const Quad* rub = nullptr;     ///< the plane's velocity, and the coefficient of friction; null: none has any
    float elapsed = 0.0f;
    MeanLoads loads;

    /// Moves x out; u loses what of it goes in, and what friction takes.  `dt` has led u to x.
    GB_FN void keep_out(std::uint32_t t, float3& x, float3& u, float dt) const {
        if (!plane) return;
        const float3 out = plane[t].xyz();
        const float depth = plane[t].w + speed[t] * elapsed - dot(x, out);
        float into = 0.0f;
        if (depth > 0.0f) {
            x = x + out * depth;
            into = max(speed[t] - dot(u, out), 0.0f);
            u = u + out * into;
        }
        if (!rub || !(rub[t].w > 0.0f)) return;
        if (depth < -loads.gap) return loads.leave(t);
        const float3 change = loads.rub(t, sliding(u - rub[t].xyz(), out), into, rub[t].w, dt);
        u = u + change;
        x = x + change * dt;
    }
};

}  // namespace globule::core::tissue
