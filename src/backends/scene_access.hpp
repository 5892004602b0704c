// What a simulation takes from the scene that shows it: the octree and the backend that both work with,
// and a way to say that the particles are others now.
#pragma once
#include <cstddef>
#include <functional>

#include "base/vec.hpp"

namespace globule::core {

struct SceneAccess {
    void* exec;    ///< the backend's own class
    void* octree;  ///< Octree of that backend
    /// What is seen of the particles.  places: positions (n, 3) by index of those that are shown, NaN for the others;
    /// null: the tree itself is drawn.  fluids, things: the same for the scenes beside, null where these show nothing.
    /// Colors (n, 3) and factors (n,) lie where the index points, factors may be null.
    struct Shown {
        std::size_t n;
        const float *places, *fluids, *things;
        bool smooth;  ///< around places is one smooth surface, else balls
        float spacing, fluid_spacing;
        const float *color, *reflection, *refraction, *wetness;
        float3 wet;  ///< color of what wets
    };
    /// The particles are others now.
    std::function<void(const Shown&)> rebuilt;
    /// Called before each use of the scene; null: the particles are gone, and so is the scene's picture.
    std::function<void(std::function<void()>)> before_use;
};

}  // namespace globule::core
