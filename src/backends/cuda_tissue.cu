// Tissue on CUDA: the same kernels.
#include "exec/cuda.hpp"
#include "backends/sweep.hpp"
#include "sim/tissue.hpp"

std::unique_ptr<globule::core::Tissue> globule::core::make_tissue(int device_index, int, Poll) {
    return std::make_unique<TissueAlone<Cuda>>(device_index);
}
