// Simulation on CUDA: the same kernels.
#include "exec/cuda.hpp"
#include "sim/simulation.hpp"

std::unique_ptr<globule::core::Simulation> globule::core::make_simulation(std::shared_ptr<Scene> scene) {
    return std::make_unique<SimulationOf<Cuda>>(std::move(scene));
}
