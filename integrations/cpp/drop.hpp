// What the programs that try the adaptors share: a drop of particles, and an image of it.
#pragma once
#include <globule/globule.hpp>

#include <array>
#include <cstdio>
#include <string>
#include <vector>

#include "../../examples/cpp/files.hpp"

inline constexpr double kSpacing = 0.05;

/// A ball of particles on a lattice; particle i moves with i / n.
inline std::vector<std::array<double, 3>> drop() {
    std::vector<std::array<double, 3>> places;
    for (int i = -8; i <= 8; ++i)
        for (int j = -8; j <= 8; ++j)
            for (int k = -8; k <= 8; ++k)
                if (i * i + j * j + k * k <= 64) places.push_back({kSpacing * i, kSpacing * j, kSpacing * k});
    return places;
}

/// NAME.ppm, an image of the scene, and NAME.raw, the values (N,) that belong to its particles.
inline void draw(
    const std::string& name, const globule::Scene& scene, const std::vector<float>& values, bool in_place) {
    const globule::Camera camera{.eye = {1.0, 0.7, 1.6}, .look_at = {0, 0, 0}};
    write_ppm(name + ".ppm", scene.render(camera, 160, 120).image(), 160, 120);
    write_raw(name + ".raw", values.data(), values.size());
    std::printf("%s.ppm: %zu particles, %s\n", name.c_str(), scene.size(), in_place ? "in place" : "copied");
}
