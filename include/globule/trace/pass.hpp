// Rays side by side through one cell, a lane each.  The CPU goes this way where many rays of a wave visit
// the same cell: a particle is read once for all of them, and nothing is added up across lanes.
#pragma once
#include "globule/base/quad.hpp"
#include "globule/trace/first_hit.hpp"

namespace globule {

/// A cell's particles, one after the other, along rays in lanes: p0 + t d, as in BlockSource.
template <class F, class Tracer>
struct CellSource {
    using Lanes = typename Tracer::Lanes;
    using Kernel = typename Tracer::Kernel;
    const float* blocks;
    int n;
    Kernel kernel;
    Vec3<F> p0, d;

    template <bool Bounds>
    GB_FN Along<F> at(F t, const Limits<F>& lim) const {
        constexpr int W = Lanes::width;
        const Vec3<F> p = p0 + d * t;
        Along<F> sum{F(0.0f), F(0.0f), F(0.0f), F(0.0f)};
        for (int j = 0; j < n; ++j) {
            const float* block = blocks + std::size_t(j / W) * Tracer::Source::kFloats;
            const float* q = block + j % W;
            const Vec3<F> v{p.x - F(q[0]), p.y - F(q[W]), p.z - F(q[2 * W])};
            if constexpr (Kernel::stretched)
                add_stretched<Bounds, true>(sum, kernel, kernel.template matrix<F>(Lanes::slot(block, j % W)), v, d, F(q[5 * W]), lim);
            else if constexpr (Tracer::PerParticle)
                add<true, Bounds, true>(sum, kernel, v, d, F(q[4 * W]), F(q[5 * W]), lim);
            else
                add<false, Bounds, true>(sum, kernel, v, d, F(1.0f), F(1.0f), lim);
        }
        sum.slope *= F(2.0f);
        if constexpr (!Tracer::PerParticle && Bounds) sum.fall *= F(most(8.0f, kernel.max_fall()));  // as in ListSource
        return sum;
    }
};

/// step_along of trace/first_hit.hpp in lanes.
template <class F, class B>
GB_FN void step_along(const Along<F>& s, const Limits<F>& lim, F rise, F fall, F rest, B active, F& t, B& crossed, B& doubtful) {
    const F gap = lim.sign * (lim.tau - s.f), slope = lim.sign * s.slope;
    const F safe = most(gap - lim.error, F(0.0f)), zero(0.0f);
    const F under = slope * slope + F(2.0f) * rise * safe;
    const F bend = quick_root(most(under, zero));
    const B away = slope <= zero;  // the bound's second root
    const B bounded = (away & (rise > zero)) | (!away & (under >= zero));
    const F bottom = select(away, rise, slope + bend);
    F move = select(bounded, quick_quotient(select(away, bend - slope, F(2.0f) * safe), select(bounded, bottom, F(1.0f))), rest);
    const B at_surface = !away & ((gap <= F(2.0f) * lim.error) | (move <= lim.least_step));
    const B quick = !away & (move * move * most(rise, fall) <= F(2.0f) * lim.least_step * slope);
    const F lift = F(2.0f) * (most(gap, zero) + F(4.0f) * lim.error);
    const B certain = (at_surface | quick) & (slope * slope > fall * lift) & (slope * rest > lift);
    move = select(away, most(move, lim.least_step), move);
    move = select(certain, quick_quotient(most(gap, zero), select(certain, slope, F(1.0f))), move);
    const B unsure = at_surface & !certain;
    t = select(active & !unsure, t + least(move, rest), t);
    crossed = active & certain;
    doubtful = active & unsure;
}

/// n rays through the cell whose list they share, to its end or to their crossing.  at: where each enters, from the
/// cell's centre, and the cell's end, scaled; along: direction and sign; which: their numbers, the
/// last repeated in the lanes beyond n; leave(k, t, way) is told of the k-th.
template <class Packet, class Tracer, class Leave>
GB_FN void pass_cell(const Tracer& tracer, const CellList& list, const Quad* at, const Quad* along, const std::uint32_t* which,
                     int n, const Leave& leave) {
    using F = typename Packet::F;
    using B = typename Packet::B;
    const Four<F> start = Packet::gather(at, which), ahead = Packet::gather(along, which);
    const typename Tracer::Source blocks = tracer.source(list, {0, 0, 0}, {0, 0, 0});
    const CellSource<F, Tracer> source{blocks.blocks, int(list.n), tracer.kernel, start.xyz(), ahead.xyz()};
    const float sharp = Tracer::PerParticle ? blocks.sharpest() * tracer.particles.most_stretch : 1.0f;
    const float heaviest = Tracer::PerParticle ? tracer.tree.header->most_weight : 1.0f;
    const F end = start.w;
    Limits<F> lim{F(tracer.tau), F(kWindow / sharp), F(5e-6f * (heaviest + tracer.tau) * sharp), F(2e-5f / sharp), ahead.w};
    F t(0.0f), rise(0.0f), fall(0.0f), window_end(0.0f);
    B active = Packet::first_lanes(n);
    for (int step = 0; any(active); ++step) {
        Along<F> s;
        const B fresh = active & (t >= window_end);
        if (any(fresh)) {
            lim.window = least(F(kWindow / sharp), most(end - t, F(1e-6f)));
            s = source.template at<true>(t, lim);
            rise = select(fresh, s.rise * F(1.0001f), rise);
            fall = select(fresh, s.fall, fall);
            window_end = select(fresh, t + lim.window, window_end);
        } else {
            s = source.template at<false>(t, lim);
        }
        B crossed, doubtful;
        step_along(s, lim, rise, fall, window_end - t, active, t, crossed, doubtful);
        if (step == 1000) doubtful = active & !crossed;
        const B done = crossed | doubtful | (active & (t >= end));
        if (!any(done)) continue;
        active = active & !done;
        Packet::each(done, [&](int k) {
            leave(k, Packet::get(t, k), Packet::get(crossed, k) ? Way::crossed : Packet::get(doubtful, k) ? Way::doubtful : Way::on);
        });
    }
}

}  // namespace globule
