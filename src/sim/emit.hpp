// Its old name, until src/backends/simulation.hpp says sim/sinks.hpp.
#pragma once
#include "sim/sinks.hpp"
