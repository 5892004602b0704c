// First crossing of the threshold on one ray, cell by cell (trace/cells.hpp), by the safe steps of
// trace/march.hpp.  One thread a ray; on the CPU its SIMD lanes share out a cell's particles.
#pragma once
#include "globule/trace/cells.hpp"
#include "globule/trace/march.hpp"

namespace globule {

/// A cell's particles along a ray: p0 + t d, relative to the cell's centre, scaled.
template <class Lanes, class Kernel, bool PerParticle>
struct BlockSource {
    using F = typename Lanes::F;
    static constexpr int kFloats = Lanes::width * block_stride(PerParticle);
    const float* blocks;
    int n_blocks;
    Kernel kernel;
    float3 p0, d;

    template <bool Bounds>
    GB_FN Along<float> at(float t, const Limits<float>& lim) const {
        const Vec3<F> p{F(p0.x + t * d.x), F(p0.y + t * d.y), F(p0.z + t * d.z)}, along{F(d.x), F(d.y), F(d.z)};
        const Limits<F> wide{F(lim.tau), F(lim.window), F(lim.error), F(lim.least_step), F(lim.sign)};
        Along<F> sum{F(0.0f), F(0.0f), F(0.0f), F(0.0f)};
        for (int j = 0; j < n_blocks; ++j) {
            const float* block = blocks + j * kFloats;
            Vec3<F> q;
            Lanes::load(block, q.x, q.y, q.z);
            if constexpr (PerParticle)
                add<true, Bounds>(sum, kernel, p - q, along, Lanes::load(block + 4 * Lanes::width),
                                  Lanes::load(block + 5 * Lanes::width), wide);
            else
                add<false, Bounds>(sum, kernel, p - q, along, F(1.0f), F(1.0f), wide);
        }
        Along<float> total{Lanes::sum(sum.f), 2.0f * Lanes::sum(sum.slope), 0.0f, 0.0f};
        if constexpr (Bounds) {
            total.rise = Lanes::sum(sum.rise);
            total.fall = Lanes::sum(sum.fall);
            if constexpr (!PerParticle) total.fall *= most(8.0f, kernel.max_fall());  // as in ListSource
        }
        return total;
    }
    /// Largest 1 / support.
    GB_FN float sharpest() const {
        if constexpr (!PerParticle) return 1.0f;
        float most_i2 = 0.0f;
        for (int j = 0; j < n_blocks; ++j)
            most_i2 = most(most_i2, Lanes::largest(Lanes::load(blocks + j * kFloats + 4 * Lanes::width)));
        return root(most_i2);
    }
};

enum class Crossed { no, yes, doubtful };

/// As march() of trace/march.hpp for one ray, which may begin on the surface itself: while it moves
/// away from the threshold it has not met it, however near it is.
template <class Source>
GB_FN Crossed march_cell(const Source& source, const Limits<float>& lim, float end, float& t) {
    float rise = 0.0f, fall = 0.0f, window_end = t;
    for (int step = 0; t < end; ++step) {
        Along<float> s;
        if (t >= window_end) {
            s = source.template at<true>(t, lim);
            rise = s.rise * 1.0001f;
            fall = s.fall;
            window_end = t + lim.window;
        } else {
            s = source.template at<false>(t, lim);
        }
        const float gap = lim.sign * (lim.tau - s.f), slope = lim.sign * s.slope;
        const float safe = most(gap - lim.error, 0.0f), rest = window_end - t;
        const float under = slope * slope + 2.0f * rise * safe;
        if (slope <= 0.0f) {  // away: the bound's second root
            const float move = rise > 0.0f ? most(quick_quotient(quick_root(under) - slope, rise), lim.least_step) : rest;
            t = move < rest ? t + move : window_end;
            continue;
        }
        const float move = under >= 0.0f ? quick_quotient(2.0f * safe, slope + quick_root(under)) : rest;
        const bool at_surface = gap <= 2.0f * lim.error || move <= lim.least_step;
        const bool quick = move * move * most(rise, fall) <= 2.0f * lim.least_step * slope;
        const float lift = 2.0f * (most(gap, 0.0f) + 4.0f * lim.error);
        if ((at_surface || quick) && slope * slope > fall * lift && slope * rest > lift) {
            t += least(quick_quotient(most(gap, 0.0f), slope), rest);
            return Crossed::yes;
        }
        if (at_surface || step == 1000) return Crossed::doubtful;
        t = move < rest ? t + move : window_end;
    }
    return Crossed::no;
}

template <class Lanes_, class Tree, class Kernel_, bool PerParticle_>
struct CellTracer {
    using Lanes = Lanes_;
    using Kernel = Kernel_;
    static constexpr bool PerParticle = PerParticle_;
    using Source = BlockSource<Lanes, Kernel, PerParticle>;

