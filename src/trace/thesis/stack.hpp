// Per-ray traversal of the dense octree (§2.5, §5.2): depth first, front to back, slab test (Kay &
// Kajiya 1986), a small stack of nodes.  Cells are disjoint and not grown by supports, so the leaves'
// intervals follow each other along the ray; a child that is empty or missed is never pushed.
#pragma once
#include "octree/dense.hpp"

namespace globule::core::thesis {

struct Ray {
    float3 o, d, inverse;  ///< inverse: 1 / d, finite
    GB_FN Ray(const float3& origin, const float3& direction)
        : o(origin), d(direction), inverse{reciprocal(direction.x), reciprocal(direction.y), reciprocal(direction.z)} {}
    GB_FN float3 at(float t) const { return o + d * t; }

private:
    GB_FN static float reciprocal(float v) { return 1.0f / (abs(v) > 1e-18f ? v : v < 0.0f ? -1e-18f : 1e-18f); }
};

/// Where the cells are.  Cells at the border reach out by `pad`: a surface may lie outside the cube
/// that encloses the particles' centers (Fig. 6.5).
struct Grid {
    morton::Space space;
    int depth;
    float pad;

    GB_FN float plane(float lo, int level, std::uint32_t i) const {
        const std::uint32_t n = 1u << level;
        if (i == 0) return lo - pad;
        if (i == n) return lo + space.extent + pad;
        return lo + float(i) * (space.extent / float(n));
    }
};

/// A node, by its triplets, and the ray's interval in it.
struct Visit {
    std::uint32_t cell;
    int level;
    float enter, leave;
    int axis;  ///< of the face through which the ray enters: 0 x, 1 y, 2 z

    GB_FN std::uint64_t index() const { return morton::dense_offset(level) + cell; }
};

GB_FN bool slab_test(const Grid& grid, const Ray& ray, Visit& visit) {
    const auto c = morton::decode(visit.cell);
    const std::uint32_t at[3] = {c.x, c.y, c.z};
    const float lo[3] = {grid.space.lo.x, grid.space.lo.y, grid.space.lo.z};
    const float o[3] = {ray.o.x, ray.o.y, ray.o.z};
    const float inverse[3] = {ray.inverse.x, ray.inverse.y, ray.inverse.z};
    visit.enter = 0.0f;
    visit.leave = infinity();
    visit.axis = 0;
    for (int k = 0; k < 3; ++k) {
        const float a = (grid.plane(lo[k], visit.level, at[k]) - o[k]) * inverse[k];
        const float b = (grid.plane(lo[k], visit.level, at[k] + 1) - o[k]) * inverse[k];
        if (min(a, b) > visit.enter) {
            visit.enter = min(a, b);
            visit.axis = k;
        }
        visit.leave = min(visit.leave, max(a, b));
    }
    return visit.enter <= visit.leave;
}

/// Which nodes are walked: those that hold particles, or, with ghosts, also their neighbors
/// (`near`, made by ghosts.hpp), into which the surface may reach.
struct Occupied {
    const DenseNode* nodes;
    const std::uint8_t* near;  ///< one flag a node, or null
    GB_FN bool operator()(std::uint64_t i) const { return near ? near[i] != 0 : nodes[i].last > nodes[i].first; }
};

class Stack {
public:
    GB_FN Stack(const Grid& grid, const Ray& ray, const Occupied& occupied)
        : grid_(grid),
          ray_(ray),
          occupied_(occupied),
          nearest_((ray.d.x < 0.0f ? 1u : 0u) | (ray.d.y < 0.0f ? 2u : 0u) | (ray.d.z < 0.0f ? 4u : 0u)) {
        push({0, 0, 0.0f, 0.0f, 0});
    }

    /// The next leaf along the ray; false when there is none.
    GB_FN bool next(Visit& leaf) {
        while (top_ > 0) {
            const Entry e = entries_[--top_];
            if (e.level == grid_.depth) {
                leaf = {e.cell, e.level, 0.0f, 0.0f, 0};
                slab_test(grid_, ray_, leaf);
                return true;
            }
            for (std::uint32_t k = 8; k-- > 0;)  // farthest first
                push({e.cell << 3 | (k ^ nearest_), e.level + 1, 0.0f, 0.0f, 0});
        }
        return false;
    }

private:
    struct Entry {
        std::uint32_t cell;
        int level;
    };
    GB_FN void push(Visit visit) {
        if (occupied_(visit.index()) && slab_test(grid_, ray_, visit)) entries_[top_++] = {visit.cell, visit.level};
    }

    Grid grid_;
    Ray ray_;
    Occupied occupied_;
    std::uint32_t nearest_;  ///< the child that a ray of this direction meets first
    Entry entries_[7 * kMaxDenseDepth + 1];
    int top_ = 0;
};

}  // namespace globule::core::thesis
