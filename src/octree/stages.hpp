// The stages of an octree's build, as functors: bounds, keys, nodes, boxes.
//
// Sparse nodes from sorted keys alone, as Karras (2012) builds hierarchies, but octree cells at once instead of a
// binary tree first.  A cell of level k starts at particle i when key i and key i - 1 share fewer than k triplets;
// it is split when key i and key i + kLeafSize share at least k.
// So each chunk of particles can list the nodes that start in it.  One exclusive scan over the
// counts, level by level and chunk by chunk, gives every node its place in level order; children of
// one parent come out side by side.  A last pass lets every leaf carry its box towards the root:
// whoever arrives last at a parent goes on.
#pragma once
#include "octree/dense.hpp"
#include "octree/tree.hpp"

namespace globule::core {

/// The caller's particles, in the caller's order, in the backend's memory.
struct ParticleInput {
    std::size_t n = 0;
    const float* positions = nullptr;  ///< (n, 3)
    Attribute support;
    Attribute weight;
    const float* stretch = nullptr;  ///< (n, 6): SortedParticles
    float most_stretch = 1.0f;
    bool given_up = false;  ///< `positions` may be emptied once they are sorted
};

struct TreeParams {
    int key_bits = 32;
    int depth = 10;            ///< deepest level, at most 10 or 21 (dense: 8)
    bool dense = false;        ///< the source's array of all cells, too, for its own tracing
    bool fixed_space = false;  ///< otherwise the bounding cube of the particles
    float3 lo{0, 0, 0}, hi{0, 0, 0};
    float typical_support = 0.0f,
          most_weight = 0.0f;  ///< of all pieces, where this is one of several; 0: of these particles
};

namespace build {

GB_FN float3 read3(const float* p, std::size_t i) { return {p[3 * i], p[3 * i + 1], p[3 * i + 2]}; }

struct Bounds {
    float3 lo, hi;
    float least_support, most_support, most_weight;
};
GB_FN Bounds nothing() {
    const float inf = infinity();
    return {{inf, inf, inf}, {-inf, -inf, -inf}, inf, 0.0f, 0.0f};
}
struct PointBounds {
    const float* positions;
    Attribute support, weight;
    GB_FN Bounds operator()(std::size_t i) const {
        const float3 p = read3(positions, i);
        const float m = morton::kFarthest, a = support[i];
        if (!morton::is_inside(p, {-m, -m, -m}, {m, m, m})) return nothing();
        return {p, p, a > 0.0f ? a : infinity(), a > 0.0f ? a : 0.0f, abs(weight[i])};
    }
};
struct Unite {
    GB_FN Bounds operator()(const Bounds& a, const Bounds& b) const {
        return {{min(a.lo.x, b.lo.x), min(a.lo.y, b.lo.y), min(a.lo.z, b.lo.z)},
            {max(a.hi.x, b.hi.x), max(a.hi.y, b.hi.y), max(a.hi.z, b.hi.z)}, min(a.least_support, b.least_support),
            max(a.most_support, b.most_support), max(a.most_weight, b.most_weight)};
    }
};
/// The octree's space: the caller's, or the particles' own.
struct SpaceOf {
    TreeParams params;
    const Bounds* bounds;
    GB_FN float3 lo() const { return params.fixed_space ? params.lo : bounds->lo; }
    GB_FN float3 hi() const { return params.fixed_space ? params.hi : bounds->hi; }
    GB_FN morton::Space operator()() const {
        const float3 l = lo(), h = hi();
        const float extent = max(max(h.x - l.x, h.y - l.y), h.z - l.z);
        return {l, extent > 0.0f ? extent : 0.0f};
    }
    GB_FN float most_weight() const { return params.most_weight > 0.0f ? params.most_weight : bounds->most_weight; }
    GB_FN float typical_support() const {
        if (params.typical_support > 0.0f) return params.typical_support;
        return bounds->most_support > 0.0f ? sqrt(bounds->least_support) * sqrt(bounds->most_support) : 1.0f;
    }
};

template <class Key> struct MakeKeys {
    const float* positions;
    SpaceOf space;
    Key* keys;
    std::uint32_t* index;
    std::uint32_t* n_outside;
    std::size_t n;
    GB_FN void operator()(std::size_t i) const {
        if (i == 0) *n_outside = std::uint32_t(n);
        const float3 p = read3(positions, i);
        keys[i] = morton::is_inside(p, space.lo(), space.hi()) ? morton::key_of<Key>(p, space()) : Key(0);
        index[i] = std::uint32_t(i);
    }
};

template <class Key> struct Gather {
    ParticleInput in;
    const Key* keys;
    std::uint32_t* n_outside;
    const std::uint32_t* index;
    float *x, *y, *z, *support, *weight, *stretch;
    /// Past the last particle, too, up to where a group's lanes read.
    GB_FN void operator()(std::size_t i) const {
        if (i >= in.n) {
            x[i] = y[i] = z[i] = 0.0f;
            if (support) support[i] = 0.0f;
            if (weight) weight[i] = 0.0f;
            for (int k = 0; stretch && k < 6; ++k) stretch[6 * i + k] = 0.0f;
            return;
        }
        constexpr Key inside = morton::Traits<Key>::inside;
        if ((keys[i] & inside) && (i == 0 || !(keys[i - 1] & inside)))
            *n_outside = std::uint32_t(i);  // they sort to the front
        const std::uint32_t from = index[i];
        const float3 p = read3(in.positions, from);
        x[i] = p.x;
        y[i] = p.y;
        z[i] = p.z;
        if (support) support[i] = in.support[from];
        if (weight) weight[i] = in.weight[from];
        for (int k = 0; stretch && k < 6; ++k) stretch[6 * i + k] = in.stretch[std::size_t(6) * from + k];
    }
};

/// Walks one chunk of sorted keys and calls start(i, from, to) wherever nodes of levels
/// from ... to start; the last of them is a leaf.
template <class Key> struct Starts {
    const Key* keys;
    std::size_t n;
    int depth;

    GB_FN int shared(std::size_t i, std::size_t j) const {
        return j < n ? morton::common_levels(keys[i], keys[j], depth) : -1;
    }
    /// Level of the leaf that holds particle i.
    GB_FN int leaf_level(std::size_t i) const {
        int level = -1;
        for (std::size_t j = i < std::size_t(kLeafSize) ? 0 : i - kLeafSize; j <= i; ++j)
            level = max(level, shared(j, j + kLeafSize));
        return min(level + 1, depth);
    }
    template <class Start> GB_FN void walk(std::size_t chunk, const Start& start) const {
        const std::size_t begin = chunk * kChunk;
        const std::size_t end = min(n, begin + kChunk);
        int leaf = begin ? leaf_level(begin - 1) : 0;
        for (std::size_t i = begin; i < end; ++i) {
            if (!(keys[i] & morton::Traits<Key>::inside)) continue;
            const int with_previous = i ? morton::common_levels(keys[i - 1], keys[i], depth) : -1;
            if (with_previous >= leaf) continue;  // same leaf as the particle before
            const int from = with_previous + 1;
            leaf = max(from, min(depth, shared(i, i + kLeafSize) + 1));
            start(i, from, leaf);
        }
    }
};

template <class Key> struct CountNodes {
    Starts<Key> starts;
    std::size_t n_chunks;
    std::uint32_t* counts;  ///< [level][chunk], one row of zeros at the end
    GB_FN void operator()(std::size_t chunk) const {
        std::uint32_t here[kMaxLevels + 2] = {};
        starts.walk(chunk, [&](std::size_t, int from, int to) {
            for (int k = from; k <= to; ++k) ++here[k];
        });
        for (int k = 0; k < starts.depth + 2; ++k) counts[k * n_chunks + chunk] = here[k];
    }
};

struct WriteHeader {
    SpaceOf space;
    std::size_t n_chunks;
    const std::uint32_t* offsets;
    int depth;
    std::size_t capacity;
    TreeHeader* header;
    GB_FN void operator()(std::size_t) const {
        TreeHeader h{};
        h.space = space();
        h.typical_support = space.typical_support();
        h.most_weight = space.most_weight();
        h.n_wanted = offsets[(depth + 1) * n_chunks];
        // Never more nodes than there is room for: the tree is cut at the level that still fits,
        // its leaves then hold more particles.  The owner grows the room before the next build.
        h.depth = depth;
        while (h.depth > 0 && offsets[(h.depth + 1) * n_chunks] > capacity) --h.depth;
        h.n_nodes = offsets[(h.depth + 1) * n_chunks];
        for (int k = 0; k <= h.depth + 1; ++k) h.level_begin[k] = offsets[k * n_chunks];
        for (int k = 0; k <= h.depth; ++k)
            if (h.level_begin[k + 1] > h.level_begin[k]) h.deepest = k;
        h.n_outside = header->n_outside;
        *header = h;
    }
};

template <class Key> struct EmitNodes {
    Starts<Key> starts;
    std::size_t n_chunks;
    const std::uint32_t* offsets;
    const TreeHeader* header;
    NodeArrays nodes;
    std::uint32_t *first_child, *parent, *arrived;

    GB_FN void operator()(std::size_t chunk) const {
        const int depth = header->depth;
        std::uint32_t next[kMaxLevels + 3];
        for (int k = 0; k <= depth + 1; ++k) next[k] = offsets[k * n_chunks + chunk];
        starts.walk(chunk, [&](std::size_t i, int from, int to) {
            to = min(to, depth);
            for (int k = from; k <= to; ++k) {
                const std::uint32_t at = next[k]++;
                first_child[at] = next[k + 1];
                parent[at] = k ? next[k - 1] - 1 : at;
                arrived[at] = 0;
                nodes.first[at] = std::uint32_t(i);
                nodes.meta[at] = k == to ? Node::leaf_bit | std::uint32_t(k) : 0;  // level, for now
            }
        });
    }
};

/// The box of particles and what they reach, a group of lanes at a time.
template <class Group> struct LeafBox {
    using F = typename Group::F;
    F lo[3] = {F(infinity()), F(infinity()), F(infinity())}, hi[3] = {F(-infinity()), F(-infinity()), F(-infinity())};

    GB_FN void add(Group& g, const SortedParticles& particles, std::size_t at, const typename Group::B& which) {
        const F a = particles.support.data ? g.load_run(particles.support.data + at) : F(particles.support.uniform);
        const F p[3] = {g.load_run(particles.x + at), g.load_run(particles.y + at), g.load_run(particles.z + at)};
        F reach[3] = {a, a, a};
        if (particles.stretch) ellipsoids(g, particles, at, which, a, reach);
        for (int k = 0; k < 3; ++k) {
            lo[k] = min(lo[k], select(which, p[k] - reach[k], F(infinity())));
            hi[k] = max(hi[k], select(which, p[k] + reach[k], F(-infinity())));
        }
    }
    /// An ellipsoid |G v| <= 1 reaches as far along an axis as that row of G's inverse is long.
    GB_FN static void ellipsoids(Group& g, const SortedParticles& particles, std::size_t at,
        const typename Group::B& which, const F& a, F* reach) {
        F m[6];
        for (int k = 0; k < 6; ++k) {
            m[k] = F(k < 3 ? 1.0f : 0.0f);
            g.per_lane(which, [&](int lane) {
                Group::put(m[k], lane, particles.stretch[6 * (at + lane) + k] * Group::get(a, lane));
            });
        }
        const F xx = m[1] * m[2] - m[5] * m[5], yy = m[0] * m[2] - m[4] * m[4], zz = m[0] * m[1] - m[3] * m[3],
                xy = m[4] * m[5] - m[3] * m[2], xz = m[3] * m[5] - m[4] * m[1], yz = m[3] * m[4] - m[5] * m[0];
        const F by = F(1.00001f) * a / abs(m[0] * xx + m[3] * xy + m[4] * xz);
        reach[0] = min(a, by * sqrt(xx * xx + xy * xy + xz * xz));
        reach[1] = min(a, by * sqrt(xy * xy + yy * yy + yz * yz));
        reach[2] = min(a, by * sqrt(xz * xz + yz * yz + zz * zz));
    }
    GB_FN Node leaf(Group& g, std::uint32_t begin, std::uint32_t count) const {
        return {{g.smallest(lo[0]), g.smallest(lo[1]), g.smallest(lo[2])},
            {g.largest(hi[0]), g.largest(hi[1]), g.largest(hi[2])}, begin, Node::leaf_bit | count};
    }
};

/// Boxes of the leaves, a group of lanes to each.
template <class Key> struct BoxLeaves {
    struct Nothing {};
    template <class Group> using Scratch = Nothing;

    Starts<Key> starts;
    const TreeHeader* header;
    SortedParticles particles;
    NodeArrays nodes;

    template <class Group> GB_FN void operator()(Group& g, Nothing&, std::size_t i) const {
        if (i >= header->n_nodes || !Node::is_leaf(nodes.meta[i])) return;
        const Node leaf = make_leaf(g, nodes.first[i], int(Node::count(nodes.meta[i])));
        g.sync();
        if (g.is_first()) nodes.set(i, leaf);
    }
    /// All particles from `begin` on that share its cell of that level.
    template <class Group> GB_FN Node make_leaf(Group& g, std::uint32_t begin, int level) const {
        LeafBox<Group> box;
        std::size_t end = begin;
        int n_here = Group::width;
        while (n_here == Group::width) {
            typename Group::B ours = g.none();
            g.per_lane(g.first_lanes(Group::width),
                [&](int lane) { Group::put(ours, lane, starts.shared(begin, end + lane) >= level); });
            box.add(g, particles, end, ours);
            n_here = g.count(ours);
            end += n_here;
        }
        return box.leaf(g, begin, std::uint32_t(end - begin));
    }
};

/// The same for leaves that are known, when their particles reach elsewhere.
struct RefitLeaves {
    struct Nothing {};
    template <class Group> using Scratch = Nothing;

