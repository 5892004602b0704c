// What a point of the surface, or of a cut face, looks like: gradient and blended attributes.
#pragma once
#include "octree/query.hpp"
#include "trace/cell_tracer.hpp"

namespace globule::core {

/// Per-particle appearance, in the caller's order; where data is null one value holds for all.
struct Attributes {
    const float* color;       ///< (n, 3)
    float3 one_color;
    Attribute reflection, refraction;
    Attribute wetness;          ///< 0 to 1: under a film of liquid where it is 1
    float3 wet;                 ///< the film's colour, which is in `color` already
    GB_FN bool uniform() const { return !color && !reflection.data && !refraction.data && !wetness.data; }
};

/// At a point: half the gradient of the field, over 1 / typical support or the world's unit of length, and attributes
/// blended by influence.
struct Looks {
    float3 gradient{0, 0, 0}, color{0, 0, 0};
    float reflection = 0, refraction = 0, wetness = 0;
};

/// The sums that give a point's attributes.
struct BlendedAttributes {
    const Attributes& of;
    BlendedColor<float> color;
    float reflection = 0, refraction = 0, wetness = 0;

    GB_FN explicit BlendedAttributes(const Attributes& attributes) : of(attributes) {}
    GB_FN void add(std::uint32_t particle, float w) {
        color.add(of.color, particle, w);
        if (of.reflection.data) reflection += w * of.reflection.data[particle];
        if (of.refraction.data) refraction += w * of.refraction.data[particle];
        if (of.wetness.data) wetness += w * of.wetness.data[particle];
    }
    GB_FN Looks with(const float3& gradient) const {
        const float scale = color.scale();
        Looks looks{gradient, of.color ? color.sum * scale : of.one_color, of.reflection.data ? reflection * scale : of.reflection.uniform,
                    of.refraction.data ? refraction * scale : of.refraction.uniform, of.wetness.uniform};
        if (of.wetness.data) looks.wetness = under_film(wetness * scale, of.wet, looks.color);
        return looks;
    }
};

/// From a cell's list, whose particles the lanes share out.
template <class Tracer>
GB_FN Looks looks_in_cell(const Tracer& tracer, const Attributes& attributes, const typename Tracer::Source& source) {
    using Lanes = typename Tracer::Lanes;
    using F = typename Lanes::F;
    BlendedAttributes blended(attributes);
    const Vec3<F> p{F(source.p0.x), F(source.p0.y), F(source.p0.z)};
    Vec3<F> gradient{F(0.0f), F(0.0f), F(0.0f)};
    for (int j = 0; j < source.n_blocks; ++j) {
        const float* block = source.block(j);
        Vec3<F> q;
        Lanes::load(block, q.x, q.y, q.z);
        const Influence<F> of = source.influence_at(block, p - q);
        gradient = gradient + of.half_gradient;
        if (!attributes.uniform())
            Lanes::where_positive(of.value, [&](int lane) {
                blended.add(tracer.particles.index[Lanes::slot(block, lane)], Lanes::get(of.value, lane));
            });
    }
    return blended.with({Lanes::sum(gradient.x), Lanes::sum(gradient.y), Lanes::sum(gradient.z)});
}

/// From the octree: where a cell has no list because the medium fills it, at a cut face.
template <class Tracer>
GB_FN Looks looks_by_tree(const Tracer& tracer, const Attributes& attributes, const float3& p) {
    BlendedAttributes blended(attributes);
    float3 gradient{0, 0, 0};
    for_each_reaching(tracer.tree, tracer.particles, p, [&](std::uint32_t j, const float3& v, const SortedShape<float>& shape) {
        const Influence<float> of = influence(tracer.kernel, shape, v, tracer.particles.weight[j]);
        gradient = gradient + of.half_gradient;
        blended.add(tracer.particles.index[j], max(of.value, 0.0f));
    });
    return blended.with(gradient);
}

template <class Tracer>
GB_FN Looks looks_at(const Tracer& tracer, const Attributes& attributes, const float3& o, const float3& d, float t) {
    const CellWalk walk(*tracer.cells.grid, o, d, t);
    bool whole_brick = true;
    const CellList list = walk.inside() ? tracer.list_of(walk, whole_brick) : CellList{kEmpty, 0, 0, 0};
    if (list.n == 0) return looks_by_tree(tracer, attributes, o + d * t);
    return looks_in_cell(tracer, attributes, tracer.source(list, tracer.in_cell(walk, o, t), d));
}

}  // namespace globule::core
