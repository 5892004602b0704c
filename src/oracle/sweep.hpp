// The reference for volumes from sweeps: float64, brute force, slow and obvious.
#pragma once
#include <cstdint>

namespace globule::core::oracle {

/// Images as float64, with the poses that the fast paths use (32 fractional bits).
struct SweepInput {
    int n, height, width;
    const double* values;       ///< (n, height, width)
    const std::int64_t* poses;  ///< (n, 9): origin, column step, row step, voxels
    const std::uint8_t* mask;   ///< (height, width) or null
    int size[3];                ///< voxels x, y, z
    bool whole;                 ///< values are rounded to integers, halves up
};

/// One value a voxel, NaN where no pixel falls; compounding as sweep::Compounding.
void bin(const SweepInput& in, int compounding, double* out);
/// Mean of samples along Bezier curves through pixels of four images, and each voxel's smallest distance of a sample
/// from a pixel along an axis, voxels; 0 where a pixel lies in the voxel.
void bezier(const SweepInput& in, double* out, double* distance);
/// Fills NaN voxels from the smallest cube with a value; radius 0 measured, 255 still empty (value 0).
void fill(
    const int size[3], bool whole, const double* bins, int reach, bool printed, double* out, std::uint8_t* radius);
/// VVN: every voxel from the pixels in the smallest sphere (rho = radius + 1/2) that holds one.
void gather(const SweepInput& in, int reach, bool printed, double* out, std::uint8_t* radius);

}  // namespace globule::core::oracle
