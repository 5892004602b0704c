// Tissue on CUDA: the same kernels.
#include "globule/exec/cuda.hpp"
#include "sweep.hpp"
#include "tissue_of.hpp"

std::unique_ptr<globule::Tissue> globule::make_tissue(int device_index, int, Poll) {
    return std::make_unique<TissueAlone<Cuda>>(device_index);
}
