// Tissue as Python holds it: its own, or a simulation's.
#pragma once
#include "api/guard.hpp"

struct PyTissue { globule::core::Handle<globule::core::Tissue> core; };
