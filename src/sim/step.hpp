// What a step knows, for those who take part in it.
#pragma once
#include "sim/density.hpp"

namespace globule::core::sim {

template <class Packet> struct Step {
    Lists<Packet> lists;
    State state;
    const Phase* phases;
    Rows rows;
    Period period;
    Sizes sizes;
    Spline spline;
    float spacing, volume;  ///< of a particle of size 1 at rest, m, m^3
    float dt;               ///< s
    float flux;             ///< momentum that an impulse carries across a face, over P
};

}  // namespace globule::core::sim
