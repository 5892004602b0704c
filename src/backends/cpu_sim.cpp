// Simulation on the CPU; compiled once per SIMD level.
#include "exec/cpu.hpp"
#include "sim/simulation.hpp"

std::shared_ptr<globule::core::Simulation> globule::core::make_simulation(const std::shared_ptr<Scene>& scene) {
    return std::make_shared<SimulationImpl<Cpu>>(scene);
}
