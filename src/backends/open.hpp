// Finds and opens the compiled backends beside this library.
#pragma once
#include <string>
#include <vector>

#include "backends/backend.hpp"

namespace globule::core {

/// SIMD levels that were built and that this processor runs, best last: "cpu_v2" ...
std::vector<std::string> cpu_backends();
/// Opens "cpu_v3", "cuda" ...; throws std::runtime_error saying why it cannot.
const BackendApi& open_backend(const std::string& name);

}  // namespace globule::core
