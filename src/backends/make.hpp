// The makers that each backend defines in files of their own: sweeps are compiled without contraction
// into fused multiply-add, so that their bits are the same everywhere.
#pragma once
#include "backends/backend.hpp"

namespace globule::core {

std::shared_ptr<Tissue> make_tissue(int device, int threads, Poll* poll);
std::shared_ptr<Reconstructor> make_reconstructor(int device, int threads, Poll* poll);

}  // namespace globule::core
