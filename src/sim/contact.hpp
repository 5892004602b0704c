// Instruments that tissue cannot enter: balls, capsules, half-spaces.  No friction.
#pragma once
#include "base/quad.hpp"
#include "base/vec.hpp"

namespace globule::core::tissue {

inline constexpr int kMaxShapes = 8;

struct Shape {
    enum Kind : std::int32_t { ball, capsule, half_space };
    Kind kind;
    float3 a, b;      ///< centre; both ends of the axis; a point of the plane and its outward normal
    float radius;     ///< half-space: how far the surface stands off the plane
    float3 velocity;

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

    /// Moves x out of every shape; u loses what of it goes in: met(shape, its change).
    template <class Met>
    GB_FN void keep_out(float3& x, float3& u, const Met& met) const {
        for (int s = 0; s < n; ++s) {
            float3 out;
            const float depth = shape[s].distance(x, out);
            if (depth >= 0.0f) continue;
            x = x - out * depth;
            const float into = dot(u - shape[s].velocity, out);
            if (!(into < 0.0f)) continue;
            u = u - out * into;
            met(s, out * (0.0f - into));
        }
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
    const Quad* plane = nullptr;  ///< per particle: normal, and how far along it the particle may go at the step's start; null: no walls
    const float* speed = nullptr; ///< of the plane along its normal
    float elapsed = 0.0f;

    /// Moves x out; u loses what of it goes in.
    GB_FN void keep_out(std::uint32_t t, float3& x, float3& u) const {
        if (!plane) return;
        const float3 out = plane[t].xyz();
        const float depth = plane[t].w + speed[t] * elapsed - dot(x, out);
        if (!(depth > 0.0f)) return;
        x = x + out * depth;
        u = u + out * max(speed[t] - dot(u, out), 0.0f);
    }
};

}  // namespace globule::core::tissue
