// What one particle adds to the field at a point, and what many of them, blended, look like there.  The one
// place where gradients and colors are summed, whatever the lanes are: rays, particles, or one thread.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

/// A particle that reaches v from its center where x(v) < 1: a ball of radius a, i2 = 1 / a^2.
template <class F> struct Ball {
    F i2;
    GB_FN F x(const Vec3<F>& v) const { return dot(v, v) * i2; }
    /// Half the gradient of c b, where db/dx is `slope`.
    GB_FN Vec3<F> half_gradient(const Vec3<F>& v, F slope, F c) const { return v * (slope * (c * i2)); }
};

/// An ellipsoid, x = |m v|^2.
template <class F> struct Ellipsoid {
    Sym3<F> m;
    GB_FN F x(const Vec3<F>& v) const {
        const Vec3<F> w = m * v;
        return dot(w, w);
    }
    GB_FN Vec3<F> half_gradient(const Vec3<F>& v, F slope, F c) const { return (m * (m * v)) * (slope * c); }
};

/// The same, x = v . m v.
template <class F> struct Form {
    Sym3<F> m;
    GB_FN F x(const Vec3<F>& v) const { return dot(v, m * v); }
    GB_FN Vec3<F> half_gradient(const Vec3<F>& v, F slope, F c) const { return (m * v) * (slope * c); }
};

/// At a point: c b, and half its gradient (5.2).
template <class F> struct Influence {
    F value;
    Vec3<F> half_gradient;
};

/// v: from the particle's center to the point; c: its weight.
template <class F, class Kernel, class Shape>
GB_FN Influence<F> influence(const Kernel& kernel, const Shape& shape, const Vec3<F>& v, F c) {
    F b, slope;
    kernel(min(shape.x(v), F(1)), b, slope);
    return {c * b, shape.half_gradient(v, slope, c)};
}

inline constexpr float kWetShare = 0.85f;  ///< of a film's color, in what is wet

/// How wet a point of the surface is, 0 to 1, and its color under the film, where particles' wetness blends to
/// `blended`.  At a surface its own layer, the one that gets wet, has about half of the influence.  The film's color is
/// in theirs already.
GB_FN float under_film(float blended, const float3& film, float3& color) {
    const float inside = min(blended, 1.0f), wetness = min(2.0f * inside, 1.0f);
    color = film + (color - film) * ((1.0f - kWetShare * wetness) / (1.0f - kWetShare * inside));
    return wetness;
}

/// Colors blended by influence: sum w v / sum w, w = max(c b, 0) (§6.0.2).
template <class F> struct BlendedColor {
    Vec3<F> sum{F(0), F(0), F(0)};
    F total = F(0);

    /// colors: (n, 3), or null where only `total` is wanted.
    GB_FN void add(const float* colors, std::uint32_t particle, F w) {
        total += w;
        if (!colors) return;
        const float* own = colors + std::size_t(3) * particle;
        sum = sum + Vec3<F>{w * F(own[0]), w * F(own[1]), w * F(own[2])};
    }
    /// Of a sum over total influence.
    GB_FN F scale() const { return F(1) / max(total, F(1e-30f)); }
    GB_FN Vec3<F> mean() const { return sum * scale(); }
};

}  // namespace globule::core
