// Images of particles that are distributed over the ranks of MPI.  Header only: the library itself does not need MPI.
//
// Each rank has a box of space and a scene with the particles that reach into it: its own and copies of its neighbors'
// (ghost particles).  Its scene then knows the whole field in the box, and the nearest of all ranks' hits, each in its
// own box, is the hit of all particles in one scene (docs/design/pieces.md).
#pragma once
#include <mpi.h>

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "globule/error.hpp"
#include "globule/frame.hpp"
#include "globule/scene.hpp"

namespace globule::mpi {

/// A finished image: on rank 0; empty on the others.
struct Image {
    std::vector<std::uint8_t> rgb{};  ///< (H, W, 3) sRGB
    std::vector<float> distance{};    ///< (H, W) along the ray, world; infinite where missed
};

/// What fn returns, on every rank.  Where it throws on some, all throw Error with the message of the first of them and
/// its rank, so that nobody waits for a rank that has given up.
template <class F> auto together(MPI_Comm comm, F&& fn) {
    int rank, size, failed;
    MPI_Comm_rank(comm, &rank);
    MPI_Comm_size(comm, &size);
    std::invoke_result_t<F> value{};
    ErrorCode code = ErrorCode::internal;
    std::string message;
    int own = size;
    try {
        value = fn();
    } catch (const Error& e) { own = rank, code = e.code(), message = e.what(); } catch (const std::exception& e) {
        own = rank, message = e.what();
    }
    MPI_Allreduce(&own, &failed, 1, MPI_INT, MPI_MIN, comm);
    if (failed == size) return value;
    int facts[2] = {int(code), int(message.size())};
    MPI_Bcast(facts, 2, MPI_INT, failed, comm);
    message.resize(std::size_t(facts[1]));
    MPI_Bcast(message.data(), facts[1], MPI_CHAR, failed, comm);
    throw Error(ErrorCode(facts[0]), "rank " + std::to_string(failed) + ": " + message);
}

/// The nearest of all ranks' images in every pixel, on rank 0.  Each rank gets a stripe of all images, keeps what is
/// nearest, and sends that on (direct-send): 7 bytes a pixel, twice.
inline Image nearest(MPI_Comm comm, const Image& own) {
    int rank, size;
    MPI_Comm_rank(comm, &rank);
    MPI_Comm_size(comm, &size);
    if (size == 1) return own;
    const std::size_t n = own.distance.size();
    const auto bound = [&](int k) { return int(n * std::size_t(k) / std::size_t(size)); };
    const int mine = bound(rank + 1) - bound(rank);
    std::vector<int> counts(std::size_t(size), 0), starts = counts, coming(counts.size(), mine), places = counts;
    for (int k = 0; k < size; ++k) {
        counts[std::size_t(k)] = bound(k + 1) - bound(k);
        starts[std::size_t(k)] = bound(k);
        places[std::size_t(k)] = k * mine;
    }
    MPI_Datatype pixel;
    MPI_Type_contiguous(3, MPI_UINT8_T, &pixel);
    MPI_Type_commit(&pixel);
    std::vector<float> distance(std::size_t(mine) * std::size_t(size));
    std::vector<std::uint8_t> rgb(3 * distance.size());
    MPI_Alltoallv(own.distance.data(), counts.data(), starts.data(), MPI_FLOAT, distance.data(), coming.data(),
        places.data(), MPI_FLOAT, comm);
    MPI_Alltoallv(
        own.rgb.data(), counts.data(), starts.data(), pixel, rgb.data(), coming.data(), places.data(), pixel, comm);
    for (std::size_t k = 1; k < std::size_t(size); ++k)
        for (std::size_t i = 0, j = k * std::size_t(mine); i < std::size_t(mine); ++i, ++j)
            if (distance[j] < distance[i]) {
                distance[i] = distance[j];
                std::copy_n(&rgb[3 * j], 3, &rgb[3 * i]);
            }
    Image image;
    if (rank == 0) image.distance.resize(n), image.rgb.resize(3 * n);
    MPI_Gatherv(
        distance.data(), mine, MPI_FLOAT, image.distance.data(), counts.data(), starts.data(), MPI_FLOAT, 0, comm);
    MPI_Gatherv(rgb.data(), mine, pixel, image.rgb.data(), counts.data(), starts.data(), pixel, 0, comm);
    MPI_Type_free(&pixel);
    return image;
}

/// The image of all ranks' particles, on rank 0.  All ranks call it, with the same camera and settings.
///
/// scene: the particles that reach within `margin` of the rank's box.  box: half open; the boxes of all ranks fill
/// space, so those at the border of the domain are infinite there.  margin: of the rounding of hits, world; a
/// thousandth of the support. The eye lies outside of the medium, and weights are at least 0.  Light makes no turns: no
/// shadows, ambient rays, reflection, transmission, sky or ground; and each pixel has one sample.  Throws Error, on all
/// ranks.
inline Image render(MPI_Comm comm, const Scene& scene, const Box& box, double margin, const Camera& camera,
    int width = 1024, int height = 782, RenderSettings settings = {}) {
    const Image own = together(comm, [&] {
        const Material& m = settings.material;
        if (settings.shadows || settings.ambient_rays || settings.ground || settings.sky.index() || !settings.ambient ||
            m.reflection.value_or(0) > 0 || m.transmission.value_or(0) > 0 || m.index.value_or(1) != 1)
            throw Error(ErrorCode::invalid, "settings: expected light without turns for particles on several ranks");
        if (settings.samples != 1)
            throw Error(ErrorCode::invalid,
                "samples: expected 1 for particles on several ranks, got " + std::to_string(settings.samples));
        settings.edge_samples = 0;
        const Frame frame = scene.render(camera, width, height, settings);
        Image image{frame.image(), frame.distance()};
        const std::vector<float> at = frame.position();
        for (std::size_t i = 0; i < image.distance.size(); ++i)
            for (std::size_t c = 0; c < 3; ++c)  // a hit elsewhere is another rank's; it stays before the background
                if (std::isfinite(image.distance[i]) &&
                    !(at[3 * i + c] >= box.low[c] - margin && at[3 * i + c] < box.high[c] + margin))
                    image.distance[i] = FLT_MAX;
        return image;
    });
    return nearest(comm, own);
}

}  // namespace globule::mpi
