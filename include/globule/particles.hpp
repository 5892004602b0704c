// Particles: positions with optional properties.
#pragma once
#include <concepts>
#include <optional>
#include <utility>

#include "globule/array.hpp"
#include "globule/vector.hpp"

namespace globule {

/// A property of particles: nothing (the default), one value for all, or an array with one value for each.
template <class One> class Property {
public:
    Property() = default;
    Property(const One& one) : one_(one) {}
    /// One color or vector.
    Property(double x, double y, double z)
        requires std::same_as<One, Vec3>
        : one_(Vec3{x, y, z}) {}
    template <class A>
        requires(!std::convertible_to<A, One> && std::convertible_to<A, ArrayView>)
    Property(A&& each) : each_(std::forward<A>(each)) {}

    const std::optional<One>& one() const { return one_; }
    const ArrayView& each() const { return each_; }

private:
    std::optional<One> one_{};
    ArrayView each_{};
};
using Scalars = Property<double>;
using Colors = Property<Vec3>;

/// N particles.  Arrays are float32; in host memory float64 is converted, and colors may be uint8, which are divided by
/// 255.
///
/// Scene::update reads positions, support, weight and anisotropy during the call.  On a GPU this reading is ordered by
/// the arrays' streams.  It uses color, reflection and refraction later: these arrays must stay alive and unchanged
/// until the next update returns, and the images of frames asked for before it were read or Scene::synchronize
/// returned.  (float64 and uint8 in host memory are converted, and so copied.)
struct Particles {
    ArrayView positions{};  ///< (N, 3), or flat (3 N,), world; a particle with a NaN is outside of everything
    Scalars support{};     ///< (N,) radius at which a particle's kernel vanishes, world, >= 0; default: by the measured
                           ///< spacing
    Scalars weight{};      ///< (N,) factor of the kernel, may be negative; default 1
    Colors color{};        ///< (N, 3) linear RGB in [0, 1]
    Scalars reflection{};  ///< (N,) specular reflectance at normal incidence, [0, 1]; default 0
    Scalars refraction{};  ///< (N,) share of the rest that is transmitted, [0, 1]; default 0
    /// (N, 3, 3) in host memory, 1 / world: symmetric positive definite matrices G of the kernels b(|G (x -
    /// position)|), in place of the support; sparse octree only.
    ArrayView anisotropy{};
};

}  // namespace globule
