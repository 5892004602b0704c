// The factory of tissue that each backend defines in a file of its own.
#pragma once
#include "backend.hpp"

namespace globule {

std::unique_ptr<Tissue> make_tissue(int device_index, int threads, Poll poll);

}  // namespace globule
