// The last word on rays that float32 or a tile's list could not decide: one thread a ray, float64,
// straight from the tree.  Few rays come here: those that graze the surface within 1e-5 of the
// threshold, and those in places where more supports overlap than a list holds.
#pragma once
#include "globule/trace/tile.hpp"

namespace globule {

template <class Tree>
struct ResolveRays {
    Tree tree;
    SortedParticles particles;
    AnyKernel kernel;
    float tau;
    const float* color;
    float3 one_color;
    RaySource rays;
    Hits out;

    GB_FN void operator()(std::size_t i) const {
        if (!(out.t[i] < 0.0f)) return;
        float3 o, d;
        rays.get(i, o, d);
        const double t = solve({o.x, o.y, o.z}, {d.x, d.y, d.z}, undecided(out.t[i]));
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
    GB_FN double solve(const Vec3<double>& o, const Vec3<double>& d, double from) const {
        const Node box = tree.node(0);
        double end = infinity();
        auto axis = [&](double at, double along, double lo, double hi) {
            if (along != 0) end = least(end, most((lo - at) / along, (hi - at) / along));
        };
        axis(o.x, d.x, box.lo.x, box.hi.x);
        axis(o.y, d.y, box.lo.y, box.hi.y);
        axis(o.z, d.z, box.lo.z, box.hi.z);
        const TreeSource<Tree> source{tree, particles, kernel, o, d};
        const double window = 0.35 * tree.header->typical_support;
        Limits<double> lim{tau, window, 1e-13 * (1.0 + tau), 1e-12 * window, 1.0};
        lim.sign = source.template at<false>(0.0, lim).f > tau ? -1.0 : 1.0;
        double t = from;
        bool hit = false, tangent = false;
        march(source, lim, end, t < end, t, hit, tangent);
        return hit || tangent ? t : double(infinity());
    }
};

}  // namespace globule
