// Capsules, and where rays meet them: all points within a radius of a segment, whose ends may be one place, which makes
// a ball. In float64, so that a small one far from the ray's origin is met to within its own rounding.
#pragma once
#include "mesh/rays.hpp"

namespace globule::core {

/// The capsules of a layer.
struct Capsules {
    static constexpr int n_corners = 2;
    const Quad* ends;  ///< (2 n,) in Morton order, w: the radius

    struct Ray { Vec3<double> o, d; };
    GB_FN static Vec3<double> wide(const float3& v) { return {double(v.x), double(v.y), double(v.z)}; }
    GB_FN Ray prepare(const float3& o, const float3& d) const { return {wide(o), wide(d)}; }

    /// Part of a ray inside of something.
    struct Inside {
        double in = double(infinity()), out = -double(infinity());
        GB_FN void unite(double from, double to) {
            if (!(from <= to)) return;
            in = min(in, from);
            out = max(out, to);
        }
    };
    /// b: from the ray's origin to the ball's center, along: its part along the ray.  The chord's half comes from the
    /// distance between the center and the ray (Haines et al. 2019), which cancels less than the usual formula.
    GB_FN static void unite_ball(Inside& inside, const Vec3<double>& d, const Vec3<double>& b, double radius) {
        const double along = dot(b, d), dd = dot(d, d), at = along / dd;
        const Vec3<double> off = b - d * at;
        const double square = radius * radius - dot(off, off);
        if (!(square >= 0.0)) return;
        const double half = sqrt(square / dd);
        inside.unite(at - half, at + half);
    }
    /// A capsule is convex: the union of the two balls and the part of a cylinder between them is one interval of the
    /// ray.
    GB_FN Inside cross(const Ray& r, std::uint32_t k) const {
        const Quad p = ends[std::size_t(2) * k], q = ends[std::size_t(2) * k + 1];
        const double radius = double(p.w);
        const Vec3<double> a = wide(p.xyz()) - r.o, b = wide(q.xyz()) - r.o, axis = b - a;
        Inside inside;
        unite_ball(inside, r.d, a, radius);
        const double square = dot(axis, axis);
        if (!(square > 0.0)) return inside;
        unite_ball(inside, r.d, b, radius);
        // Across the axis: the ray's distance from it, as for a ball in the plane.
        const double rise = dot(r.d, axis) / square, base = dot(a, axis) / square;
        const Vec3<double> d = r.d - axis * rise, c = a - axis * base;
        const double dd = dot(d, d);
        double from = -double(infinity()), to = double(infinity());
        if (dd > 0.0) {
            const double at = dot(c, d) / dd;
            const Vec3<double> off = c - d * at;
            const double left = radius * radius - dot(off, off);
            if (!(left >= 0.0)) return inside;
            const double half = sqrt(left / dd);
            from = at - half;
            to = at + half;
        } else if (dot(c, c) > radius * radius) {
            return inside;
        }
        if (rise != 0.0) {  // 0 <= rise t - base <= 1
            const double one = base / rise, other = (base + 1.0) / rise;
            from = max(from, min(one, other));
            to = min(to, max(one, other));
        } else if (-base < 0.0 || -base > 1.0) {
            return inside;
        }
        inside.unite(from, to);
        return inside;
    }
    GB_FN bool may_meet(const Ray&, std::uint32_t) const { return true; }
    /// Capsule k against what was found so far, as for triangles.
    GB_FN bool meet(
        const Ray& r, std::uint32_t k, std::uint32_t index, const RayRange& range, bool found, ItemHit& hit) const {
        const Inside inside = cross(r, k);
        if (!(inside.in <= inside.out)) return false;
        bool better = false;
        const auto look = [&](double at, bool entering) {
            const float t = float(at);
            if ((range.side != 0 && entering != (range.side > 0)) || !(t >= range.from) || !(t <= hit.t)) return;
            if (t == hit.t && (!(found || better) || index > hit.index)) return;
            hit = {t, k, index, entering};
            better = true;
        };
        // A ray that begins on the surface and leaves has the middle of its chord behind it.
        if (inside.in >= 0.0 || inside.in + inside.out > 0.0) look(inside.in, true);
        look(inside.out, false);
        return better;
    }
    /// At a place near the surface: where along the axis, from 0 to 1.
    GB_FN float along(std::uint32_t k, const float3& at) const {
        const float3 a = ends[std::size_t(2) * k].xyz(), axis = ends[std::size_t(2) * k + 1].xyz() - a;
        const float square = dot(axis, axis);
        return square > 0.0f ? min(max(dot(at - a, axis) / square, 0.0f), 1.0f) : 0.0f;
    }
    GB_FN float3 normal(std::uint32_t k, const float3& at) const {
        const float3 a = ends[std::size_t(2) * k].xyz(), axis = ends[std::size_t(2) * k + 1].xyz() - a,
                     n = at - (a + axis * along(k, at));
        return dot(n, n) > 0.0f ? normalize(n) : float3{0, 0, 1};
    }
    /// Shares of the two ends.
    GB_FN float3 shares(std::uint32_t k, const float3& at) const {
        const float s = along(k, at);
        return {1.0f - s, s, 0.0f};
    }
};

}  // namespace globule::core
