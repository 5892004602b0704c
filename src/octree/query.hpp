// Questions at a point: who reaches it, who is near it.  One traversal, one thread a point or a packet of points;
// the float64 last word of the tracer and the public field, gradient and neighbor calls use it.
#pragma once
#include "exec/bits.hpp"
#include "field/column.hpp"
#include "field/influence.hpp"
#include "field/kernels.hpp"
#include "octree/dense.hpp"
#include "octree/tree.hpp"

namespace globule::core {

/// Depth-first over all leaves of the nodes that opens(node) accepts, in Morton order: leaf(first slot,
/// number of particles).
template <class Opens, class Leaf>
GB_FN void for_each_leaf_where(const Tree& tree, const Opens& opens, const Leaf& leaf) {
    if (tree.empty()) return;
    struct Run { std::uint32_t next, end; } stack[kMaxLevels + 2];
    int top = 0;
    stack[0] = {0, 1};
    while (top >= 0) {
        if (stack[top].next == stack[top].end) {
            --top;
            continue;
        }
        const Node node = tree.node(stack[top].next++);
        if (!opens(node)) continue;
        const std::uint32_t count = Node::count(node.meta);
        if (Node::is_leaf(node.meta)) {
            leaf(node.first, count);
        } else if (count) {
            stack[++top] = {node.first, node.first + count};
        }
    }
}

/// The same over all leaves whose box meets the box [lo, hi].
template <class Leaf> GB_FN void for_each_leaf(const Tree& tree, const float3& lo, const float3& hi, const Leaf& leaf) {
    for_each_leaf_where(
        tree,
        [&](const Node& node) {
            return !(node.lo.x > hi.x || node.lo.y > hi.y || node.lo.z > hi.z || node.hi.x < lo.x || node.hi.y < lo.y ||
                     node.hi.z < lo.z);
        },
        leaf);
}

/// The same for a whole group of lanes, which looks at all children of a node at once.
template <class Group, class Leaf>
GB_FN void for_each_leaf(Group& g, const Tree& tree, const float3& lo, const float3& hi, const Leaf& leaf) {
    using F = typename Group::F;
    if (tree.empty()) return;
    struct Siblings {
        std::uint32_t first, set;  ///< those of them that are still to come
    } stack[2 * kMaxLevels + 2];
    int top = 0;
    Siblings now{0, 0};
    typename Group::U firsts, metas;
    const auto enter = [&](std::uint32_t first) {
        now.first = first;
        firsts = g.load_run(tree.nodes.first + first);
        metas = g.load_run(tree.nodes.meta + first);
    };
    const auto meeting = [&](std::uint32_t first, int n) {
        float* const* box = tree.nodes.box;
        const auto out = (g.load_run(box[0] + first) > F(hi.x)) | (g.load_run(box[1] + first) > F(hi.y)) |
                         (g.load_run(box[2] + first) > F(hi.z)) | (g.load_run(box[3] + first) < F(lo.x)) |
                         (g.load_run(box[4] + first) < F(lo.y)) | (g.load_run(box[5] + first) < F(lo.z));
        return g.set_of(g.first_lanes(n) & !out);
    };
    const auto open = [&](std::uint32_t first, int n) {
        enter(first);
        now.set = meeting(first, n);
        for (int part = (n - 1) / Group::width; part > 0; --part)  // of more siblings than lanes
            stack[top++] = {first + part * Group::width, meeting(first + part * Group::width, n - part * Group::width)};
    };
    for (open(0, 1);;) {
        if (now.set == 0) {
            if (top == 0) return;
            now = stack[--top];
            enter(now.first);
            continue;
        }
        const int child = trailing_zeros(now.set);
        now.set &= now.set - 1;
        const std::uint32_t meta = Group::pick(metas, child), first = Group::pick(firsts, child),
                            count = Node::count(meta);
        if (Node::is_leaf(meta)) {
            leaf(first, count);
        } else if (count) {
            if (now.set) stack[top++] = now;
            open(first, int(count));
        }
    }
}

/// visit(slot) for each particle of those leaves.
template <class Visit>
GB_FN void for_each_touching(const Tree& tree, const float3& lo, const float3& hi, const Visit& visit) {
    for_each_leaf(tree, lo, hi, [&](std::uint32_t first, std::uint32_t count) {
        for (std::uint32_t j = first; j < first + count; ++j) visit(j);
    });
}

/// A sorted particle's shape, as field/influence.hpp asks for it.
template <class F> struct SortedShape {
    const SortedParticles& particles;
    std::uint32_t slot;
    GB_FN F x(const Vec3<F>& v) const { return particles.x_at(slot, v); }
    GB_FN Vec3<F> half_gradient(const Vec3<F>& v, F slope, F c) const {
        return particles.half_gradient(slot, v) * (slope * c);
    }
};

/// visit(v, shape) if the particle reaches p; v: from its center to p.
template <class F, class Visit>
GB_FN void if_reaching(const SortedParticles& particles, std::uint32_t slot, const Vec3<F>& p, const Visit& visit) {
    const Vec3<F> v{p.x - F(particles.x[slot]), p.y - F(particles.y[slot]), p.z - F(particles.z[slot])};
    const SortedShape<F> shape{particles, slot};
    if (shape.x(v) < F(1)) visit(v, shape);
}

/// visit(slot, v, shape) for each particle that reaches p.
template <class F, class Visit>
GB_FN void for_each_reaching(const Tree& tree, const SortedParticles& particles, const Vec3<F>& p, const Visit& visit) {
    const float3 at{float(p.x), float(p.y), float(p.z)};
    for_each_touching(tree, at, at, [&](std::uint32_t j) {
        if_reaching(particles, j, p, [&](const Vec3<F>& v, const SortedShape<F>& shape) { visit(j, v, shape); });
    });
}

/// Field and gradient at points, float64 sums in Morton order: f = sum c b(r), grad f.  Points of a packet that are
/// near each other walk the tree together; a particle that does not reach a point adds 0 there, so that it does not
/// matter who walks with whom.
struct EvaluateField {
    Tree tree;
    SortedParticles particles;
    AnyKernel kernel;
    std::size_t n;
    float near;           ///< how far apart points are that walk together, world units
    const float* points;  ///< (n, 3)
    float* field;         ///< (n,) or null
    float* gradient;      ///< (n, 3) or null
    template <class Packet> GB_FN void run(std::size_t first) const {
        for (std::size_t i = first; i < first + Packet::width && i < n; i += Packet::half)
            look_around<Packet>(i, int(min<std::size_t>(Packet::half, n - i)));
    }

private:
    GB_FN float3 point(std::size_t i) const { return {points[3 * i], points[3 * i + 1], points[3 * i + 2]}; }

