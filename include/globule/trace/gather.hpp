// A tile's walk of the tree: all particles whose support the bundle meets between distances z0 and
// z1, found by the whole group together, a batch of nodes at a time, and kept relative to the axis
// point at z0 in units of the support, where float32 is precise whatever the scene's coordinates.
#pragma once
#include "globule/octree/types.hpp"
#include "globule/trace/bundle.hpp"

namespace globule {

struct Candidate {
    float x, y, z;       ///< relative to the axis point, scaled
    std::uint32_t slot;  ///< in the sorted particles
};
/// Only where supports or weights differ.
struct CandidateShape {
    float inverse_a2;  ///< 1 / support^2, scaled
    float weight;
};

template <class Group, bool PerParticle>
struct TileScratch {
    Candidate list[Group::list_capacity];
    CandidateShape shape[PerParticle ? Group::list_capacity : 1];
    std::uint32_t stack[Group::stack_capacity];
};

struct Gathered {
    int n = 0;          ///< candidates; -1: more than the list holds
    float next = 0;     ///< nearest distance past z1 where something begins
    float sharpest = 1; ///< largest 1 / support in the list, scaled
};

template <bool PerParticle, class Group, class Tree>
GB_FN Gathered gather(Group& g, TileScratch<Group, PerParticle>& scratch, const Tree& tree,
                      const SortedParticles& particles, const Bundle& bundle, float z0, float dz,
                      const float3& at, float scale) {
    using F = typename Group::F;
    using B = typename Group::B;
    using U = typename Group::U;
    const float tiny = 1e-18f;
    const float3 d = bundle.d;
    const float3 inv{1.0f / (magnitude(d.x) > tiny ? d.x : tiny), 1.0f / (magnitude(d.y) > tiny ? d.y : tiny),
                     1.0f / (magnitude(d.z) > tiny ? d.z : tiny)};
    F next = F(infinity()), sharpest = F(0.0f);
    int n = 0, top = 1;
    scratch.stack[0] = 0;
    g.sync();
    while (top > 0) {
        // A batch may push 8 for each of its nodes; what stays below still needs room to go down
        // one node at a time, 7 a level.
        const int room = (Group::stack_capacity - 7 * (kMaxLevels + 1) - top) / 8;
        const int take = least(least(top, int(Group::width)), most(1, room));
        const B lanes = g.first_lanes(take);
        top -= take;
        U first{}, meta{};
        F lox(0.0f), loy(0.0f), loz(0.0f), hix(0.0f), hiy(0.0f), hiz(0.0f);
        g.per_lane(lanes, [&](int lane) {
            const Node node = tree.node(scratch.stack[top + lane]);
            Group::put(lox, lane, node.lo.x);
            Group::put(loy, lane, node.lo.y);
            Group::put(loz, lane, node.lo.z);
            Group::put(hix, lane, node.hi.x);
            Group::put(hiy, lane, node.hi.y);
            Group::put(hiz, lane, node.hi.z);
            Group::put(first, lane, node.first);
            Group::put(meta, lane, node.meta);
        });
        g.sync();
        // Slab test (Kay & Kajiya 1986) of the axis against the box grown by the bundle's radius.
        const F half(0.5f);
        const F hx = (hix - lox) * half, hy = (hiy - loy) * half, hz = (hiz - loz) * half;
        const F cx = lox + hx - F(at.x), cy = loy + hy - F(at.y), cz = loz + hz - F(at.z);
        const F ahead = cx * F(d.x) + cy * F(d.y) + cz * F(d.z);
        const F r = radius_at(bundle, F(z0) + ahead + hx + hy + hz);
        const F ax = (cx - hx - r) * F(inv.x), bx = (cx + hx + r) * F(inv.x);
        const F ay = (cy - hy - r) * F(inv.y), by = (cy + hy + r) * F(inv.y);
        const F az = (cz - hz - r) * F(inv.z), bz = (cz + hz + r) * F(inv.z);
        const F enter = most(most(least(ax, bx), least(ay, by)), least(az, bz));
        const F leave = least(least(most(ax, bx), most(ay, by)), most(az, bz));
        const B met = lanes & (enter <= leave) & (leave >= F(0.0f));
        const B later = met & (enter > F(dz));
        next = select(later, least(next, enter), next);
        const B open = met & (enter <= F(dz));

        B is_leaf = g.none();
        g.per_lane(open, [&](int lane) {
            Group::put(is_leaf, lane, Node::is_leaf(Group::get(meta, lane)));
        });
        const B inner = open & !is_leaf;
        for (std::uint32_t c = 0; c < 8; ++c) {
            B has = g.none();
            g.per_lane(inner, [&](int lane) { Group::put(has, lane, c < Group::get(meta, lane)); });
            if (!g.any(has)) break;
            top = g.append(has, top, [&](int lane, int place) {
                scratch.stack[place] = Group::get(first, lane) + c;
            });
        }
        bool full = false;
        g.each(open & is_leaf, [&](int lane) {
            const std::uint32_t begin = Group::pick(first, lane);
            const std::uint32_t end = begin + Node::count(Group::pick(meta, lane));
            for (std::uint32_t j = begin; j < end && !full; j += Group::width) {
                if (n + Group::width > Group::list_capacity) {
                    full = true;
                    break;
                }
                const B present = g.first_lanes(int(least<std::uint32_t>(end - j, Group::width)));
                const F x = g.load_run(particles.x + j) - F(at.x);
                const F y = g.load_run(particles.y + j) - F(at.y);
                const F z = g.load_run(particles.z + j) - F(at.z);
                const F a = PerParticle && particles.support.data ? g.load_run(particles.support.data + j)
                                                                  : F(particles.support.uniform);
                // The chord that the grown sphere cuts from the axis.
                const F s = x * F(d.x) + y * F(d.y) + z * F(d.z);
                const F grown = a + radius_at(bundle, F(z0) + s + a);
                const F chord2 = grown * grown - (x * x + y * y + z * z - s * s);
                const F chord = root(most(chord2, F(0.0f)));
                const B hit = present & (chord2 >= F(0.0f)) & (s + chord >= F(0.0f)) & (a > F(0.0f));
                const B far = hit & (s - chord > F(dz));
                next = select(far, least(next, s - chord), next);
                if constexpr (PerParticle)
                    sharpest = most(sharpest, select(hit & !far, F(1.0f) / (a * F(scale)), F(0.0f)));
                n = g.append(hit & !far, n, [&](int k, int place) {
                    scratch.list[place] = {Group::get(x, k) * scale, Group::get(y, k) * scale,
                                           Group::get(z, k) * scale, j + std::uint32_t(k)};
                    if constexpr (PerParticle) {
                        const float support = Group::get(a, k) * scale;
                        scratch.shape[place] = {1.0f / (support * support), particles.weight[j + k]};
                    }
                });
            }
        });
        g.sync();
        if (full) return {-1};
    }
    return {n, z0 + g.smallest(next), PerParticle ? g.largest(sharpest) : 1.0f};
}

}  // namespace globule
