// The backend libraries that lie beside this one.
#pragma once
#include <string>
#include <vector>

#include "backends/backend.hpp"
#include "globule/version.hpp"

namespace globule::core {

/// Names of the CPU libraries that are here and that this processor runs, best last: "cpu_v2", ...
GLOBULE_API std::vector<std::string> cpu_backends();

/// Opens a library once; throws Error saying why it cannot be used.
GLOBULE_API const BackendApi& open_backend(const std::string& name);

}  // namespace globule::core
