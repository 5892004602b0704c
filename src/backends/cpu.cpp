// The CPU backend; compiled once per SIMD level.
#include <omp.h>

#include "backends/entry.hpp"
#include "backends/make.hpp"
#include "exec/cpu.hpp"
#include "pipeline/scene.hpp"

namespace globule::core {
namespace {

using Scope = Cpu::DeviceScope;

Status scene(int device, int threads, Poll* poll, std::shared_ptr<Scene>* out) noexcept {
    return caught([&] { *out = std::make_shared<SceneImpl<Cpu>>(device, threads, poll); });
}
Status reconstructor(int device, int threads, Poll* poll, std::shared_ptr<Reconstructor>* out) noexcept {
    return caught([&] { *out = make_reconstructor(device, threads, poll); });
}
Status tissue(int device, int threads, Poll* poll, std::shared_ptr<Tissue>* out) noexcept {
    return caught([&] { *out = make_tissue(device, threads, poll); });
}
Status simulation(const std::shared_ptr<Scene>& of, std::shared_ptr<Simulation>* out) noexcept {
    return caught([&] { *out = make_simulation(of); });
}
Status describe(int, bool* ok, std::string* out) noexcept {
    return caught([&] {
        *ok = true;
        *out = "CPU, " + std::to_string(omp_get_max_threads()) + " threads, " + std::to_string(GB_WIDTH) +
               " lanes (" GB_ISA ")";
    });
}
Status locate(const void*, int* device) noexcept {
    *device = kHost;
    return {};
}
Status fetch(void*, const AnyArray&, std::size_t) noexcept {
    return caught([] { throw Refused("the CPU backend reads no GPU memory"); });
}
Status deliver(const ArrayAt<void>&, const void*, std::size_t) noexcept {
    return caught([] { throw Refused("the CPU backend writes no GPU memory"); });
}

Status let_wait(int, std::uintptr_t) noexcept { return {}; }
void* take_pinned(std::size_t) noexcept { return nullptr; }
void give_pinned_back(void*, std::size_t) noexcept {}

constexpr BackendApi kApi{scene, describe, reconstructor, simulation, tissue, locate, fetch, deliver, let_wait,
    take_pinned, give_pinned_back, run<Scope>};

}  // namespace
}  // namespace globule::core

extern "C" __attribute__((visibility("default"))) const globule::core::BackendApi globule_backend = globule::core::kApi;
