// What scenes and settings may be at most, and the kernels' defaults. Python has them from here: globule._core.limits
// and globule._core.kernels.
#pragma once
#include <cstddef>

#include "backends/backend.hpp"

namespace globule {

using core::kMaxParticles;
inline constexpr double kMaxSupport = 1e18;  ///< past it squares overflow float32
inline constexpr double kMaxRatio = 1e6;     ///< between the largest and the smallest support
inline constexpr int kMaxSamples = 65536;

struct KernelDefaults {
    const char* name;
    double spacings, threshold;  ///< support in spacings and iso-value
    double reach;                ///< in supports: where b is an eighth of the threshold
};
/// By core::KernelName.
inline constexpr KernelDefaults kKernels[] = {
    {"murakami", 2.0, 0.6, 0.85},
    {"nishimura", 2.5, 0.6, 0.78},
    {"wyvill", 2.0, 0.6, 0.82},
    {"blinn", 3.5, 0.6, 0.47},
    {"cubic_spline", 2.75, 0.6, 0.67},
    {"wendland_c2", 2.75, 0.6, 0.62},
    {"solid", 2.2, 0.1, 0.69},
};
inline const KernelDefaults& defaults_of(core::KernelName kernel) { return kKernels[int(kernel)]; }

}  // namespace globule
