// Bézier clipping (Nishita & Nakamae 1994).  Between two events f is a polynomial along the ray:
// with w = 1 - (r/a)^2 = (t - enter)(leave - t)/a^2, murakami's b is w^2 and wyvill's
// w^2 (5 + 4 w)/9.  In Bernstein form its control points enclose it: where they stay below tau there is
// no root, else the first one lies between the crossings of their convex hull with tau.
#pragma once
#include "trace/thesis/candidates.hpp"

namespace globule::core::thesis {

template <int degree> struct Bernstein {
    float c[degree + 1];

    GB_FN void add(float weight, const float (&w)[3]) {
        const float square[5] = {
            w[0] * w[0], w[0] * w[1], (w[0] * w[2] + 2.0f * w[1] * w[1]) * (1.0f / 3.0f), w[1] * w[2], w[2] * w[2]};
        if constexpr (degree == 4) {
            for (int k = 0; k < 5; ++k) c[k] += weight * square[k];
        } else {
            const float four[5] = {1, 4, 6, 4, 1}, two[3] = {1, 2, 1}, six[7] = {1, 6, 15, 20, 15, 6, 1};
            for (int i = 0; i < 5; ++i)
                for (int j = 0; j < 3; ++j)
                    c[i + j] += weight * square[i] * (5.0f + 4.0f * w[j]) * (four[i] * two[j] / (9.0f * six[i + j]));
        }
    }
    /// The same polynomial over [u0, u1], by de Casteljau.
    GB_FN Bernstein over(float u0, float u1) const {
        Bernstein out = *this;
        for (int k = 1; k <= degree; ++k)
            for (int i = degree; i >= k; --i) out.c[i] = out.c[i - 1] + (out.c[i] - out.c[i - 1]) * u1;
        const float u = u0 / u1;
        for (int k = 1; k <= degree; ++k)
            for (int i = 0; i <= degree - k; ++i) out.c[i] += (out.c[i + 1] - out.c[i]) * u;
        return out;
    }
    /// Where the hull of the control points crosses 0, in [0, 1]; false where all are negative.
    GB_FN bool clip(float& lo, float& hi) const {
        lo = 1.0f;
        hi = 0.0f;
        for (int i = 0; i <= degree; ++i) {
            if (c[i] >= 0.0f) continue;
            for (int j = 0; j <= degree; ++j) {
                if (c[j] < 0.0f) continue;
                const float at = (float(i) + float(j - i) * (c[i] / (c[i] - c[j]))) * (1.0f / degree);
                lo = min(lo, at);
                hi = max(hi, at);
            }
        }
        return lo <= hi;
    }
    /// First u of [0, 1] where the polynomial is no longer negative; 2 where it stays so.
    GB_FN float first_root() const {
        float a = 0.0f, width = 1.0f;
        for (int i = 0; i < 64 && a < 1.0f; ++i) {
            const float b = min(a + width, 1.0f);
            const Bernstein part = over(a, b);
            if (part.c[0] >= 0.0f) return a;
            float lo, hi;
            const bool last = b - a <= 1e-6f;
            if (last && part.c[degree] >= 0.0f) return b;
            if (last || !part.clip(lo, hi)) {
                width = 4.0f * (b - a);
                a = b;
                continue;
            }
            width = (b - a) * (hi - lo > 0.8f ? 0.5f : hi - lo);  // several roots: the nearer half
            a += lo * (b - a);
            width = max(width, 5e-7f);
        }
        return 2.0f;
    }
};

template <int degree> struct Bezier {
    /// First point of [from, end] where sign (tau - f) is no longer positive.
    GB_FN bool operator()(Candidates& candidates, float tau, float sign, float from, float end, float& t) const {
        for (t = from; t < end;) {
            float next = end;
            candidates.each([&](const Candidate& s) {
                const float event = s.enter > t ? s.enter : s.leave;
                if (event > t) next = min(next, event);
            });
            candidates.count_sum();
            Bernstein<degree> g;
            for (float& c : g.c) c = -sign * tau;
            const SortedParticles& particles = candidates.particles();
            candidates.each([&](const Candidate& s) {
                if (s.enter > t || s.leave < next) return;
                const float a = particles.support[s.slot], scale = 1.0f / (a * a);
                const float since0 = t - s.enter, since1 = next - s.enter, till0 = s.leave - t, till1 = s.leave - next;
                const float w[3] = {
                    since0 * till0 * scale, 0.5f * (since0 * till1 + since1 * till0) * scale, since1 * till1 * scale};
                g.add(sign * particles.weight[s.slot], w);
            });
            const float u = g.first_root();
            if (u <= 1.0f) {
                t += u * (next - t);
                return true;
            }
            t = next;
        }
        return false;
    }
};

}  // namespace globule::core::thesis
