// First crossing of the threshold on one ray, cell by cell (trace/cells.hpp), by the safe steps of
// trace/march.hpp.  One thread a ray; on the CPU its SIMD lanes share out a cell's particles.
#pragma once
#include "trace/cells.hpp"
#include "trace/march.hpp"

namespace globule::core {

/// A cell's particles along a ray: p0 + t d, relative to the cell's centre, scaled.
template <class Lanes, class Kernel, bool PerParticle>
struct BlockSource {
    using F = typename Lanes::F;
    static constexpr int kFloats = Lanes::width * block_stride(PerParticle);
    const float* blocks;  ///< of all cells
    std::uint32_t first;  ///< of this one's
    int n_blocks;
    Kernel kernel;
    float3 p0, d;

    /// f and slope at t, and with Bounds the bounds of f'' over the window from there.
    template <bool Bounds>
    GB_FN Along<float> at(float t, const Limits<float>& lim) const {
        Along<F> sum{F(0.0f), F(0.0f), F(0.0f), F(0.0f)};
        add_blocks<Bounds>(sum, 0, 1, point(t), lim);
        return finished<Bounds>({Lanes::sum(sum.f), Lanes::sum(sum.slope), Bounds ? Lanes::sum(sum.rise) : 0.0f,
                                 Bounds ? Lanes::sum(sum.fall) : 0.0f});
    }
    GB_FN float3 point(float t) const { return {p0.x + t * d.x, p0.y + t * d.y, p0.z + t * d.z}; }
    GB_FN const float* block(int j) const { return blocks + std::size_t(first + j) * kFloats; }
    /// Adds every `stride`th block from the `begin`th on, as seen from a point of the ray.
    template <bool Bounds>
    GB_FN void add_blocks(Along<F>& sum, int begin, int stride, const float3& at, const Limits<float>& lim) const {
        const Vec3<F> p{F(at.x), F(at.y), F(at.z)}, along{F(d.x), F(d.y), F(d.z)};
        const Limits<F> wide{F(lim.tau), F(lim.window), F(lim.error), F(lim.least_step), F(lim.sign)};
        const float* from = block(begin);
        for (int j = begin; j < n_blocks; j += stride, from += stride * kFloats) add_block<Bounds>(sum, from, p, along, wide);
    }
    /// As add_blocks of `begin` and of `begin` + 4, every eighth, each in a sum of its own, and then the two.
    template <bool Bounds>
    GB_FN void add_pairs(Along<F>& sum, int begin, const float3& at, const Limits<float>& lim) const {
        const Vec3<F> p{F(at.x), F(at.y), F(at.z)}, along{F(d.x), F(d.y), F(d.z)};
        const Limits<F> wide{F(lim.tau), F(lim.window), F(lim.error), F(lim.least_step), F(lim.sign)};
        Along<F> other{F(0.0f), F(0.0f), F(0.0f), F(0.0f)};
        const float* from = block(begin);
        for (int j = begin; j < n_blocks; j += 8, from += 8 * kFloats) {
            add_block<Bounds>(sum, from, p, along, wide);
            add_block<Bounds>(other, from + 4 * kFloats, p, along, wide);
        }
        sum = {sum.f + other.f, sum.slope + other.slope, sum.rise + other.rise, sum.fall + other.fall};
    }
    template <bool Bounds>
    GB_FN void add_block(Along<F>& sum, const float* from, const Vec3<F>& p, const Vec3<F>& along, const Limits<F>& wide) const {
        Vec3<F> q;
        Lanes::load(from, q.x, q.y, q.z);
        if constexpr (Kernel::stretched)
            add_stretched<Bounds, true>(sum, kernel, matrix(from), p - q, along, Lanes::load(from + 5 * Lanes::width), wide);
        else if constexpr (PerParticle)
            add<true, Bounds, true>(sum, kernel, p - q, along, Lanes::load(from + 4 * Lanes::width),
                              Lanes::load(from + 5 * Lanes::width), wide);
        else
            add<false, Bounds, true>(sum, kernel, p - q, along, F(1.0f), F(1.0f), wide);
    }
    /// Matrices of a block's particles.
    GB_FN Sym3<F> matrix(const float* block) const {
        F m[6];
        for (int k = 0; k < 6; ++k) m[k] = Lanes::map([&](int lane) { return kernel.component(Lanes::slot(block, lane), k); });
        return {m[0], m[1], m[2], m[3], m[4], m[5]};
    }
    template <bool Bounds>
    GB_FN Along<float> finished(Along<float> total) const {
        total.slope *= 2.0f;
        if constexpr (!PerParticle && Bounds) total.fall *= max(8.0f, kernel.max_fall());  // as in ListSource
        return total;
    }
    /// Largest 1 / support.
    GB_FN float sharpest() const {
        if constexpr (!PerParticle) return 1.0f;
        float most_i2 = 0.0f;
        for (int j = 0; j < n_blocks; ++j)
            most_i2 = max(most_i2, Lanes::largest(Lanes::load(block(j) + 4 * Lanes::width)));
        return sqrt(most_i2);
    }
};

/// How far a ray has come.
enum class Way { on, crossed, doubtful, missed };

/// A ray on its way, between two evaluations of the field: rays of a warp that are done can be replaced
/// while others go on.
struct RayState {
    CellWalk walk;
    float3 o;
    float to;                      ///< how far it looks
    float sign;                    ///< +1 outside, -1 inside, 0 not known yet
    float t;                       ///< in a cell: from where the ray enters it, scaled; at the end: along the ray
    float end;                     ///< of the cell, likewise
    float3 p0;                     ///< where it enters, from the cell's centre, scaled
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
        return whole_brick ? CellList{brick, 0, 0, 0} : cells.lists[std::size_t(brick - kListed) * kBrickCells + walk.cell_in_brick()];
    }
    GB_FN Source source(const CellList& list, const float3& p0, const float3& d) const {
        return {cells.blocks, list.first, int(ceil_div<std::uint32_t>(list.n, Lanes::width * Lanes::list_unit)) * Lanes::list_unit, kernel, p0, d};
    }
    /// The ray's point at t, from the cell's centre, scaled: the only place where distance from the eye
    /// would cost precision.
    GB_FN float3 in_cell(const CellWalk& walk, const float3& o, float t) const {
        const double scale = cells.grid->scale;
        const float3 c = walk.centre(), d = walk.d;
        return {float((double(o.x) + double(t) * d.x - c.x) * scale), float((double(o.y) + double(t) * d.y - c.y) * scale),
                float((double(o.z) + double(t) * d.z - c.z) * scale)};
    }

