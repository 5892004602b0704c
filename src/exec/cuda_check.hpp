// What a failed CUDA call turns into.
#pragma once
#include <cuda_runtime.h>

#include <new>
#include <string>

#include "base/device.hpp"

namespace globule::core {

inline void check(cudaError_t status) {
    if (status == cudaSuccess) return;
    cudaGetLastError();  // else a later call finds this error again
    if (status == cudaErrorMemoryAllocation) throw std::bad_alloc();
    throw DeviceFailure(std::string("CUDA: ") + cudaGetErrorString(status));
}

}  // namespace globule::core
