// Exterior spheres (§5.2, Figs 5.3, 5.4): the surface lies inside the spheres of radius a around the
// particles.  A ray enters and leaves each at once; those events, in order, bound the search, and a
// sphere that is met alone needs none: its surface has the radius d_m, f(d_m) = tau.
#pragma once
#include "octree/types.hpp"
#include "trace/thesis/stack.hpp"

namespace globule::core::thesis {

/// A particle and where the ray enters and leaves its sphere.
struct Candidate {
    std::uint32_t slot;
    float enter, leave;
};

/// False where the ray misses the sphere.
GB_FN bool meet_sphere(const SortedParticles& particles, const Ray& ray, std::uint32_t slot, Candidate& out) {
    const float a = particles.support[slot];
    const float3 v = particles.position(slot) - ray.o;
    const float middle = dot(v, ray.d);
    const float3 across = v - ray.d * middle;  // subtracted as vectors: |v|^2 - middle^2 would cancel
    const float half2 = a * a - dot(across, across);
    if (!(half2 > 0.0f)) return false;
    const float half = sqrt(half2);
    out = {slot, middle - half, middle + half};
    return true;
}

/// Where the ray meets the surface of a sphere that acts alone, within [from, end].  `lone` is
/// (d_m / a)^2, negative where one particle does not reach tau.
GB_FN bool meet_lone(const Candidate& c, float a, float lone, float from, float end, float& t) {
    const float half = 0.5f * (c.leave - c.enter);
    const float inner2 = half * half - a * a * (1.0f - lone);
    if (lone < 0.0f || !(inner2 > 0.0f)) return false;
    const float middle = 0.5f * (c.enter + c.leave), inner = sqrt(inner2);
    if (middle + inner < from) return false;
    t = max(middle - inner, from);  // already inside where the leaf begins: at its wall
    return t <= end;
}

/// (d_m / a)^2 for particles of one weight, by bisection, once a frame.
template <class Kernel> inline float lone_surface(const Kernel& kernel, float weight, float tau) {
    const auto above = [&](double x) {
        double b, slope;
        kernel(x, b, slope);
        return weight * b > tau;
    };
    if (!above(0.0)) return -1.0f;
    double lo = 0.0, hi = 1.0;
    for (int i = 0; i < 60; ++i) (above(0.5 * (lo + hi)) ? lo : hi) = 0.5 * (lo + hi);
    return float(lo);
}

}  // namespace globule::core::thesis
