// Cells of half a support, four a side to a brick.  Each knows whether the medium fills it, leaves it
// empty, or has its surface there; only those with a surface list the particles that reach them.
// Rays walk the cells, and only where there is a list do they look for the surface.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

inline constexpr int kBrick = 4;  ///< cells a side
inline constexpr int kBrickCells = kBrick * kBrick * kBrick;
inline constexpr std::uint32_t kMaxBricks =
    1u << 21;  ///< and one for every 16 particles; where space is larger, cells are larger

struct CellGrid {
    float3 lo;
    float edge, per;  ///< of a cell, and how many to a unit of length; corners and centers are float32 without rounding
    float slack;      ///< in cells: float32 may take a ray so far past a cell's side; cells know what is there too
    float scale;      ///< 1 / typical support
    int nx, ny, nz;   ///< bricks
    std::uint32_t n_bricks;
    std::uint32_t n_lists;   ///< bricks with lists wanted so far
    std::uint32_t n_blocks;  ///< blocks of particles wanted so far
    std::uint32_t n_next;    ///< bricks to be looked at next
    bool everywhere;         ///< also bricks that no ray from outside can reach

    GB_FN bool holds(const float3& p) const { return covers(p - lo); }
    /// The same of a point that counts from the corner.
    GB_FN bool covers(const float3& p) const {
        const float brick = kBrick * edge;
        return p.x >= 0.0f && p.x <= brick * nx && p.y >= 0.0f && p.y <= brick * ny && p.z >= 0.0f && p.z <= brick * nz;
    }
};

/// What a cell, or a whole brick, holds.
inline constexpr std::uint32_t kEmpty = 0, kFull = 1;
inline constexpr std::uint32_t kUnlisted = 2;         ///< a surface, but no room for its particles
inline constexpr std::uint32_t kListed = 3;           ///< brick: kListed + number of its lists
inline constexpr std::uint32_t kUnseen = 0xffffffff;  ///< brick: something reaches it; while cells are made

/// Floats a particle in a block; four at a time, as a GPU loads them.
GB_FN constexpr int block_stride(bool per_particle, bool stretched) { return stretched ? 12 : per_particle ? 8 : 4; }

/// A cell's particles: n of them in blocks from `first` on; n = 0: first is kEmpty, kFull or kUnlisted.
/// Of its eight octants (bit 0: upper half in x, 1: y, 2: z) some may be known to be empty or full.
struct CellList {
    std::uint32_t first;
    std::uint32_t n : 16, empty : 8, full : 8;
};

/// Octants of a cell that the ray p + t d, p from the cell's center, passes for t in [0, end]; inv = 1 / d.
GB_FN std::uint32_t octants_on(const float3& p, const float3& d, const float3& inv, float end) {
    const float inf = infinity();
    const auto turn = [&](float a, float v, float iv) {
        return a * v < 0.0f && (-a < end * v) == (v > 0.0f) ? -a * iv : inf;
    };
    const std::uint32_t first = (p.x > 0.0f || (p.x == 0.0f && d.x > 0.0f)) |
                                (p.y > 0.0f || (p.y == 0.0f && d.y > 0.0f)) << 1 |
                                (p.z > 0.0f || (p.z == 0.0f && d.z > 0.0f)) << 2;
    const float tx = turn(p.x, d.x, inv.x), ty = turn(p.y, d.y, inv.y), tz = turn(p.z, d.z, inv.z);
    const auto by = [&](float t) {
        return 1u << (first ^ (std::uint32_t(tx <= t) | std::uint32_t(ty <= t) << 1 | std::uint32_t(tz <= t) << 2));
    };
    return 1u << first | (tx < inf ? by(tx) : 0u) | (ty < inf ? by(ty) : 0u) | (tz < inf ? by(tz) : 0u);
}

/// The cells in memory.  A block holds Lanes::width particles: x y z relative to the cell's center in
/// typical supports, the particle's slot, and where particles differ 1 / support^2 and weight, and the square of an
/// ellipsoid's matrix.
struct Cells {
    const CellGrid* grid;
    const std::uint32_t* bricks;  ///< (n_bricks,)
    const CellList* lists;        ///< (bricks with lists, 64)
    const float* blocks;
};

/// A ray's way through the cells, brick by brick where those are alike throughout. Its distances count from where the
/// ray comes to the grid, so that they are as precise for an eye far away.
struct CellWalk {
    const CellGrid* grid;
    float3 d, inv;
    float base;   ///< distance along the ray where the walk begins
    float3 at;    ///< from the grid's corner to the ray's point there
    int x, y, z;  ///< cell; outside: x < 0
    float t;      ///< where the ray enters it, from `base` on

