// The knife: a bond is cut exactly when its segment crosses a triangle that the blade swept.
//
// Points are snapped to a fine grid and all signs come from integers, so that no rounding can let a bond
// slip through between two triangles.  Ties are broken by moving all tissue by (ε, ε², ε³) against the blade
// (simulation of simplicity, Edelsbrunner & Mücke 1990, for a translation): then no particle lies on a plane
// and no bond meets an edge, and of two triangles that share an edge, exactly one is crossed by a bond
// that passes there -- also where one triangle belongs to this swept surface and the other to the next.
#pragma once
#include "exec/bits.hpp"
#include "sim/bonds.hpp"

namespace globule::core::tissue {

using Wide = __int128;

/// A point of the grid; coordinates below 2^31, so that determinants stay below 2^99.
struct GridPoint { std::int64_t x, y, z; };
GB_FN GridPoint operator-(const GridPoint& a, const GridPoint& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
GB_FN GridPoint operator+(const GridPoint& a, const GridPoint& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }

/// World to grid.  Even numbers only, so that midpoints are points of the grid too.
struct Grid {
    double origin[3] = {0, 0, 0}, cells_per_unit = 1.0;
    static constexpr double kReach = 1073741824.0;  ///< 2^30
    GB_FN std::int64_t snap(double v, int axis) const {
        double g = (v - origin[axis]) * cells_per_unit;
        g = g > kReach ? kReach : g < -kReach ? -kReach : g;
        return 2 * std::int64_t(rint(0.5 * g));
    }
    GB_FN GridPoint snap(const float3& p) const { return {snap(p.x, 0), snap(p.y, 1), snap(p.z, 2)}; }
};

struct WidePoint { Wide x, y, z; };
GB_FN WidePoint cross(const GridPoint& a, const GridPoint& b) {
    return {Wide(a.y) * b.z - Wide(a.z) * b.y, Wide(a.z) * b.x - Wide(a.x) * b.z, Wide(a.x) * b.y - Wide(a.y) * b.x};
}
GB_FN Wide dot(const GridPoint& a, const WidePoint& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
GB_FN int sign(Wide v) { return (v > 0) - (v < 0); }
/// Sign of v · (ε, ε², ε³).
GB_FN int sign_along_shift(const WidePoint& v) { return v.x != 0 ? sign(v.x) : v.y != 0 ? sign(v.y) : sign(v.z); }

struct Triangle { GridPoint a, b, c; };

/// On which side of the triangle's plane p lies; 0 only if the triangle has no area.
GB_FN int side_of_plane(const Triangle& t, const GridPoint& p) {
    const WidePoint n = cross(t.b - t.a, t.c - t.a);
    const int s = sign(dot(p - t.a, n));
    return s != 0 ? s : sign_along_shift(n);
}
/// On which side of the line p q the directed edge a b passes; 0 only if they are parallel.
GB_FN int side_of_line(const GridPoint& a, const GridPoint& b, const GridPoint& p, const GridPoint& q) {
    const WidePoint n = cross(p - a, q - a);
    const int s = sign(dot(b - a, n));
    return s != 0 ? s : sign_along_shift(cross(b - a, p - q));
}

GB_FN bool crosses(const Triangle& t, const GridPoint& p, const GridPoint& q) {
    if (side_of_plane(t, p) == side_of_plane(t, q)) return false;
    const int s = side_of_line(t.a, t.b, p, q);
    return s == side_of_line(t.b, t.c, p, q) && s == side_of_line(t.c, t.a, p, q);
}

/// A blade's triangles.  The first n_moving vertices are those of the pose before this step: they are seen
/// from where each bond was then, so that what counts is the motion of the edge against the bond.
struct SweptSurface {
    Grid grid;
    const GridPoint* vertices = nullptr;
    const std::uint32_t* triangles = nullptr;  ///< (n, 3)
    std::uint32_t n = 0, n_moving = 0;
    float3 lo, hi;  ///< box of all vertices, with a margin for snapping

    GB_FN GridPoint vertex(std::uint32_t v, const GridPoint& shift) const {
        return v < n_moving ? vertices[v] + shift : vertices[v];
    }
    GB_FN bool crossed(const GridPoint& p, const GridPoint& q, const GridPoint& shift) const {
        for (std::uint32_t i = 0; i < n; ++i) {
            const Triangle t{vertex(triangles[3 * i], shift), vertex(triangles[3 * i + 1], shift),
                vertex(triangles[3 * i + 2], shift)};
            if (may_meet(t, p, q) && crosses(t, p, q)) return true;
        }
        return false;
    }
    GB_FN static bool may_meet(const Triangle& t, const GridPoint& p, const GridPoint& q) {
        return overlap(t.a.x, t.b.x, t.c.x, p.x, q.x) && overlap(t.a.y, t.b.y, t.c.y, p.y, q.y) &&
               overlap(t.a.z, t.b.z, t.c.z, p.z, q.z);
    }
    GB_FN static bool overlap(std::int64_t a, std::int64_t b, std::int64_t c, std::int64_t p, std::int64_t q) {
        return min(a, min(b, c)) <= max(p, q) && max(a, max(b, c)) >= min(p, q);
    }
};

/// Cuts the bonds that the swept surface crosses.  A bond belongs to its lesser end.
struct Cut {
    Bonds bonds;
    const Quad* at;
    const float3* before;  ///< where particles were at the blade's last pose; null: where they are
    SweptSurface surface;
    std::uint32_t* n_cut;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        const float3 here = at[t].xyz();
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
            const std::uint32_t o = bonds.other[e];
            if (o <= t || bonds.length[e] <= 0.0f) continue;
            const float3 there = at[o].xyz();
            const float3 moved = before ? (here + there - before[t] - before[o]) * 0.5f : float3{0, 0, 0};
            if (!near(here.x, there.x, moved.x, surface.lo.x, surface.hi.x) ||
                !near(here.y, there.y, moved.y, surface.lo.y, surface.hi.y) ||
                !near(here.z, there.z, moved.z, surface.lo.z, surface.hi.z))
                continue;
            const GridPoint p = surface.grid.snap(here), q = surface.grid.snap(there);
            GridPoint shift{0, 0, 0};
            if (before) {
                shift = (p + q) - (surface.grid.snap(before[t]) + surface.grid.snap(before[o]));
                shift = {shift.x / 2, shift.y / 2, shift.z / 2};
            }
            if (!surface.crossed(p, q, shift)) continue;
            bonds.set_length(t, e, -bonds.length[e]);
            atomic_take(n_cut, 1);
        }
    }
    /// Whether the bond, now or where it was, reaches between lo and hi along one axis.
    GB_FN static bool near(float p, float q, float moved, float lo, float hi) {
        return min(p, q) - max(moved, 0.0f) <= hi && max(p, q) - min(moved, 0.0f) >= lo;
    }
};

}  // namespace globule::core::tissue
