// Integrals of the basis functions along a line, in closed form and float64.  With q = r/a and the
// line at distance h from the center (both in supports), q^2 = h^2 + u^2; every kernel but blinn is,
// piece by piece, a polynomial in q.
#pragma once
#include "field/kernels.hpp"

namespace globule::core {

/// Integrals of q^n over [0, u], n = 0 … 6: I_n = (u q^n + n h^2 I_{n-2}) / (n + 1), by parts.
struct PowersOnLine {
    double i[7];
    GB_FN PowersOnLine(double h2, double u) {
        const double q2 = h2 + u * u, q = sqrt(q2);
        i[0] = u;
        i[1] = 0.5 * (u * q + (h2 > 0.0 ? h2 * ::asinh(u / sqrt(h2)) : 0.0));
        double power = u;
        for (int n = 2; n < 7; ++n) {
            if (n % 2 == 0) power *= q2;  // u q^n of the even n
            i[n] = ((n % 2 ? power * q : power) + n * h2 * i[n - 2]) / (n + 1);
        }
    }
    /// Of the polynomial with these coefficients.
    GB_FN double operator()(const double (&c)[7]) const {
        double sum = 0;
        for (int n = 0; n < 7; ++n) sum += c[n] * i[n];
        return sum;
    }
};

/// Of a kernel that is one polynomial up to q = bound and another one beyond.
GB_FN double two_pieces(double h2, double u, double bound, const double (&inner)[7], const double (&outer)[7]) {
    const double edge = h2 < bound * bound ? min(u, sqrt(bound * bound - h2)) : 0.0;
    const PowersOnLine near(h2, edge), far(h2, u);
    return near(inner) + far(outer) - near(outer);
}

/// Integral of b over [0, u], u >= 0, h^2 + u^2 <= 1.
GB_FN double half_column(const AnyKernel& kernel, double h2, double u) {
    switch (kernel.name) {
        case KernelName::murakami:
            return PowersOnLine(h2, u)({1, 0, -2, 0, 1, 0, 0});
        case KernelName::wyvill:
            return PowersOnLine(h2, u)({1, 0, -22.0 / 9.0, 0, 17.0 / 9.0, 0, -4.0 / 9.0});
        case KernelName::solid:
            return PowersOnLine(h2, u)({1, 0, -4, 0, 5, 0, -2});
        case KernelName::wendland_c2:
            return PowersOnLine(h2, u)({1, 0, -10, 20, -15, 4, 0});
        case KernelName::nishimura:
            return two_pieces(h2, u, 1.0 / 3.0, {1, 0, -3, 0, 0, 0, 0}, {1.5, -3, 1.5, 0, 0, 0, 0});
        case KernelName::cubic_spline:
            return two_pieces(h2, u, 0.5, {1, 0, -6, 6, 0, 0, 0}, {2, -6, 6, -2, 0, 0, 0});
        case KernelName::blinn: {
            constexpr double k = AnyKernel::blinn_k, root_k = 3.393070212207556, half_root_pi = 0.8862269254527579;
            const double gauss = exp(-k * h2) * (half_root_pi / root_k) * ::erf(root_k * u);
            return gauss - AnyKernel::blinn_cut * ((1.0 + k) * u - k * (h2 * u + u * u * u / 3.0));
        }
    }
    return 0.0;
}

/// Integral of b over [u0, u1], both within the support.
GB_FN double column(const AnyKernel& kernel, double h2, double u0, double u1) {
    const double low = half_column(kernel, h2, abs(u0)), high = half_column(kernel, h2, abs(u1));
    return (u1 < 0.0 ? -high : high) - (u0 < 0.0 ? -low : low);
}

}  // namespace globule::core
