// Where the cells of trace/cells.hpp lie, and which bricks of them something reaches.
#pragma once
#include "exec/bits.hpp"
#include "octree/dense.hpp"
#include "octree/sparse.hpp"
#include "trace/cells.hpp"

namespace globule::core {

inline constexpr float kCellEdge = 0.4f;  ///< in typical supports: fewest particles a ray (docs/design/cells.md)
inline constexpr float kStretchedCellEdge = 0.3f;  ///< of ellipsoids, whose support is their longest axis

/// Grid over the octree's root box, which holds all supports.
template <class Tree>
struct PlanCells {
    Tree tree;
    bool stretched;
    CellGrid* grid;
    GB_FN void operator()(std::size_t) const {
        CellGrid g{};
        if (!tree.empty()) {
            const Node box = tree.node(0);
            const float3 size = box.hi - box.lo;
            g.edge = (stretched ? kStretchedCellEdge : kCellEdge) * tree.header->typical_support;
            // Past this a cell would not move a ray on in float32.
            g.edge = max(g.edge, 2e-6f * (length(box.lo) + length(box.hi)));
            for (;; g.edge *= 1.25f) {
                const float per = 1.0f / (g.edge * kBrick);
                const float bricks = ceilf(size.x * per + 0.01f) * ceilf(size.y * per + 0.01f) * ceilf(size.z * per + 0.01f);
                if (!(bricks <= float(kMaxBricks))) continue;
                g.nx = int(ceilf(size.x * per + 0.01f));
                g.ny = int(ceilf(size.y * per + 0.01f));
                g.nz = int(ceilf(size.z * per + 0.01f));
                break;
            }
            g.lo = box.lo;
            g.per = 1.0f / g.edge;
            g.scale = 1.0f / tree.header->typical_support;
            g.n_bricks = std::uint32_t(g.nx) * g.ny * g.nz;
        }
        *grid = g;
    }
};

/// Marks the bricks that a leaf's supports may reach, so that empty space costs no walk of the tree.
template <class Tree>
struct MarkBricks {
    Tree tree;
    std::size_t n_nodes;
    const CellGrid* grid;
    std::uint32_t* bricks;   ///< cleared
    GB_FN void operator()(std::size_t i) const {
        if (grid->n_bricks == 0 || !tree.holds(i)) return;
        const Node node = tree.node(std::uint32_t(i));
        if (!Node::is_leaf(node.meta) || Node::count(node.meta) == 0) return;
        const float per = 1.0f / (grid->edge * kBrick);
        const int x0 = place(node.lo.x - grid->lo.x, per, -1, grid->nx), x1 = place(node.hi.x - grid->lo.x, per, 1, grid->nx);
        const int y0 = place(node.lo.y - grid->lo.y, per, -1, grid->ny), y1 = place(node.hi.y - grid->lo.y, per, 1, grid->ny);
        const int z0 = place(node.lo.z - grid->lo.z, per, -1, grid->nz), z1 = place(node.hi.z - grid->lo.z, per, 1, grid->nz);
        for (int z = z0; z <= z1; ++z)
            for (int y = y0; y <= y1; ++y)
                for (int x = x0; x <= x1; ++x) raise_flag(bricks + (std::size_t(z) * grid->ny + y) * grid->nx + x);
    }

private:
    /// A brick's number along one axis, a little further on to `side`.
    GB_FN static int place(float v, float per, int side, int n) {
        return int(max(0.0f, min(floorf(v * per + 1e-3f * side), float(n - 1))));
    }
};

}  // namespace globule::core
