// The basis functions b(r), written in x = (r/a)^2 with 0 <= x <= 1 (thesis §2.4, (3.6), corrected).
// All are C1 and vanish with their slope at x = 1, so x may simply be clamped there.
//
// Along a ray, r^2 = h^2 + u^2 (h: distance of the ray, u: signed distance from the closest point).
// With A = 1 - (h/a)^2, `rise` bounds a^2 d2b/du2 from above on a window of the ray where
// (u/a)^2 <= u2; `max_fall` bounds -a^2 d2b/du2 everywhere.  march.hpp steps by them.
#pragma once
#include "base/scalar.hpp"

namespace globule::core {

enum class KernelName : int { murakami, nishimura, wyvill, blinn, cubic_spline, wendland_c2, solid };

/// (1 - x)^2                                              Murakami & Ichihara 1987, (3.6c)
struct Murakami {
    static constexpr bool stretched = false;   ///< supports are balls; trace/stretched.hpp: ellipsoids
    static constexpr bool linear_rise = true;  ///< s rise(u^2, A) = rise(s u^2, s A)
    template <class F> GB_FN void operator()(F x, F& b, F& slope) const {
        const F w = F(1) - x;
        b = w * w;
        slope = F(-2) * w;
    }
    /// 12 u^2 - 4 A, up to the support's edge at u^2 = A.
    template <class F> GB_FN F rise(F u2, F A) const { return F(12) * min(u2, A) - F(4) * A; }
    GB_FN float max_fall() const { return 4.0f; }
    /// As rise, of -a^2 d2b/du2, from the window's nearest point on.
    template <class F> GB_FN F dive(F u2, F A) const { return max(F(4) * A - F(12) * u2, F(0)); }
    /// Smallest and largest b where near <= x <= far.
    template <class F> GB_FN void range(F near, F far, F& lo, F& hi) const {
        F slope;
        (*this)(near, hi, slope);
        (*this)(far, lo, slope);
    }
};

/// (1 - x)^2 (1 - 2 x): solid mode, §6.0.2.  A particle raises the field close by and asks for more of it
/// farther away: sum (1 - x)^3 is compared with (tau + sum (1 - x)^2) / 2, a threshold that rises with the
/// supports that overlap.  Near dense matter both sums shrink alike towards a face, an edge or a corner, so
/// that those stay flat and sharp.
struct Solid {
    template <class F> GB_FN void operator()(F x, F& b, F& slope) const {
        const F y = F(1) - x;
        b = y * y * (F(1) - F(2) * x);
        slope = y * (F(2) - F(6) * y);
    }
    // With y = A - u^2, 1 - x along the ray: b'' = -60 y^2 + (48 A + 12) y - 8 A.
    template <class F> GB_FN F rise(F u2, F A) const {
        const F y = max(A - u2, min(F(0.4) * A + F(0.1), A));
        return max(second(max(y, F(0)), A), F(0));
    }
    GB_FN float max_fall() const { return 8.0f; }
    template <class F> GB_FN F dive(F u2, F A) const {
        return max(max(F(8) * A, F(0) - second(max(A - u2, F(0)), A)), F(0));
    }
    template <class F> GB_FN void range(F near, F far, F& lo, F& hi) const {
        F first, last, slope;
        (*this)(near, first, slope);
        (*this)(far, last, slope);
        const auto dips = (near < F(2.0 / 3.0)) & (far > F(2.0 / 3.0));
        lo = select(dips, F(-1.0 / 27.0), min(first, last));
        hi = max(first, last);
    }

private:
    template <class F> GB_FN static F second(F y, F A) { return y * (F(48) * A + F(12) - F(60) * y) - F(8) * A; }
};

/// Any of the seven, by name.
struct AnyKernel {
    static constexpr bool stretched = false, linear_rise = false;
    KernelName name;

