// A tile's walk of the tree: all particles whose support the bundle meets between distances z0 and
// z1, found by the whole group together, a batch of nodes at a time, and kept relative to the axis
// point at z0 in units of the support, where float32 is precise whatever the scene's coordinates.
#pragma once
#include "exec/bits.hpp"
#include "trace/bundle.hpp"
#include "trace/walk_tree.hpp"

namespace globule::core {

/// What a list holds of each particle beside its place: nothing where all are alike;
struct AlikeCandidate {
    static constexpr bool per_particle = false, ellipsoid = false;
    static constexpr float inverse_a2 = 1.0f, weight = 1.0f;
    template <class Group> static constexpr int capacity = Group::list_capacity;
};
/// where supports or weights differ,
struct BallCandidate {
    static constexpr bool per_particle = true, ellipsoid = false;
    template <class Group> static constexpr int capacity = Group::list_capacity;
    float inverse_a2;  ///< 1 / support^2, scaled
    float weight;
};
/// or, of an ellipsoid, the square of its matrix.
struct alignas(16) EllipsoidCandidate {
    static constexpr bool per_particle = true, ellipsoid = true;
    template <class Group> static constexpr int capacity = Group::ellipsoid_capacity;
    Sym3<float> form;  ///< scaled: x = v . form v
    float weight;
    template <class F> GB_FN Sym3<F> form_as() const {
        return {F(form.xx), F(form.yy), F(form.zz), F(form.xy), F(form.xz), F(form.yz)};
    }
};

template <class Group, class Candidate> struct TileScratch {
    static constexpr int capacity = Candidate::template capacity<Group>;
    /// Particles relative to the axis point, scaled, with their slots in the sorted arrays.
    typename Group::template List<capacity + Group::width> list;
    Candidate shape[Candidate::per_particle ? capacity : 1];
    Siblings stack[Group::stack_capacity];
    typename Group::LaneOf lane_of;
    std::uint32_t marked[Group::width * Group::vectors];  ///< of TileLayout
};

/// What a slab's list turned out to be.
struct Gathered {
    int n = 0;           ///< candidates; -1: more than the list holds
    float next = 0;      ///< nearest distance past z0 + dz where something begins
    float nearest = 0;   ///< distance where the list's first support begins
    float sharpest = 1;  ///< largest 1 / support in the list, scaled
};

/// Walks the tree along the bundle from distance z0 on; `at` is the axis point there.
template <class Candidate, class Group> struct Walk {
    using F = typename Group::F;
    using B = typename Group::B;
    Group& g;
    TileScratch<Group, Candidate>& scratch;
    const Tree& tree;
    const SortedParticles& particles;
    const Bundle& bundle;
    float z0;
    float3 at, inv;

    GB_FN Walk(Group& group, TileScratch<Group, Candidate>& s, const Tree& t, const SortedParticles& p, const Bundle& b,
        float z, const float3& point)
        : g(group), scratch(s), tree(t), particles(p), bundle(b), z0(z), at(point) {
        const float tiny = 1e-18f;
        inv = {1.0f / (abs(b.d.x) > tiny ? b.d.x : tiny), 1.0f / (abs(b.d.y) > tiny ? b.d.y : tiny),
            1.0f / (abs(b.d.z) > tiny ? b.d.z : tiny)};
    }

    /// open(enter, met) says which met nodes to open; leaf(lanes, enter, boxes) as in walk_tree.
    template <class Open, class Leaf> GB_FN void operator()(const Open& open, const Leaf& leaf) {
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
template <class Candidate, class Group> GB_FN float seek(Walk<Candidate, Group>& walk) {
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
template <class Candidate, class Group, class Takes>
GB_FN bool list_particles(Group& g, TileScratch<Group, Candidate>& scratch, const SortedParticles& particles,
    const float3& at, float scale, const typename Group::B& leaves, const Boxes<Group>& boxes, int& n,
    const Takes& takes) {
    using F = typename Group::F;
    using B = typename Group::B;
    for (std::uint32_t set = g.set_of(leaves); set;) {
        const auto next = [&](std::uint32_t& begin) {
            const int leaf = trailing_zeros(set);
            begin = Group::pick(boxes.first, leaf);
            return begin + Node::count(Group::pick(boxes.meta, leaf));
        };
        std::uint32_t begin, following;  // leaves that follow each other in memory are one run
        std::uint32_t end = next(begin);
        for (set &= set - 1; set; set &= set - 1) {
            const std::uint32_t further = next(following);
            if (following != end) break;
            end = further;
        }
        for (std::uint32_t j = begin; j < end; j += Group::width) {
            if (n + Group::width > scratch.capacity) return false;
            const B present = g.first_lanes(int(min<std::uint32_t>(end - j, Group::width)));
            const F x = g.load_run(particles.x + j) - F(at.x);
            const F y = g.load_run(particles.y + j) - F(at.y);
            const F z = g.load_run(particles.z + j) - F(at.z);
            const F a = Candidate::per_particle && particles.support.data ? g.load_run(particles.support.data + j)
                                                                          : F(particles.support.uniform);
            n = g.append(takes(present, x, y, z, a, j), n, [&](int k, int place) {
                scratch.list.set(place, {Group::get(x, k) * scale, Group::get(y, k) * scale, Group::get(z, k) * scale},
                    j + std::uint32_t(k));
                if constexpr (Candidate::ellipsoid) {
                    scratch.shape[place] = {
                        square(particles.template matrix<float>(j + k) * (1.0f / scale)), particles.weight[j + k]};
                } else if constexpr (Candidate::per_particle) {
                    const float support = Group::get(a, k) * scale;
                    scratch.shape[place] = {1.0f / (support * support), particles.weight[j + k]};
                }
            });
        }
    }
    return true;
}

/// All candidates between z0 and z0 + dz into the list.
template <class Candidate, class Group> GB_FN Gathered gather(Walk<Candidate, Group>& walk, float dz, float scale) {
    using F = typename Group::F;
    using B = typename Group::B;
    Group& g = walk.g;
    const float3 d = walk.bundle.d;
    F next = F(infinity()), nearest = next, least = next;  // least: shortest axis
    // The chord that the grown support cuts from the axis: from middle - half to middle + half, if half2 >= 0.
    const auto meets = [&](const B& present, const F& a, const F& middle, const F& half2, const F& shortest) {
        const F half = quick_root(max(half2, F(0.0f)));
        const B hit = present & (half2 >= F(0.0f)) & (middle + half >= F(0.0f)) & (a > F(0.0f));
        const B far = middle - half > F(dz);
        next = select(hit & far, min(next, middle - half), next);
        const B take = hit & !far;
        nearest = select(take, min(nearest, middle - half), nearest);
        if constexpr (Candidate::per_particle) least = select(take, min(least, shortest), least);
        return take;
    };
    // How far a particle lies from the axis is the length of what is left when its part along the axis is taken away:
    // an error of 4 roundings of its distance, which the bundle is wider by. A difference of squares would be off by
    // the distance's square, 1 support at a distance of 3,000.
    const auto meets_ball = [&](const B& present, const F& x, const F& y, const F& z, const F& a) {
        const F s = x * F(d.x) + y * F(d.y) + z * F(d.z);
        const F grown = a + radius_at(walk.bundle, F(walk.z0) + s + a);
        const F wx = x - s * F(d.x), wy = y - s * F(d.y), wz = z - s * F(d.z);
        return meets(present, a, s, grown * grown - (wx * wx + wy * wy + wz * wz), a);
    };
    // In the space that its matrix maps to an ellipsoid is a ball, and the bundle not wider than its radius over the
    // shortest axis.
    const auto meets_ellipsoid = [&](const B& present, const F& x, const F& y, const F& z, const F& a,
                                     std::uint32_t first) {
        const SortedParticles& all = walk.particles;
        const auto m = [&](int k) {
            return g.map([&](int lane) { return all.stretch[6 * (first + std::size_t(lane)) + k]; });
        };
        const Sym3<F> matrix{m(0), m(1), m(2), m(3), m(4), m(5)};
        const Vec3<F> p = matrix * Vec3<F>{x, y, z}, q = matrix * Vec3<F>{F(d.x), F(d.y), F(d.z)};
        const F s = x * F(d.x) + y * F(d.y) + z * F(d.z),
                shortest = all.shortest ? g.load_run(all.shortest + first) : a * F(1.0f / all.most_stretch);
        const F reach = F(1.001f) + quick_quotient(radius_at(walk.bundle, F(walk.z0) + s + a), shortest);
        const F by = quick_quotient(F(1.0f), dot(q, q)), middle = dot(p, q) * by;
        const Vec3<F> w = p - q * middle;
        return meets(present, a, middle, (reach * reach - dot(w, w)) * by, shortest);
    };
    const auto takes = [&](const B& present, const F& x, const F& y, const F& z, const F& a, std::uint32_t first) {
        if constexpr (Candidate::ellipsoid) return meets_ellipsoid(present, x, y, z, a, first);
        else if (Candidate::per_particle && walk.particles.stretch) return meets_ellipsoid(present, x, y, z, a, first);
        else return meets_ball(present, x, y, z, a);
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
            room = list_particles(g, walk.scratch, walk.particles, walk.at, scale, leaves, boxes, n, takes);
            return room;
        });
    g.sync();
    if (!room) return {-1};
    return {n, walk.z0 + g.smallest(next), walk.z0 + g.smallest(nearest),
        Candidate::per_particle ? 1.0f / (g.smallest(least) * scale) : 1.0f};
}

}  // namespace globule::core
