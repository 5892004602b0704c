// As toy_sph, but the particles live on the GPU and never leave it:   toy_sph_cuda [steps]
//
// globule reads positions and colors where they lie, after what the toy's own stream was given before, and copies each
// image into the toy's device memory; the stream goes on after that.  No particle and no pixel passes through host
// memory.
#include <globule/globule.hpp>

#include <cuda_runtime.h>

#include "files.hpp"

#define CHECK(call)                                                         \
    if (const cudaError_t error = (call); error != cudaSuccess) {           \
        std::fprintf(stderr, "%s: %s\n", #call, cudaGetErrorString(error)); \
        return 1;                                                           \
    }

constexpr float kSpacing = 0.025f, kSupport = 2 * kSpacing, kStiffness = 40.0f, kFriction = 4.0f, kGravity = 9.81f,
                kStep = 0.001f;
constexpr int kSide = 20, kParticles = kSide * 24 * kSide;

__global__ void start(float* position, float* velocity, float* color) {
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= kParticles) return;
    const int cell[3] = {i % kSide, i / kSide % 24, i / kSide / 24};
    for (int c = 0; c < 3; ++c) {
        position[3 * i + c] = (cell[c] + 0.5f) * kSpacing;
        velocity[3 * i + c] = 0.0f;
    }
    color[3 * i] = 0.1f;
    color[3 * i + 1] = 0.3f + 0.02f * cell[1];
    color[3 * i + 2] = 0.8f;
}

/// Every particle looks at all others: a toy needs no octree.
__global__ void push(const float* position, const float* velocity, float* pressure, float* next) {
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= kParticles) return;
    float density = 0, force[3] = {0, -kGravity, 0};
    for (int j = 0; j < kParticles; ++j) {
        float away[3], square = 0;
        for (int c = 0; c < 3; ++c) {
            away[c] = position[3 * i + c] - position[3 * j + c];
            square += away[c] * away[c];
        }
        const float r = sqrtf(square), q = 1.0f - r / kSupport;
        if (j == i || q <= 0.0f) continue;
        density += q * q;
        for (int c = 0; c < 3; ++c)
            force[c] += kStiffness * (pressure[i] + pressure[j]) * q * away[c] / (r + 1e-6f) +
                        kFriction * q * (velocity[3 * j + c] - velocity[3 * i + c]);
    }
    for (int c = 0; c < 3; ++c) next[3 * i + c] = velocity[3 * i + c] + kStep * force[c];
    pressure[kParticles + i] = fmaxf(density - 4.0f, 0.0f);  // of the next step
}

__global__ void move(float* position, float* velocity, const float* next, float* pressure) {
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= kParticles) return;
    const float room[3] = {1.0f, 1.0f, 0.5f};
    for (int c = 0; c < 3; ++c) {
        const float low = 0.5f * kSpacing, high = room[c] - low, x = position[3 * i + c] + kStep * next[3 * i + c];
        position[3 * i + c] = fminf(fmaxf(x, low), high);
        velocity[3 * i + c] = x < low || x > high ? 0.0f : next[3 * i + c];
    }
    pressure[i] = pressure[kParticles + i];
}

int main(int n_arguments, char** arguments) {
    const int steps = n_arguments > 1 ? std::atoi(arguments[1]) : 200, width = 640, height = 480,
              blocks = (kParticles + 127) / 128;
    cudaStream_t stream;
    float *position, *velocity, *next, *color, *pressure;
    std::uint8_t* picture;
    CHECK(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking));
    for (float** array : {&position, &velocity, &next, &color})
        CHECK(cudaMalloc(array, 3 * kParticles * sizeof(float)));
    CHECK(cudaMalloc(&pressure, 2 * kParticles * sizeof(float)));
    CHECK(cudaMemsetAsync(pressure, 0, 2 * kParticles * sizeof(float), stream));
    CHECK(cudaMalloc(&picture, 3 * width * height));
    start<<<blocks, 128, 0, stream>>>(position, velocity, color);
    try {
        const auto on_stream = globule::on_gpu(stream);
        const globule::Particles particles{.positions = globule::ArrayView(position, {kParticles, 3}, on_stream),
            .support = kSupport,
            .color = globule::ArrayView(color, {kParticles, 3}, on_stream)};
        globule::Scene scene(particles, {.device = "cuda"});
        const globule::Camera camera{.eye = {0.5, 0.9, 2.2}, .look_at = {0.5, 0.3, 0.25}};
        for (int s = 0; s < steps; ++s) {
            push<<<blocks, 128, 0, stream>>>(position, velocity, pressure, next);
            move<<<blocks, 128, 0, stream>>>(position, velocity, next, pressure);
            scene.update(particles);
            scene.render(camera, width, height)
                .image(globule::MutableArrayView(picture, {height, width, 3}, on_stream));
            // Here a program would show `picture`, or encode it, on the same stream.
        }
        std::vector<std::uint8_t> image(3 * width * height);
        std::vector<float> end(3 * kParticles);
        CHECK(cudaMemcpyAsync(image.data(), picture, image.size(), cudaMemcpyDeviceToHost, stream));
        CHECK(cudaMemcpyAsync(end.data(), position, end.size() * sizeof(float), cudaMemcpyDeviceToHost, stream));
        CHECK(cudaStreamSynchronize(stream));
        write_ppm("toy_sph_cuda.ppm", image, width, height);
        write_raw("toy_sph_cuda.raw", end.data(), end.size());
        std::printf(
            "toy_sph_cuda.ppm: %d particles after %d steps, on %s\n", kParticles, steps, scene.device().c_str());
    } catch (const globule::Error& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
}
