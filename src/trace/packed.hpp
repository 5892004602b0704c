// The camera's rays of marked pixels side by side, all samples of a pixel at once, so that tiles are full: at edges few
// pixels are marked.  Each block of 8 x 8 pixels has room for all its samples, and fills the first places: a tile's
// rays are neighbors.
#pragma once
#include "trace/camera.hpp"
#include "trace/hits.hpp"

namespace globule::core {

/// Whether a work item has a marked pixel; a scan makes places of these.
struct CountMarked {
    RaySource pixels;
    std::uint32_t* place;  ///< (items,)
    GB_FN void operator()(std::size_t item) const { place[item] = pixels.swizzled(item) < pixels.n; }
};

struct PackMarked {
    RaySource pixels;
    std::uint32_t samples;
    const std::uint32_t* place;  ///< (items + 1,) how many are marked before
    float *origin, *direction;   ///< (items * samples, 3) of the packed rays
    std::uint32_t* pixel;        ///< (items * samples,) of the picture
    std::uint32_t* place_of;     ///< (n,) a pixel's first ray
    std::uint8_t* is_there;      ///< (items * samples,) cleared
    GB_FN void operator()(std::size_t item) const {
        if (place[item + 1] == place[item]) return;
        const std::size_t block = item / RaySource::kBlock * RaySource::kBlock, i = pixels.swizzled(item);
        const std::size_t at = (block + (place[item] - place[block])) * samples;
        place_of[i] = std::uint32_t(at);
        RaySource of = pixels;
        for (std::size_t k = at; k < at + samples; ++k, ++of.pass) {
            float3 o, d;
            of.get(i, o, d);
            write3(origin, k, o);
            write3(direction, k, d);
            pixel[k] = std::uint32_t(i) + pixels.first_row * std::uint32_t(pixels.camera.width);
            is_there[k] = 1;
        }
    }
};

}  // namespace globule::core
