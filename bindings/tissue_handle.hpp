// Tissue as Python holds it: its own, or a simulation's.
#pragma once
#include <nanobind/nanobind.h>

#include <memory>

#include "tissue.hpp"

struct PyTissue {
    std::unique_ptr<globule::Tissue> own;
    globule::Tissue* core;
};
