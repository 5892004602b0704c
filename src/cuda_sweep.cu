// Sweeps on CUDA: the same kernels; compiled without contraction into fused multiply-add.
#include "globule/exec/cuda.hpp"
#include "reconstructor_of.hpp"
#include "sweep.hpp"

std::unique_ptr<globule::Reconstructor> globule::make_reconstructor(int device_index, int, Poll) {
    return std::make_unique<ReconstructorOf<Cuda>>(device_index);
}
