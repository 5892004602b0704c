// Where a ray crosses the surface, in float64: Newton's steps from a crossing that float32 found.  Float64 sums are
// almost always the same when they are rounded to float32, whatever their order, so that what light goes on from
// depends on the ray and the particles, and not on the tile, the cells or the piece that found the hit
// (docs/design/pieces.md).
#pragma once
#include <type_traits>

#include "octree/query.hpp"
#include "trace/cell_tracer.hpp"

namespace globule::core {

/// The field around a point of a ray, in world units: from the particles of the point's cell or, where that has no
/// list, the octree.
template <class Tracer> struct ExactField {
    using Lanes = typename Tracer::Lanes;
    using D = typename Lanes::D;
    using Slots = typename Lanes::Slots;
    using Kernel = typename Tracer::Kernel;
    const Tracer& tracer;
    CellList list{kEmpty, 0, 0, 0};

    GB_FN ExactField(const Tracer& of, const float3& o, const float3& d, float t) : tracer(of) {
        const CellWalk walk(*tracer.cells.grid, o, d, t);
        bool whole_brick;
        if (walk.inside()) list = tracer.list_of(walk, whole_brick);
    }

    /// Value and half the gradient; each(particle, value) for those that add to the field.
    template <class Each> GB_FN_APART Influence<double> at(const Vec3<double>& p, const Each& each) const {
        const std::uint32_t* index = tracer.particles.index;
        if (list.n == 0) {
            Influence<double> sum{0.0, {0.0, 0.0, 0.0}};
            for_each_reaching(tracer.tree, tracer.particles, p,
                [&](std::uint32_t j, const Vec3<double>& v, const SortedShape<double>& shape) {
                    const double weight = Tracer::PerParticle ? double(tracer.particles.weight[j]) : 1.0;
                    const Influence<double> own = influence(tracer.kernel, shape, v, weight);
                    sum = {sum.value + own.value, sum.half_gradient + own.half_gradient};
                    if (own.value > 0.0) each(index[j], own.value);
                });
            return sum;
        }
        D f(0.0);
        Vec3<D> half{f, f, f};
        for_each_part(p, [&](const Slots& slots, const Influence<D>& own) {
            f += own.value;
            half = half + own.half_gradient;
            if constexpr (!std::is_same_v<Each, Nobody>)
                Lanes::where_positive(
                    slots, own.value, [&](std::uint32_t slot, double value) { each(index[slot], value); });
        });
        return {Lanes::sum(f), {Lanes::sum(half.x), Lanes::sum(half.y), Lanes::sum(half.z)}};
    }
    struct Nobody {
        GB_FN void operator()(std::uint32_t, double) const {}
    };

private:
    template <class Fn> GB_FN void for_each_part(const Vec3<double>& p, const Fn& fn) const {
        constexpr int W = Lanes::width, stride = W * block_stride(Tracer::PerParticle, Kernel::stretched);
        const SortedParticles& all = tracer.particles;
        const float* block = tracer.cells.blocks + std::size_t(list.first) * stride;
        for (int n = int(list.n); n > 0; n -= W, block += stride) {
            for (int first = 0; first < min(n, W); first += Lanes::part) {
                const Slots slots = Lanes::slots(block, first, min(n - first, int(Lanes::part)));
                const Vec3<D> v{D(p.x) - Lanes::gather(all.x, slots), D(p.y) - Lanes::gather(all.y, slots),
                    D(p.z) - Lanes::gather(all.z, slots)};
                const D weight = Lanes::counted(slots, Tracer::PerParticle ? own(all.weight, slots) : D(1.0));
                if constexpr (Kernel::stretched) {
                    D m[6];
                    for (int k = 0; k < 6; ++k) m[k] = Lanes::gather(all.stretch, slots, 6, k);
                    fn(slots, influence(tracer.kernel, Ellipsoid<D>{{m[0], m[1], m[2], m[3], m[4], m[5]}}, v, weight));
                } else {
                    const D support = own(all.support, slots);
                    fn(slots, influence(tracer.kernel, Ball<D>{D(1.0) / (support * support)}, v, weight));
                }
            }
        }
    }
    GB_FN static D own(const Attribute& a, const Slots& slots) {
        return a.data ? Lanes::gather(a.data, slots) : D(double(a.uniform));
    }
};

/// Moves t from a crossing to the root of the field nearby; at(point) gives value and half the gradient.  Returns the
/// latter.
template <class At>
GB_FN Vec3<double> settle(
    const At& at, double tau, double typical, const Vec3<double>& o, const Vec3<double>& d, double& t) {
    // Float32 is off by 1e-7 supports, where a ray grazes the surface by up to 1e-4, and two roundings of t: farther
    // away, the root is another one.
    const double found = t, most = 1e-3 * typical + 2.4e-7 * t;
    for (int step = 0; step < 5; ++step) {
        const Influence<double> here = at(o + d * t, step > 0);
        const double move = (tau - here.value) / (2.0 * dot(here.half_gradient, d));
        if (step > 0 && abs(move) <= 1e-11 * typical) return here.half_gradient;
        if (!(abs(t + move - found) <= most)) break;
        t += move;
    }
    t = found;  // a tangent
    return at(o + d * t, true).half_gradient;
}

}  // namespace globule::core
