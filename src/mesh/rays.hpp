// Rays through a hierarchy of boxes: what they meet first, and whether they meet anything.
#pragma once
#include "exec/bits.hpp"
#include "mesh/types.hpp"

namespace globule::core {

/// What a ray looks for: a closed solid's faces where it enters (+1) or leaves (-1), or all of them (0).
struct RayRange {
    float3 o, d;
    float from, to;
    int side;
    float near = 0.0f;  ///< a sheet whose plane is nearer to o than that is where the ray begins
};

/// Where a ray meets an item; t infinite: nowhere.
struct ItemHit {
    float t = infinity();
    std::uint32_t slot = 0;   ///< in Morton order
    std::uint32_t index = 0;  ///< in the caller's order
    bool entering = true;     ///< else the ray comes from inside
};

/// The nearest item, ties to the lower index; with `any` the first that is found.
/// items.prepare(o, d) gives what one ray needs; items.meet(prepared, slot, range, hit) improves hit, and does so only
/// where items.may_meet(prepared, slot).
template <bool any, class Items>
GB_FN ItemHit walk_boxes(const BoxTree& tree, const Items& items, const RayRange& range) {
    ItemHit hit;
    hit.t = range.to;
    bool found = false;
    const auto ray = items.prepare(range.o, range.d);
    const auto safe = [](float v) { return 1.0f / (abs(v) > 1e-18f ? v : v < 0.0f ? -1e-18f : 1e-18f); };
    const float3 inv{safe(range.d.x), safe(range.d.y), safe(range.d.z)};
    // A leaf's items are tested side by side, without a branch: one after the other, each would wait for its own loads.
    const auto look = [&](std::uint32_t first, std::uint32_t n) {
        std::uint32_t met = 0;
        GB_UNROLL for (std::uint32_t j = 0; j < WideNode::most_of_leaf; ++j) met |=
            std::uint32_t(items.may_meet(ray, first + min(j, n - 1))) << j;
        for (met &= (1u << n) - 1; met && !(any && found); met &= met - 1) {
            const std::uint32_t k = first + std::uint32_t(trailing_zeros(met));
            if (items.meet(ray, k, tree.index[k], range, found, hit)) found = true;
        }
    };
    const auto look_at_all = [&](std::uint32_t first, std::uint32_t last) {
        for (std::uint32_t k = first; k <= last; ++k) look(k, 1);
    };
    struct Entry {
        std::uint32_t child;
        float t;
    };
    constexpr int room = 40;
    Entry stack[room];
    int top = 0;
    std::uint32_t at = 0;
    for (;;) {
        const WideNode& node = tree.nodes[at];
        float t[WideNode::width];
        std::uint32_t child[WideNode::width];
        GB_UNROLL for (int k = 0; k < WideNode::width;
            ++k) {  // both sides, though one counts: their loads are wide ones
            const float lx = node.lo[0][k], ly = node.lo[1][k], lz = node.lo[2][k], hx = node.hi[0][k],
                        hy = node.hi[1][k], hz = node.hi[2][k];
            const float in = max(
                max(((inv.x >= 0.0f ? lx : hx) - range.o.x) * inv.x, ((inv.y >= 0.0f ? ly : hy) - range.o.y) * inv.y),
                ((inv.z >= 0.0f ? lz : hz) - range.o.z) * inv.z);
            // Ize 2013: the far side a little farther makes up for rounding.
            const float out = min(min(((inv.x >= 0.0f ? hx : lx) - range.o.x) * inv.x,
                                      ((inv.y >= 0.0f ? hy : ly) - range.o.y) * inv.y),
                                  ((inv.z >= 0.0f ? hz : lz) - range.o.z) * inv.z) *
                              1.0000004f;
            t[k] = in <= out && out >= range.from && in <= hit.t ? in : infinity();
            child[k] = node.child[k];
        }
        const auto order = [&](int a, int b) {  // nearest first
            if (!(t[b] < t[a])) return;
            const float s = t[a];
            t[a] = t[b];
            t[b] = s;
            const std::uint32_t c = child[a];
            child[a] = child[b];
            child[b] = c;
        };
        order(0, 1);
        order(2, 3);
        order(0, 2);
        order(1, 3);
        order(1, 2);
        GB_UNROLL for (int k = WideNode::width - 1; k >= 0; --k) {
            if (!(t[k] < infinity())) continue;
            if (top < room) stack[top++] = {child[k], t[k]};
            else if (child[k] & WideNode::leaf) look(WideNode::first_of(child[k]), WideNode::count_of(child[k]));
            else look_at_all(tree.first[child[k]], tree.last[child[k]]);  // deeper than any sensible tree
        }
        for (;;) {
            if (any && found) return hit;
            if (top == 0) {
                if (!found) hit.t = infinity();
                return hit;
            }
            const Entry next = stack[--top];
            if (next.t > hit.t) continue;
            if (!(next.child & WideNode::leaf)) {
                at = next.child;
                break;
            }
            look(WideNode::first_of(next.child), WideNode::count_of(next.child));
        }
    }
}

}  // namespace globule::core
