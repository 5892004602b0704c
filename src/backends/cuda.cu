// The CUDA backend: the same functors, for the GPU.
#include "backends/entry.hpp"
#include "backends/make.hpp"
#include "exec/cuda.hpp"
#include "pipeline/scene.hpp"

namespace globule::core {
namespace {

using Scope = Cuda::DeviceScope;

Status scene(int device, int threads, Poll* poll, std::shared_ptr<Scene>* out) noexcept {
    return caught([&] {
        const Scope scope(device);
        *out = std::make_shared<SceneImpl<Cuda>>(device, threads, poll);
    });
}
Status reconstructor(int device, int threads, Poll* poll, std::shared_ptr<Reconstructor>* out) noexcept {
    return caught([&] {
        const Scope scope(device);
        *out = make_reconstructor(device, threads, poll);
    });
}
Status tissue(int device, int threads, Poll* poll, std::shared_ptr<Tissue>* out) noexcept {
    return caught([&] {
        const Scope scope(device);
        *out = make_tissue(device, threads, poll);
    });
}
Status simulation(const std::shared_ptr<Scene>& of, std::shared_ptr<Simulation>* out) noexcept {
    return caught([&] {
        const Scope scope(of->device());
        *out = make_simulation(of);
    });
}
/// Tries the device for real: a driver, a device of that number, and code that it can run.
std::string description(int index, bool& ok) {
    ok = false;
    int driver = 0, count = 0;
    if (cudaDriverGetVersion(&driver) != cudaSuccess || driver == 0) return "no NVIDIA driver found";
    const cudaError_t status = cudaGetDeviceCount(&count);
    if (status == cudaErrorInsufficientDriver)
        return "the NVIDIA driver supports CUDA " + std::to_string(driver / 1000) + "." +
               std::to_string(driver % 1000 / 10) + ", older than the " + std::to_string(CUDART_VERSION / 1000) + "." +
               std::to_string(CUDART_VERSION % 1000 / 10) + " that globule was built with";
    if (status != cudaSuccess) return std::string("no usable GPU: ") + cudaGetErrorString(status);
    if (index >= count) return "no GPU number " + std::to_string(index) + ", there are " + std::to_string(count);
    cudaDeviceProp properties;
    if (cudaGetDeviceProperties(&properties, index) != cudaSuccess) return "the GPU does not answer";
    cudaFuncAttributes attributes;
    const Scope scope(index);
    if (cudaFuncGetAttributes(&attributes, run_each<Shade>) != cudaSuccess) {
        cudaGetLastError();
        return std::string("no code for ") + properties.name + " (compute capability " +
               std::to_string(properties.major) + "." + std::to_string(properties.minor) +
               ") in this build; set CMAKE_CUDA_ARCHITECTURES";
    }
    ok = true;
    return std::string(properties.name) + ", " + std::to_string(properties.totalGlobalMem >> 30) + " GiB";
}
Status describe(int index, bool* ok, std::string* out) noexcept {
    return caught([&] { *out = description(index, *ok); });
}
Status locate(const void* address, int* device) noexcept {
    return caught([&] {
        cudaPointerAttributes attributes;
        check(cudaPointerGetAttributes(&attributes, address));
        const bool on_device = attributes.type == cudaMemoryTypeDevice || attributes.type == cudaMemoryTypeManaged;
        *device = on_device ? attributes.device : kHost;
    });
}
Status fetch(void* to, const AnyArray& from, std::size_t bytes) noexcept {
    return caught([&] {
        const Scope scope(from.device);
        const auto stream = reinterpret_cast<cudaStream_t>(from.stream);
        check(cudaMemcpyAsync(to, from.data, bytes, cudaMemcpyDeviceToHost, stream));
        check(cudaStreamSynchronize(stream));
    });
}
Status deliver(const ArrayAt<void>& to, const void* from, std::size_t bytes) noexcept {
    return caught([&] {
        const Scope scope(to.device);
        const auto stream = reinterpret_cast<cudaStream_t>(to.stream);
        check(cudaMemcpyAsync(to.data, from, bytes, cudaMemcpyHostToDevice, stream));
        if (!to.stream) check(cudaStreamSynchronize(stream));
    });
}

Status let_wait(int device, std::uintptr_t stream) noexcept {
    return caught([&] {
        const Scope scope(device);
        cudaEvent_t done;
        check(cudaEventCreateWithFlags(&done, cudaEventDisableTiming));
        check(cudaEventRecord(done, cudaStreamLegacy));  // which waits for the streams of all objects
        check(cudaStreamWaitEvent(reinterpret_cast<cudaStream_t>(stream), done));
        check(cudaEventDestroy(done));
    });
}
void* take_pinned(std::size_t bytes) noexcept {
    void* room = nullptr;
    caught([&] { room = PinnedImages::take(bytes); });
    return room;
}
void give_pinned_back(void* room, std::size_t bytes) noexcept {
    caught([&] { PinnedImages::give_back(room, bytes); });
}

constexpr BackendApi kApi{scene, describe, reconstructor, simulation, tissue, locate, fetch, deliver, let_wait,
    take_pinned, give_pinned_back, run<Scope>};

}  // namespace
}  // namespace globule::core

extern "C" __attribute__((visibility("default"))) const globule::core::BackendApi globule_backend = globule::core::kApi;