    template <class Packet> GB_FN void look_around(std::size_t first, int count) const {
        using D = typename Packet::D;
        for (unsigned left = (1u << count) - 1; left != 0;) {
            const int leader = trailing_zeros(left);
            const float3 p = point(first + leader);
            float3 lo = p, hi = p;
            unsigned together = 1u << leader;
            for (int k = leader + 1; k < count; ++k) {
                const float3 q = point(first + k), away = q - p;
                const bool beside = abs(away.x) <= near && abs(away.y) <= near && abs(away.z) <= near;
                if (!beside || !(left >> k & 1)) continue;
                together |= 1u << k;
                lo = {min(lo.x, q.x), min(lo.y, q.y), min(lo.z, q.z)};
                hi = {max(hi.x, q.x), max(hi.y, q.y), max(hi.z, q.z)};
            }
            left &= ~together;
            const auto place = [&](int axis) {
                return Packet::map_d(
                    [&](int k) { return double(points[3 * (first + (together >> k & 1 ? k : leader)) + axis]); });
            };
            const Vec3<D> at{place(0), place(1), place(2)};
            D f(0.0);
            Vec3<D> half{D(0.0), D(0.0), D(0.0)};
            for_each_touching(tree, lo, hi, [&](std::uint32_t j) {
                const Vec3<D> v{at.x - D(particles.x[j]), at.y - D(particles.y[j]), at.z - D(particles.z[j])};
                const SortedShape<D> shape{particles, j};
                const auto reached = D(1.0) > shape.x(v);
                if (!any(reached)) return;
                const Influence<D> s = influence(kernel, shape, v, select(reached, D(particles.weight[j]), D(0.0)));
                f += s.value;
                half = half + s.half_gradient;
            });
            for (int k = leader; k < count; ++k) {
                if (!(together >> k & 1)) continue;
                if (field) field[first + k] = float(Packet::get(f, k));
                if (!gradient) continue;
                float* slope = gradient + 3 * (first + k);
                slope[0] = float(2.0 * Packet::get(half.x, k));
                slope[1] = float(2.0 * Packet::get(half.y, k));
                slope[2] = float(2.0 * Packet::get(half.z, k));
            }
        }
    }
};

/// Influence-weighted mean of `channels` values a particle: sum w v / sum w, w = max(c b, 0)
/// (§6.0.2).  NaN where nothing reaches.
struct Blend {
    Tree tree;
    SortedParticles particles;
    AnyKernel kernel;
    const float* points;
    const float* values;  ///< (n, channels), caller's order
    int channels;
    float* out;  ///< (m, channels)
    GB_FN void operator()(std::size_t i) const {
        const float3 p{points[3 * i], points[3 * i + 1], points[3 * i + 2]};
        float* mine = out + i * channels;
        for (int c = 0; c < channels; ++c) mine[c] = 0.0f;
        float total = 0.0f;
        for_each_reaching(tree, particles, p, [&](std::uint32_t j, const float3& v, const SortedShape<float>& shape) {
            const float w = max(influence(kernel, shape, v, particles.weight[j]).value, 0.0f);
            total += w;
            for (int c = 0; c < channels; ++c) mine[c] += w * values[std::size_t(particles.index[j]) * channels + c];
        });
        for (int c = 0; c < channels; ++c) mine[c] = total > 0.0f ? mine[c] / total : NAN;
    }
};

/// Half a line from o along d, in float64.
struct HalfLine {
    Vec3<double> o, d;
    /// Whether it meets a node's box.
    GB_FN bool meets(const Node& node) const {
        double t0 = 0.0, t1 = double(infinity());
        return clips(o.x, d.x, node.lo.x, node.hi.x, t0, t1) && clips(o.y, d.y, node.lo.y, node.hi.y, t0, t1) &&
               clips(o.z, d.z, node.lo.z, node.hi.z, t0, t1);
    }

private:
    GB_FN static bool clips(double from, double way, double lo, double hi, double& t0, double& t1) {
        if (way == 0.0) return from >= lo && from <= hi;
        const double a = (lo - from) / way, b = (hi - from) / way;
        t0 = max(t0, min(a, b));
        t1 = min(t1, max(a, b));
        return t0 <= t1;
    }
};

/// Integrals along rays, from their origin on: sum over j of value_j times the integral of particle j's
/// kernel, weights left out.  Float64 sums in Morton order.
struct IntegrateLines {
    static constexpr int most_channels = 8;
    Tree tree;
    SortedParticles particles;
    AnyKernel kernel;
    const float *origins, *directions;  ///< (m, 3); directions of unit length, else the result is 0
    const float* values;                ///< (n, channels), caller's order
    int channels, first, count;         ///< channels [first, first + count) are summed, count <= most_channels
    float* out;                         ///< (m, channels)
    GB_FN void operator()(std::size_t i) const {
        const HalfLine ray{{origins[3 * i], origins[3 * i + 1], origins[3 * i + 2]},
            {directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]}};
        double sums[most_channels];
        for (int c = 0; c < count; ++c) sums[c] = 0.0;
        if (dot(ray.d, ray.d) > 0.5)
            for_each_leaf_where(
                tree, [&](const Node& node) { return ray.meets(node); },
                [&](std::uint32_t begin, std::uint32_t n) {
                    for (std::uint32_t j = begin; j < begin + n; ++j) add(ray, j, sums);
                });
        for (int c = 0; c < count; ++c) out[i * channels + first + c] = float(sums[c]);
    }

private:
    GB_FN void add(const HalfLine& ray, std::uint32_t j, double* sums) const {
        // Where the support is the unit ball: w is the origin, e the way of one world unit.
        Vec3<double> w{ray.o.x - particles.x[j], ray.o.y - particles.y[j], ray.o.z - particles.z[j]}, e = ray.d;
        if (particles.stretch) {
            const Sym3<double> m = particles.matrix<double>(j);
            w = m * w;
            e = m * e;
        } else {
            const double scale = 1.0 / particles.support[j];
            w = w * scale;
            e = e * scale;
        }
        const double speed = length(e), along = dot(w, e) / speed;
        const Vec3<double> across = cross(w, e);
        const double h2 = dot(across, across) / (speed * speed);
        if (!(h2 < 1.0)) return;
        const double half = sqrt(1.0 - h2), from = max(along, -half);
        if (from >= half) return;
        const double way = column(kernel, h2, from, half) / speed;
        const float* mine = values + std::size_t(particles.index[j]) * channels + first;
        for (int c = 0; c < count; ++c) sums[c] += way * mine[c];
    }
};

