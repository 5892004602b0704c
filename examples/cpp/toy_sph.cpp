// A toy simulation of your own, drawn at every step from the arrays where it keeps them:   toy_sph [steps [device]]
//
// The forces come from globule's own neighbor search; the simulation is a toy (weakly compressible SPH without
// finesse).
#include <globule/globule.hpp>

#include <algorithm>
#include <cmath>

#include "files.hpp"

namespace {

constexpr float kSpacing = 0.05f, kSupport = 2 * kSpacing, kStiffness = 40.0f, kFriction = 4.0f, kGravity = 9.81f,
                kStep = 0.002f;

/// Water in a box of 1 x 1 x 0.5 with a floor and walls.
struct Toy {
    std::vector<float> positions, velocities, colors;  // (N, 3), flat

    Toy() {
        for (int i = 0; i < 10; ++i)
            for (int j = 0; j < 12; ++j)
                for (int k = 0; k < 10; ++k) {
                    for (const int c : {i, j, k}) positions.push_back((float(c) + 0.5f) * kSpacing);
                    colors.insert(colors.end(), {0.1f, 0.3f + 0.05f * float(j), 0.8f});
                }
        velocities.assign(positions.size(), 0.0f);
    }

    /// neighbors: of each particle, within kSupport.
    void step(const globule::Neighbors& neighbors) {
        const std::size_t n = positions.size() / 3;
        std::vector<float> pressure(n), next = velocities;
        const auto each = [&](std::size_t i, const auto& fn) {
            for (std::uint64_t at = neighbors.offsets[i]; at < neighbors.offsets[i + 1]; ++at) {
                const std::size_t j = neighbors.indices[at];
                float away[3], square = 0;
                for (int c = 0; c < 3; ++c) {
                    away[c] = positions[3 * i + c] - positions[3 * j + c];
                    square += away[c] * away[c];
                }
                const float q = 1.0f - std::sqrt(square) / kSupport;
                if (j != i && q > 0.0f) fn(j, away, std::sqrt(square), q);
            }
        };
        for (std::size_t i = 0; i < n; ++i) {
            float density = 0;
            each(i, [&](std::size_t, const float*, float, float q) { density += q * q; });
            pressure[i] = std::max(density - 4.0f, 0.0f);
        }
        for (std::size_t i = 0; i < n; ++i) {
            each(i, [&](std::size_t j, const float* away, float r, float q) {
                for (int c = 0; c < 3; ++c) {
                    const float push = kStiffness * (pressure[i] + pressure[j]) * q * away[c] / (r + 1e-6f);
                    next[3 * i + c] += kStep * (push + kFriction * q * (velocities[3 * j + c] - velocities[3 * i + c]));
                }
            });
            next[3 * i + 1] -= kStep * kGravity;
        }
        velocities = std::move(next);
        const float room[3] = {1.0f, 1.0f, 0.5f};
        for (std::size_t i = 0; i < positions.size(); ++i) {
            positions[i] += kStep * velocities[i];
            const float low = 0.5f * kSpacing, high = room[i % 3] - 0.5f * kSpacing;
            if (positions[i] < low || positions[i] > high) velocities[i] = 0;
            positions[i] = std::clamp(positions[i], low, high);
        }
    }
};

}  // namespace

int main(int n_arguments, char** arguments) {
    const int steps = n_arguments > 1 ? std::atoi(arguments[1]) : 200, width = 320, height = 240;
    try {
        Toy toy;
        // Views of the toy's arrays: nothing is copied but what a GPU needs.  They stay valid, as the vectors never
        // grow.
        const globule::Particles particles{.positions = toy.positions, .support = kSupport, .color = toy.colors};
        globule::Scene scene(particles, {.device = n_arguments > 2 ? arguments[2] : "auto"});
        const globule::Camera camera{.eye = {0.5, 0.9, 2.2}, .look_at = {0.5, 0.3, 0.25}};
        globule::Frame frame;
        for (int s = 0; s < steps; ++s) {
            toy.step(scene.neighbors(toy.positions, kSupport));
            scene.update(particles);  // the same views, whose contents have changed
            frame = scene.render(camera, width, height);
        }
        if (steps > 0) write_ppm("toy_sph.ppm", frame.image(), width, height);
        write_raw("toy_sph.raw", toy.positions.data(), toy.positions.size());
        std::printf("toy_sph.ppm: %zu particles after %d steps, on %s\n", scene.size(), steps, scene.device().c_str());
    } catch (const globule::Error& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
}
