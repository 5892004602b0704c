// The last word on rays that float32 could not decide: those that graze the surface within 1e-5 of
// the threshold, and those in places where more supports overlap than a list holds.  A whole group
// works on one such ray at a time, its lanes sharing out the candidates, all sums in float64.
#pragma once
#include "globule/trace/tile.hpp"

namespace globule {

/// The list's particles in float64 and world units, shared out among the lanes.
template <bool PerParticle, class Group>
struct SharedListSource {
    Group& g;
    const TileScratch<Group, PerParticle>& scratch;
    int n;
    const SortedParticles& particles;
    AnyKernel kernel;
    Vec3<double> o, d;
    template <bool Bounds>
    GB_FN Along<double> at(double t, const Limits<double>& lim) const {
        Along<double> sum{0, 0, 0, 0};
        const Vec3<double> p = o + d * t;
        g.share(n, [&](int j) { add_exact<Bounds>(sum, particles, kernel, scratch.list.number(j), p, d, lim); });
        sum = {g.total(sum.f), 2 * g.total(sum.slope), Bounds ? g.total(sum.rise) : 0, Bounds ? g.total(sum.fall) : 0};
        return sum;
    }
};

template <class Tree, bool PerParticle>
struct ResolveRays {
    template <class Group>
    using Scratch = TileScratch<Group, PerParticle>;

    Tree tree;
    SortedParticles particles;
    AnyKernel kernel;
    float tau;
    const float* color;
    float3 one_color;
    RaySource rays;
    Hits out;

    template <class Group>
    std::size_t n_tiles() const { return ceil_div<std::size_t>(rays.n, Group::width); }

    template <class Group>
    GB_FN void operator()(Group& g, Scratch<Group>& scratch, std::size_t tile) const {
        typename Group::B open = g.none();
        g.per_lane(g.first_lanes(Group::width), [&](int lane) {
            const std::size_t i = tile * Group::width + lane;
            Group::put(open, lane, i < rays.n && out.t[i] < 0.0f);
        });
        g.each(open, [&](int lane) { resolve(g, scratch, tile * Group::width + lane); });
    }

    template <class Group>
    GB_FN void resolve(Group& g, Scratch<Group>& scratch, std::size_t i) const {
        float3 o, d;
        rays.get(i, o, d);
        const double t = solve(g, scratch, o, d, undecided(out.t[i]));
        g.sync();
        if (!g.is_first()) return;  // one lane writes
        out.t[i] = float(t);
        if (!(t < infinity())) return;
        const float3 p{float(o.x + t * d.x), float(o.y + t * d.y), float(o.z + t * d.z)};
        float gradient[3], rgb[3] = {one_color.x, one_color.y, one_color.z};
        EvaluateField<Tree>{tree, particles, kernel, &p.x, nullptr, gradient}(0);
        if (color) Blend<Tree>{tree, particles, kernel, &p.x, color, 3, rgb}(0);
        const float3 n = normalize(float3{gradient[0], gradient[1], gradient[2]});
        write3(out.normal, i, {-n.x, -n.y, -n.z});
        write3(out.albedo, i, {rgb[0], rgb[1], rgb[2]});
    }

    /// First root at or after `from`, or infinity.
    template <class Group>
    GB_FN double solve(Group& g, Scratch<Group>& scratch, const float3& o, const float3& d, double from) const {
        const float typical = tree.header->typical_support, scale = 1.0f / typical;
        const Vec3<double> o2{o.x, o.y, o.z}, d2{d.x, d.y, d.z};
        const TreeSource<Tree> straight{tree, particles, kernel, o2, d2};
        const double window = 0.35 * typical;
        Limits<double> lim{tau, window, 1e-13 * (1.0 + tau), 1e-12 * window, 1.0};
        lim.sign = straight.template at<false>(0.0, lim).f > tau ? -1.0 : 1.0;
        const Bundle ray{o, d, rounding(tree), 0.0f};
        float z = float(from), dz = typical;
        while (z < infinity()) {
            const float3 at{o.x + z * d.x, o.y + z * d.y, o.z + z * d.z};
            Walk<PerParticle, Group, Tree> walk(g, scratch, tree, particles, ray, z, at);
            const Gathered found = gather(walk, dz, scale);
            if (found.n < 0 && dz > least_slab(typical, z)) {
                dz *= 0.5f;
                continue;
            }
            if (found.n == 0) {
                z = found.next;
                dz = typical;
                continue;
            }
            double t = most(from, double(z));
            bool hit = false, tangent = false;
            if (found.n > 0)
                march(SharedListSource<PerParticle, Group>{g, scratch, found.n, particles, kernel, o2, d2}, lim,
                      double(z + dz), true, t, hit, tangent);
            else
                march(straight, lim, double(z + dz), true, t, hit, tangent);
            if (hit || tangent) return t;
            z += dz;
        }
        return infinity();
    }
};

}  // namespace globule
