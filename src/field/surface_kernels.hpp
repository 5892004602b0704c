// One smooth surface around particles of fluid that encloses their volume (docs/design/surface.md): each particle's
// ellipsoid and weight from its neighbors, so that the field is 1/2 where the fluid ends.
//
//   covariance of the neighbors   Yu and Turk 2013, eq. 9, weights 1 - (r / radius)^4
//   axes                           as wide across the surface as inside, wider along it: with sqrt(2) as the ratio of
//   the
//                                  two the curvature of the surface does not move it; narrow across a sheet of one
//                                  layer a particle too deep inside for the surface to feel its kernel is round
//   weight                         kernels of mass 1; where a particle is almost alone, its own field is raised to that
//   of
//                                  a particle in a flat face, or in a sheet as thin as its particles are apart
#pragma once
#include "field/eigen.hpp"
#include "field/full_cells.hpp"
#include "octree/query.hpp"

namespace globule::core {

/// Lengths in spacings; eigenvalues over those where neighbors fill the radius evenly.
namespace surface {
inline constexpr float kRadius = 3.375f;                        ///< of the neighbors: the longest axis that there is
inline constexpr float kAxis = 2.25f;                           ///< support across the surface, and inside
inline constexpr float kThin = 1.5f;                            ///< across a single layer
inline constexpr float kAlong = 1.5f;                           ///< ratio of the supports along and across the surface
inline constexpr float kTwoLayers = 0.18f, kFaceEigen = 0.36f;  ///< least eigenvalue
inline constexpr float kFlat = 0.3f, kInside = 1.0f;            ///< eigenvalue across a face, and inside
inline constexpr float kFace = 0.73f;                           ///< field at a particle in a flat face
inline constexpr float kDroplet = 0.1f,
                       kCrowd = 0.36f;  ///< share of the neighborhood that is filled: weights are raised below
inline constexpr float kEdgeCrowd = 0.482f,
                       kEdge = 0.82f;  ///< the same, and raised to, at edges, which are rounded off
inline constexpr float kEdgeFrom = 0.04f,
                       kEdgeTo = 0.1225f;             ///< square of the neighbors' mean over the radius: an edge
inline constexpr float kAlone = 0.04f, kSome = 0.2f;  ///< the same: kernels are round below
inline constexpr float kSheet = 0.16f;  ///< the same: what is flat is a sheet in full from here, and none below kAlone
inline constexpr float kRow = 0.3f, kWide = 0.8f;  ///< second eigenvalue of a row of particles, of a sheet
inline constexpr float kFull = 0.85f,
                       kEven = 0.02f;       ///< the same, and how far off the neighbors' mean may be: inside, round
inline constexpr float kMass = 1.0444544f;  ///< 1 over the integral of (1 - r^2)^2 over the unit ball
inline constexpr float kThreshold = 0.5f;
inline constexpr float kMostStretch = 2.26f;  ///< ratio of axes, (kAxis + (kAlong - 1) kAxis) / kThin at most

template <class F> GB_FN F smooth_step(const F& x, float from, float to) {
    const F t = min(max((x - F(from)) * F(1.0f / (to - from)), F(0.0f)), F(1.0f));
    return t * t * (F(3.0f) - F(2.0f) * t);
}

/// What the neighbors add up to, with weights 1 - (r / radius)^4, distances over the radius.
template <class F> struct Mean {
    F sum = F(0.0f);
    Vec3<F> first{F(0.0f), F(0.0f), F(0.0f)};

    GB_FN void add(const F& w, const Vec3<F>& v) {
        sum = sum + w;
        first = first + v * w;
    }
    /// Share of the radius's ball that is filled: in an endless lattice the sum is 16 pi / 21 kRadius^3.
    GB_FN F filled() const { return sum * F(1.0f / (2.3935946f * kRadius * kRadius * kRadius)); }
    /// Too deep inside for its kernel to reach the surface.
    GB_FN auto inside() const { return (filled() >= F(kFull)) & (dot(first, first) <= F(kEven * kEven) * (sum * sum)); }
};
template <class F> struct Moments : Mean<F> {
    Sym3<F> second{F(0.0f), F(0.0f), F(0.0f), F(0.0f), F(0.0f), F(0.0f)};

    GB_FN void add(const F& w, const Vec3<F>& v) {
        const Vec3<F> t = v * w;
        this->sum = this->sum + w;
        this->first = this->first + t;
        second = {second.xx + t.x * v.x, second.yy + t.y * v.y, second.zz + t.z * v.z, second.xy + t.x * v.y,
            second.xz + t.x * v.z, second.yz + t.y * v.z};
    }
    /// 1 along each axis in an endless lattice.
    GB_FN Sym3<F> covariance() const {
        const F by = F(1.0f) / this->sum, s = F(45.0f / 7.0f);
        const Vec3<F> m = this->first * by;
        return {(second.xx * by - m.x * m.x) * s, (second.yy * by - m.y * m.y) * s, (second.zz * by - m.z * m.z) * s,
            (second.xy * by - m.x * m.y) * s, (second.xz * by - m.x * m.z) * s, (second.yz * by - m.y * m.z) * s};
    }
};

/// The ellipsoid, for vectors over the neighbors' radius.
template <class F> struct Shape {
    Sym3<F> matrix;
    F longest, shortest;  ///< axes, in spacings
    F mass;               ///< factor that makes the kernel's integral one particle's volume
    F sheet;              ///< 1 in a sheet of one layer, 0 in a body, a row or a droplet
    F edge;               ///< 1 at an edge, a corner or in a clump, 0 in a face, a row or a droplet

    /// Where nothing but fluid is near.
    GB_FN static Shape inside() {
        const F round = F(kRadius / kAxis), none = F(0.0f);
        return {{round, round, round, none, none, none}, F(kAxis), F(kAxis), F(kMass / (kAxis * kAxis * kAxis)), none,
            none};
    }
    template <class B> GB_FN Shape where(const B& m, const Shape& other) const {
        const Sym3<F>&a = matrix, &b = other.matrix;
        return {{select(m, a.xx, b.xx), select(m, a.yy, b.yy), select(m, a.zz, b.zz), select(m, a.xy, b.xy),
                    select(m, a.xz, b.xz), select(m, a.yz, b.yz)},
            select(m, longest, other.longest), select(m, shortest, other.shortest), select(m, mass, other.mass),
            select(m, sheet, other.sheet), select(m, edge, other.edge)};
    }
};
template <class F> GB_FN Shape<F> shape(const Moments<F>& moments, const F& filled) {
    const Eigen3<F> e = eigen(moments.covariance());
    const F least = min(min(e.value[0], e.value[1]), e.value[2]),
            largest = max(max(e.value[0], e.value[1]), e.value[2]);
    const F middle = e.value[0] + e.value[1] + e.value[2] - least - largest;
    const auto flat = [](const F& s) { return F(1.0f) - smooth_step(s, kFlat, kInside); };
    const F flattest = flat(least), company = smooth_step(filled, kAlone, kSome);
    F inverse[3], longest = F(0.0f), shortest = F(kRadius), mass = F(kMass);
    for (int k = 0; k < 3; ++k) {
        const F across = F(kThin) + F(kAxis - kThin) * smooth_step(e.value[k], kTwoLayers, kFaceEigen);
        const F wide = across + F((kAlong - 1.0f) * kAxis) * max(flattest - flat(e.value[k]), F(0.0f));
        const F a = F(kThin) + company * (wide - F(kThin));
        longest = max(longest, a);
        shortest = min(shortest, a);
        inverse[k] = F(kRadius) / a;
        mass = mass / a;
    }
    const F sheet = smooth_step(filled, kAlone, kSheet) * smooth_step(middle, kRow, kWide) *
                    (F(1.0f) - smooth_step(least, 0.0f, kTwoLayers));
    const F off = dot(moments.first, moments.first) / (moments.sum * moments.sum);
    return {e.compose(inverse), longest, shortest, mass, sheet, company * smooth_step(off, kEdgeFrom, kEdgeTo)};
}
/// own: the particle's field at its place, with weights of mass 1.
template <class F> GB_FN F raised(const F& own, const F& filled, const Shape<F>& shape) {
    // smooth_step(filled, kDroplet, kCrowd), and at an edge up to kEdgeCrowd
    const F crowd = F(kCrowd - kDroplet) + F(kEdgeCrowd - kCrowd) * shape.edge;
    const F few = F(1.0f) - smooth_step((filled - F(kDroplet)) / crowd, 0.0f, 1.0f);
    const F full = F(kFace) + F(kEdge - kFace) * shape.edge;
    // A sheet of t particles in a square spacing is t spacings thick: c (1 - (t / 2)^2 / kThin^2)^3 = 1/2, t = own /
    // kFace.
    const F t = min(own * F(1.0f / (2.0f * kThin * kFace)), F(0.4f)), rest = F(1.0f) - t * t;
    const F in_sheet = min(F(kThreshold) / (rest * rest * rest), F(kFace));
    return F(1.0f) + few * max((full + shape.sheet * (in_sheet - full)) / own - F(1.0f), F(0.0f));
}

}  // namespace surface

/// Ellipsoids and weights of the particles of an octree, a group's worth of those that follow each other along the
/// curve at a time, one in each lane:
///   bunch    rows that lie together (where the curve jumps, neighbors along it are far apart)
///   gather   the leaves around, of whose particles those near the bunch are kept
///   add up   each row goes through them
struct FindSurfaceKernels {
    static constexpr int kNear = 416;              ///< at once; there may be more
    static constexpr std::size_t kMany = 1 << 19;  ///< most are deep inside, which fewer sums tell
    static constexpr int tile_blocks = 6;          ///< at one time on a GPU's processor
    static constexpr float kSpread = 2.0f;         ///< of a bunch from its first row, in radii
    template <class Group>
    using Scratch =
        typename Group::template List<kNear + Group::width>;  ///< places over the radius, from the bunch's first row

