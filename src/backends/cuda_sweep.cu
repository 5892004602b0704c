// Sweeps on the GPU, without contraction into fused multiply-add.
#include "backends/make.hpp"
#include "exec/cuda.hpp"
#include "sweep/reconstructor.hpp"

std::shared_ptr<globule::core::Reconstructor> globule::core::make_reconstructor(int device, int threads, Poll* poll) {
    return std::make_shared<ReconstructorImpl<Cuda>>(device, threads, poll);
}
