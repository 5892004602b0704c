// Boxes -> centers -> keys -> sort -> binary radix tree -> nodes of four, all on the device, nothing read back.
//
// Karras 2012: inner node i of the binary tree begins or ends at sorted item i and holds all items whose keys share a
// prefix that its neighbor on the other side does not have; equal keys go on with the items' places.  Leaves carry
// their boxes towards the root, whoever arrives last at a node goes on.  Then each inner node takes, instead of its two
// children, up to four of its descendants: while there is room, the child with the largest surface is replaced by its
// own two.
#pragma once
#include "exec/bits.hpp"
#include "exec/buffer.hpp"
#include "mesh/types.hpp"
#include "morton/quantize.hpp"

namespace globule::core {

namespace mesh_build {

using Key = std::uint64_t;
inline constexpr std::uint32_t kLeaf = 1u << 31;  ///< of a binary node's child: a sorted item
inline constexpr std::uint32_t kLeafItems =
    WideNode::most_of_leaf;  ///< a subtree with no more items is a leaf of the wide tree

struct Bounds { Box all, centers; };
template <class Boxes> struct BoundsOf {
    Boxes boxes;
    GB_FN Bounds operator()(std::size_t i) const {
        const Box b = boxes(i);
        const float3 c = b.middle();
        return {b, {c, c}};
    }
};
struct Unite {
    GB_FN Bounds operator()(const Bounds& a, const Bounds& b) const {
        return {a.all.united(b.all), a.centers.united(b.centers)};
    }
};

template <class Boxes> struct MakeKeys {
    Boxes boxes;
    const Bounds* bounds;
    Key* keys;
    std::uint32_t* index;
    GB_FN void operator()(std::size_t i) const {
        const float3 lo = bounds->centers.lo, hi = bounds->centers.hi;
        keys[i] = morton::key_of<Key>(boxes(i).middle(), {lo, max(max(hi.x - lo.x, hi.y - lo.y), hi.z - lo.z)});
        index[i] = std::uint32_t(i);
    }
};

struct Binary {
    std::uint32_t *left, *right, *first, *last;  ///< of inner nodes
    std::uint32_t *parent_of_item, *parent_of_node, *arrived;
    float* box;  ///< (n - 1, 6)
    GB_FN Box box_of(std::size_t i) const {
        const float* b = box + 6 * i;
        return {{read_fresh(b), read_fresh(b + 1), read_fresh(b + 2)},
            {read_fresh(b + 3), read_fresh(b + 4), read_fresh(b + 5)}};
    }
};

struct Link {
    const Key* keys;
    std::int64_t n;
    Binary tree;
    GB_FN int shared(std::int64_t i, std::int64_t j) const {
        if (j < 0 || j >= n) return -1;
        return keys[i] != keys[j] ? leading_zeros(keys[i] ^ keys[j])
                                  : 64 + leading_zeros(std::uint32_t(i) ^ std::uint32_t(j));
    }
    GB_FN void operator()(std::size_t at) const {
        const std::int64_t i = std::int64_t(at), d = shared(i, i + 1) > shared(i, i - 1) ? 1 : -1;
        const int outside = shared(i, i - d);
        std::int64_t most = 2, length = 0;
        while (shared(i, i + most * d) > outside) most *= 2;
        for (std::int64_t t = most / 2; t > 0; t /= 2)
            if (shared(i, i + (length + t) * d) > outside) length += t;
        const std::int64_t j = i + length * d;
        const int prefix = shared(i, j);
        std::int64_t split = 0, t = length;
        do {
            t = (t + 1) / 2;
            if (shared(i, i + (split + t) * d) > prefix) split += t;
        } while (t > 1);
        const std::int64_t cut = i + split * d + min<std::int64_t>(d, 0), begin = min(i, j), end = max(i, j);
        tree.first[at] = std::uint32_t(begin);
        tree.last[at] = std::uint32_t(end);
        tree.left[at] = adopt(begin == cut, cut, at);
        tree.right[at] = adopt(end == cut + 1, cut + 1, at);
        tree.arrived[at] = 0;
        if (at == 0) tree.parent_of_node[0] = 0;
    }
    GB_FN std::uint32_t adopt(bool is_item, std::int64_t child, std::size_t parent) const {
        (is_item ? tree.parent_of_item : tree.parent_of_node)[child] = std::uint32_t(parent);
        return std::uint32_t(child) | (is_item ? kLeaf : 0u);
    }
};

/// Boxes of items in Morton order.
template <class Boxes> struct SortedBoxes {
    Boxes boxes;
    const std::uint32_t* index;
    GB_FN Box operator()(std::size_t k) const { return boxes(index[k]); }
};

template <class Boxes> struct CarryBoxes {
    SortedBoxes<Boxes> items;
    Binary tree;
    GB_FN Box box_of(std::uint32_t child) const { return child & kLeaf ? items(child & ~kLeaf) : tree.box_of(child); }
    GB_FN void operator()(std::size_t k) const {
        for (std::uint32_t at = tree.parent_of_item[k];; at = tree.parent_of_node[at]) {
            if (atomic_increment(&tree.arrived[at]) == 0) return;
            const Box b = box_of(tree.left[at]).united(box_of(tree.right[at]));
            const float six[6] = {b.lo.x, b.lo.y, b.lo.z, b.hi.x, b.hi.y, b.hi.z};
            for (int a = 0; a < 6; ++a) tree.box[std::size_t(6) * at + a] = six[a];
            if (at == 0) return;
        }
    }
};

template <class Boxes> struct Widen {
    CarryBoxes<Boxes> boxes;
    const Bounds* bounds;
    std::size_t n;  ///< items
    WideNode* nodes;
    BoxTreeHeader* header;
    GB_FN std::uint32_t count(std::uint32_t child) const {
        return child & kLeaf ? 1 : boxes.tree.last[child] - boxes.tree.first[child] + 1;
    }

    GB_FN void operator()(std::size_t i) const {
        const float farthest = n ? bounds->all.farthest() : 0.0f;
        if (i == 0) *header = {n ? bounds->all : Box::nothing(), 2e-6f * farthest};
        if (i > 0 && count(std::uint32_t(i)) <= kLeafItems) return;  // part of a leaf
        std::uint32_t child[WideNode::width];
        Box box[WideNode::width];
        int used = 0;
        if (n == 1) {
            child[used++] = kLeaf;
            box[0] = boxes.box_of(kLeaf);
        } else if (n > 1) {
            child[0] = boxes.tree.left[i];
            child[1] = boxes.tree.right[i];
            for (; used < 2; ++used) box[used] = boxes.box_of(child[used]);
        }
        while (used >= 2 && used < WideNode::width) {
            int widest = -1;
            float most = -1.0f;
            for (int k = 0; k < used; ++k)
                if (count(child[k]) > kLeafItems && box[k].area() > most) {
                    most = box[k].area();
                    widest = k;
                }
            if (widest < 0) break;
            const std::uint32_t opened = child[widest];
            child[widest] = boxes.tree.left[opened];
            box[widest] = boxes.box_of(child[widest]);
            child[used] = boxes.tree.right[opened];
            box[used] = boxes.box_of(child[used]);
            ++used;
        }
        WideNode out;
        const float pad = 5e-7f * farthest;  // the rounding of box tests must not let a ray slip through
        for (int k = 0; k < WideNode::width; ++k) {
            const bool there = k < used;
            const Box b = there ? box[k] : Box::nothing();
            const std::uint32_t first = !there ? 0 : child[k] & kLeaf ? child[k] & ~kLeaf : boxes.tree.first[child[k]];
            out.lo[0][k] = b.lo.x - pad;
            out.lo[1][k] = b.lo.y - pad;
            out.lo[2][k] = b.lo.z - pad;
            out.hi[0][k] = b.hi.x + pad;
            out.hi[1][k] = b.hi.y + pad;
            out.hi[2][k] = b.hi.z + pad;
            out.child[k] = !there                          ? WideNode::none
                           : count(child[k]) <= kLeafItems ? WideNode::leaf_of(first, count(child[k]))
                                                           : child[k];
        }
        nodes[i] = out;
    }
};

}  // namespace mesh_build

/// Owns the hierarchy over the items of one scene.
template <class Exec> class BoxHierarchy {
public:
    explicit BoxHierarchy(Exec& exec)
        : exec_(exec), bounds_(exec), keys_(exec), words_(exec), boxes_(exec), nodes_(exec), header_(exec) {}

    /// boxes(i): of the caller's i-th item; what it reads must stay until the work is done.
    template <class Boxes> void build(std::size_t n, const Boxes& boxes) {
        using namespace mesh_build;
        Bounds* bounds = bounds_.reserve(1);
        const std::size_t inner = n > 1 ? n - 1 : 0, nodes = max<std::size_t>(inner, 1);
        Key* keys = keys_.reserve(2 * n + 1);
        std::uint32_t* words = words_.reserve(2 * n + 7 * nodes);
        std::uint32_t *spare = words + n, *more = words + 2 * n;  // the parents of items take the spare's room
        const Binary tree{more, more + nodes, more + 2 * nodes, more + 3 * nodes, spare, more + 4 * nodes,
            more + 5 * nodes, boxes_.reserve(6 * nodes)};
        exec_.reduce(n, BoundsOf<Boxes>{boxes}, Unite{}, Bounds{Box::nothing(), Box::nothing()}, bounds);
        exec_.for_each(n, MakeKeys<Boxes>{boxes, bounds, keys, words});
        exec_.sort_pairs(n, keys, keys + n, words, spare, 3 * morton::Traits<Key>::levels);
        exec_.for_each(inner, Link{keys, std::int64_t(n), tree});
        const CarryBoxes<Boxes> carry{{boxes, words}, tree};
        if (inner) exec_.for_each(n, carry);
        exec_.for_each(nodes, Widen<Boxes>{carry, bounds, n, nodes_.reserve(nodes), header_.reserve(1)});
        tree_ = {header_.data(), nodes_.data(), tree.first, tree.last, words};
    }
    const BoxTree& tree() const { return tree_; }
    std::size_t bytes() const { return keys_.bytes() + words_.bytes() + boxes_.bytes() + nodes_.bytes(); }

private:
    Exec& exec_;
    Buffer<mesh_build::Bounds, Exec> bounds_;
    Buffer<mesh_build::Key, Exec> keys_;
    Buffer<std::uint32_t, Exec> words_;
    Buffer<float, Exec> boxes_;
    Buffer<WideNode, Exec> nodes_;
    Buffer<BoxTreeHeader, Exec> header_;
    BoxTree tree_{};
};

}  // namespace globule::core
