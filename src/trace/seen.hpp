// Pictures in which light makes no turns but shadows, tile by tile (trace/tile.hpp): neighboring pixels' shadow rays
// are neighbors, too, so that no cells are needed.
#pragma once
#include "trace/hits.hpp"
#include "trace/looks.hpp"
#include "trace/occlude.hpp"

namespace globule::core {

/// The nearest of the layers so far, as tiles have seen them.
struct KeepSeen {
    Attributes attributes;
    WaveRays rays;
    int layer;
    Hits seen;
    WaveHits out;
    GB_FN void operator()(std::size_t i) const {
        if (!rays.source.has(i, Share::kTile)) return;  // shadow rays, too, are those of whole tiles
        const float t = seen.t[i];
        if (layer == 0) {
            rays.inside[i] = 0;
            out.t[i] = infinity();
            out.layer[i] = kMissed;
            if (!(t < infinity())) {
                write3(out.normal, i, {0, 0, 0});
                write3(out.albedo, i, {0, 0, 0});
            }
        }
        if (t < infinity() && seen.sign[i] < 0) rays.inside[i] |= 1u << layer;  // a camera may stand inside
        if (!(t < out.t[i])) return;
        out.t[i] = t;
        out.layer[i] = std::uint32_t(layer);
        for (std::size_t k = 3 * i; k < 3 * i + 3; ++k) {
            out.normal[k] = seen.normal[k];
            out.albedo[k] = seen.albedo[k];
        }
        out.reflection[i] = attributes.reflection.uniform;
        out.refraction[i] = attributes.refraction.uniform;
        out.wetness[i] = attributes.wetness.data ? seen.wetness[i] : attributes.wetness.uniform;
    }
};

/// Every pixel's ray to one light, if it has one.
struct AimShadows {
    Lighting lighting;
    WaveRays rays;
    WaveHits hits;
    int layer, which;
    float* visibility;
    float *origin, *direction;  ///< (n, 3)
    float* distance;            ///< of the light
    std::uint8_t* wanted;
    GB_FN void operator()(std::size_t i) const {
        ShadowRay ray;
        wanted[i] = rays.source.has(i, Share::kTile) && ray.start(i, which, lighting, rays, hits, layer, visibility);
        if (!wanted[i]) return;
        write3(origin, i, ray.o);
        write3(direction, i, ray.d);
        distance[i] = ray.distance;
    }
};

/// No light comes through what lies before it.
struct Darken {
    const std::uint8_t* wanted;
    const float *t, *distance;
    float* visibility;
    GB_FN void operator()(std::size_t i) const {
        if (wanted[i] && t[i] < distance[i]) visibility[i] = 0.0f;
    }
};

}  // namespace globule::core
