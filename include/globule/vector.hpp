// Points, directions, colors and boxes.
#pragma once
#include <array>

namespace globule {

/// A point or direction (world), or a color or radiance (linear, 1 = white).  World frames are right-handed.
using Vec3 = std::array<double, 3>;

/// A box with its faces along the axes, world.
struct Box { Vec3 low{0, 0, 0}, high{0, 0, 0}; };

/// target_from_source: acts on columns (x, y, z, 1) from the left; row after row.
using Matrix4 = std::array<double, 16>;

}  // namespace globule
