// Simulation on CUDA: the same kernels.
#include "globule/exec/cuda.hpp"
#include "simulation_of.hpp"

std::unique_ptr<globule::Simulation> globule::make_simulation(std::shared_ptr<Scene> scene) {
    return std::make_unique<SimulationOf<Cuda>>(std::move(scene));
}
