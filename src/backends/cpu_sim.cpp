// Simulation on the CPU; compiled once per SIMD level.
#include "exec/cpu.hpp"
#include "sim/simulation.hpp"

std::unique_ptr<globule::core::Simulation> globule::core::make_simulation(std::shared_ptr<Scene> scene) {
    return std::make_unique<SimulationOf<Cpu>>(std::move(scene));
}
