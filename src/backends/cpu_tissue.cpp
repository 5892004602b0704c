// Tissue on the CPU; compiled once per SIMD level.
#include "exec/cpu.hpp"
#include "backends/sweep.hpp"
#include "sim/tissue.hpp"

std::unique_ptr<globule::core::Tissue> globule::core::make_tissue(int, int threads, Poll poll) {
    return std::make_unique<TissueAlone<Cpu>>(threads, poll);
}
