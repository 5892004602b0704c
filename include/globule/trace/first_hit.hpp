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

    /// f and slope at t, and with Bounds the bounds of f'' over the window from there.
    template <bool Bounds>
    GB_FN Along<float> at(float t, const Limits<float>& lim) const {
        Along<F> sum{F(0.0f), F(0.0f), F(0.0f), F(0.0f)};
        add_blocks<Bounds>(sum, 0, 1, t, lim);
        return finished<Bounds>({Lanes::sum(sum.f), Lanes::sum(sum.slope), Bounds ? Lanes::sum(sum.rise) : 0.0f,
                                 Bounds ? Lanes::sum(sum.fall) : 0.0f});
    }
    /// Adds every `stride`th block from `first` on.
    template <bool Bounds>
    GB_FN void add_blocks(Along<F>& sum, int first, int stride, float t, const Limits<float>& lim) const {
        const Vec3<F> p{F(p0.x + t * d.x), F(p0.y + t * d.y), F(p0.z + t * d.z)}, along{F(d.x), F(d.y), F(d.z)};
        const Limits<F> wide{F(lim.tau), F(lim.window), F(lim.error), F(lim.least_step), F(lim.sign)};
        for (int j = first; j < n_blocks; j += stride) {
            const float* block = blocks + j * kFloats;
            Vec3<F> q;
            Lanes::load(block, q.x, q.y, q.z);
            if constexpr (PerParticle)
                add<true, Bounds>(sum, kernel, p - q, along, Lanes::load(block + 4 * Lanes::width),
                                  Lanes::load(block + 5 * Lanes::width), wide);
            else
                add<false, Bounds>(sum, kernel, p - q, along, F(1.0f), F(1.0f), wide);
        }
    }
    template <bool Bounds>
    GB_FN Along<float> finished(Along<float> total) const {
        total.slope *= 2.0f;
        if constexpr (!PerParticle && Bounds) total.fall *= most(8.0f, kernel.max_fall());  // as in ListSource
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

/// How far a ray has come.
enum class Way { on, crossed, doubtful };

/// One turn of march() in trace/march.hpp, for a ray that may begin on the surface itself: while it moves
/// away from the threshold it has not met it, however near it is.
GB_FN Way step_along(const Along<float>& s, const Limits<float>& lim, float rise, float fall, float rest, float& t) {
    const float gap = lim.sign * (lim.tau - s.f), slope = lim.sign * s.slope;
    const float safe = most(gap - lim.error, 0.0f);
    const float under = slope * slope + 2.0f * rise * safe;
    if (slope <= 0.0f) {  // away: the bound's second root
        const float move = rise > 0.0f ? most(quick_quotient(quick_root(under) - slope, rise), lim.least_step) : rest;
        t += least(move, rest);
        return Way::on;
    }
    const float move = under >= 0.0f ? quick_quotient(2.0f * safe, slope + quick_root(under)) : rest;
    const bool at_surface = gap <= 2.0f * lim.error || move <= lim.least_step;
    const bool quick = move * move * most(rise, fall) <= 2.0f * lim.least_step * slope;
    const float lift = 2.0f * (most(gap, 0.0f) + 4.0f * lim.error);
    if ((at_surface || quick) && slope * slope > fall * lift && slope * rest > lift) {
        t += least(quick_quotient(most(gap, 0.0f), slope), rest);
        return Way::crossed;
    }
    if (at_surface) return Way::doubtful;
    t += least(move, rest);
    return Way::on;
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
    /// A cell's particles along the ray from t on.
    GB_FN Source source(const CellWalk& walk, const CellList& list, float t, const float3& o, const float3& d) const {
        const double scale = 1.0f / tree.header->typical_support;
        const float3 c = walk.centre();
        // The only place where distance from the eye would cost precision.
        return {cells.blocks + std::size_t(list.first) * Source::kFloats, int(ceil_div<std::uint32_t>(list.n, Lanes::width)), kernel,
                {float((double(o.x) + double(t) * d.x - c.x) * scale), float((double(o.y) + double(t) * d.y - c.y) * scale),
                 float((double(o.z) + double(t) * d.z - c.z) * scale)}, d};
    }

    /// First crossing in [from, to]; infinity where there is none; undecided(t) where float32 cannot
    /// tell from t on.  sign: +1 the ray begins outside, -1 inside, 0 not known; afterwards as at the end.
    /// The rays of a warp go together, those not `active` too: they lend their hands.
    GB_FN float operator()(const float3& o, const float3& d, float from, float to, float& sign, bool active) const {
        const float typical = tree.header->typical_support;
        CellWalk walk{};
        if (active) walk = CellWalk(*cells.grid, o, d, from);
        if (active && sign == 0.0f && !(walk.inside() && walk.t <= from)) sign = 1.0f;
        float found = infinity();
        while (Lanes::any(active)) {
            Source src{};
            float t = 0.0f, end = -1.0f, sharp = 1.0f;
            Limits<float> lim{};
            if (active) {
                CellList list;
                active = next_list(walk, to, sign, list, found);
                if (active) {
                    src = source(walk, list, walk.t, o, d);
                    sharp = src.sharpest();
                    end = (least(walk.leave(), to) - walk.t) / typical;
                    const float heaviest = PerParticle ? tree.header->most_weight : 1.0f;
                    lim = {tau, least(kWindow / sharp, most(end, 1e-6f)), 5e-6f * (heaviest + tau) * sharp, 2e-5f / sharp, sign};
                    if (sign == 0.0f) sign = lim.sign = src.template at<false>(0.0f, lim).f > tau ? -1.0f : 1.0f;
                }
            }
            float rise = 0.0f, fall = 0.0f, window_end = 0.0f;
            for (int step = 0; Lanes::any(t < end); ++step) {
                const bool here = t < end, fresh = t >= window_end;
                const Along<float> s = Lanes::evaluate(src, t, lim, here, fresh);
                if (!here) continue;
                if (fresh) {
                    rise = s.rise * 1.0001f;
                    fall = s.fall;
                    window_end = t + lim.window;
                }
                Way way = step_along(s, lim, rise, fall, window_end - t, t);
                if (step == 1000 && way == Way::on) way = Way::doubtful;
                if (way == Way::on) continue;
                found = walk.t + t * typical;
                if (way == Way::doubtful) found = undecided(found);
                active = false;
                end = -1.0f;
            }
            if (active) walk.step(1);
        }
        return found;
    }

private:
    /// Moves on to a cell with a list; false: the ray ends before, at `found`.
    GB_FN bool next_list(CellWalk& walk, float to, float& sign, CellList& list, float& found) const {
        while (walk.inside() && walk.t < to) {
            bool whole_brick;
            list = list_of(walk, whole_brick);
            if (list.n) return true;
            if (list.first == kUnlisted) {
                found = undecided(walk.t);
                return false;
            }
            const float here = list.first == kFull ? -1.0f : 1.0f;
            if (sign == 0.0f) sign = here;
            if (sign != here) {  // rounding at the cell's side
                found = walk.t;
                return false;
            }
            walk.step(whole_brick ? kBrick : 1);
        }
        return false;
    }
};

}  // namespace globule
