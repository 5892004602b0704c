// The factories that each backend defines in files of their own: sweeps are compiled without contraction
// into fused multiply-add, so that their bits are the same everywhere.
#pragma once
#include "backends/backend.hpp"

namespace globule::core {

std::unique_ptr<Tissue> make_tissue(int device_index, int threads, Poll poll);
std::unique_ptr<Reconstructor> make_reconstructor(int device_index, int threads, Poll poll);

}  // namespace globule::core
