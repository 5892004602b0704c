// Sweeps on the CPU; compiled once per SIMD level, without contraction into fused multiply-add.
#include "exec/cpu.hpp"
#include "sweep/reconstructor.hpp"
#include "backends/sweep.hpp"

std::unique_ptr<globule::core::Reconstructor> globule::core::make_reconstructor(int, int threads, Poll poll) {
    return std::make_unique<ReconstructorOf<Cpu>>(threads, poll);
}