    CellWalk() = default;
    GB_FN CellWalk(const CellGrid& g, const float3& origin, const float3& direction, float from)
        : grid(&g), d(direction), base(from) {
        inv = {inverse(d.x), inverse(d.y), inverse(d.z)};
        begin(origin);
        bool meets = true;
        if (!grid->covers(at)) {
            float leave = infinity();
            meet_grid(leave);
            base += t * (1.0f - 1e-5f);
            begin(origin);
            leave = infinity();
            meet_grid(leave);
            meets = t <= leave;
        }
        const float per = grid->per;
        x = place(at.x + t * d.x, per, 0, kBrick * grid->nx - 1);
        y = place(at.y + t * d.y, per, 0, kBrick * grid->ny - 1);
        z = place(at.z + t * d.z, per, 0, kBrick * grid->nz - 1);
        if (!meets || grid->n_bricks == 0) x = -1;
    }
    GB_FN bool inside() const { return x >= 0; }
    GB_FN std::uint32_t brick() const {
        return (std::uint32_t(z / kBrick) * grid->ny + std::uint32_t(y / kBrick)) * grid->nx +
               std::uint32_t(x / kBrick);
    }
    GB_FN int cell_in_brick() const { return ((z % kBrick) * kBrick + y % kBrick) * kBrick + x % kBrick; }
    GB_FN float3 center() const {
        return {grid->lo.x + (float(x) + 0.5f) * grid->edge, grid->lo.y + (float(y) + 0.5f) * grid->edge,
            grid->lo.z + (float(z) + 0.5f) * grid->edge};
    }
    /// Where the ray leaves the cell.
    GB_FN float leave() const {
        return max(t, min(min(side(x, 1, at.x, inv.x), side(y, 1, at.y, inv.y)), side(z, 1, at.z, inv.z)));
    }
    /// The grid walk of Amanatides & Woo 1987, but sides are found from their planes instead of being added up, so that
    /// no error grows on a long way, and cells come in two sizes.  To the next cell (size 1) or past the brick (size
    /// kBrick) that holds this one.
    GB_FN void step(int size) {
        const float bx = side(x, size, at.x, inv.x), by = side(y, size, at.y, inv.y), bz = side(z, size, at.z, inv.z);
        const float next = min(min(bx, by), bz), per = grid->per;
        t = max(t, next);
        const bool in_x = move(x, size, bx == next, at.x, d.x, inv.x, per, grid->nx);
        const bool in_y = move(y, size, by == next && bx != next, at.y, d.y, inv.y, per, grid->ny);
        const bool in_z = move(z, size, bz == next && bx != next && by != next, at.z, d.z, inv.z, per, grid->nz);
        if (!(in_x && in_y && in_z)) x = -1;
    }

    /// The walk's t as a distance along the ray.
    GB_FN float distance() const { return base + t; }

private:
    static constexpr float kTiny = 1e-18f;
    /// At the walk's base, where the ray is far from its origin, perhaps.
    GB_FN void begin(const float3& o) {
        const auto from_corner = [&](float of, float v, float lo) { return float(double(of) + double(base) * v - lo); };
        at = {from_corner(o.x, d.x, grid->lo.x), from_corner(o.y, d.y, grid->lo.y), from_corner(o.z, d.z, grid->lo.z)};
        t = 0.0f;
    }
    /// Moves t to where the ray enters the grid; leave: where it ends there, before t if it misses.
    GB_FN void meet_grid(float& leave) {
        const float brick = kBrick * grid->edge;
        slab(at.x, d.x, inv.x, brick * grid->nx, leave);
        slab(at.y, d.y, inv.y, brick * grid->ny, leave);
        slab(at.z, d.z, inv.z, brick * grid->nz, leave);
    }
    GB_FN static float inverse(float v) { return 1.0f / (abs(v) > kTiny ? v : kTiny); }
    GB_FN static int place(float v, float per, int lo, int hi) { return int(max(float(lo), min(v * per, float(hi)))); }
    GB_FN void slab(float a, float v, float i, float size, float& leave) {
        if (abs(v) <= kTiny) {
            if (a < 0.0f || a > size) leave = -1.0f;
            return;
        }
        const float p = -a * i, q = (size - a) * i;
        t = max(t, min(p, q));
        leave = min(leave, max(p, q));
    }
    /// Far away along an axis that the ray goes across: inv is never infinite.
    GB_FN float side(int i, int size, float a, float iv) const {
        const int plane = (i & -size) + (iv > 0.0f ? size : 0);
        return (float(plane) * grid->edge - a) * iv;
    }
    /// Along one axis out of the box of `size` cells that holds i: across its side, or to where t lies in it.
    GB_FN bool move(int& i, int size, bool across, float a, float v, float iv, float per, int n) const {
        const int first = i & -size, ahead = iv > 0.0f ? first + size : first - 1;
        i = across ? ahead : size == 1 ? first : place(a + t * v, per, first, first + size - 1);
        return i >= 0 && i < kBrick * n;
    }
};

}  // namespace globule::core
