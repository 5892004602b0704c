// What a point of the surface, or of a cut face, looks like: gradient and blended attributes.
#pragma once
#include "trace/exact.hpp"

namespace globule::core {

/// Per-particle appearance, in the caller's order; where data is null one value holds for all.
struct Attributes {
    const float* color;  ///< (n, 3)
    float3 one_color;
    Attribute reflection, refraction;
    Attribute wetness;  ///< 0 to 1: under a film of liquid where it is 1
    float3 wet;         ///< the film's color, which is in `color` already
    GB_FN bool uniform() const { return !color && !reflection.data && !refraction.data && !wetness.data; }
};

/// At a point: half the gradient of the field, over 1 / typical support, and attributes blended by influence.
struct Looks {
    float3 gradient{0, 0, 0}, color{0, 0, 0};
    float reflection = 0, refraction = 0, wetness = 0;
};

/// The sums that give a point's attributes.
struct BlendedAttributes {
    const Attributes& of;
    BlendedColor<double> color;
    double reflection = 0, refraction = 0, wetness = 0;

    GB_FN explicit BlendedAttributes(const Attributes& attributes) : of(attributes) {}
    GB_FN void clear() {
        color = {};
        reflection = refraction = wetness = 0;
    }
    GB_FN void add(std::uint32_t particle, double w) {
        color.add(of.color, particle, w);
        if (of.reflection.data) reflection += w * of.reflection.data[particle];
        if (of.refraction.data) refraction += w * of.refraction.data[particle];
        if (of.wetness.data) wetness += w * of.wetness.data[particle];
    }
    GB_FN Looks with(const float3& gradient) const {
        const double scale = color.scale();
        Looks looks{gradient, of.color ? to_float(color.sum * scale) : of.one_color,
            of.reflection.data ? float(reflection * scale) : of.reflection.uniform,
            of.refraction.data ? float(refraction * scale) : of.refraction.uniform, of.wetness.uniform};
        if (of.wetness.data) looks.wetness = under_film(float(wetness * scale), of.wet, looks.color);
        return looks;
    }
};

/// At t along a ray.  settles: t is a crossing, and moves to where float64 has it.
template <class Tracer>
GB_FN Looks looks_at(
    const Tracer& tracer, const Attributes& attributes, const float3& o, const float3& d, float& t, bool settles) {
    using Field = ExactField<Tracer>;
    const Field field(tracer, o, d, t);
    BlendedAttributes blended(attributes);
    const auto at = [&](const Vec3<double>& p, bool last) {
        if (!last || attributes.uniform()) return field.at(p, typename Field::Nobody{});
        blended.clear();
        return field.at(p, [&](std::uint32_t particle, double w) { blended.add(particle, w); });
    };
    const Vec3<double> o2{o.x, o.y, o.z}, d2{d.x, d.y, d.z};
    if (!settles) {  // its normal is known
        at(o2 + d2 * double(t), true);
        return blended.with({0, 0, 0});
    }
    const double typical = tracer.tree.header->typical_support;
    double exact = t;
    const Vec3<double> gradient = settle(at, double(tracer.tau), typical, o2, d2, exact);
    t = max(float(exact), 0.0f);
    return blended.with(to_float(gradient * typical));
}

}  // namespace globule::core
