// Simulation on the CPU; compiled once per SIMD level.
#include "globule/exec/cpu.hpp"
#include "simulation_of.hpp"

std::unique_ptr<globule::Simulation> globule::make_simulation(std::shared_ptr<Scene> scene) {
    return std::make_unique<SimulationOf<Cpu>>(std::move(scene));
}
