// Tissue on the CPU; compiled once per SIMD level.
#include "backends/make.hpp"
#include "exec/cpu.hpp"
#include "sim/tissue.hpp"

std::shared_ptr<globule::core::Tissue> globule::core::make_tissue(int device, int threads, Poll* poll) {
    return std::make_shared<TissueAlone<Cpu>>(device, threads, poll);
}
