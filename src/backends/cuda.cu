// The CUDA backend: the same kernels, for the GPU.
#include "exec/cuda.hpp"
#include "pipeline/scene.hpp"
#include "backends/simulation.hpp"
#include "backends/sweep.hpp"

namespace {

std::unique_ptr<globule::core::Scene> make_scene(int device_index, int, globule::core::Poll) {
    return std::make_unique<globule::core::SceneOf<globule::core::Cuda>>(device_index);
}

/// Tries the device for real: a driver, a device of that number, and code that it can run.
std::string describe(int index, bool& ok) {
    ok = false;
    int driver = 0, count = 0;
    if (cudaDriverGetVersion(&driver) != cudaSuccess || driver == 0) return "no NVIDIA driver found";
    const cudaError_t status = cudaGetDeviceCount(&count);
    if (status == cudaErrorInsufficientDriver)
        return "the NVIDIA driver supports CUDA " + std::to_string(driver / 1000) + "." + std::to_string(driver % 1000 / 10) +
               ", older than the " + std::to_string(CUDART_VERSION / 1000) + "." +
               std::to_string(CUDART_VERSION % 1000 / 10) + " that globule was built with";
    if (status != cudaSuccess) return std::string("no usable GPU: ") + cudaGetErrorString(status);
    if (index >= count) return "no GPU number " + std::to_string(index) + ", there are " + std::to_string(count);
    cudaDeviceProp properties;
    if (cudaGetDeviceProperties(&properties, index) != cudaSuccess) return "the GPU does not answer";
    cudaFuncAttributes attributes;
    cudaSetDevice(index);
    if (cudaFuncGetAttributes(&attributes, globule::core::run_each<globule::core::Shade>) != cudaSuccess) {
        cudaGetLastError();
        return std::string("no code for ") + properties.name + " (compute capability " + std::to_string(properties.major) +
               "." + std::to_string(properties.minor) + ") in this build; set CMAKE_CUDA_ARCHITECTURES";
    }
    ok = true;
    return std::string(properties.name) + ", " + std::to_string(properties.totalGlobalMem >> 30) + " GiB";
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const globule::core::BackendApi globule_backend{
    make_scene, describe, globule::core::make_reconstructor, globule::core::make_simulation, globule::core::make_tissue};
