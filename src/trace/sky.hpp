// What a ray sees that meets nothing.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

struct Sky {
    float3 zenith, horizon, ground;  ///< radiance straight up, level, straight down
    float3 up;                       ///< unit
    float3 east;                     ///< unit, across up: where an image's middle column lies
    const float* image = nullptr;    ///< (height, width, 3) equirectangular, row 0 at the zenith
    int width = 0, height = 0;
    float strength = 1.0f;  ///< of the image

    /// Seen all at once rather than sharply: the gradient, or an image's mean, which it then holds.
    GB_FN float3 blurred(const float3& d) const {
        const float s = dot(d, up), w = sqrt(abs(s));
        return horizon * (1.0f - w) + (s > 0.0f ? zenith : ground) * w;
    }
    GB_FN float3 operator()(const float3& d) const {
        if (!image) return blurred(d);
        const float s = min(max(dot(d, up), -1.0f), 1.0f);
        const float3 side = cross(up, east);
        const float turn = atan2f(dot(d, side), dot(d, east)) * 0.15915494f + 0.5f;
        const float x = turn * width - 0.5f, y = min(max(acosf(s) * 0.31830989f * height - 0.5f, 0.0f), height - 1.0f);
        const float fx = floorf(x), fy = floorf(y);
        const int x0 = (int(fx) % width + width) % width, x1 = (x0 + 1) % width, y0 = int(fy),
                  y1 = min(y0 + 1, height - 1);
        const float u = x - fx, v = y - fy;
        return (at(x0, y0) * (1.0f - u) + at(x1, y0) * u) * (strength * (1.0f - v)) +
               (at(x0, y1) * (1.0f - u) + at(x1, y1) * u) * (strength * v);
    }
    GB_FN float3 at(int x, int y) const {
        const float* p = image + (std::size_t(y) * width + x) * 3;
        return {p[0], p[1], p[2]};
    }
};

}  // namespace globule::core
