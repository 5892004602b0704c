// Triangles, and where rays meet them: the watertight test of Woop, Benthin & Wald 2013.  Its products of two float32
// numbers are taken in float64, where they are exact: two triangles always agree about a shared edge, whatever a
// compiler fuses.
#pragma once
#include "mesh/rays.hpp"

namespace globule::core {

/// The triangles of a mesh.
struct Triangles {
    static constexpr int n_corners = 3;
    const Quad* corners;  ///< (3 n,) in Morton order

    struct Ray {
        float3 o, d;
        float sx, sy, sz;
        int kx, ky, kz;
        GB_FN static float part(const float3& v, int k) { return k == 0 ? v.x : k == 1 ? v.y : v.z; }
        /// A corner in the ray's own axes, in which it runs along z.
        GB_FN void turn(const Quad& corner, float& x, float& y, float& z) const {
            const float3 p = corner.xyz() - o;
            const float along = part(p, kz);
            x = float(double(part(p, kx)) - double(sx) * double(along));
            y = float(double(part(p, ky)) - double(sy) * double(along));
            z = along;
        }
    };
    GB_FN Ray prepare(const float3& o, const float3& d) const {
        Ray r{o, d, 0, 0, 0, 0, 0, 0};
        const float ax = abs(d.x), ay = abs(d.y), az = abs(d.z);
        r.kz = ax >= ay && ax >= az ? 0 : ay >= az ? 1 : 2;
        r.kx = r.kz == 2 ? 0 : r.kz + 1;
        r.ky = r.kx == 2 ? 0 : r.kx + 1;
        if (Ray::part(d, r.kz) < 0.0f) {
            const int k = r.kx;
            r.kx = r.ky;
            r.ky = k;
        }
        const float along = Ray::part(d, r.kz);
        r.sx = Ray::part(d, r.kx) / along;
        r.sy = Ray::part(d, r.ky) / along;
        r.sz = 1.0f / along;
        return r;
    }
    /// Whether the ray's line crosses triangle k.
    GB_FN bool may_meet(const Ray& r, std::uint32_t k) const {
        const Quad* c = corners + std::size_t(3) * k;
        float ax, ay, az, bx, by, bz, cx, cy, cz;
        r.turn(c[0], ax, ay, az);
        r.turn(c[1], bx, by, bz);
        r.turn(c[2], cx, cy, cz);
        const double u = double(cx) * by - double(cy) * bx, v = double(ax) * cy - double(ay) * cx,
                     w = double(bx) * ay - double(by) * ax;
        return !(bool(u < 0) | bool(v < 0) | bool(w < 0)) | !(bool(u > 0) | bool(v > 0) | bool(w > 0));
    }
    /// Triangle k against what was found so far, in hit.t (range.to where nothing was); true: it is what counts now.
    GB_FN bool meet(
        const Ray& r, std::uint32_t k, std::uint32_t index, const RayRange& range, bool found, ItemHit& hit) const {
        const Quad* c = corners + std::size_t(3) * k;
        float ax, ay, az, bx, by, bz, cx, cy, cz;
        r.turn(c[0], ax, ay, az);
        r.turn(c[1], bx, by, bz);
        r.turn(c[2], cx, cy, cz);
        const double u = double(cx) * by - double(cy) * bx, v = double(ax) * cy - double(ay) * cx,
                     w = double(bx) * ay - double(by) * ax;
        if ((u < 0 || v < 0 || w < 0) && (u > 0 || v > 0 || w > 0)) return false;
        const double det = u + v + w;
        if (det == 0) return false;
        const bool entering = det > 0;
        if (range.side != 0 && entering != (range.side > 0)) return false;
        const float t = float((u * az + v * bz + w * cz) * r.sz / det);
        if (!(t >= range.from) || !(t <= hit.t)) return false;
        if (t == hit.t && (!found || index > hit.index)) return false;
        if (range.near > 0.0f && abs(dot(r.o - c[0].xyz(), normal(k))) < range.near) return false;
        hit = {t, k, index, entering};
        return true;
    }
    GB_FN float3 normal(std::uint32_t k) const {
        const Quad* c = corners + std::size_t(3) * k;
        const float3 a = c[0].xyz();
        return normalize(cross(normalize(c[1].xyz() - a), normalize(c[2].xyz() - a)));
    }
    GB_FN float3 normal(std::uint32_t k, const float3&) const { return normal(k); }
    /// Shares of the three corners at a point of triangle k.
    GB_FN float3 shares(std::uint32_t k, const float3& p) const {
        const Quad* c = corners + std::size_t(3) * k;
        const float3 a = c[0].xyz(), e = c[1].xyz() - a, f = c[2].xyz() - a, n = cross(e, f), at = p - a;
        const float square = dot(n, n);
        if (!(square > 0.0f)) return {1, 0, 0};
        const float y = min(max(dot(cross(at, f), n) / square, 0.0f), 1.0f),
                    z = min(max(dot(cross(e, at), n) / square, 0.0f), 1.0f - y);
        return {1.0f - y - z, y, z};
    }
};

}  // namespace globule::core
