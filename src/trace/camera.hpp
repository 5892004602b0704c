// Where rays come from: a camera's pixel centers, or arrays.
#pragma once
#include "trace/random.hpp"

namespace globule::core {

/// Which pixels one of several devices makes: squares of the picture, dealt in turn, and an apron around them that only
/// the search for edges looks at.
struct Share {
    int device = 0, n = 1;           ///< of n devices
    int square = 64;                 ///< edge in pixels, whole tiles of rays
    int step = 1;                    ///< by how many devices the next row of squares is shifted
    bool apron = false;              ///< one pixel wide
    static constexpr int kTile = 8;  ///< no tile of rays is wider or higher: rays of a tile are traced together

    GB_FN int owner(int column, int row) const { return (column / square + row / square * step) % n; }
    GB_FN bool owns(int column, int row) const { return n == 1 || owner(column, row) == device; }
    /// Within `margin` of its own pixels.
    GB_FN bool near(int column, int row, int margin) const {
        if (owns(column, row)) return true;
        const int x = max(column - margin, 0), y = max(row - margin, 0);
        return apron &&
               (owns(x, y) || owns(column + margin, y) || owns(x, row + margin) || owns(column + margin, row + margin));
    }
};

/// Pinhole (fov > 0) or orthographic.  Row 0 is the top of the image; the center of pixel (0, 0) is
/// half a pixel inside the top left corner.
struct CameraRays {
    float3 eye;
    float3 forward, right, up;  ///< right and up span the image plane at distance 1: half its size
    int width, height;
    bool orthographic;
    Share share{};

    template <class F> GB_FN void operator()(F column, F row, Vec3<F>& o, Vec3<F>& d) const {
        const F sx = (column + F(0.5f)) * F(2.0f / float(width)) - F(1.0f);
        const F sy = F(1.0f) - (row + F(0.5f)) * F(2.0f / float(height));
        const Vec3<F> across{
            F(right.x) * sx + F(up.x) * sy, F(right.y) * sx + F(up.y) * sy, F(right.z) * sx + F(up.z) * sy};
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
    std::size_t n = 0;                   ///< rays, or pixels
    std::uint32_t first_row = 0;         ///< of the camera's picture; ray 0 is its first pixel
    std::uint32_t pass = 0;              ///< 0: through the pixels' centers; else anywhere in the pixel
    const std::uint8_t* only = nullptr;  ///< pixels that have a ray where it is not 0; null: all
    std::uint32_t samples = 1;  ///< rays of each pixel of `only`, of as many passes: ray k n + i is pixel i's k-th
    bool of_pixels = false;     ///< origins: one for each of the camera's pixels, whose tiles they form
    bool dithered = true;       ///< pixels see different points of a light (trace/wave_rays.hpp)
    bool apart = false;         ///< tiles of pixels have those that see the same one
    std::uint32_t packed =
        0;  ///< not 0: origins are the camera's rays of some pixels, so many for each (trace/packed.hpp)
    GB_FN std::size_t n_rays() const { return n * samples; }

    static constexpr std::uint32_t kEdge = 64, kSquare = kEdge * kEdge,
                                   kBlock = 64;  ///< of squares; of the blocks of 8 x 8 pixels in them
    /// Work items: the pixels in Morton order within squares of 64, so that neighbors in memory, and
    /// the rays that they send on, see the same places.
    GB_FN std::size_t n_items() const {
        return origins ? n
                       : std::size_t(ceil_div<std::uint32_t>(camera.width, kEdge)) *
                             ceil_div<std::uint32_t>(rows(), kEdge) * kSquare;
    }
    /// Whether a ray is wanted; to trace it, the rest of its tile may be.
    GB_FN bool has(std::size_t i, int margin = 1) const {
        return (!only || only[i]) && (camera.share.n == 1 || mine(i, margin));
    }
    GB_FN bool mine(std::size_t i, int margin) const {
        if (origins) return true;
        const std::uint32_t width = std::uint32_t(camera.width), pixel = std::uint32_t(i) + first_row * width;
        return camera.share.near(int(pixel % width), int(pixel / width), margin);
    }
    /// The ray of work item k; n: none.
    GB_FN std::size_t swizzled(std::size_t k) const {
        if (origins) return k < n && only && !only[k] ? n : k;
        const std::uint32_t square = std::uint32_t(k / kSquare), in = std::uint32_t(k % kSquare),
                            across = ceil_div<std::uint32_t>(camera.width, kEdge);
        const std::uint32_t x = square % across * kEdge + every_other(in),
                            y = square / across * kEdge + every_other(in >> 1);
        if (x >= std::uint32_t(camera.width)) return n;
        const std::size_t i = min(std::size_t(y) * camera.width + x, n);
        return i < n && !has(i) ? n : i;
    }
    /// Bits 0, 2, 4 … of 12, side by side.
    GB_FN static std::uint32_t every_other(std::uint32_t v) {
        v &= 0x555;
        v = (v | v >> 1) & 0x333;
        v = (v | v >> 2) & 0x70f;
        return (v | v >> 4) & 0x3f;
    }
    GB_FN int rows() const { return int(n / std::size_t(camera.width)); }
    /// Where ray i passes through the picture.
    GB_FN void on_picture(std::size_t i, float& column, float& row) const {
        const std::uint32_t width = std::uint32_t(camera.width), further = samples > 1 ? std::uint32_t(i / n) : 0;
        const std::uint32_t pixel = std::uint32_t(i - further * n) + first_row * width;
        column = float(pixel % width);
        row = float(pixel / width);
        if (!pass) return;
        const Pair at = sample(pixel, 0, pass + further);
        column += at.u - 0.5f;
        row += at.v - 0.5f;
    }

    GB_FN void get(std::size_t i, float3& o, float3& d) const {
        if (origins) {
            o = {origins[3 * i], origins[3 * i + 1], origins[3 * i + 2]};
            d = {directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]};
            if (!(dot(d, d) > 0.5f)) d.x = NAN;  // such a ray would make no way; this one meets nothing
        } else {
            float column, row;
            on_picture(i, column, row);
            camera(column, row, o, d);
        }
    }
};

}  // namespace globule::core
