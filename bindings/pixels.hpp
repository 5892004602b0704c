// Images of several ranks as one: squares of pixels that ranks have made, and the nearest of several images.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <cstring>

#include "trace/camera.hpp"

namespace globule::core {

using Bytes = nb::ndarray<std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Floats = nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Numbers = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
inline constexpr int kHit = 9;  ///< floats of a hit that goes to another rank

/// fn(where in the image, where in the packed squares, how many bytes) for each row of the squares of the view's rank.
template <class Fn> void each_row_of_squares(const CameraRays& view, std::size_t pixel, const Fn& fn) {
    const Share& share = view.share;
    std::size_t packed = 0;
    for (int y = 0; y < view.height; y += share.square)
        for (int x = 0; x < view.width; x += share.square) {
            if (!share.owns(x, y)) continue;
            const std::size_t bytes = pixel * std::size_t(min(share.square, view.width - x));
            for (int row = y; row < min(y + share.square, view.height); ++row, packed += bytes)
                fn(pixel * (std::size_t(row) * view.width + x), packed, bytes);
        }
}

inline void bind_pixels(nb::module_& m) {
    m.def(
        "pack_squares",
        [](const CameraRays& view, Bytes image, Bytes packed) {
            const std::uint8_t* from = image.data();
            std::uint8_t* to = packed.data();
            nb::gil_scoped_release others;
            each_row_of_squares(view, image.size() / (std::size_t(view.width) * view.height),
                [&](std::size_t at, std::size_t place, std::size_t bytes) {
                    std::memcpy(to + place, from + at, bytes);
                });
        },
        "The squares of an image that the view's rank has made, one after the other.");
    m.def(
        "unpack_squares",
        [](const CameraRays& view, Bytes packed, Bytes image) {
            const std::uint8_t* from = packed.data();
            std::uint8_t* to = image.data();
            nb::gil_scoped_release others;
            each_row_of_squares(view, image.size() / (std::size_t(view.width) * view.height),
                [&](std::size_t at, std::size_t place, std::size_t bytes) {
                    std::memcpy(to + at, from + place, bytes);
                });
        },
        "The reverse.");
    m.def(
        "nearest_pixels",
        [](const std::vector<Floats>& depths, const std::vector<Bytes>& pictures, Floats depth, Bytes picture) {
            std::vector<const float*> d;
            std::vector<const std::uint8_t*> c;
            for (const Floats& a : depths) d.push_back(a.data());
            for (const Bytes& a : pictures) c.push_back(a.data());
            const std::size_t n = depth.size();
            float* best = depth.data();
            std::uint8_t* shown = picture.data();
            nb::gil_scoped_release others;
            for (std::size_t i = 0; i < n; ++i) {
                std::size_t winner = 0;
                for (std::size_t k = 1; k < d.size(); ++k)
                    if (d[k][i] < d[winner][i]) winner = k;
                best[i] = d[winner][i];
                std::memcpy(shown + 3 * i, c[winner] + 3 * i, 3);
            }
        },
        "Of each pixel the nearest of several images: (n,) depths, (3 n,) bytes; the first of equals.");
    m.def(
        "pack_hits",
        [](Numbers rays, std::int32_t first, Floats t, Floats normal, Floats albedo, Bytes layer, Floats rows) {
            const std::int64_t* which = rays.data();
            float* row = rows.data();
            const std::size_t n = rays.size();
            nb::gil_scoped_release others;
            for (std::size_t i = 0; i < n; ++i, row += kHit) {
                const std::size_t k = std::size_t(which[i]);
                const std::int32_t number = first + std::int32_t(k);
                std::memcpy(row, &number, 4);
                row[1] = t.data()[k];
                std::memcpy(row + 2, normal.data() + 3 * k, 12);
                std::memcpy(row + 5, albedo.data() + 3 * k, 12);
                row[8] = layer.data()[k];
            }
        },
        "Rows of 9 for rays (K,): the number as an int32's bits, t, normal, albedo, layer.");
    m.def(
        "put_hits",
        [](Floats rows, std::int32_t first, Floats t, Floats normal, Floats albedo, Bytes layer) {
            const float* row = rows.data();
            const std::size_t n = rows.size() / kHit;
            nb::gil_scoped_release others;
            for (std::size_t i = 0; i < n; ++i, row += kHit) {
                std::int32_t number;
                std::memcpy(&number, row, 4);
                const std::size_t k = std::size_t(number - first);
                if (!(row[1] < t.data()[k])) continue;
                t.data()[k] = row[1];
                std::memcpy(normal.data() + 3 * k, row + 2, 12);
                std::memcpy(albedo.data() + 3 * k, row + 5, 12);
                layer.data()[k] = std::uint8_t(row[8]);
            }
        },
        "What `pack_hits` has packed, where it is nearer than what is there; the first of equals.");
}

}  // namespace globule::core