    Tree tree;
    SortedParticles particles;
    Kernel kernel;
    float tau;       ///< over the common weight unless PerParticle
    Cells cells;

    GB_FN CellList list_of(const CellWalk& walk, bool& whole_brick) const {
        const std::uint32_t brick = cells.bricks[walk.brick()];
        whole_brick = brick < kListed;
        return whole_brick ? CellList{brick, 0} : cells.lists[std::size_t(brick - kListed) * kBrickCells + walk.cell_in_brick()];
    }
    GB_FN Source source(const CellWalk& walk, const CellList& list, float t, const float3& o, const float3& d) const {
        const float scale = 1.0f / tree.header->typical_support;
        const float3 c = walk.centre();
        // The only place where distance from the eye would cost precision.
        return {cells.blocks + std::size_t(list.first) * Source::kFloats, int(ceil_div<std::uint32_t>(list.n, Lanes::width)), kernel,
                {float((double(o.x) + double(t) * d.x - c.x) * scale), float((double(o.y) + double(t) * d.y - c.y) * scale),
                 float((double(o.z) + double(t) * d.z - c.z) * scale)}, d};
    }

    /// First crossing in [from, to]; infinity where there is none; undecided(t) where float32 cannot
    /// tell from t on.  sign: +1 the ray begins outside, -1 inside, 0 not known; afterwards as at the end.
    GB_FN float operator()(const float3& o, const float3& d, float from, float to, float& sign) const {
        CellWalk walk(*cells.grid, o, d, from);
        if (sign == 0.0f && !(walk.inside() && walk.t <= from)) sign = 1.0f;
        const float typical = tree.header->typical_support;
        for (;;) {
            // All rays of a warp come to their next list before any of them looks into it.
            CellList list;
            for (;;) {
                if (!walk.inside() || !(walk.t < to)) return infinity();
                bool whole_brick;
                list = list_of(walk, whole_brick);
                if (list.n) break;
                if (list.first == kUnlisted) return undecided(walk.t);
                const float here = list.first == kFull ? -1.0f : 1.0f;
                if (sign == 0.0f) sign = here;
                if (sign != here) return walk.t;  // rounding at the cell's side
                walk.step(whole_brick ? kBrick : 1);
            }
            const float end = least(walk.leave(1), to);
            const Source src = source(walk, list, walk.t, o, d);
            const float sharp = src.sharpest(), length = (end - walk.t) / typical;
            const float heaviest = PerParticle ? tree.header->most_weight : 1.0f;
            Limits<float> lim{tau, least(kWindow / sharp, most(length, 1e-6f)), 5e-6f * (heaviest + tau) * sharp, 2e-5f / sharp, sign};
            if (sign == 0.0f) sign = lim.sign = src.template at<false>(0.0f, lim).f > tau ? -1.0f : 1.0f;
            float t = 0.0f;
            const Crossed crossed = march_cell(src, lim, length, t);
            if (crossed == Crossed::yes) return walk.t + t * typical;
            if (crossed == Crossed::doubtful) return undecided(walk.t + t * typical);
            walk.step(1);
        }
        return infinity();
    }
};

}  // namespace globule
