// Sweeps on the CPU; compiled once per SIMD level, without contraction into fused multiply-add.
#include "globule/exec/cpu.hpp"
#include "reconstructor_of.hpp"
#include "sweep.hpp"

std::unique_ptr<globule::Reconstructor> globule::make_reconstructor(int, int threads, Poll poll) {
    return std::make_unique<ReconstructorOf<Cpu>>(threads, poll);
}
