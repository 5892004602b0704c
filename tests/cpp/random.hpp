// Random numbers for tests of kernels.
#pragma once
#include <doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>

#include "base/vec.hpp"

namespace core = globule::core;
using core::float3;

/// The same numbers everywhere.
class Random {
public:
    explicit Random(std::uint64_t seed) : engine_(seed) {}
    double operator()(double lo = 0.0, double hi = 1.0) { return lo + (hi - lo) * double(engine_() >> 11) * 0x1p-53; }
    std::uint64_t below(std::uint64_t n) { return engine_() % n; }
    float3 point(double lo = 0.0, double hi = 1.0) {
        const double x = (*this)(lo, hi), y = (*this)(lo, hi);
        return {float(x), float(y), float((*this)(lo, hi))};
    }
    float3 direction() {
        for (;;) {
            const float3 v = point(-1, 1);
            if (const float n = core::length(v); n > 0.1f && n < 1.0f) return v * (1.0f / n);
        }
    }

private:
    std::mt19937_64 engine_;
};
