// A tile's walk of the tree: all particles whose support the bundle meets between distances z0 and
// z1, found by the whole group together, a batch of nodes at a time, and kept relative to the axis
// point at z0 in units of the support, where float32 is precise whatever the scene's coordinates.
#pragma once
#include "exec/bits.hpp"
#include "trace/bundle.hpp"
#include "trace/walk_tree.hpp"

namespace globule::core {

/// Only where supports or weights differ.
struct CandidateShape {
    float inverse_a2;  ///< 1 / support^2, scaled
    float weight;
};

template <class Group, bool PerParticle>
struct TileScratch {
    /// Particles relative to the axis point, scaled, with their slots in the sorted arrays.
    typename Group::template List<Group::list_capacity + Group::width> list;
    CandidateShape shape[PerParticle ? Group::list_capacity : 1];
    Siblings stack[Group::stack_capacity];
    typename Group::LaneOf lane_of;
};

/// What a slab's list turned out to be.
struct Gathered {
    int n = 0;          ///< candidates; -1: more than the list holds
    float next = 0;     ///< nearest distance past z0 + dz where something begins
    float nearest = 0;  ///< distance where the list's first support begins
    float sharpest = 1; ///< largest 1 / support in the list, scaled
};

/// Walks the tree along the bundle from distance z0 on; `at` is the axis point there.
template <bool PerParticle, class Group, class Tree>
struct Walk {
    using F = typename Group::F;
    using B = typename Group::B;
    Group& g;
    TileScratch<Group, PerParticle>& scratch;
    const Tree& tree;
    const SortedParticles& particles;
    const Bundle& bundle;
    float z0;
    float3 at, inv;

    GB_FN Walk(Group& group, TileScratch<Group, PerParticle>& s, const Tree& t, const SortedParticles& p, const Bundle& b,
               float z, const float3& point)
        : g(group), scratch(s), tree(t), particles(p), bundle(b), z0(z), at(point) {
        const float tiny = 1e-18f;
        inv = {1.0f / (abs(b.d.x) > tiny ? b.d.x : tiny), 1.0f / (abs(b.d.y) > tiny ? b.d.y : tiny),
               1.0f / (abs(b.d.z) > tiny ? b.d.z : tiny)};
    }

