// The few operations that kernels use on one lane; base/wide.hpp gives the same names for a packet.
#pragma once
#include <cmath>
#include <limits>

#include "base/fn.hpp"

namespace globule::core {

template <class T> GB_FN T min(T a, T b) { return a < b ? a : b; }
template <class T> GB_FN T max(T a, T b) { return a > b ? a : b; }
GB_FN float select(bool m, float a, float b) { return m ? a : b; }
GB_FN double select(bool m, double a, double b) { return m ? a : b; }
GB_FN bool any(bool m) { return m; }
GB_FN float sqrt(float a) { return sqrtf(a); }
GB_FN double sqrt(double a) { return ::sqrt(a); }
GB_FN float abs(float a) { return fabsf(a); }
GB_FN double abs(double a) { return fabs(a); }

/// x^p; 0 for x <= 0.  Cheaper than powf where the last bits do not matter.
GB_FN float pow(float x, float p) { return x > 0.0f ? exp2f(p * log2f(x)) : 0.0f; }
GB_FN double exp(double x) { return ::exp(x); }
GB_FN float exp(float x) { return expf(x); }

GB_FN constexpr float infinity() { return std::numeric_limits<float>::infinity(); }

template <class T> GB_FN T ceil_div(T a, T b) { return (a + b - 1) / b; }

}  // namespace globule::core
