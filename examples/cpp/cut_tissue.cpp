// A scalpel cuts a block of tissue that two graspers stretch, and the wound opens:   cut_tissue [device]
#include <globule/globule.hpp>

#include <cmath>

#include "files.hpp"

int main(int n_arguments, char** arguments) {
    const std::string device = n_arguments > 1 ? arguments[1] : "auto";
    const int side[3] = {40, 20, 10}, width = 640, height = 480;
    const double spacing = 0.002, young = 3000, density = 1000, dt = 0.002;  // m, Pa, kg/m^3, s
    try {
        std::vector<float> positions;
        for (int x = 0; x < side[0]; ++x)
            for (int y = 0; y < side[1]; ++y)
                for (int z = 0; z < side[2]; ++z)
                    for (const int c : {x, y, z}) positions.push_back(float(spacing * c));
        const std::size_t n = positions.size() / 3;

        // Bonds within 1.5 spacings make a lattice as stiff as a solid where each has 0.4 young spacing.
        globule::Scene scene(
            {.positions = positions}, {.surface = globule::Surface::smooth, .spacing = spacing, .device = device});
        const globule::Neighbors near = scene.neighbors(positions, 1.5 * spacing);
        std::vector<std::uint64_t> offsets{0};
        std::vector<std::uint32_t> other;
        std::vector<float> length;
        for (std::size_t i = 0; i < n; ++i) {
            for (std::size_t k = near.offsets[i]; k < near.offsets[i + 1]; ++k) {
                const std::size_t j = near.indices[k];
                if (j == i) continue;
                const float *a = &positions[3 * i], *b = &positions[3 * j];
                other.push_back(std::uint32_t(j));
                length.push_back(std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]));
            }
            offsets.push_back(other.size());
        }
        const std::vector<float> stiffness(other.size(), float(0.4 * young * spacing)),
            inverse_mass(n, float(1 / (density * std::pow(spacing, 3)))), bound(n, 7.5f);  // 18 bonds: 6, with a margin
        globule::Tissue tissue({.device = device});
        tissue.add({.positions = positions,
            .inverse_mass = inverse_mass,
            .offsets = offsets,
            .other = other,
            .length = length,
            .stiffness = stiffness,
            .bound = bound,
            .contact = spacing});
        tissue.set_materials({{.damping = 10}});

        // Balls so large that they hold the faces at both ends, which go apart for 0.2 s.
        const double end = spacing * (side[0] - 1), top = spacing * (side[2] - 1);
        tissue.grasp({-1, 0.02, 0.01}, 1 + 0.5 * spacing, 0);
        tissue.grasp({end + 1, 0.02, 0.01}, 1 + 0.5 * spacing, 1);
        tissue.set_instruments({{.velocity = {-0.04, 0, 0}}, {.velocity = {0.04, 0, 0}}});
        for (int i = 0; i < 100; ++i) tissue.advance(dt);
        tissue.set_instruments({});
        const double before = tissue.felt()[6];
        // The edge stands upright, half as deep as the tissue, and is drawn through it along y.
        std::uint32_t n_cut = 0;
        for (int i = 0; i < 100; ++i) {
            const double x = 0.49 * end, y = 0.0006 * i - 0.01, low = 0.5 * top, high = 2 * top;
            const std::vector<std::array<double, 3>> edges{
                {x, y, low}, {x, y, high}, {x, y + 0.0006, low}, {x, y + 0.0006, high}};
            n_cut += tissue.cut({.vertices = edges, .triangles = std::vector<std::uint32_t>{0, 1, 3, 0, 3, 2}});
            tissue.advance(dt);
        }
        for (int i = 0; i < 100; ++i) tissue.advance(dt);
        std::printf("%u bonds cut, %u piece; the grasper feels %.3f N, %.3f N before\n", n_cut, tissue.n_pieces(),
            std::abs(tissue.felt()[6]), std::abs(before));

        const std::vector<float> now = tissue.positions();
        scene.update({.positions = now, .color = {0.8, 0.35, 0.32}});
        const auto camera = globule::Camera::fit(now,
            {.direction = {0.3, -0.6, 1}, .up = {0, 0, 1}, .width = width, .height = height, .margin = scene.margin()});
        write_ppm("cut_tissue.ppm", scene.render(camera, width, height).image(), width, height);
    } catch (const std::exception& e) {  // globule::Error is one
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
}
