// What a failed CUDA call turns into.
#pragma once
#include <cuda_runtime.h>

#include <new>
#include <stdexcept>
#include <string>

namespace globule::core {

inline void check(cudaError_t status) {
    if (status == cudaSuccess) return;
    cudaGetLastError();  // else a later call finds this error again
    if (status == cudaErrorMemoryAllocation) throw std::bad_alloc();
    throw std::runtime_error(std::string("CUDA: ") + cudaGetErrorString(status));
}

}  // namespace globule::core
