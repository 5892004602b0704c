// The CPU backend; compiled once per SIMD level.
#include "globule/exec/cpu.hpp"
#include "scene.hpp"
#include "simulation.hpp"
#include "sweep.hpp"

namespace {

std::unique_ptr<globule::Scene> make_scene(int, int threads, globule::Poll poll) {
    return std::make_unique<globule::SceneOf<globule::Cpu>>(threads, poll);
}
std::string describe(int, bool& ok) {
    ok = true;
    return "CPU, " + std::to_string(omp_get_max_threads()) + " threads, " + std::to_string(GB_WIDTH) + " lanes (" GB_ISA ")";
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const globule::BackendApi globule_backend{
    make_scene, describe, globule::make_reconstructor, globule::make_simulation, globule::make_tissue};
