// Where the cells of trace/cells.hpp lie, and which bricks of them something reaches.
#pragma once
#include "exec/bits.hpp"
#include "octree/tree.hpp"
#include "trace/cells.hpp"

namespace globule::core {

inline constexpr float kCellEdge = 0.4f;  ///< in typical supports: fewest particles a ray (docs/design/cells.md)
inline constexpr float kStretchedCellEdge = 0.3f;  ///< of ellipsoids, whose support is their longest axis

/// Grid over the octree's root box, which holds all supports.
struct PlanCells {
    Tree tree;
    bool stretched;
    float most_bricks;
    bool everywhere;  ///< else only what rays from outside can reach, if the eye is outside
    float3 eye;
    CellGrid* grid;
    GB_FN void operator()(std::size_t) const {
        CellGrid g{};
        if (!tree.empty()) {
            const Node box = tree.node(0);
            const float3 size = box.hi - box.lo;
            g.edge = (stretched ? kStretchedCellEdge : kCellEdge) * tree.header->typical_support;
            // A coordinate is at most 2^18 edges, an edge 5 bits long and the grid's corner a multiple of its last bit:
            // so corners and centers of cells need no more than float32's 24 bits, and all who count from them count
            // from the same place.
            g.edge = max(g.edge, 4e-6f * (length(box.lo) + length(box.hi)));
            for (;; g.edge *= 1.25f) {
                int exponent;
                const float digits = frexpf(g.edge, &exponent) * 32.0f;
                g.edge = ldexpf(rintf(digits), exponent - 5);
                const float unit = ldexpf(1.0f, exponent - 5), per = 1.0f / (g.edge * kBrick),
                            more = 0.01f + unit * per;
                const float nx = ceilf(size.x * per + more), ny = ceilf(size.y * per + more),
                            nz = ceilf(size.z * per + more);
                if (!(nx * ny * nz <= most_bricks)) continue;
                g.nx = int(nx);
                g.ny = int(ny);
                g.nz = int(nz);
                g.lo = {floorf(box.lo.x / unit) * unit, floorf(box.lo.y / unit) * unit, floorf(box.lo.z / unit) * unit};
                g.slack = 1e-4f + 5e-7f * (length(box.lo) + length(box.hi)) / g.edge;
                break;
            }
            g.per = 1.0f / g.edge;
            g.scale = 1.0f / tree.header->typical_support;
            g.n_bricks = std::uint32_t(g.nx) * g.ny * g.nz;
            g.everywhere = everywhere || g.holds(eye);
        }
        *grid = g;
    }
};

/// Marks the bricks that a leaf's supports may reach, so that empty space costs no walk of the tree.
struct MarkBricks {
    Tree tree;
    std::size_t n_nodes;
    const CellGrid* grid;
    std::uint32_t* bricks;  ///< cleared
    GB_FN void operator()(std::size_t i) const {
        if (grid->n_bricks == 0 || !tree.holds(i)) return;
        const Node node = tree.node(std::uint32_t(i));
        if (!Node::is_leaf(node.meta) || Node::count(node.meta) == 0) return;
        const float per = 1.0f / (grid->edge * kBrick);
        const int x0 = place(node.lo.x - grid->lo.x, per, -1, grid->nx),
                  x1 = place(node.hi.x - grid->lo.x, per, 1, grid->nx);
        const int y0 = place(node.lo.y - grid->lo.y, per, -1, grid->ny),
                  y1 = place(node.hi.y - grid->lo.y, per, 1, grid->ny);
        const int z0 = place(node.lo.z - grid->lo.z, per, -1, grid->nz),
                  z1 = place(node.hi.z - grid->lo.z, per, 1, grid->nz);
        for (int z = z0; z <= z1; ++z)
            for (int y = y0; y <= y1; ++y)
                for (int x = x0; x <= x1; ++x)
                    raise_flag(bricks + (std::size_t(z) * grid->ny + y) * grid->nx + x, kUnseen);
    }

private:
    /// A brick's number along one axis, a little further on to `side`.
    GB_FN int place(float v, float per, int side, int n) const {
        return int(max(0.0f, min(floorf(v * per + (1e-3f + grid->slack) * side), float(n - 1))));
    }
};

/// Begins a list of bricks.
struct BeginBricks {
    CellGrid* grid;
    GB_FN void operator()(std::size_t) const { grid->n_next = 0; }
};

/// Lists the bricks that nobody has looked at yet and that a ray can enter: beside them there is one that is not full.
struct ListBricks {
    CellGrid* grid;
    const std::uint32_t* bricks;
    std::uint32_t* next;
    GB_FN void operator()(std::size_t i) const {
        if (i >= grid->n_bricks || bricks[i] != kUnseen) return;
        if (grid->everywhere || is_open(i)) next[atomic_take(&grid->n_next, 1)] = std::uint32_t(i);
    }

private:
    GB_FN bool is_open(std::size_t i) const {
        const int x = int(i % grid->nx), y = int(i / grid->nx % grid->ny), z = int(i / grid->nx / grid->ny);
        if (x == 0 || y == 0 || z == 0 || x + 1 == grid->nx || y + 1 == grid->ny || z + 1 == grid->nz) return true;
        for (int dz = -1; dz <= 1; ++dz)
            for (int dy = -1; dy <= 1; ++dy)
                for (int dx = -1; dx <= 1; ++dx) {
                    const std::uint32_t state =
                        bricks[(std::size_t(z + dz) * grid->ny + (y + dy)) * grid->nx + (x + dx)];
                    if (state != kFull && state != kUnseen) return true;
                }
        return false;
    }
};

/// Bricks that no ray can enter are as good as full.
struct CloseBricks {
    const CellGrid* grid;
    std::uint32_t* bricks;
    GB_FN void operator()(std::size_t i) const {
        if (i < grid->n_bricks && bricks[i] == kUnseen) bricks[i] = kFull;
    }
};

}  // namespace globule::core
