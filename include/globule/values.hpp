// Plain values that calls take and return, and that backends fill.
#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace globule {

/// Rows of particles: that of point i is indices[offsets[i]] to indices[offsets[i + 1] - 1].
struct Neighbors {
    std::vector<std::uint64_t> offsets{};  ///< (M + 1,)
    std::vector<std::uint32_t> indices{};  ///< in Morton order, the same on every device
};

/// What a step did.
struct StepReport {
    double time = 0, dt = 0;  ///< s
    std::uint64_t step = 0;
    int iterations = 0, divergence_iterations = 0, viscosity_iterations = 0;
    double error = 0, divergence_error = 0;            ///< that the solvers left, mean and relative
    double most_error = 0, most_divergence_error = 0;  ///< the largest
    double compression = 0, high_compression = 0,
           most_compression = 0;  ///< max(density / rest density - 1, 0) before the step: mean, what 0.1 % of the
                                  ///< particles exceed, largest
    int n_halved = 0;             ///< how often the solver halved the step because it gave kinetic energy
    std::uint64_t n = 0, n_solved = 0, n_escaped = 0;
    std::uint64_t n_removed = 0;                            ///< by sinks, in this step
    double most_speed = 0;                                  ///< m/s
    std::vector<std::pair<std::string, double>> seconds{};  ///< per stage
};

/// A vessel of tissue: what its cut ends bleed.
struct BloodVessel {
    float speed;  ///< m/s of blood at a cut end
    double pool;  ///< m^3 that is left
    int phase;    ///< of the blood
};

/// What a grid's holes are filled from: bins, or pixels, by growing kernels or without the octree; or neighboring
/// images along the probe's path.
enum class FillMethod : int { bins, points, plain_bins, plain_points, frames };
/// How holes weigh their voxels by distance: by weights that sum up to 1, or as the thesis prints it.
enum class HoleWeights : int { normalized, printed };
/// An element of PLUS's hole filling.
struct PlusFiller {
    int type = 0;  ///< Gaussian, Gaussian of the accumulator, inverse distance, nearest neighbor, stick
    int size = 0;  ///< of the window, or the longest stick
    int n_sticks = 0;
    float least_ratio = 0;
    std::vector<float> weights{};
};
/// What a volume's grid takes.
struct VolumeFacts {
    std::uint64_t n_blocks = 0, bytes = 0;
    double bin_seconds = 0, fill_seconds = 0;
};

}  // namespace globule
