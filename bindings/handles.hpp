// The Python objects that several files of bindings know.
#pragma once
#include "api/guard.hpp"

namespace globule::core {

struct PyFrame { Handle<Frame> core; };
struct PyScene {
    Handle<Scene> core;
    std::shared_ptr<Arrays> held;  ///< copies of attributes that pictures read until the next build
};

}  // namespace globule::core
