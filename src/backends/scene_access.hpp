// What a simulation takes from the scene that shows it: the octree and the backend that both work with,
// and a way to say that the particles are others now.
#pragma once
#include <functional>

namespace globule::core {

struct SceneAccess {
    void* exec;    ///< the backend's own class
    void* octree;  ///< Octree of that backend
    /// The tree was built anew; colours (n, 3) and factors (n,) lie where its index points, factors may be null.
    std::function<void(const float* color, const float* reflection, const float* refraction)> rebuilt;
    /// Called before each use of the scene; null: the particles are gone, and so is the scene's picture.
    std::function<void(std::function<void()>)> before_use;
};

}  // namespace globule::core