    Tree tree;
    SortedParticles particles;  ///< as sorted: with the support that the tree's boxes hold
    std::size_t n;
    float spacing;
    FullCells full;  ///< without counts: not asked
    float *support, *weight, *stretch, *shortest;

    template <class Group> GB_FN void operator()(Group& g, Scratch<Group>& near, std::size_t tile) const {
        using V = typename Group::F;
        using B = typename Group::B;
        const std::size_t first = tile * Group::width;
        const Vec3<V> at{
            g.load_run(particles.x + first), g.load_run(particles.y + first), g.load_run(particles.z + first)};
        B present = g.none();
        const std::size_t outside = tree.header->n_outside;
        Group::for_lanes([&](int lane) {
            const std::size_t slot = first + g.lane_number(lane);
            Group::put(present, lane, slot >= outside && slot < n);
        });
        const auto add_up = [&](auto& sums, const B& rows) {
            for_all(g, near, at, rows, [&](const Vec3<V>& own, int n_near) {
                for (int k = 0; k < n_near; ++k) {
                    const Vec3<float> q = near.point(k);
                    const Vec3<V> v{V(q.x) - own.x, V(q.y) - own.y, V(q.z) - own.z};
                    const V d2 = dot(v, v);
                    sums.add(max(V(1.0f) - d2 * d2, V(0.0f)), v);
                }
            });
        };
        B open = present;  // not known to be deep inside
        if (full.counts) open = open & !surrounded(g, present, first);
        if (n >= kMany && g.any(open)) {
            surface::Mean<V> mean;
            add_up(mean, open);
            open = open & !mean.inside();
        }
        surface::Shape<V> shape = surface::Shape<V>::inside();
        V filled = V(1.0f);
        if (g.any(open)) {
            surface::Moments<V> moments;
            add_up(moments, open);
            moments.sum = select(open, moments.sum, V(1.0f));
            open = open & !moments.inside();
            filled = select(open, moments.filled(), filled);
            shape = surface::shape(moments, filled).where(open, shape);
        }
        const B alone = present & (filled < V(surface::kCrowd) + V(surface::kEdgeCrowd - surface::kCrowd) * shape.edge);
        V factor = V(1.0f);
        if (g.any(alone)) {
            V sum = V(0.0f);
            for_all(g, near, at, alone, [&](const Vec3<V>& own, int n_near) {
                for (int k = 0; k < n_near; ++k) {
                    const Vec3<float> q = near.point(k);
                    const Vec3<V> w = shape.matrix * Vec3<V>{V(q.x) - own.x, V(q.y) - own.y, V(q.z) - own.z};
                    const V rest = V(1.0f) - min(dot(w, w), V(1.0f));
                    sum = sum + rest * rest;
                }
            });
            factor = select(alone, surface::raised(max(sum, V(1.0f)) * shape.mass, filled, shape), factor);
        }
        write(g, first, present, shape, factor);
    }

private:
    /// Rows that need no look at their neighbors.
    template <class Group>
    GB_FN typename Group::B surrounded(Group& g, const typename Group::B& present, std::size_t first) const {
        typename Group::B deep = g.none();
        const FullCells::Level level = full.level();
        if (!level.is_fine()) return deep;
        std::uint32_t last = ~0u;  // rows that follow each other share cells
        bool is_deep = false;
        Group::for_lanes([&](int lane) {
            if (!Group::get(present, lane)) return;
            const std::uint32_t cell = full.cell_of(first + g.lane_number(lane), level.number);
            if (cell != last) is_deep = full.surrounds(cell, level);
            last = cell;
            Group::put(deep, lane, is_deep);
        });
        return deep;
    }
    /// look(places of the rows, number of near): all particles near the rows `left`, in `near`, in the curve's order;
    /// rows that it is not about are far from everybody.
    template <class Group, class V, class Look>
    GB_FN void for_all(
        Group& g, Scratch<Group>& near, const Vec3<V>& at, typename Group::B left, const Look& look) const {
        const float radius = surface::kRadius * spacing, by = 1.0f / radius,
                    beside = max(radius - particles.support.uniform, 0.0f);
        const float3 margin{beside, beside, beside};
        const V inf = V(infinity()), spread = V(kSpread * radius), far = V(1e3f);
        while (g.any(left)) {
            const int leader = g.first_from(left, 0);
            const float3 middle{g.pick(at.x, leader), g.pick(at.y, leader), g.pick(at.z, leader)};
            const Vec3<V> away{at.x - V(middle.x), at.y - V(middle.y), at.z - V(middle.z)};
            const typename Group::B together =
                left & (abs(away.x) <= spread) & (abs(away.y) <= spread) & (abs(away.z) <= spread);
            left = left & !together;
            const Vec3<V> own{select(together, away.x * V(by), far), select(together, away.y * V(by), far),
                select(together, away.z * V(by), far)};
            const float3 lo{g.smallest(select(together, at.x, inf)), g.smallest(select(together, at.y, inf)),
                g.smallest(select(together, at.z, inf))};
            const float3 hi{g.largest(select(together, at.x, -inf)), g.largest(select(together, at.y, -inf)),
                g.largest(select(together, at.z, -inf))};
            int n_near = 0;
            const auto look_at_them = [&] {
                g.sync();
                look(own, n_near);
                g.sync();
                n_near = 0;
            };
            std::uint32_t begin = 0, end = 0;  // leaves that follow each other in memory are one run
            const auto take = [&] {
                for (; begin < end; begin += Group::width) {
                    if (n_near > kNear) look_at_them();
                    n_near = collect(g, near, n_near, begin, g.first_lanes(int(end - begin)), lo, hi, middle, by);
                }
            };
            for_each_leaf(g, tree, lo - margin, hi + margin, [&](std::uint32_t from, std::uint32_t count) {
                if (from != end) {
                    take();
                    begin = from;
                }
                end = from + count;
            });
            take();
            look_at_them();
        }
    }
    /// Of a group's worth of particles those that some row in the box may be near.
    template <class Group>
    GB_FN int collect(Group& g, Scratch<Group>& near, int n_near, std::uint32_t begin, const typename Group::B& present,
        const float3& lo, const float3& hi, const float3& middle, float by) const {
        using V = typename Group::F;
        const V zero = V(0.0f), x = g.load_run(particles.x + begin), y = g.load_run(particles.y + begin),
                z = g.load_run(particles.z + begin);
        const V ex = max(max(V(lo.x) - x, x - V(hi.x)), zero) * V(by),
                ey = max(max(V(lo.y) - y, y - V(hi.y)), zero) * V(by),
                ez = max(max(V(lo.z) - z, z - V(hi.z)), zero) * V(by);
        const typename Group::B may = present & (ex * ex + ey * ey + ez * ez < V(1.0002f));
        near.keep(g, may, {(x - V(middle.x)) * V(by), (y - V(middle.y)) * V(by), (z - V(middle.z)) * V(by)}, n_near);
        return n_near + g.count(may);
    }
    template <class Group, class V>
    GB_FN void write(Group& g, std::size_t first, const typename Group::B& present, const surface::Shape<V>& shape,
        const V& factor) const {
        const Sym3<V>& m = shape.matrix;
        const float by = 1.0f / (surface::kRadius * spacing);
        Group::for_lanes([&](int lane) {
            const std::size_t slot = first + g.lane_number(lane);
            if (slot >= n) return;
            const bool row = Group::get(present, lane);
            const float six[6] = {Group::get(m.xx, lane), Group::get(m.yy, lane), Group::get(m.zz, lane),
                Group::get(m.xy, lane), Group::get(m.xz, lane), Group::get(m.yz, lane)};
            for (int k = 0; k < 6; ++k) stretch[6 * slot + k] = row ? six[k] * by : k < 3 ? by : 0.0f;
            support[slot] = row ? 1.0001f * spacing * Group::get(shape.longest, lane)
                                : 0.0f;  // rounding must not cut off what it reaches
            shortest[slot] = row ? spacing * Group::get(shape.shortest, lane) : spacing;
            weight[slot] =
                row ? particles.weight[slot] * Group::get(shape.mass, lane) * Group::get(factor, lane) : 0.0f;
        });
    }
};

}  // namespace globule::core
