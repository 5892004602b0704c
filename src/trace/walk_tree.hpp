// A group's walk of the octree: all lanes look at nodes together, a batch at a time.
#pragma once
#include "octree/tree.hpp"

namespace globule::core {

/// Siblings waiting to be looked at: first node and their number, 1 to 8, in 32 bits.
struct Siblings {
    std::uint32_t packed = 0;
    static constexpr std::uint32_t max_first = (1u << 29) - 8;
    GB_FN static Siblings of(std::uint32_t first, std::uint32_t n) { return {first | (n - 1) << 29}; }
    GB_FN std::uint32_t first() const { return packed & ((1u << 29) - 1); }
    GB_FN std::uint32_t count() const { return (packed >> 29) + 1; }
};

/// A group's worth of nodes.
template <class Group> struct Boxes {
    typename Group::F lo[3], hi[3];
    typename Group::U first, meta;
};
template <class Group>
GB_FN void load_boxes(Group& g, const Tree& tree, const typename Group::Runs& runs, Boxes<Group>& out) {
    for (int k = 0; k < 3; ++k) {
        out.lo[k] = g.load(tree.nodes.box[k], runs);
        out.hi[k] = g.load(tree.nodes.box[k + 3], runs);
    }
    out.first = g.load(tree.nodes.first, runs);
    out.meta = g.load(tree.nodes.meta, runs);
}

/// Where a walk begins: with the root's children, if there are any, which spares it a batch of one node.
GB_FN Siblings topmost(const Tree& tree) {
    const Node root = tree.node(0);
    const std::uint32_t n = Node::is_leaf(root.meta) ? 0 : Node::count(root.meta);
    return n ? Siblings::of(root.first, n) : Siblings::of(0, 1);
}

/// Depth first from the top, a group's worth of nodes at a time.  go(lanes, boxes) says which of the
/// nodes to open; leaf(lanes, boxes) takes the leaves among them and says whether to go on.
template <class Group, class Go, class Leaf>
GB_FN void walk_tree(Group& g, Siblings* stack, const Tree& tree, const Go& go, const Leaf& leaf) {
    using B = typename Group::B;
    // A batch may push a group's worth of entries; what stays below still needs room to go down
    // one entry at a time, 7 a level.
    constexpr int reserve = 8 * (kMaxLevels + 1);
    int top = 1;
    stack[0] = topmost(tree);
    g.sync();
    while (top > 0) {
        const int room = (Group::stack_capacity - reserve - top) / 8;
        const int take = min(min(top, int(Group::n_runs)), max(1, room));
        top -= take;
        const auto entries = g.take(stack + top, take);
        g.sync();
        for (int part = 0; part * Group::run_width < 8; ++part) {
            typename Group::Runs runs;
            const B lanes = g.lay_out(entries, part, runs);
            Boxes<Group> boxes;
            load_boxes(g, tree, runs, boxes);
            const B open = go(lanes, boxes);
            const B is_leaf = g.is_leaf(boxes.meta);
            top = g.append(open & !is_leaf, top, [&](int lane, int place) {
                stack[place] = Siblings::of(Group::get(boxes.first, lane), Group::get(boxes.meta, lane));
            });
            g.sync();
            if (!leaf(open & is_leaf, boxes)) return;
        }
    }
}

}  // namespace globule::core
