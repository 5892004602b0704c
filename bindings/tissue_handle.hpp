// Tissue as Python holds it: its own, or a simulation's.
#pragma once
#include <nanobind/nanobind.h>

#include <memory>

#include "backends/tissue.hpp"

struct PyTissue {
    std::unique_ptr<globule::core::Tissue> own;
    globule::core::Tissue* core;
};
