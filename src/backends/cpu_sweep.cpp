// Sweeps on the CPU; compiled once per SIMD level, without contraction into fused multiply-add.
#include "backends/make.hpp"
#include "exec/cpu.hpp"
#include "sweep/reconstructor.hpp"

std::shared_ptr<globule::core::Reconstructor> globule::core::make_reconstructor(int device, int threads, Poll* poll) {
    return std::make_shared<ReconstructorImpl<Cpu>>(device, threads, poll);
}
