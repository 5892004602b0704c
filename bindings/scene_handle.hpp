// The Python object that holds a scene, shared by those who render it and those who move its particles.
#pragma once
#include <memory>

#include "backends/backend.hpp"

namespace globule::core {

struct PyScene {
    std::shared_ptr<Scene> scene;  // frames and simulations may outlive the Python object
};

}  // namespace globule::core
