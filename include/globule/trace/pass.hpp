// Rays through cells, a team of lanes each: how the CPU finds crossings.  Rays that went different ways
// stand in different cells, so every team reads a list of its own.
#pragma once
#include "globule/trace/first_hit.hpp"

namespace globule {

/// Where a ray stands in a cell with a list, as in RayState.
struct CellStop {
    float3 p0;
    float end;
    float3 d;
    float sign;
    CellList list;
    float sharp;
};

/// Particles of a team's cell along its ray: p0 + t d, as in BlockSource.
template <class Teams, class Tracer>
struct TeamSource {
    using F = typename Teams::F;
    using Lanes = typename Tracer::Lanes;
    using Kernel = typename Tracer::Kernel;
    static_assert(Lanes::width == Teams::size);
    const float* blocks[Teams::n];
    int n_blocks[Teams::n];
    Kernel kernel;
    Vec3<F> p0, d;

    /// f, slope and the bounds of f'' over the window from t.
    GB_FN Along<F> at(F t, const Limits<F>& lim) const {
        constexpr int W = Lanes::width;
        alignas(16) static constexpr float nobody[8 * W] = {64, 64, 64, 64, 64, 64, 64, 64, 64, 64, 64, 64, 0, 0, 0, 0, 1, 1, 1, 1};
        const Vec3<F> p = p0 + d * t;
        Along<F> sum{F(0.0f), F(0.0f), F(0.0f), F(0.0f)};
        int longest = 0;
        for (int k = 0; k < Teams::n; ++k) longest = most(longest, n_blocks[k]);
        for (int j = 0; j < longest; ++j) {
            const float* block[Teams::n];
            for (int k = 0; k < Teams::n; ++k) block[k] = j < n_blocks[k] ? blocks[k] + j * Tracer::Source::kFloats : nobody;
            const Vec3<F> v{p.x - Teams::load(block, 0), p.y - Teams::load(block, W), p.z - Teams::load(block, 2 * W)};
            if constexpr (Kernel::stretched) {
                F m[6];
                for (int c = 0; c < 6; ++c) m[c] = Teams::map([&](int lane) { return kernel.component(Lanes::slot(block[lane / W], lane % W), c); });
                add_stretched<true, true>(sum, kernel, Sym3<F>{m[0], m[1], m[2], m[3], m[4], m[5]}, v, d, Teams::load(block, 5 * W), lim);
            } else if constexpr (Tracer::PerParticle) {
                add<true, true, true>(sum, kernel, v, d, Teams::load(block, 4 * W), Teams::load(block, 5 * W), lim);
            } else {
                add<false, true, true>(sum, kernel, v, d, F(1.0f), F(1.0f), lim);
            }
        }
        sum = {Teams::sum(sum.f), F(2.0f) * Teams::sum(sum.slope), Teams::sum(sum.rise) * F(1.0001f), Teams::sum(sum.fall)};
        if constexpr (!Tracer::PerParticle) sum.fall *= F(most(8.0f, kernel.max_fall()));  // as in ListSource
        return sum;
    }
};

/// step_along of trace/first_hit.hpp in lanes, the bounds those of s.
template <class F, class B>
GB_FN void step_along(const Along<F>& s, const Limits<F>& lim, F& t, B& crossed, B& doubtful) {
    const F gap = lim.sign * (lim.tau - s.f), slope = lim.sign * s.slope, rest = lim.window;
    const F safe = most(gap - lim.error, F(0.0f)), zero(0.0f);
    const F under = slope * slope + F(2.0f) * s.rise * safe;
    const F bend = quick_root(most(under, zero));
    const B away = slope <= zero;  // the bound's second root
    const B bounded = (away & (s.rise > zero)) | (!away & (under >= zero));
    const F bottom = select(away, s.rise, slope + bend), top = select(away, bend - slope, F(2.0f) * safe);
    F move = select(bounded, quick_quotient(top, select(bounded, bottom, F(1.0f))), rest);
    const B at_surface = !away & ((gap <= F(2.0f) * lim.error) | (move <= lim.least_step));
    const B quick = !away & (move * move * most(s.rise, s.fall) <= F(2.0f) * lim.least_step * slope);
    const F lift = F(2.0f) * (most(gap, zero) + F(4.0f) * lim.error);
    crossed = (at_surface | quick) & (slope * slope > s.fall * lift) & (slope * rest > lift);
    doubtful = at_surface & !crossed;
    move = select(away, most(move, lim.least_step), move);
    move = select(crossed, quick_quotient(most(gap, zero), select(crossed, slope, F(1.0f))), move);
    t = select(doubtful, t, t + least(move, rest));
}

/// Rays through the cells where they stand; leave(k, t, way) is told of each at the cell's end or at its crossing.
template <class Teams, class Tracer, class Leave>
GB_FN void pass_cells(const Tracer& tracer, const CellStop* stops, int n, const Leave& leave) {
    using F = typename Teams::F;
    using B = typename Teams::B;
    TeamSource<Teams, Tracer> source;
    source.kernel = tracer.kernel;
    source.p0 = source.d = {F(0.0f), F(0.0f), F(0.0f)};
    F t(0.0f), end(0.0f), sharp(1.0f);
    Limits<F> lim{F(tracer.tau), F(0.0f), F(0.0f), F(0.0f), F(1.0f)};
    const float heaviest = Tracer::PerParticle ? tracer.tree.header->most_weight : 1.0f;
    int who[Teams::n], steps[Teams::n], n_busy = 0, next = 0;
    for (int k = 0; k < Teams::n; ++k) {
        who[k] = -1;
        source.n_blocks[k] = 0;
    }
    for (;;) {
        for (int k = 0; k < Teams::n; ++k) {
            if (who[k] >= 0 || next == n) continue;
            const CellStop& s = stops[next];
            const B mine = Teams::lanes_of(k);
            const auto put = [&](F& v, float x) { v = select(mine, F(x), v); };
            put(source.p0.x, s.p0.x);
            put(source.p0.y, s.p0.y);
            put(source.p0.z, s.p0.z);
            put(source.d.x, s.d.x);
            put(source.d.y, s.d.y);
            put(source.d.z, s.d.z);
            put(t, 0.0f);
            put(end, s.end);
            put(lim.sign, s.sign);
            if constexpr (Tracer::PerParticle) put(sharp, s.sharp);
            source.blocks[k] = tracer.cells.blocks + std::size_t(s.list.first) * Tracer::Source::kFloats;
            source.n_blocks[k] = int(ceil_div<std::uint32_t>(s.list.n, Teams::size));
            who[k] = next++;
            steps[k] = 0;
            ++n_busy;
        }
        if (n_busy == 0) return;
        lim.window = least(F(kWindow) / sharp, most(end - t, F(1e-6f)));
        lim.error = F(5e-6f * (heaviest + tracer.tau)) * sharp;
        lim.least_step = F(2e-5f) / sharp;
        B crossed, doubtful;
        step_along(source.at(t, lim), lim, t, crossed, doubtful);
        const unsigned done = bits(crossed | doubtful | (t >= end));
        for (int k = 0; k < Teams::n; ++k) {
            if (who[k] < 0) continue;
            const bool stuck = ++steps[k] > 1000;
            if (!(done >> Teams::size * k & 1) && !stuck) continue;
            const Way way = Teams::bits_of(crossed, k) ? Way::crossed : stuck || Teams::bits_of(doubtful, k) ? Way::doubtful : Way::on;
            leave(who[k], Teams::get(t, k), way);
            who[k] = -1;
            source.n_blocks[k] = 0;
            --n_busy;
        }
    }
}

/// What a CPU needs of a walk (exec/cpu_walk.hpp): the ray to a cell with a list, and rays through such cells.
template <class Walk>
struct Passes {
    using Place = CellStop;
    template <class Teams, class State>
    GB_FN bool to_place(State& s, CellStop& stop) const {
        const Walk& walk = *static_cast<const Walk*>(this);
        const auto& tracer = walk.cut.tracer;
        constexpr int kFloats = std::decay_t<decltype(tracer)>::Source::kFloats;
        RayState& ray = s.of.ray;
        while (walk.settle(s)) {
            s.way = walk.cut.follow(s.of, tracer.walk_on(ray, tracer.tree.header->typical_support));
            if (s.way == Way::on && ray.list.n) {
                stop = {ray.p0, ray.end, ray.walk.d, ray.sign, ray.list, ray.sharp};
                const float* block = tracer.cells.blocks + std::size_t(ray.list.first) * kFloats;
                for (std::uint32_t k = 0; k < ray.list.n; k += Teams::size) Teams::prefetch(block + k / Teams::size * kFloats);
                return true;
            }
        }
        return false;
    }
    template <class Teams, class State>
    GB_FN void pass(State* states, const std::uint32_t* which, const CellStop* stops, int n) const {
        const Walk& walk = *static_cast<const Walk*>(this);
        const auto& tracer = walk.cut.tracer;
        const float typical = tracer.tree.header->typical_support;
        pass_cells<Teams>(tracer, stops, n, [&](int k, float t, Way way) {
            State& s = states[which[k]];
            RayState& ray = s.of.ray;
            if (way == Way::on) return;
            ray.t = ray.walk.t + t * typical;
            s.way = walk.cut.follow(s.of, way);
        });
    }
};

}  // namespace globule
