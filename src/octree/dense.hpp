// The source's octree: the array L of all cells of all levels (§3.3), 16 bytes a node.  A node's
// place is its key and the reverse (morton/code.hpp), so nothing points anywhere.
#pragma once
#include "octree/types.hpp"

namespace globule::core {

inline constexpr int kMaxDenseDepth = 8;

struct DenseNode {
    std::uint32_t first, last;  ///< run of particles [first, last); empty cells 0, 0
    std::uint32_t child_mask;   ///< bit c: child c holds particles
    float reach;                ///< largest support of a particle inside
};

struct DenseTree {
    const TreeHeader* header;
    const DenseNode* nodes;
    GB_FN bool empty() const { return header->n_nodes == 0; }

    GB_FN bool holds(std::size_t i) const { return nodes[i].last > nodes[i].first; }

    /// The node as the traversals see it; the box is the cell grown by the particles' reach.
    GB_FN Node node(std::uint32_t i) const {
        const DenseNode n = nodes[i];
        const int level = morton::dense_level(i);
        const auto cell = morton::decode(std::uint32_t(i - morton::dense_offset(level)));
        const morton::Space& space = header->space;
        const float edge = space.extent / float(1 << level);
        // A position may lie a rounding error outside of the cell that truncation gave it.
        const float reach =
            n.reach + 1e-5f * edge + 4e-7f * (abs(space.lo.x) + abs(space.lo.y) + abs(space.lo.z) + space.extent);
        Node out;
        out.lo = {
            space.lo.x + float(cell.x) * edge, space.lo.y + float(cell.y) * edge, space.lo.z + float(cell.z) * edge};
        out.hi = {out.lo.x + edge + reach, out.lo.y + edge + reach, out.lo.z + edge + reach};
        out.lo = {out.lo.x - reach, out.lo.y - reach, out.lo.z - reach};
        if (n.last <= n.first) {
            out.first = 0;
            out.meta = Node::leaf_bit;
        } else if (level == header->depth || n.last - n.first <= std::uint32_t(kLeafSize)) {
            out.first = n.first;
            out.meta = Node::leaf_bit | (n.last - n.first);
        } else {
            out.first = 8 * i + 1;
            out.meta = 8;
        }
        return out;
    }
};

}  // namespace globule::core
