// The sparse linear octree: only occupied cells, in level order, siblings side by side.
#pragma once
#include "octree/types.hpp"

namespace globule::core {

struct Tree {
    const TreeHeader* header;
    NodeArrays nodes;
    GB_FN bool empty() const { return header->n_nodes == 0; }
    GB_FN bool holds(std::size_t i) const { return i < header->n_nodes; }
    GB_FN Node node(std::uint32_t i) const { return nodes[i]; }
};

}  // namespace globule::core
