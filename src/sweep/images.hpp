// From images and poses to the voxels that their pixels fall into.
//
// A pose is a fixed-point affine map with 32 fractional bits, so that a pixel's voxel is found by
// integer additions alone: no drift, no rounding, the same voxel on every machine.
#pragma once
#include "base/scalar.hpp"

namespace globule::core::sweep {

using Fix = std::int64_t;  ///< 32 fractional bits
inline constexpr int kFraction = 32;

/// Voxel coordinates of pixel center (column, row): origin + column * x + row * y.
struct Pose { Fix origin[3], x[3], y[3]; };

GB_FN Fix floor_divide(Fix a, Fix b) {
    const Fix q = a / b;
    return q - (a % b != 0 && (a < 0) != (b < 0));
}

template <class T> struct Images {
    const T* values;           ///< (n, height, width)
    const Pose* poses;         ///< (n,)
    const std::uint8_t* mask;  ///< (height, width), or null: all pixels
    int n, height, width;
    std::uint32_t first_order;  ///< of the first pixel among all that were ever added
};

/// A row of pixels and its piece inside of a box of voxels.
struct Row {
    Fix at[3], step[3];  ///< place of column `first`
    int first, last;     ///< columns inside; none where first > last
};

template <class T> GB_FN Row row_inside(const Images<T>& images, std::size_t i, const int* size) {
    const Pose& pose = images.poses[i / images.height];
    const Fix row = Fix(i % images.height);
    Fix first = 0, last = images.width - 1;
    Row out;
    for (int k = 0; k < 3; ++k) {
        const Fix start = pose.origin[k] + row * pose.y[k], step = pose.x[k];
        const Fix end = (Fix(size[k]) << kFraction) - 1;  // 0 <= start + column * step <= end
        out.at[k] = start;
        out.step[k] = step;
        if (step > 0) {
            first = max(first, -floor_divide(start, step));
            last = min(last, floor_divide(end - start, step));
        } else if (step < 0) {
            first = max(first, -floor_divide(end - start, -step));
            last = min(last, floor_divide(start, -step));
        } else if (start < 0 || start > end) {
            last = -1;
        }
    }
    out.first = int(min(first, Fix(images.width)));
    out.last = int(max(last, Fix(-1)));
    for (int k = 0; k < 3; ++k) out.at[k] += out.first * out.step[k];
    return out;
}

}  // namespace globule::core::sweep
