// The camera's rays of marked pixels side by side, all samples of a pixel at once: at edges few pixels are marked. Each
// block of 8 x 8 pixels has tiles of its own, so that a tile's rays are neighbors.
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

/// How many tiles the rays of a block's marked pixels fill; a scan makes the block's first tile of these.
struct CountTiles {
    std::uint32_t samples, size;  ///< rays of a pixel, of a tile
    const std::uint32_t* place;
    std::uint32_t* n_tiles;  ///< (blocks,)
    GB_FN void operator()(std::size_t block) const {
        const std::size_t item = block * RaySource::kBlock;
        n_tiles[block] = ceil_div((place[item + RaySource::kBlock] - place[item]) * samples, size);
    }
};

struct PackMarked {
    RaySource pixels;
    std::uint32_t samples, size;        ///< rays of a pixel, of a tile
    const std::uint32_t *place, *tile;  ///< (items + 1,) how many are marked before; (blocks + 1,) tiles before
    float *origin, *direction;          ///< (rays, 3), packed
    std::uint32_t* pixel;               ///< (rays,) of the picture
    std::uint32_t* place_of;            ///< (n,) a pixel's first ray
    std::uint8_t* is_there;             ///< (rays,) cleared
    GB_FN void operator()(std::size_t item) const {
        if (place[item + 1] == place[item]) return;
        const std::size_t block = item / RaySource::kBlock, i = pixels.swizzled(item);
        const std::size_t at =
            std::size_t(tile[block]) * size + (place[item] - place[block * RaySource::kBlock]) * samples;
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
