// The cubic spline kernel of SPH: W(r), normalised in 3D, zero from the support h on (Monaghan 1992).
#pragma once
#include "base/vec.hpp"

namespace globule::core::sim {

struct Spline {
    float support, inverse, scale;  ///< h, 1/h, 8/(pi h^3)

    static Spline of(float support) {
        return {support, 1.0f / support, 8.0f / (3.14159265358979f * support * support * support)};
    }
    /// W and W'(r)/r.  Without branches: W/k = 2 (1 - q)^3 - 8 (1/2 - q)^3, each where positive.
    template <class F> GB_FN void operator()(const F& r, F& w, F& slope) const {
        const F q = r * F(inverse);
        const F a = max(F(1.0f) - q, F(0.0f)), b = max(F(0.5f) - q, F(0.0f));
        w = F(2.0f * scale) * (a * a * a - F(4.0f) * b * b * b);
        slope = F(-6.0f * scale * inverse) * (a * a - F(4.0f) * b * b) / max(r, F(1e-6f * support));
    }
    template <class F> GB_FN F operator()(const F& r) const {
        const F q = r * F(inverse);
        const F a = max(F(1.0f) - q, F(0.0f)), b = max(F(0.5f) - q, F(0.0f));
        return F(2.0f * scale) * (a * a * a - F(4.0f) * b * b * b);
    }
};

/// Sums of W over an infinite lattice: what the volume of a particle is calibrated with.
struct LatticeSums {
    double all = 0.0;      ///< over the cubic lattice
    double plane = 0.0;    ///< over one of its planes
    double squares = 0.0;  ///< of |V grad W| h over the lattice, V = 1 / all
    LatticeSums(const Spline& w, float spacing) {
        const int n = int(w.support / spacing) + 1;
        for (int x = -n; x <= n; ++x)
            for (int y = -n; y <= n; ++y)
                for (int z = -n; z <= n; ++z) {
                    const float r = spacing * std::sqrt(float(x * x + y * y + z * z));
                    if (r >= w.support) continue;
                    float value, slope;
                    w(r, value, slope);
                    all += value;
                    squares += double(slope * r * w.support) * (slope * r * w.support);
                    if (z == 0) plane += w(r);
                }
        squares /= all * all;
    }
};

}  // namespace globule::core::sim