    const TreeHeader* header;
    SortedParticles particles;
    NodeArrays nodes;

    template <class Group> GB_FN void operator()(Group& g, Nothing&, std::size_t i) const {
        if (i >= header->n_nodes || !Node::is_leaf(nodes.meta[i])) return;
        const std::uint32_t begin = nodes.first[i], count = Node::count(nodes.meta[i]);
        LeafBox<Group> box;
        for (std::uint32_t k = 0; k < count; k += Group::width)
            box.add(g, particles, begin + k, g.first_lanes(int(count - k)));
        const Node leaf = box.leaf(g, begin, count);
        if (g.is_first()) nodes.set(i, leaf);
    }
};
struct ScaleMostWeight {
    TreeHeader* header;
    float by;
    GB_FN void operator()(std::size_t) const { header->most_weight *= by; }
};

/// Boxes of inner nodes: the child that arrives last makes its parent's.
struct CarryBoxes {
    const TreeHeader* header;
    NodeArrays nodes;
    const std::uint32_t *first_child, *parent;
    std::uint32_t* arrived;

    GB_FN void operator()(std::size_t i) const {
        if (i >= header->n_nodes || !Node::is_leaf(nodes.meta[i])) return;
        for (std::uint32_t at = std::uint32_t(i); at != 0;) {
            at = parent[at];
            const std::uint32_t begin = first_child[at], n_children = child_end(at) - begin;
            if (atomic_increment(&arrived[at]) + 1 < n_children) return;
            Node out = Node::nothing();
            out.first = begin;
            out.meta = n_children;
            for (std::uint32_t k = 0; k < 8; ++k) {  // the last one again where there are fewer: all loads at once
                const std::uint32_t c = begin + min(k, n_children - 1);
                out.unite({read_fresh(&nodes.box[0][c]), read_fresh(&nodes.box[1][c]), read_fresh(&nodes.box[2][c])},
                    {read_fresh(&nodes.box[3][c]), read_fresh(&nodes.box[4][c]), read_fresh(&nodes.box[5][c])});
            }
            nodes.set(at, out);
        }
    }
    GB_FN std::uint32_t child_end(std::uint32_t at) const {
        return at + 1 < header->n_nodes ? first_child[at + 1] : header->n_nodes;
    }
};

/// Dense: a cell's run starts at the particle whose key differs from the one before, and ends
/// likewise, so every node is written by exactly one particle.
struct FillDense {
    const std::uint32_t* keys;
    std::size_t n;
    int depth;
    SortedParticles particles;
    DenseNode* nodes;
    GB_FN void operator()(std::size_t i) const {
        using Key = std::uint32_t;
        if (!(keys[i] & morton::Traits<Key>::inside)) return;
        const int before = i ? morton::common_levels(keys[i - 1], keys[i], depth) : -1;
        const int after = i + 1 < n ? morton::common_levels(keys[i], keys[i + 1], depth) : -1;
        for (int k = before + 1; k <= depth; ++k) nodes[morton::dense_index(keys[i], k)].first = std::uint32_t(i);
        for (int k = after + 1; k <= depth; ++k) nodes[morton::dense_index(keys[i], k)].last = std::uint32_t(i + 1);
    }
};
/// Masks and reaches of one level, from the level below.
struct CarryDense {
    int level, depth;
    SortedParticles particles;
    DenseNode* nodes;
    GB_FN void operator()(std::size_t v) const {
        const std::size_t at = morton::dense_offset(level) + v;
        DenseNode& out = nodes[at];
        if (out.last <= out.first) return;
        if (level == depth) {
            for (std::size_t j = out.first; j < out.last; ++j) out.reach = max(out.reach, particles.support[j]);
            return;
        }
        for (int c = 0; c < 8; ++c) {
            const DenseNode& child = nodes[8 * at + 1 + c];
            if (child.last <= child.first) continue;
            out.child_mask |= 1u << c;
            out.reach = max(out.reach, child.reach);
        }
    }
};

}  // namespace build

}  // namespace globule::core
