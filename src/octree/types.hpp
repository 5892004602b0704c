// What the octree is made of.  Particles sorted by Morton key; nodes point at runs of them.
#pragma once
#include "base/vec.hpp"
#include "base/view.hpp"
#include "morton/quantize.hpp"

namespace globule::core {

/// Of a scene: their numbers have 32 bits, and packets read 64 past the last.
inline constexpr std::size_t kMaxParticles = (std::size_t(1) << 31) - 64;

/// Particles in key order, structure of arrays, world units.
struct SortedParticles {
    const float* x;
    const float* y;
    const float* z;
    const std::uint32_t* index;  ///< place in the caller's arrays
    Attribute support;           ///< per sorted slot, or one for all
    Attribute weight;
    const float* stretch =
        nullptr;  ///< (n, 6) per sorted slot, xx yy zz xy xz yz: the particle reaches v where |G v| < 1; null: balls
    float most_stretch = 1.0f;        ///< largest ratio of a particle's axes; `support` is its longest
    const float* shortest = nullptr;  ///< (n,) per sorted slot: shortest axis; null: not known beyond most_stretch
    float least_axis = 0.0f;          ///< no axis is shorter

    template <class F> GB_FN Sym3<F> matrix(std::size_t slot) const {
        const float* m = stretch + 6 * slot;
        return {F(m[0]), F(m[1]), F(m[2]), F(m[3]), F(m[4]), F(m[5])};
    }
    /// x at v from the particle's center: (|v| / a)^2, or |G v|^2.
    template <class F> GB_FN F x_at(std::size_t slot, const Vec3<F>& v) const {
        if (stretch) {
            const Vec3<F> w = matrix<F>(slot) * v;
            return dot(w, w);
        }
        return dot(v, v) / (F(support[slot]) * F(support[slot]));
    }
    /// Half of x's gradient there.
    template <class F> GB_FN Vec3<F> half_gradient(std::size_t slot, const Vec3<F>& v) const {
        if (stretch) return matrix<F>(slot) * (matrix<F>(slot) * v);
        return v * (F(1) / (F(support[slot]) * F(support[slot])));
    }
    GB_FN float3 position(std::size_t slot) const { return {x[slot], y[slot], z[slot]}; }
};

/// A node's box holds the supports of all particles below, not only their centers: what the box does
/// not touch, its particles cannot influence ("ghost neighbors" of §5.3 come along).
struct Node {
    float3 lo, hi;
    std::uint32_t first;  ///< inner: first child (children are consecutive); leaf: first particle
    std::uint32_t meta;   ///< inner: number of children; leaf: leaf_bit | number of particles
    static constexpr std::uint32_t leaf_bit = 1u << 31;
    GB_FN static bool is_leaf(std::uint32_t meta) { return meta & leaf_bit; }
    GB_FN static std::uint32_t count(std::uint32_t meta) { return meta & ~leaf_bit; }
    GB_FN static Node nothing() {
        const float inf = infinity();
        return {{inf, inf, inf}, {-inf, -inf, -inf}, 0, 0};
    }
    GB_FN void unite(const float3& l, const float3& h) {
        lo = {min(lo.x, l.x), min(lo.y, l.y), min(lo.z, l.z)};
        hi = {max(hi.x, h.x), max(hi.y, h.y), max(hi.z, h.z)};
    }
};

/// Nodes in memory: 32 bytes each as eight arrays, so that siblings load as vectors.
struct NodeArrays {
    float* box[6];  ///< lo x y z, hi x y z
    std::uint32_t *first, *meta;
    GB_FN Node operator[](std::size_t i) const {
        return {{box[0][i], box[1][i], box[2][i]}, {box[3][i], box[4][i], box[5][i]}, first[i], meta[i]};
    }
    GB_FN void set(std::size_t i, const Node& n) const {
        box[0][i] = n.lo.x;
        box[1][i] = n.lo.y;
        box[2][i] = n.lo.z;
        box[3][i] = n.hi.x;
        box[4][i] = n.hi.y;
        box[5][i] = n.hi.z;
        first[i] = n.first;
        meta[i] = n.meta;
    }
};

inline constexpr int kMaxLevels = 21;
inline constexpr std::uint32_t kMaxNodes = 1u << 29;
inline constexpr int kLeafSize = 32;  ///< a cell with more particles is split
inline constexpr int kChunk = 8;      ///< consecutive particles that one thread turns into nodes

/// What a build finds out; lives beside the tree, on the device.
struct TreeHeader {
    morton::Space space;
    float typical_support;    ///< geometric mean of the smallest and the largest
    float most_weight;        ///< largest magnitude
    std::uint32_t n_nodes;    ///< 0 where no particle is inside
    std::uint32_t n_outside;  ///< particles marked as outside; they come first
    std::int32_t depth;       ///< deepest level that may be used
    std::uint32_t n_wanted;   ///< nodes that the full depth would have taken
    std::int32_t deepest;     ///< deepest level with a node
    std::uint32_t level_begin[kMaxLevels + 3];
};

}  // namespace globule::core