    /// A ray that looks for a crossing in [from, to] and begins on a known side, or, with sign 0, anywhere.
    GB_FN void start(RayState& ray, const float3& o, const float3& d, float from, float to, float sign) const {
        ray.walk = CellWalk(*cells.grid, o, d, from);
        ray.o = o;
        ray.to = to;
        ray.sign = sign == 0.0f && !(ray.walk.inside() && ray.walk.t <= from) ? 1.0f : sign;
        ray.list.n = 0;
    }

    /// One evaluation further, or some cells.  crossed, doubtful: ray.t has become the distance along the
    /// ray; doubtful: float32 cannot tell from there on.  The rays of a warp go together, those not
    /// `active` too: they lend their hands.
    GB_FN Way advance(RayState& ray, bool active) const {
        const float typical = tree.header->typical_support;
        Way way = Way::on;
        if (active && ray.list.n == 0) way = walk_on(ray, typical);
        const bool here = active && way == Way::on && ray.list.n > 0;
        Source src{cells.blocks, 0, 0, kernel, {0, 0, 0}, {0, 0, 0}};  // lanes that only help need the kernel too
        Limits<float> lim{};
        if (here) {
            const float heaviest = PerParticle ? tree.header->most_weight : 1.0f, sharp = PerParticle ? ray.sharp : 1.0f;
            src = source(ray.list, ray.p0, ray.walk.d);
            lim = {tau, min(kWindow / sharp, max(ray.end - ray.t, 1e-6f)), 5e-6f * (heaviest + tau) * sharp, 2e-5f / sharp, ray.sign};
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
            ray.t = ray.walk.t + ray.t * typical;
        } else if (ray.t >= ray.end) {
            ray.walk.step(1);
            ray.list.n = 0;
        }
        return way;
    }

private:
    /// On to a cell with a list, if there is one a few steps on.
    GB_FN Way walk_on(RayState& ray, float typical) const {
        CellWalk& walk = ray.walk;
        for (int k = 0; k < Lanes::cells_at_once; ++k) {
            if (!walk.inside() || !(walk.t < ray.to)) return Way::missed;
            bool whole_brick;
            const CellList list = list_of(walk, whole_brick);
            ray.t = walk.t;
            if (list.n) {
                ray.p0 = in_cell(walk, ray.o, walk.t);
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
                if constexpr (PerParticle) ray.sharp = src.sharpest() * particles.most_stretch;
                if (ray.sign == 0.0f) ray.sign = src.template at<false>(0.0f, {}).f > tau ? -1.0f : 1.0f;
                return Way::on;
            }
            if (list.first == kUnlisted) return Way::doubtful;
            const float side = list.first == kFull ? -1.0f : 1.0f;
            if (ray.sign == 0.0f) ray.sign = side;
            if (ray.sign != side) return Way::crossed;  // rounding at the cell's side
            walk.step(whole_brick ? kBrick : 1);
        }
        return Way::on;
    }
};

}  // namespace globule::core
