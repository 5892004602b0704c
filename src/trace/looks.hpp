// What a point of the surface, or of a cut face, looks like: gradient and blended attributes.
#pragma once
#include "octree/query.hpp"
#include "trace/first_hit.hpp"

namespace globule::core {

/// Per-particle appearance, in the caller's order; where data is null one value holds for all.
struct Attributes {
    const float* color;       ///< (n, 3)
    float3 one_color;
    Attribute reflection, refraction;
    GB_FN bool uniform() const { return !color && !reflection.data && !refraction.data; }
};

/// At a point: gradient of the field over 1 / typical support, and attributes blended by influence:
/// sum w v / sum w, w = max(c b, 0) (§6.0.2).
struct Looks {
    float3 gradient{0, 0, 0}, color{0, 0, 0};
    float reflection = 0, refraction = 0;
    float total = 0;

    GB_FN void add(const Attributes& a, std::uint32_t particle, float w) {
        total += w;
        if (a.color) {
            const float* own = a.color + std::size_t(3) * particle;
            color = color + float3{own[0], own[1], own[2]} * w;
        }
        if (a.reflection.data) reflection += w * a.reflection.data[particle];
        if (a.refraction.data) refraction += w * a.refraction.data[particle];
    }
    GB_FN void finish(const Attributes& a) {
        const float scale = 1.0f / max(total, 1e-30f);
        color = a.color ? color * scale : a.one_color;
        reflection = a.reflection.data ? reflection * scale : a.reflection.uniform;
        refraction = a.refraction.data ? refraction * scale : a.refraction.uniform;
    }
};

template <class Tracer>
GB_FN Looks looks_at(const Tracer& tracer, const Attributes& attributes, const float3& o, const float3& d, float t) {
    using Lanes = typename Tracer::Lanes;
    using F = typename Lanes::F;
    constexpr bool PerParticle = Tracer::PerParticle;
    Looks out;
    const CellWalk walk(*tracer.cells.grid, o, d, t);
    bool whole_brick = true;
    const CellList list = walk.inside() ? tracer.list_of(walk, whole_brick) : CellList{kEmpty, 0, 0, 0};
    if (list.n) {
        const auto source = tracer.source(list, tracer.in_cell(walk, o, t), d);
        const Vec3<F> p{F(source.p0.x), F(source.p0.y), F(source.p0.z)};
        Vec3<F> gradient{F(0.0f), F(0.0f), F(0.0f)};
        for (int j = 0; j < source.n_blocks; ++j) {
            const float* block = source.block(j);
            Vec3<F> q;
            Lanes::load(block, q.x, q.y, q.z);
            const Vec3<F> r = p - q;
            F i2(1.0f), c(1.0f), b, slope;
            if constexpr (PerParticle) {
                i2 = Lanes::load(block + 4 * Lanes::width);
                c = Lanes::load(block + 5 * Lanes::width);
            }
            if constexpr (Tracer::Kernel::stretched) {
                const Sym3<F> m = source.matrix(block);
                const Vec3<F> w = m * r;
                tracer.kernel(min(dot(w, w), F(1.0f)), b, slope);
                gradient = gradient + (m * w) * (slope * c);
            } else {
                tracer.kernel(min(dot(r, r) * i2, F(1.0f)), b, slope);
                gradient = gradient + r * (slope * c * i2);
            }
            if (!attributes.uniform())
                Lanes::where_positive(b * c, [&](int lane) {
                    out.add(attributes, tracer.particles.index[Lanes::slot(block, lane)], Lanes::get(b * c, lane));
                });
        }
        out.gradient = {Lanes::sum(gradient.x), Lanes::sum(gradient.y), Lanes::sum(gradient.z)};
    } else {
        // No list where the medium fills the cell: a cut face.
        const float3 p = o + d * t;
        for_each_touching(tracer.tree, p, p, [&](std::uint32_t j) {
            const float3 r = p - tracer.particles.position(j);
            const float c = tracer.particles.weight[j], x = tracer.particles.x_at(j, r);
            if (!(x < 1.0f)) return;
            float b, slope;
            tracer.kernel(x, b, slope);
            out.gradient = out.gradient + tracer.particles.half_gradient(j, r) * (slope * c);
            out.add(attributes, tracer.particles.index[j], max(c * b, 0.0f));
        });
    }
    out.finish(attributes);
    return out;
}

}  // namespace globule::core
