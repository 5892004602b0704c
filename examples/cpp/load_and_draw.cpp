// Reads particles and draws their surface:   load_and_draw particles.npy [image.ppm [device]]
#include <globule/globule.hpp>

#include "files.hpp"

int main(int n_arguments, char** arguments) {
    if (n_arguments < 2) {
        std::fprintf(stderr, "usage: load_and_draw PARTICLES.npy|.raw|.xyz [IMAGE.ppm [DEVICE]]\n");
        return 2;
    }
    const std::string image = n_arguments > 2 ? arguments[2] : "particles.ppm",
                      device = n_arguments > 3 ? arguments[3] : "auto";
    const int width = 640, height = 480;
    try {
        const std::vector<float> positions = read_positions(arguments[1]);

        // The support and the threshold follow from the particles' spacing.
        const globule::Scene scene({.positions = positions}, {.device = device});
        const auto camera =
            globule::Camera::fit(positions, {.width = width, .height = height, .margin = scene.margin()});
        const globule::Frame frame = scene.render(camera, width, height);

        write_ppm(image, frame.image(), width, height);
        std::printf("%s: %zu particles, %d octree levels, traced in %.1f ms on %s\n", image.c_str(), scene.size(),
            scene.octree().level, 1e3 * frame.trace_seconds(), scene.device().c_str());
    } catch (const std::exception& e) {  // globule::Error is one
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
}
