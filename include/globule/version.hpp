// Which globule this is, and what its library exports.
#pragma once

#define GLOBULE_VERSION_MAJOR 0
#define GLOBULE_VERSION_MINOR 2
#define GLOBULE_VERSION_PATCH 0

#define GLOBULE_API __attribute__((visibility("default")))

namespace globule {

/// Version of the library that is linked, "major.minor.patch"; the macros are those of the headers.
GLOBULE_API const char* version() noexcept;

}  // namespace globule