    /// open(enter, met) says which met nodes to open; leaf(lanes, enter, boxes) as in walk_tree.
    template <class Open, class Leaf>
    GB_FN void operator()(const Open& open, const Leaf& leaf) {
        F enter(0.0f);
        walk_tree(
            g, scratch.stack, tree,
            [&](const B& lanes, const Boxes<Group>& boxes) {
                // Slab test (Kay & Kajiya 1986) of the axis against the box grown by the bundle's radius.
                const F half(0.5f);
                const F hx = (boxes.hi[0] - boxes.lo[0]) * half, cx = boxes.lo[0] + hx - F(at.x);
                const F hy = (boxes.hi[1] - boxes.lo[1]) * half, cy = boxes.lo[1] + hy - F(at.y);
                const F hz = (boxes.hi[2] - boxes.lo[2]) * half, cz = boxes.lo[2] + hz - F(at.z);
                const F ahead = cx * F(bundle.d.x) + cy * F(bundle.d.y) + cz * F(bundle.d.z);
                const F r = radius_at(bundle, F(z0) + ahead + hx + hy + hz);
                const F mx = cx * F(inv.x), ex = (hx + r) * F(abs(inv.x));
                const F my = cy * F(inv.y), ey = (hy + r) * F(abs(inv.y));
                const F mz = cz * F(inv.z), ez = (hz + r) * F(abs(inv.z));
                enter = max(max(mx - ex, my - ey), mz - ez);
                const F leave = min(min(mx + ex, my + ey), mz + ez);
                return open(enter, lanes & (enter <= leave) & (leave >= F(0.0f)));
            },
            [&](const B& leaves, const Boxes<Group>& boxes) { return leaf(leaves, enter, boxes); });
    }
};

/// Where the nearest leaf's box begins, at or after z0.
template <bool PerParticle, class Group, class Tree>
GB_FN float seek(Walk<PerParticle, Group, Tree>& walk) {
    using F = typename Group::F;
    using B = typename Group::B;
    F nearest = F(infinity());
    float best = infinity();
    walk([&](const F& enter, const B& met) { return met & (enter < F(best)); },
         [&](const B& leaves, const F& enter, const Boxes<Group>&) {
             nearest = select(leaves, min(nearest, enter), nearest);
             best = walk.g.smallest(nearest);
             return best > 0.0f;
         });
    return walk.z0 + max(best, 0.0f);
}

/// Goes through the leaves' particles, a group's worth at a time, and lists those that takes(present, x, y, z, a)
/// chooses; x y z: from `at`; a: support; the first's slot.  n: listed so far.  False: the list cannot hold any more.
template <bool PerParticle, class Group, class Takes>
GB_FN bool list_particles(Group& g, TileScratch<Group, PerParticle>& scratch, const SortedParticles& particles, const float3& at,
                          float scale, const typename Group::B& leaves, const Boxes<Group>& boxes, int& n, const Takes& takes) {
    using F = typename Group::F;
    using B = typename Group::B;
    bool full = false;
    g.each(leaves, [&](int leaf) {
        const std::uint32_t begin = Group::pick(boxes.first, leaf);
        const std::uint32_t end = begin + Node::count(Group::pick(boxes.meta, leaf));
        for (std::uint32_t j = begin; j < end && !full; j += Group::width) {
            if (n + Group::width > Group::list_capacity) {
                full = true;
                break;
            }
            const B present = g.first_lanes(int(min<std::uint32_t>(end - j, Group::width)));
            const F x = g.load_run(particles.x + j) - F(at.x);
            const F y = g.load_run(particles.y + j) - F(at.y);
            const F z = g.load_run(particles.z + j) - F(at.z);
            const F a = PerParticle && particles.support.data ? g.load_run(particles.support.data + j) : F(particles.support.uniform);
            n = g.append(takes(present, x, y, z, a, j), n, [&](int k, int place) {
                scratch.list.set(place, {Group::get(x, k) * scale, Group::get(y, k) * scale, Group::get(z, k) * scale},
                                 j + std::uint32_t(k));
                if constexpr (PerParticle) {
                    const float support = Group::get(a, k) * scale;
                    scratch.shape[place] = {1.0f / (support * support), particles.weight[j + k]};
                }
            });
        }
    });
    return !full;
}

/// All candidates between z0 and z0 + dz into the list.
template <bool PerParticle, class Group, class Tree>
GB_FN Gathered gather(Walk<PerParticle, Group, Tree>& walk, float dz, float scale) {
    using F = typename Group::F;
    using B = typename Group::B;
    Group& g = walk.g;
    const float3 d = walk.bundle.d;
    F next = F(infinity()), nearest = next, sharpest = F(0.0f), least = next;
    // The chord that the grown sphere cuts from the axis.
    const auto meets = [&](const B& present, const F& x, const F& y, const F& z, const F& a) {
        const F s = x * F(d.x) + y * F(d.y) + z * F(d.z);
        const F grown = a + radius_at(walk.bundle, F(walk.z0) + s + a);
        const F chord2 = grown * grown - (x * x + y * y + z * z - s * s);
        const F chord = quick_root(max(chord2, F(0.0f)));
        const B hit = present & (chord2 >= F(0.0f)) & (s + chord >= F(0.0f)) & (a > F(0.0f));
        const B far = s - chord > F(dz);
        next = select(hit & far, min(next, s - chord), next);
        const B take = hit & !far;
        nearest = select(take, min(nearest, s - chord), nearest);
        if constexpr (PerParticle) sharpest = max(sharpest, select(take, F(1.0f) / (a * F(scale)), F(0.0f)));
        return take;
    };
    // The ellipsoid itself: in the space that its matrix maps to it is a ball, and the bundle not wider than its radius
    // over the shortest axis.
    const auto meets_ellipsoid = [&](const B& present, const F& x, const F& y, const F& z, const F& a, std::uint32_t first) {
        B take = meets(present, x, y, z, a);
        if constexpr (PerParticle) {
            const SortedParticles& all = walk.particles;
            if (!all.shortest || !g.any(take)) return take;
            const auto m = [&](int k) { return g.map([&](int lane) { return all.stretch[6 * (first + std::size_t(lane)) + k]; }); };
            const Sym3<F> matrix{m(0), m(1), m(2), m(3), m(4), m(5)};
            const Vec3<F> p = matrix * Vec3<F>{x, y, z}, q = matrix * Vec3<F>{F(d.x), F(d.y), F(d.z)};
            const F s = x * F(d.x) + y * F(d.y) + z * F(d.z), sharp = F(1.0f) / g.load_run(all.shortest + first);
            const F reach = F(1.001f) + sharp * radius_at(walk.bundle, F(walk.z0) + s + a), pq = dot(p, q), pp = dot(p, p);
            take = take & (pp - pq * pq / dot(q, q) <= reach * reach + F(1e-5f) * pp);
            least = min(least, select(take, F(1.0f) / sharp, least));
        }
        return take;
    };
    int n = 0;
    bool room = true;
    walk(
        [&](const F& enter, const B& met) {
            const B near = enter <= F(dz);
            next = select(met & !near, min(next, enter), next);
            return met & near;
        },
        [&](const B& leaves, const F&, const Boxes<Group>& boxes) {
            room = list_particles(g, walk.scratch, walk.particles, walk.at, scale, leaves, boxes, n, meets_ellipsoid);
            return room;
        });
    g.sync();
    if (!room) return {-1};
    return {n, walk.z0 + g.smallest(next), walk.z0 + g.smallest(nearest),
            !PerParticle ? 1.0f : walk.particles.shortest ? 1.0f / (g.smallest(least) * scale) : g.largest(sharpest) * walk.particles.most_stretch};
}

}  // namespace globule::core
