// Tissue on the CPU; compiled once per SIMD level.
#include "globule/exec/cpu.hpp"
#include "sweep.hpp"
#include "tissue_of.hpp"

std::unique_ptr<globule::Tissue> globule::make_tissue(int, int threads, Poll poll) {
    return std::make_unique<TissueAlone<Cpu>>(threads, poll);
}
