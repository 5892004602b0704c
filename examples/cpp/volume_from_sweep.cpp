// A tracked ultrasound sweep, image by image, to a volume of voxels:   volume_from_sweep [device]
//
// The sweep is made up: a bright ball with a dark core, cut by parallel planes that tilt as the probe moves on.
#include <globule/globule.hpp>

#include <cmath>

#include "files.hpp"

int main(int n_arguments, char** arguments) {
    const int n_frames = 60, width = 96, height = 80;  // pixels of 0.5 mm
    const double pixel = 0.5, center[3] = {24.0, 20.0, 15.0};
    try {
        globule::Reconstructor reconstructor({.spacing = 0.75, .device = n_arguments > 1 ? arguments[1] : "auto"});
        std::vector<std::uint8_t> sweep;
        std::vector<double> poses;
        for (int f = 0; f < n_frames; ++f) {
            // world_from_image: columns of pixels along x, rows along y and a little along z.
            const double tilt = 0.002 * f;
            const globule::Matrix4 pose{pixel, 0, 0, 0,  //
                0, pixel, 0, 0,                          //
                0, tilt, 1, 0.5 * f,                     //
                0, 0, 0, 1};
            std::vector<std::uint8_t> image(width * height);
            for (int row = 0; row < height; ++row)
                for (int column = 0; column < width; ++column) {
                    const double x = pixel * column - center[0], y = pixel * row - center[1],
                                 z = tilt * row + 0.5 * f - center[2];
                    const double square = x * x + y * y + z * z;
                    image[std::size_t(row) * width + column] = square < 16 ? 40
                                                               : square < 144
                                                                   ? 220
                                                                   : std::uint8_t(60 + (7 * row + 3 * column) % 20);
                }
            reconstructor.add(
                globule::ArrayView(image.data(), {height, width}), globule::ArrayView(pose.data(), {4, 4}));
            sweep.insert(sweep.end(), image.begin(), image.end());
            poses.insert(poses.end(), pose.begin(), pose.end());
        }
        const globule::Volume live = reconstructor.volume();

        // All images at once, on a grid that fits them.
        const globule::Volume volume =
            globule::reconstruct({.frames = globule::ArrayView(sweep.data(), {n_frames, height, width}),
                                     .world_from_image = globule::ArrayView(poses.data(), {n_frames, 4, 4})},
                {.spacing = 0.75,
                    .compounding = globule::Compounding::maximum,
                    .device = n_arguments > 1 ? arguments[1] : "auto"});

        write_raw("volume_live.raw", live.bytes.data(), live.bytes.size());
        write_raw("volume.raw", volume.bytes.data(), volume.bytes.size());
        std::size_t n_measured = 0;
        for (const std::uint8_t radius : volume.radius) n_measured += radius == 0;
        std::printf("volume.raw: %zu x %zu x %zu voxels of %g mm (uint8, x fastest), %zu of them measured\n",
            volume.size[0], volume.size[1], volume.size[2], volume.spacing, n_measured);
        std::printf("volume_live.raw: %zu x %zu x %zu voxels\n", live.size[0], live.size[1], live.size[2]);
    } catch (const globule::Error& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 1;
    }
}
