// The last word on rays that float32 could not decide: those that graze the surface within 1e-5 of
// the threshold, and those in places where more supports overlap than a list holds.  A whole group
// works on one such ray at a time, its lanes sharing out the candidates, all sums in float64.
#pragma once
#include "trace/camera.hpp"
#include "trace/clip.hpp"
#include "trace/march.hpp"
#include "trace/slab.hpp"

namespace globule::core {

template <class Group, bool PerParticle>
using ResolveScratch = TileScratch<Group, std::conditional_t<PerParticle, BallCandidate, AlikeCandidate>>;

/// The list's particles in float64 and world units, shared out among the lanes.
template <bool PerParticle, class Group> struct SharedListSource {
    Group& g;
    const ResolveScratch<Group, PerParticle>& scratch;
    int n;
    const SortedParticles& particles;
    AnyKernel kernel;
    Vec3<double> o, d;
    GB_FN bool any(bool active) const { return active; }
    template <bool Bounds> GB_FN_APART Along<double> at(double t, const Limits<double>& lim, bool = true) const {
        Along<double> sum{0, 0, 0, 0};
        const Vec3<double> p = o + d * t;
        g.share(n, [&](int j) { add_exact<Bounds>(sum, particles, kernel, scratch.list.number(j), p, d, lim); });
        sum = {g.total(sum.f), 2 * g.total(sum.slope), Bounds ? g.total(sum.rise) : 0, Bounds ? g.total(sum.fall) : 0};
        return sum;
    }
    /// From t on, where the ray is in a support or comes to one; infinity: nowhere.
    GB_FN_APART double next(double t) const {
        double first = infinity();
        g.share(n, [&](int j) {
            const std::uint32_t slot = scratch.list.number(j);
            const double a = particles.support[slot];
            const Vec3<double> v{particles.x[slot] - o.x, particles.y[slot] - o.y, particles.z[slot] - o.z};
            const double middle = dot(v, d) / dot(d, d), margin = 1e-3 * a + 1e-15 * abs(middle);
            const Vec3<double> w = v - d * middle;
            const double half2 = (a + margin) * (a + margin) - dot(w, w);
            if (!(a > 0) || half2 < 0) return;
            const double half = sqrt(half2) + margin;
            if (middle + half >= t) first = min(first, max(t, middle - half));
        });
        return g.least(first);
    }
};

/// Straight from the tree: where even the thinnest slab holds more than a list can.
template <class Group> struct TreeSource {
    Group& g;
    const Tree& tree;
    const SortedParticles& particles;
    AnyKernel kernel;
    Vec3<double> o, d;
    GB_FN bool any(bool active) const { return active; }
    template <bool Bounds> GB_FN_APART Along<double> at(double t, const Limits<double>& lim, bool = true) const {
        Along<double> sum{0, 0, 0, 0};
        const Vec3<double> p = o + d * t, q = p + d * (Bounds ? lim.window : 0.0);
        const float3 lo{float(min(p.x, q.x)), float(min(p.y, q.y)), float(min(p.z, q.z))};
        const float3 hi{float(max(p.x, q.x)), float(max(p.y, q.y)), float(max(p.z, q.z))};
        for_each_leaf(tree, lo, hi, [&](std::uint32_t first, std::uint32_t count) {
            g.share(count, [&](int j) { add_exact<Bounds>(sum, particles, kernel, first + j, p, d, lim); });
        });
        sum = {g.total(sum.f), 2 * g.total(sum.slope), Bounds ? g.total(sum.rise) : 0, Bounds ? g.total(sum.fall) : 0};
        return sum;
    }
    GB_FN double next(double t) const { return t; }
};

/// Tile k is the k-th of out.undecided.  Leaving: rays begin outside, and may begin on the surface (march()).
template <bool PerParticle, bool Leaving = false> struct ResolveRays {
    template <class Group> using Scratch = ResolveScratch<Group, PerParticle>;

    Tree tree;
    SortedParticles particles;
    AnyKernel kernel;
    float tau;
    const float* color;
    float3 one_color;
    RaySource rays;
    Hits out;  ///< normal null: distances alone
    Clips clips{};
    std::int8_t* sign = nullptr;     ///< +1 or -1: the side where each ray is at its t; 0 or null: to be found
    std::int32_t* cap = nullptr;     ///< with clips: where a cut face is met, its clip
    const float* wetness = nullptr;  ///< of the particles, as out.wetness is wanted
    float3 film{};                   ///< its color

    template <class Group> GB_FN void operator()(Group& g, Scratch<Group>& scratch, std::size_t k) const {
        const std::size_t i = out.undecided.ray[k];
        float3 o, d;
        rays.get(i, o, d);
        int n = 0;
        const double t = solve_kept(g, scratch, o, d, i, n);
        g.sync();
        if (!out.normal) {
            if (g.is_first()) out.t[i] = float(t);
            return;
        }
        const Vec3<double> p{o.x + t * d.x, o.y + t * d.y, o.z + t * d.z};
        const bool hit = t < infinity();
        Vec3<double> gradient{0, 0, 0};
        BlendedColor<double> blended;
        double wet = 0;
        const auto add = [&](std::uint32_t slot) {
            if_reaching(particles, slot, p, [&](const Vec3<double>& v, const SortedShape<double>& shape) {
                const Influence<double> of = influence(kernel, shape, v, double(particles.weight[slot]));
                gradient = gradient + of.half_gradient;
                const double w = max(of.value, 0.0);
                blended.add(color, particles.index[slot], w);
                if (wetness) wet += w * wetness[particles.index[slot]];
            });
        };
        if (hit && n > 0) g.share(n, [&](int j) { add(scratch.list.number(j)); });
        else if (hit)
            for_each_leaf(tree, to_float(p), to_float(p),
                [&](std::uint32_t first, std::uint32_t count) { g.share(count, [&](int j) { add(first + j); }); });
        gradient = total(g, gradient);
        blended = {total(g, blended.sum), g.total(blended.total)};
        if (wetness) wet = g.total(wet) * blended.scale();
        if (!g.is_first()) return;  // one lane writes
        out.t[i] = float(t);
        if (!hit) {
            write3(out.normal, i, {0, 0, 0});
            write3(out.albedo, i, {0, 0, 0});
            return;
        }
        write3(out.normal, i, to_float(normalize(gradient) * -1.0));
        float3 seen = color ? to_float(blended.mean()) : one_color;
        if (wetness) out.wetness[i] = under_film(float(wet), film, seen);
        write3(out.albedo, i, seen);
    }

    template <class Group> GB_FN static Vec3<double> total(const Group& g, const Vec3<double>& v) {
        return {g.total(v.x), g.total(v.y), g.total(v.z)};
    }

    /// First root or cut face of ray i, from where it is undecided, through what the clips keep.
    template <class Group>
    GB_FN double solve_kept(
        Group& g, Scratch<Group>& scratch, const float3& o, const float3& d, std::size_t i, int& n) const {
        double side = Leaving ? 1.0 : sign ? double(sign[i]) : 0.0;
        float from = out.t[i], begin, end;
        int at_begin, at_end;
        g.sync();  // all have read t
        const TreeSource<Group> straight{g, tree, particles, kernel, {o.x, o.y, o.z}, {d.x, d.y, d.z}};
        if (!Leaving && sign && side == 0.0) {
            side = straight.template at<false>(from, {}).f > tau ? -1.0 : 1.0;
            if (g.is_first()) sign[i] = std::int8_t(side);
        }
        if (clips.n == 0) return solve(g, scratch, o, d, from, infinity(), side, n);
        for (bool first = true; clips.next(o, d, from, begin, end, at_begin, at_end); first = false) {
            if (!first && begin > from) {
                if (straight.template at<false>(begin, {}).f > tau) {
                    if (g.is_first()) cap[i] = at_begin;
                    return begin;
                }
                side = 1.0;
            }
            const double t = solve(g, scratch, o, d, begin, end, side, n);
            if (t < end) return t;
            n = 0;
            if (side < 0.0 && end < infinity()) {
                if (g.is_first()) cap[i] = at_end;
                return end;
            }
            from = end;
            if (!(from < infinity())) break;
        }
        return infinity();
    }

    /// First root in [from, to), or infinity; side: +1 outside there, -1 inside, 0 to be found; n: candidates in the
    /// list that found it, 0 if none did.
    template <class Group>
    GB_FN_APART double solve(Group& g, Scratch<Group>& scratch, const float3& o, const float3& d, double from,
        double to, double side, int& n) const {
        const float typical = tree.header->typical_support;
        const Node box = tree.node(0);
        // From where the ray comes near the octree: far from its origin, float32 would make slabs deeper than supports
        // and bundles wider.
        const double base = before(box, o, d);
        const Vec3<double> d2{d.x, d.y, d.z}, o2 = Vec3<double>{o.x, o.y, o.z} + d2 * base;
        from = max(from - base, 0.0);
        to -= base;
        const TreeSource<Group> straight{g, tree, particles, kernel, o2, d2};
        const double size = double(tau) + tree.header->most_weight;
        Limits<double> lim{tau, kWindow * typical, 1e-13 * size, 1e-12 * typical, 1.0};
        if (side != 0.0) lim.sign = side;
        else if (morton::is_inside(o, box.lo, box.hi) && straight.template at<false>(0.0, lim).f > tau) lim.sign = -1.0;
        const Bundle ray = bundle_around(to_float(o2), d, 0.0f, 0.0f);
        Slab slab(float(from), typical, 1.0f);
        while (slab.z < to) {
            const Gathered found = gather_slab(g, scratch, tree, particles, ray, slab, [] { return false; });
            if (found.n == 0) {
                slab.skip_to(found.next);
                continue;
            }
            const float smallest = typical / found.sharpest;
            lim.window = kWindow * smallest;
            lim.least_step = 1e-12 * smallest;
            double t = max(from, double(slab.z));
            bool hit;
            if (found.n > 0)
                hit = search(SharedListSource<PerParticle, Group>{g, scratch, found.n, particles, kernel, o2, d2}, lim,
                    t, slab.end());
            else hit = search(straight, lim, t, slab.end());
            n = max(found.n, 0);
            if (hit) return t < to ? base + t : infinity();
            slab.step(smallest, true);
        }
        return infinity();
    }

    /// A distance at which the ray has not yet come to the box; 0 near it.
    GB_FN static double before(const Node& box, const float3& o, const float3& d) {
        const Vec3<double> lo{box.lo.x, box.lo.y, box.lo.z}, size = Vec3<double>{box.hi.x, box.hi.y, box.hi.z} - lo;
        const Vec3<double> to = lo + size * 0.5 - Vec3<double>{o.x, o.y, o.z}, along{d.x, d.y, d.z};
        return max(dot(to, along) / dot(along, along) - (size.x + size.y + size.z), 0.0);
    }

    /// A root between t and end; a place where f comes within rounding of the threshold counts as one.
    template <class Source>
    GB_FN_APART bool search(const Source& source, const Limits<double>& lim, double& t, double end) const {
        // A slab far away is deep, or float32 could not tell its ends apart: march() takes its steps in rounds, and
        // none where nothing is.
        for (int round = 0; round < 100; ++round) {
            t = source.next(t);
            if (!(t < end)) return false;
            const double from = t;
            bool hit = false, unsure = false;
            march<Leaving>(source, lim, end, true, t, hit, unsure);
            if (hit || !unsure) return hit;
            if (abs(source.template at<false>(t, lim).f - lim.tau) < 1e4 * lim.error) return true;
            if (t == from) return false;  // and would not move in the next round
        }
        return false;
    }
};

}  // namespace globule::core
