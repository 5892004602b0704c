// Spans of host or device memory, as kernels hold them.
#pragma once
#include "base/fn.hpp"

namespace globule::core {

/// n floats per item, or one set of values for all (data == nullptr).
struct Attribute {
    const float* data = nullptr;
    float uniform = 0.0f;
    GB_FN float operator[](std::size_t i) const { return data ? data[i] : uniform; }
};

}  // namespace globule::core
