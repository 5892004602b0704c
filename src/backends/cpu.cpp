// The CPU backend; compiled once per SIMD level.
#include "exec/cpu.hpp"
#include "pipeline/scene.hpp"
#include "backends/simulation.hpp"
#include "backends/sweep.hpp"

namespace {

std::unique_ptr<globule::core::Scene> make_scene(int, int threads, globule::core::Poll poll) {
    return std::make_unique<globule::core::SceneOf<globule::core::Cpu>>(threads, poll);
}
std::string describe(int, bool& ok) {
    ok = true;
    return "CPU, " + std::to_string(omp_get_max_threads()) + " threads, " + std::to_string(GB_WIDTH) + " lanes (" GB_ISA ")";
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const globule::core::BackendApi globule_backend{
    make_scene, describe, globule::core::make_reconstructor, globule::core::make_simulation, globule::core::make_tissue};
