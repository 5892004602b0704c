// The exact first root of f(o + t d) = tau, for any kernel, without sorting events.
//
// From a point with gap g = tau - f > 0 and slope f', Taylor with an upper bound M on f'' over the
// next window says that f cannot reach tau before
//     s = 2 g / (f' + sqrt(f'^2 + 2 M g)),
// so the ray may be moved on by s (or by the whole window, if that is less) and no root is ever
// passed, however thin the feature.  Near a crossing the bound is tight and convergence is
// quadratic, as Newton's; near a tangency the steps shrink and grow again with sqrt(g).  A ray whose
// gap falls inside float32's own error without a certain crossing is finished in float64.
//
// Rays that begin inside (f > tau) look for the exit by the same walk with the sign turned.
#pragma once
#include "globule/octree/query.hpp"
#include "globule/trace/gather.hpp"

namespace globule {

/// What one evaluation on the ray gives.
template <class F>
struct Along {
    F f, slope, curvature, downward;  ///< f, f', bound on sign f'', bound on -sign f''
};

template <class F>
struct Limits {
    F tau, window, error, least_step;
    F sign;  ///< +1 outside, -1 inside
};

/// Adds one candidate: v = point - centre, c its weight, i2 = 1/a^2.
template <bool PerParticle, class Kernel, class F>
GB_FN void add_along(Along<F>& sum, const Kernel& kernel, const Vec3<F>& v, const Vec3<F>& d, F i2, F c,
                     const Limits<F>& lim) {
    const F u = dot(v, d);
    const F x0 = dot(v, v) * i2;
    const F x = least(x0, F(1));
    F b, slope;
    kernel(x, b, slope);
    const F u2 = u * u * i2;
    const F A = F(1) - x0 + u2;
    const F u1 = u + lim.window;
    const F u12 = u1 * u1 * i2;
    const F e = least(most(u2, u12), A);
    const auto apart = (A <= F(0)) | ((u > F(0)) & (x0 >= F(1))) | ((u1 < F(0)) & (u12 >= A));
    if constexpr (PerParticle) {
        const F cs = c * lim.sign, ci = magnitude(c) * i2;
        const F rise = kernel.rise(e, A), fall = kernel.fall(A);
        sum.f += c * b;
        sum.slope += F(2) * c * i2 * slope * u;
        sum.curvature += select(apart, F(0), ci * select(cs > F(0), rise, fall));
        sum.downward += ci * F(most(8.0f, kernel.max_fall()));
    } else {
        sum.f += b;
        sum.slope += slope * u;
        sum.curvature += select(apart, F(0), kernel.rise(e, A));
    }
}

/// Candidates from the tile's list; all have a = 1 and c = 1 unless PerParticle.
template <bool PerParticle, class Group, class Kernel>
struct ListSource {
    const TileScratch<Group, PerParticle>& scratch;
    int n;
    Kernel kernel;

    template <class F>
    GB_FN Along<F> operator()(const Vec3<F>& p, const Vec3<F>& d, const Limits<F>& lim) const {
        Along<F> sum{F(0), F(0), F(0), F(0)};
        for (int j = 0; j < n; ++j) {
            const Candidate q = scratch.list[j];
            const Vec3<F> v{p.x - F(q.x), p.y - F(q.y), p.z - F(q.z)};
            if constexpr (PerParticle)
                add_along<true>(sum, kernel, v, d, F(scratch.shape[j].inverse_a2), F(scratch.shape[j].weight), lim);
            else
                add_along<false>(sum, kernel, v, d, F(1), F(1), lim);
        }
        if constexpr (!PerParticle) {
            sum.slope = F(2) * sum.slope;
            sum.downward = F(kernel.max_fall() * float(n));
            sum.curvature = select(lim.sign > F(0), sum.curvature, sum.downward);
        }
        return sum;
    }
};

/// One particle in float64 and world units.
GB_FN void add_exact(Along<double>& sum, const SortedParticles& particles, const AnyKernel& kernel,
                     std::uint32_t slot, const Vec3<double>& p, const Vec3<double>& d,
                     const Limits<double>& lim) {
    const double a = particles.support[slot];
    const Vec3<double> v{p.x - particles.x[slot], p.y - particles.y[slot], p.z - particles.z[slot]};
    if (a > 0) add_along<true>(sum, kernel, v, d, 1.0 / (a * a), double(particles.weight[slot]), lim);
}

/// The list's particles again, for rays that float32 cannot decide.
template <bool PerParticle, class Group>
struct ExactListSource {
    const TileScratch<Group, PerParticle>& scratch;
    int n;
    SortedParticles particles;
    AnyKernel kernel;
    GB_FN Along<double> operator()(const Vec3<double>& p, const Vec3<double>& d, const Limits<double>& lim) const {
        Along<double> sum{0, 0, 0, 0};
        for (int j = 0; j < n; ++j) add_exact(sum, particles, kernel, scratch.list[j].slot, p, d, lim);
        return sum;
    }
};

/// Straight from the tree, where even the thinnest slab holds more than a list can.
template <class Tree>
struct TreeSource {
    Tree tree;
    SortedParticles particles;
    AnyKernel kernel;
    GB_FN Along<double> operator()(const Vec3<double>& p, const Vec3<double>& d, const Limits<double>& lim) const {
        Along<double> sum{0, 0, 0, 0};
        const Vec3<double> q = p + d * lim.window;
        const float3 lo{float(least(p.x, q.x)), float(least(p.y, q.y)), float(least(p.z, q.z))};
        const float3 hi{float(most(p.x, q.x)), float(most(p.y, q.y)), float(most(p.z, q.z))};
        for_each_touching(tree, lo, hi,
                          [&](std::uint32_t slot) { add_exact(sum, particles, kernel, slot, p, d, lim); });
        return sum;
    }
};

/// Walks lanes from t to `end`.  `hit`: crossed at t.  `doubtful`: float32 cannot tell from t on.
template <class F, class B, class Source>
GB_FN void march(const Source& source, const Vec3<F>& p0, const Vec3<F>& d, const Limits<F>& lim, F end,
                 B active, F& t, B& hit, B& doubtful) {
    for (int step = 0; any(active); ++step) {
        const Along<F> s = source(p0 + d * t, d, lim);
        const F gap = lim.sign * (lim.tau - s.f);
        const F slope = lim.sign * s.slope;
        const F safe = most(gap - lim.error, F(0));
        const F M = s.curvature * F(1.0001f);
        const F under = slope * slope + F(2) * M * safe;
        const F bottom = slope + root(most(under, F(0)));
        const auto reaches = (under >= F(0)) & (bottom > F(0));
        const F move = select(reaches, F(2) * safe / select(reaches, bottom, F(1)), lim.window);
        const B close = active & ((gap <= F(2) * lim.error) | (move <= lim.least_step));
        // From here f rises by at least slope^2 / (2 downward): more than float32's error?
        const B certain = close & (slope > F(0)) & (slope * slope > F(8) * lim.error * s.downward);
        t = select(active, t + select(certain, least(most(gap, F(0)) / select(certain, slope, F(1)), lim.window),
                                      select(close, F(0), least(move, lim.window))), t);
        hit = hit | certain;
        doubtful = doubtful | (close & !certain);
        if (step == 500) doubtful = doubtful | active;
        active = active & !close & !doubtful & (t < end);
    }
}

}  // namespace globule
