// The seam for several devices: each has traced its own piece of the particles; the nearest hit of a pixel is the frame's.
// With one device there is one piece, and its hits are the frame's.
#pragma once
#include "trace/hits.hpp"

namespace globule::core {

/// Leaves the nearest of all pieces' hits in `hits` ((n,) rays).
template <class Exec>
void composite(Exec&, const Hits&, std::size_t) {}

}  // namespace globule::core
