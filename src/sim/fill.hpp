// One value for a whole array.
#pragma once
#include "base/scalar.hpp"

namespace globule::core::sim {

struct Fill {
    std::uint32_t* values;
    std::uint32_t value;
    GB_FN void operator()(std::size_t i) const { values[i] = value; }
};

}  // namespace globule::core::sim
