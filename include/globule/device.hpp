// Devices: "cpu", "cuda:N", or "auto".
#pragma once
#include <string>
#include <vector>

#include "globule/version.hpp"

namespace globule {

struct Device {
    std::string name{};         ///< "cpu" or "cuda:N"
    std::string description{};  ///< one line
    std::string note{};         ///< why "auto" took no GPU; empty otherwise
};

/// The device that this name stands for: "cpu", "cuda" (the first GPU), "cuda:N", or "auto", which takes the first GPU
/// that can be used and otherwise the CPU.  The environment variable GLOBULE_SIMD=v2|v3|v4 chooses the CPU library by
/// hand.
///
/// Throws Error: invalid for another name; device where that device cannot be used, with the reason.
GLOBULE_API Device find_device(const std::string& device = "auto");

/// All devices that can be used.
GLOBULE_API std::vector<Device> devices();

}  // namespace globule
