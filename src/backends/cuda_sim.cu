// Simulation on the GPU.
#include "exec/cuda.hpp"
#include "sim/simulation.hpp"

std::shared_ptr<globule::core::Simulation> globule::core::make_simulation(const std::shared_ptr<Scene>& scene) {
    return std::make_shared<SimulationImpl<Cuda>>(scene);
}