    /// b and db/dx.
    template <class F> GB_FN void operator()(F x, F& b, F& slope) const {
        switch (name) {
            case KernelName::murakami:
                return Murakami{}(x, b, slope);
            case KernelName::nishimura: {  // 1 - 3 q^2 for q <= 1/3, 3/2 (1 - q)^2 beyond; q = r/a
                const F q = sqrt(max(x, F(1e-12)));
                const F w = F(1) - q;
                const auto inner = x <= F(1.0 / 9.0);
                b = select(inner, F(1) - F(3) * x, F(1.5) * w * w);
                slope = select(inner, F(-3), F(-1.5) * w / q);
                return;
            }
            case KernelName::wyvill:  // 1 - 22/9 x + 17/9 x^2 - 4/9 x^3   Wyvill et al. 1986
                b = F(1) + x * (F(-22.0 / 9.0) + x * (F(17.0 / 9.0) - F(4.0 / 9.0) * x));
                slope = F(-22.0 / 9.0) + x * (F(34.0 / 9.0) - F(12.0 / 9.0) * x);
                return;
            case KernelName::blinn: {  // exp(-k x), less its tangent at the cut: no jump, no kink
                const F g = exp(F(-blinn_k) * x);
                b = g - F(blinn_cut) * (F(1.0 + blinn_k) - F(blinn_k) * x);
                slope = F(-blinn_k) * (g - F(blinn_cut));
                return;
            }
            case KernelName::cubic_spline: {  // M4: 1 - 6 q^2 + 6 q^3 for q <= 1/2, 2 (1 - q)^3 beyond
                const F q = sqrt(max(x, F(1e-12)));
                const F w = F(1) - q;
                const auto inner = x <= F(0.25);
                b = select(inner, F(1) - F(6) * x * w, F(2) * w * w * w);
                slope = select(inner, F(-6) + F(9) * q, F(-3) * w * w / q);
                return;
            }
            case KernelName::solid:
                return Solid{}(x, b, slope);
            default: {  // wendland_c2: (1 - q)^4 (1 + 4 q)   Wendland 1995
                const F q = sqrt(x);
                const F w = F(1) - q;
                const F w3 = w * w * w;
                b = w3 * w * (F(1) + F(4) * q);
                slope = F(-10) * w3;
                return;
            }
        }
    }
    template <class F> GB_FN F rise(F u2, F A) const {
        switch (name) {
            case KernelName::murakami:
                return Murakami{}.rise(u2, A);
            case KernelName::nishimura:
                return F(3);
            case KernelName::wyvill:
                return F(4.75);
            case KernelName::blinn:
                return F(max_rise_blinn);
            case KernelName::cubic_spline:
                return F(6);
            case KernelName::wendland_c2:
                return F(5);
            case KernelName::solid:
                return Solid{}.rise(u2, A);
        }
        return F(0);
    }
    GB_FN float max_fall() const {
        switch (name) {
            case KernelName::murakami:
                return 4.0f;
            case KernelName::nishimura:
                return 6.0f;
            case KernelName::wyvill:
                return 4.9f;
            case KernelName::blinn:
                return float(2 * blinn_k);
            case KernelName::cubic_spline:
                return 12.0f;
            case KernelName::wendland_c2:
                return 20.0f;
            case KernelName::solid:
                return Solid{}.max_fall();
        }
        return 0.0f;
    }

    template <class F> GB_FN F dive(F u2, F A) const {
        switch (name) {
            case KernelName::murakami:
                return Murakami{}.dive(u2, A);
            case KernelName::solid:
                return Solid{}.dive(u2, A);
            default:
                return F(max_fall());
        }
    }
    template <class F> GB_FN void range(F near, F far, F& lo, F& hi) const {
        if (name == KernelName::solid) return Solid{}.range(near, far, lo, hi);
        F slope;
        (*this)(near, hi, slope);
        (*this)(far, lo, slope);
    }

    // Blinn's Gaussian has infinite support: it is cut where it has fallen to epsilon = 1e-5.
    static constexpr double blinn_k = 11.512925464970229;  // -ln(epsilon)
    static constexpr double blinn_cut = 1e-5;
    // max of (4 k^2 u^2 - 2 k) exp(-k x): at u^2 = x = 1.5 / k, 4 k exp(-1.5)
    static constexpr double max_rise_blinn = 4 * blinn_k * 0.2231302;
};

}  // namespace globule::core