/// Particles within `radius` of each point, as compressed rows.  Run twice: counts, then indices.
struct FindNeighbors {
    Tree tree;
    SortedParticles particles;
    const float* points;
    float radius;
    std::uint64_t* offsets;  ///< (m + 1,)
    std::uint32_t* indices;  ///< null in the counting run
    GB_FN void operator()(std::size_t i) const {
        const float3 p{points[3 * i], points[3 * i + 1], points[3 * i + 2]};
        const float3 r{radius, radius, radius};
        std::uint64_t n = 0;
        for_each_touching(tree, p - r, p + r, [&](std::uint32_t j) {
            const double dx = double(p.x) - particles.x[j], dy = double(p.y) - particles.y[j],
                         dz = double(p.z) - particles.z[j];
            if (!(dx * dx + dy * dy + dz * dz <= double(radius) * radius)) return;
            if (indices) indices[offsets[i] + n] = particles.index[j];
            ++n;
        });
        if (!indices) offsets[i] = n;
    }
};

/// Spacing around sampled particles, from the distance r to the 12th neighbor: a volume of
/// 4/3 pi r^3 holds 12.5 particles.  0 where there are too few particles or too many coincide.
struct LocalSpacing {
    Tree tree;
    SortedParticles particles;
    std::size_t begin, n, stride;  ///< particles [begin, n) are inside
    float* out;
    static constexpr int k = 12;
    GB_FN void operator()(std::size_t s) const {
        const std::size_t at = begin + s * stride;
        out[s] = 0.0f;
        if (n - begin <= std::size_t(k)) return;
        const float3 p = particles.position(at);
        float nearest[k];
        for (int i = 0; i < k; ++i) nearest[i] = infinity();
        auto insert = [&](std::size_t j) {
            const float3 v = particles.position(j) - p;
            float d = dot(v, v);
            for (int i = 0; i < k; ++i)
                if (d < nearest[i]) {
                    const float t = nearest[i];
                    nearest[i] = d;
                    d = t;
                }
        };
        // Neighbors along the curve bound the radius, so that the walk of the tree stays short.
        const std::size_t from = at - begin > std::size_t(k) ? at - k : begin;
        for (std::size_t j = from; j < min(n, at + k + 1); ++j)
            if (j != at) insert(j);
        const float r = sqrt(nearest[k - 1]);
        for (int i = 0; i < k; ++i) nearest[i] = infinity();
        for_each_touching(tree, {p.x - r, p.y - r, p.z - r}, {p.x + r, p.y + r, p.z + r}, [&](std::uint32_t j) {
            if (j != at) insert(j);
        });
        out[s] = sqrt(nearest[k - 1]) * 0.6946f;  // (4/3 pi / 12.5)^(1/3)
    }
};

}  // namespace globule::core
