// Where rays come from: a camera's pixel centres, or arrays.
#pragma once
#include "globule/base/vec.hpp"

namespace globule {

/// Pinhole (fov > 0) or orthographic.  Row 0 is the top of the image; the centre of pixel (0, 0) is
/// half a pixel inside the top left corner.
struct CameraRays {
    float3 eye;
    float3 forward, right, up;  ///< right and up span the image plane at distance 1: half its size
    int width, height;
    bool orthographic;

    template <class F>
    GB_FN void operator()(F column, F row, Vec3<F>& o, Vec3<F>& d) const {
        const F sx = (column + F(0.5f)) * F(2.0f / float(width)) - F(1.0f);
        const F sy = F(1.0f) - (row + F(0.5f)) * F(2.0f / float(height));
        const Vec3<F> across{F(right.x) * sx + F(up.x) * sy, F(right.y) * sx + F(up.y) * sy,
                             F(right.z) * sx + F(up.z) * sy};
        const Vec3<F> ahead{F(forward.x), F(forward.y), F(forward.z)};
        const Vec3<F> at{F(eye.x), F(eye.y), F(eye.z)};
        o = orthographic ? at + across : at;
        d = orthographic ? ahead : normalize(ahead + across);
    }
};

/// The rays of one trace: from `camera`, or (n, 3) origins and unit directions.
struct RaySource {
    CameraRays camera;
    const float* origins = nullptr;
    const float* directions = nullptr;
    std::size_t n = 0;  ///< rays, or pixels

    GB_FN void get(std::size_t i, float3& o, float3& d) const {
        if (origins) {
            o = {origins[3 * i], origins[3 * i + 1], origins[3 * i + 2]};
            d = {directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]};
        } else {
            const std::uint32_t pixel = std::uint32_t(i), width = std::uint32_t(camera.width);
            camera(float(pixel % width), float(pixel / width), o, d);
        }
    }
};

}  // namespace globule
