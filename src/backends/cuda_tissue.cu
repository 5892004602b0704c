// Tissue on the GPU.
#include "backends/make.hpp"
#include "exec/cuda.hpp"
#include "sim/tissue.hpp"

std::shared_ptr<globule::core::Tissue> globule::core::make_tissue(int device, int threads, Poll* poll) {
    return std::make_shared<TissueAlone<Cuda>>(device, threads, poll);
}
