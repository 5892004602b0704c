// The backend and device that a name stands for.
#pragma once
#include "api/guard.hpp"
#include "globule/device.hpp"

namespace globule {

struct Chosen {
    const core::BackendApi* backend = nullptr;
    int index = 0;
    Device device;
};
Chosen choose(const std::string& device);

}  // namespace globule
