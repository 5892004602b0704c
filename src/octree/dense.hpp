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
    GB_FN bool empty() const { return nodes[0].last <= nodes[0].first; }
};

}  // namespace globule::core
