// First crossing of the threshold on one ray that has no neighbors, cell by cell (trace/cells.hpp), by the safe
// steps of trace/march.hpp.  One thread a ray; its evaluations are shared out by Lanes (exec/).
#pragma once
#include "trace/block_source.hpp"

namespace globule::core {

/// How far a ray has come.
enum class Way { on, crossed, doubtful, missed };

/// A ray on its way, between two evaluations of the field: rays of a warp that are done can be replaced
/// while others go on.
struct CellRay {
    CellWalk walk;
    float3 o;
    float to;                      ///< how far it looks, as the walk counts
    float sign;                    ///< +1 outside, -1 inside, 0 not known yet
    float t;                       ///< in a cell: from where the ray enters it, scaled; at the end: along the ray
    float end;                     ///< of the cell, likewise
    float3 p0;                     ///< where it enters, from the cell's center, scaled
    CellList list;                 ///< n = 0: between cells
    float sharp;                   ///< largest 1 / support in the list
    float rise, fall, window_end;  ///< bounds in force, and how far
    int steps;
};

/// One turn of march() in trace/march.hpp, for a ray that may begin on the surface itself: while it moves
/// away from the threshold it has not met it, however near it is.
GB_FN Way step_along(const Along<float>& s, const Limits<float>& lim, float rise, float fall, float rest, float& t) {
    const float gap = lim.sign * (lim.tau - s.f), slope = lim.sign * s.slope;
    const float safe = max(gap - lim.error, 0.0f);
    const float under = slope * slope + 2.0f * rise * safe;
    if (slope <= 0.0f) {  // away: the bound's second root
        const float move = rise > 0.0f ? max(quick_quotient(quick_root(under) - slope, rise), lim.least_step) : rest;
        t += min(move, rest);
        return Way::on;
    }
    const float move = under >= 0.0f ? quick_quotient(2.0f * safe, slope + quick_root(under)) : rest;
    const bool at_surface = gap <= 2.0f * lim.error || move <= lim.least_step;
    const bool quick = move * move * max(rise, fall) <= 2.0f * lim.least_step * slope;
    const float lift = 2.0f * (max(gap, 0.0f) + 4.0f * lim.error);
    if ((at_surface || quick) && slope * slope > fall * lift && slope * rest > lift) {
        t += min(quick_quotient(max(gap, 0.0f), slope), rest);
        return Way::crossed;
    }
    if (at_surface) return Way::doubtful;
    t += min(move, rest);
    return Way::on;
}

template <class Lanes_, class Kernel_, bool PerParticle_> struct CellTracer {
    using Lanes = Lanes_;
    using Kernel = Kernel_;
    static constexpr bool PerParticle = PerParticle_;
    using Source = BlockSource<Lanes, Kernel, PerParticle>;

    Tree tree;
    SortedParticles particles;
    Kernel kernel;
    float tau;  ///< over the common weight unless PerParticle
    Cells cells;

    GB_FN CellList list_of(const CellWalk& walk, bool& whole_brick) const {
        const std::uint32_t brick = cells.bricks[walk.brick()];
        whole_brick = brick < kListed;
        return whole_brick ? CellList{brick, 0, 0, 0}
                           : cells.lists[std::size_t(brick - kListed) * kBrickCells + walk.cell_in_brick()];
    }
    GB_FN Source source(const CellList& list, const float3& p0, const float3& d) const {
        return {cells.blocks, list.first,
            int(ceil_div<std::uint32_t>(list.n, Lanes::width * Lanes::list_unit)) * Lanes::list_unit, kernel, p0, d};
    }
    /// Where the ray enters the cell, from its center, scaled: here distance from the eye would cost precision.
    GB_FN float3 in_cell(const CellWalk& walk, const float3& o) const {
        const double scale = cells.grid->scale, t = double(walk.base) + double(walk.t);
        const float3 c = walk.center(), d = walk.d;
        return {float((double(o.x) + t * d.x - c.x) * scale), float((double(o.y) + t * d.y - c.y) * scale),
            float((double(o.z) + t * d.z - c.z) * scale)};
    }

    /// A ray that looks for a crossing in [from, to] and begins on a known side, or, with sign 0, anywhere.
    GB_FN void start(CellRay& ray, const float3& o, const float3& d, float from, float to, float sign) const {
        ray.walk = CellWalk(*cells.grid, o, d, from);
        ray.o = o;
        ray.to = to - ray.walk.base;
        ray.sign = sign == 0.0f && !(ray.walk.inside() && ray.walk.distance() <= from) ? 1.0f : sign;
        ray.list.n = 0;
    }

    /// One evaluation further, or some cells.  crossed, doubtful: ray.t has become the distance along the
    /// ray; doubtful: float32 cannot tell from there on.  The rays of a warp go together, those not
    /// `active` too: they lend their hands.
    GB_FN Way advance(CellRay& ray, bool active) const {
        const float typical = tree.header->typical_support;
        Way way = Way::on;
        if (active && ray.list.n == 0) way = walk_on(ray);
        const bool here = active && way == Way::on && ray.list.n > 0;
        Source src{cells.blocks, 0, 0, kernel, {0, 0, 0}, {0, 0, 0}};  // lanes that only help need the kernel too
        Limits<float> lim{};
        if (here) {
            const float heaviest = PerParticle ? tree.header->most_weight : 1.0f,
                        sharp = PerParticle ? ray.sharp : 1.0f;
            src = source(ray.list, ray.p0, ray.walk.d);
            lim = {tau, min(kWindow / sharp, max(ray.end - ray.t, 1e-6f)),
                5e-6f * (heaviest + tau) * sharp * max(1.0f, cells.grid->edge * cells.grid->scale), 2e-5f / sharp,
                ray.sign};
        }
        const bool fresh = ray.t >= ray.window_end;
        const Along<float> s = Lanes::evaluate(src, ray.t, lim, here, fresh);
        if (!here) return way;
        if (fresh) {
            ray.rise = s.rise * 1.0001f;
            ray.fall = s.fall;
            ray.window_end = ray.t + lim.window;
        }
        way = step_along(s, lim, ray.rise, ray.fall, ray.window_end - ray.t, ray.t);
        if (++ray.steps > 1000 && way == Way::on) way = Way::doubtful;
        if (way != Way::on) {
            ray.t = ray.walk.base + (ray.walk.t + ray.t * typical);
            if (way == Way::doubtful) ray.t = max(before(ray.t), ray.walk.base);
        } else if (ray.t >= ray.end) {
            ray.walk.step(1);
            ray.list.n = 0;
        }
        return way;
    }

private:
    /// On to a cell with a list, if there is one a few steps on.
    GB_FN Way walk_on(CellRay& ray) const {
        CellWalk& walk = ray.walk;
        for (int k = 0; k < Lanes::cells_at_once; ++k) {
            if (!walk.inside() || !(walk.t < ray.to)) return Way::missed;
            bool whole_brick;
            const CellList list = list_of(walk, whole_brick);
            ray.t = walk.distance();
            if (list.n) {
                ray.p0 = in_cell(walk, ray.o);
                ray.end = (min(walk.leave(), ray.to) - walk.t) * cells.grid->scale;
                const std::uint32_t on_side = ray.sign > 0.0f ? list.empty : ray.sign < 0.0f ? list.full : 0;
                if (!(octants_on(ray.p0, walk.d, walk.inv, ray.end) & ~on_side)) {
                    walk.step(1);
                    continue;
                }
                ray.list = list;
                ray.t = 0.0f;
                ray.window_end = 0.0f;
                ray.steps = 0;
                const Source src = source(list, ray.p0, walk.d);
                if constexpr (PerParticle) {
                    ray.sharp = src.sharpest() * particles.most_stretch;
                    if (particles.least_axis > 0.0f)
                        ray.sharp = min(ray.sharp, tree.header->typical_support / particles.least_axis);
                }
                if (ray.sign == 0.0f) ray.sign = src.template at<false>(0.0f, {}).f > tau ? -1.0f : 1.0f;
                return Way::on;
            }
            if (list.first == kUnlisted) {
                ray.t = max(before(ray.t), walk.base);
                return Way::doubtful;
            }
            const float side = list.first == kFull ? -1.0f : 1.0f;
            if (ray.sign == 0.0f) ray.sign = side;
            if (ray.sign != side) return Way::crossed;  // rounding at the cell's side
            walk.step(whole_brick ? kBrick : 1);
        }
        return Way::on;
    }
};

}  // namespace globule::core
