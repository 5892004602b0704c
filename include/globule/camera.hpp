// The camera: where rays come from.
#pragma once
#include <optional>

#include "globule/array.hpp"
#include "globule/vector.hpp"
#include "globule/version.hpp"

namespace globule {

struct FitOptions {
    Vec3 direction{0.6, 0.45, 1.0};  ///< from the particles' middle to the camera
    Vec3 up{0, 1, 0};
    double fov = 40;                 ///< vertical, degrees
    int width = 1024, height = 782;  ///< of the image, for its aspect
    double margin = 0;  ///< added around the particles, world; Scene::margin() tells how far a surface lies outside
    bool orthographic = false;
};

/// A pinhole camera, or an orthographic one.  Image rows go from top to bottom; the center of pixel (0, 0) is half a
/// pixel inside the top left corner.
struct Camera {
    Vec3 eye{0, 0, 1};      ///< world
    Vec3 look_at{0, 0, 0};  ///< world, seen in the middle of the image
    Vec3 up{0, 1, 0};       ///< direction that is upwards in the image
    double fov = 40;        ///< vertical field of view, degrees
    std::optional<double>
        height{};  ///< world units from the bottom to the top of the image: makes the camera orthographic

    /// A camera that sees all positions ((N, 3) or flat, world).  Throws Error: invalid.
    GLOBULE_API static Camera fit(const ArrayView& positions, const FitOptions& options = {});
};

}  // namespace globule
