// Marching points with several thresholds (§5.2, Fig. 5.5): tau_k = tau (k + 1) / (n + 1), k = 0 … n - 1;
// each one that f has passed halves the step.  A sign change is refined by regula falsi, or left as
// it is: then the surface lies at the first point inside, in terraces (Fig. 5.1).  What is thinner
// than a step may be passed: that is the method's, and why it is not the default.
#pragma once
#include "trace/thesis/request.hpp"
#include "base/scalar.hpp"

namespace globule::core::thesis {

struct March {
    float step;  ///< where no threshold is passed
    int n_thresholds;
    bool refine;

    GB_FN float next_step(float gap, float tau) const {
        const float share = max(0.0f, 1.0f - abs(gap) / tau);  // f / tau on the way in
        const int passed = int(min(share * float(n_thresholds + 1), float(n_thresholds)));
        return step / float(1 << passed);
    }

    /// First point of [from, end] where sign (tau - f) is no longer positive.
    template <class Field>
    GB_FN bool operator()(const Field& field, float tau, float sign, float from, float end, float& t) const {
        float before = from, gap = sign * (tau - field(from));
        t = from;
        while (gap > 0.0f) {
            if (!(t < end)) return false;
            before = t;
            const float gap_before = gap;
            t = min(t + max(next_step(gap, tau), 4e-7f * t), end);
            gap = sign * (tau - field(t));
            if (gap <= 0.0f && refine) t = refined(field, tau, sign, before, gap_before, t, gap);
        }
        return true;
    }

private:
    /// Regula falsi that halves the value of an end which stays (Illinois).
    template <class Field>
    GB_FN float refined(const Field& field, float tau, float sign, float a, float above, float b, float below) const {
        int stays = 0;
        for (int i = 0; i < 24 && b - a > max(1e-5f * step, 4e-7f * b) && below < 0.0f; ++i) {
            const float middle = a + (b - a) * (above / (above - below));
            const float gap = sign * (tau - field(middle));
            if (gap > 0.0f) {
                a = middle;
                above = gap;
                if (stays == 1) below *= 0.5f;
                stays = 1;
            } else {
                b = middle;
                below = gap;
                if (stays == -1) above *= 0.5f;
                stays = -1;
            }
        }
        return b;
    }
};

}  // namespace globule::core::thesis
