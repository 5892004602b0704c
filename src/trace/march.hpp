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
// Guaranteed roots from bounds: Kalra & Barr (1989) bound f' and f'' to halve a ray into pieces with one root
// at most, Hart (1996) makes a bound on |f'| a step.  Here the bound on f'' is the step, so that it heeds the slope.
//
// Rays that begin inside (f > tau) look for the exit by the same walk with the sign turned.
#pragma once
#include "octree/query.hpp"
#include "trace/gather.hpp"
#include "trace/hits.hpp"
#include "trace/stretched.hpp"

namespace globule::core {

/// What one evaluation on the ray gives.
template <class F> struct Along {
    F f, slope;
    F rise;  ///< bound on sign f'' over the window that begins here; only where it was asked for
    F fall;  ///< bound on -sign f'', likewise
};

template <class F> struct Limits {
    F tau, window, error, least_step;
    F sign;  ///< +1 outside, -1 inside
};

/// Adds one particle at (r/a)^2 = x, u past its point nearest to the ray, i2 = 1/a^2, c its weight (both 1 unless
/// PerParticle).  Tight: the bound from inside, too, heeds where the window lies; it pays where rays begin inside.
template <bool PerParticle, bool Bounds, bool Tight, class F, class Kernel>
GB_FN void add_along(Along<F>& sum, const Kernel& kernel, F x, F u, F i2, F c, const Limits<F>& lim) {
    F b, db;
    kernel(min(x, F(1)), b, db);
    if constexpr (PerParticle) {
        sum.f += c * b;
        sum.slope += c * i2 * db * u;
    } else {
        sum.f += b;
        sum.slope += db * u;
    }
    if constexpr (Bounds) {
        // The window spans u to u1; `near` and `far` are its points nearest to and farthest from the
        // closest approach.  It misses the support where even `near` lies outside.
        const F scale2 = PerParticle ? i2 : F(1);
        const F u1 = u + lim.window;
        const F near = max(max(u, -u1), F(0)), far = max(abs(u), abs(u1));
        const F A = F(1) - x + u * u * scale2;
        const auto apart = near * near * scale2 >= A;
        F rise = kernel.rise(far * far * scale2, A), dive(kernel.max_fall());
        if constexpr (Tight && PerParticle) dive = kernel.dive(near * near * scale2, A);
        if constexpr (PerParticle) {
            const F weight = abs(c) * i2;
            sum.rise += select(apart, F(0), weight * select(c * lim.sign > F(0), rise, dive));
            sum.fall += select(apart, F(0), weight * F(max(8.0f, kernel.max_fall())));
        } else {
            if constexpr (Tight) rise = select(lim.sign > F(0), rise, kernel.dive(near * near, A));
            sum.rise += select(apart, F(0), rise);
            sum.fall += select(apart, F(0), A);
        }
    }
}

/// Adds one particle: v = point - center, i2 = 1/a^2, c its weight (both 1 unless PerParticle).
template <bool PerParticle, bool Bounds, bool Tight, class F, class Kernel>
GB_FN void add(
    Along<F>& sum, const Kernel& kernel, const Vec3<F>& v, const Vec3<F>& d, F i2, F c, const Limits<F>& lim) {
    const F r2 = dot(v, v);
    add_along<PerParticle, Bounds, Tight>(sum, kernel, PerParticle ? r2 * i2 : r2, dot(v, d), i2, c, lim);
}

/// As add, of a particle with the matrix m in place of 1/a: in m's space the ray has the speed |m d|.
template <bool Bounds, bool Tight, class F, class Kernel>
GB_FN void add_stretched(Along<F>& sum, const Kernel& kernel, const Sym3<F>& m, const Vec3<F>& v, const Vec3<F>& d, F c,
    const Limits<F>& lim) {
    const Vec3<F> w = m * v, e = m * d;
    const F speed2 = dot(e, e);
    add_along<true, Bounds, Tight>(sum, kernel, dot(w, w), dot(w, e) / speed2, speed2, c, lim);
}

/// As add_stretched, from the square of the matrix; c: its weight.
template <bool Bounds, bool Tight, class F, class Kernel>
GB_FN void add_ellipsoid(Along<F>& sum, const Kernel& kernel, const Sym3<F>& form, const F& c, const Vec3<F>& v,
    const Vec3<F>& d, const Limits<F>& lim) {
    const Vec3<F> w = form * v;
    const F x = dot(v, w), along = dot(d, w);
    if constexpr (Bounds && (Tight || !Kernel::linear_rise)) {
        const F speed2 = dot(d, form * d);
        add_along<true, true, Tight>(sum, kernel, x, quick_quotient(along, speed2), speed2, c, lim);
        return;
    }
    F b, db;
    kernel(min(x, F(1)), b, db);
    sum.f += c * b;
    sum.slope += c * db * along;
    if constexpr (Bounds) {  // as in add_along, u and A times the speed: no division
        const F speed2 = dot(d, form * d), end = along + speed2 * lim.window;
        const F near = max(max(along, -end), F(0)), A = speed2 * (F(1) - x) + along * along;
        const F rise = kernel.rise(max(along * along, end * end), A), most = speed2 * F(kernel.max_fall());
        const F weight = select(near * near >= A, F(0), abs(c));
        sum.rise += weight * select(c * lim.sign > F(0), rise, most);
        sum.fall += weight * speed2;
    }
}

/// Candidates from the tile's list.
template <class Candidate, class Group, class Kernel> struct ListSource {
    using F = typename Group::F;
    using B = typename Group::B;
    Group& g;
    TileScratch<Group, Candidate>& scratch;
    int n;
    Kernel kernel;
    Vec3<F> p0, d;

    GB_FN bool any(const B& lanes) const { return g.any(lanes); }
    template <bool Bounds> GB_FN Along<F> at(F t, const Limits<F>& lim, const B& active) const {
        Along<F> sum{F(0), F(0), F(0), F(0)};
        g.template share_rays<Bounds>(scratch.lane_of, active, p0 + d * t, d, lim.sign, sum,
            [&](const Vec3<F>& p, const Vec3<F>& along, const F& sign, int first, int stride, Along<F>& mine) {
                Limits<F> of_ray = lim;
                of_ray.sign = sign;
                for (int j = first; j < n; j += stride) {
                    const float3 q = scratch.list.point(j);
                    const Vec3<F> v{p.x - F(q.x), p.y - F(q.y), p.z - F(q.z)};
                    if constexpr (Candidate::ellipsoid) {
                        const EllipsoidCandidate of = scratch.shape[j];
                        add_ellipsoid<Bounds, false>(
                            mine, kernel, of.template form_as<F>(), F(of.weight), v, along, of_ray);
                    } else if constexpr (Candidate::per_particle)
                        add<true, Bounds, false>(
                            mine, kernel, v, along, F(scratch.shape[j].inverse_a2), F(scratch.shape[j].weight), of_ray);
                    else add<false, Bounds, false>(mine, kernel, v, along, F(1), F(1), of_ray);
                }
            });
        sum.slope = F(2) * sum.slope;
        // 8: b falls at most so much per unit A, and no faster where the window leaves it.
        if constexpr (Bounds && (!Candidate::per_particle || (Candidate::ellipsoid && Kernel::linear_rise)))
            sum.fall = F(max(8.0f, kernel.max_fall())) * sum.fall;
        if constexpr (Bounds && !Candidate::per_particle) sum.rise = select(lim.sign > F(0), sum.rise, sum.fall);
        return sum;
    }
};

/// One particle in float64 and world units.
template <bool Bounds>
GB_FN void add_exact(Along<double>& sum, const SortedParticles& particles, const AnyKernel& kernel, std::uint32_t slot,
    const Vec3<double>& p, const Vec3<double>& d, const Limits<double>& lim) {
    const double a = particles.support[slot];
    const Vec3<double> v{p.x - particles.x[slot], p.y - particles.y[slot], p.z - particles.z[slot]};
    if (a > 0 && particles.stretch)
        add_stretched<Bounds, false>(
            sum, kernel, particles.matrix<double>(slot), v, d, double(particles.weight[slot]), lim);
    else if (a > 0) add<true, Bounds, false>(sum, kernel, v, d, 1.0 / (a * a), double(particles.weight[slot]), lim);
}

/// Walks lanes from t to `end`.  `hit`: crossed at t.  `doubtful`: this precision cannot tell from t on.
/// The bounds cost more than f and f' together and hold for a whole window, so they are asked for
/// only when some lane has used its window up.
/// Leaving: rays may begin on the surface itself, on a known side: while one moves away from the threshold it has not
/// met it, however near it is (as step_along in trace/cell_tracer.hpp).
template <bool Leaving = false, class F, class B, class Source>
GB_FN void march(const Source& source, const Limits<F>& lim, F end, B active, F& t, B& hit, B& doubtful) {
    F rise = F(0), fall = F(0), window_end = t;
    for (int step = 0; source.any(active); ++step) {
        Along<F> s;
        if (source.any(active & (t >= window_end))) {
            s = source.template at<true>(t, lim, active);
            rise = s.rise * F(1.0001f);
            fall = s.fall;
            window_end = t + lim.window;
        } else {
            s = source.template at<false>(t, lim, active);
        }
        const F gap = lim.sign * (lim.tau - s.f);
        const F slope = lim.sign * s.slope;
        const F safe = max(gap - lim.error, F(0));
        const F under = slope * slope + F(2) * rise * safe;
        const F bottom = slope + quick_root(max(under, F(0)));
        const auto reaches = (under >= F(0)) & (bottom > F(0));
        const F rest = window_end - t;
        F move = select(reaches, quick_quotient(F(2) * safe, select(reaches, bottom, F(1))), rest);
        B towards = active;
        if constexpr (Leaving) {
            const B away = slope <= F(0), curved = rise > F(0);
            const F back = quick_quotient(
                quick_root(max(under, F(0))) - slope, select(curved, rise, F(1)));  // the bound's second root
            move = select(away, select(curved, max(back, lim.least_step), rest), move);
            towards = towards & !away;
        }
        // A Newton step ends this where its error, curvature move^2 / (2 slope), is small enough and f is
        // certain to rise by the gap and this precision's error: by slope^2 / (2 fall), or slope rest / 2
        // up to the window's end.
        const B at_surface = towards & ((gap <= F(2) * lim.error) | (move <= lim.least_step));
        const B quick = active & (move * move * max(rise, fall) <= F(2) * lim.least_step * slope);
        const F lift = F(2) * (max(gap, F(0)) + F(4) * lim.error);
        const B certain = (at_surface | quick) & (slope > F(0)) & (slope * slope > fall * lift) & (slope * rest > lift);
        const B unsure = at_surface & !certain;
        const F newton = t + min(quick_quotient(max(gap, F(0)), select(certain, slope, F(1))), rest);
        const F onward = select(move < rest, t + move, window_end);
        t = select(active, select(certain, newton, select(unsure, t, onward)), t);
        hit = hit | certain;
        doubtful = doubtful | unsure;
        if (step == 1000) doubtful = doubtful | (active & !certain);
        active = active & !certain & !doubtful & (t < end);
    }
}

}  // namespace globule::core
