// The rays of the next wave: mirrored and transmitted ones.
#pragma once
#include "trace/hits.hpp"
#include "trace/lit.hpp"

namespace globule::core {

/// Writes the next wave; `place` (2 items + 1,): where each ray's children go.
struct Spawn {
    Lighting lighting;
    WaveRays rays;
    WaveHits hits;
    int generation;
    const std::uint32_t* place;
    WaveRays out;
    float *origin, *direction;  ///< of `out`
    GB_FN void operator()(std::size_t item) const {
        const std::size_t i = rays.source.swizzled(item), through = rays.source.n_items() + item;
        if (place[item + 1] == place[item] && place[through + 1] == place[through]) return;
        const Point h = point_of(lighting, rays, hits, i);
        const float3 weight = rays.throughput_of(i) * Lit::attenuation(lighting, rays, hits, i);
        if (h.split.mirror > 0.0f)
            send(item, weight * h.split.mirror, mirrored(h.d, facet(h, i, 0)), h, i, rays.inside[i]);
        if (largest(h.split.through) > 0.0f) {
            const std::uint32_t bit = lighting.sheets >> hits.layer[i] & 1 ? 0u : 1u << hits.layer[i];
            send(through, weight * h.split.through, refracted(h.d, facet(h, i, 1), h.split.eta), h, i,
                h.entering ? rays.inside[i] | bit : rays.inside[i] & ~bit);
        }
    }

private:
    /// The normal, or of a rough surface that of one of its facets (GGX, Walter et al. 2007), against d.
    GB_FN float3 facet(const Point& h, std::size_t i, std::uint32_t branch) const {
        const float rough = hits.layer[i] == kGround ? 0.0f : h.material->roughness * h.material->roughness;
        if (rough <= 0.0f) return h.normal;
        const Pair at = sample(rays.pixel_of(i), 64 + 2 * generation + branch, rays.pass_of(i));
        const float tangent = rough * sqrt(at.u / max(1.0f - at.u, 1e-6f)), angle = 6.2831853f * at.v;
        float3 s, t;
        tangents(h.normal, s, t);
        const float3 n = normalize(h.normal + s * (tangent * cosf(angle)) + t * (tangent * sinf(angle)));
        const bool usable = dot(n, h.d) < 0.0f && dot(mirrored(h.d, n), h.normal) > 0.0f;
        return usable ? n : h.normal;
    }
    GB_FN void send(std::size_t child, const float3& weight, const float3& d, const Point& h, std::size_t i,
        std::uint32_t inside) const {
        const std::uint32_t at = place[child];
        if (place[child + 1] == at) return;
        write3(origin, at, h.p);
        write3(direction, at, d);
        write3(out.throughput, at, weight);
        out.pixel[at] = rays.pixel_of(i);
        out.inside[at] = inside;
    }
};

}  // namespace globule::core
