// Sweeps on CUDA: the same kernels; compiled without contraction into fused multiply-add.
#include "exec/cuda.hpp"
#include "sweep/reconstructor.hpp"
#include "backends/sweep.hpp"

std::unique_ptr<globule::core::Reconstructor> globule::core::make_reconstructor(int device_index, int, Poll) {
    return std::make_unique<ReconstructorOf<Cuda>>(device_index);
}
