// Silhouettes and creases of a picture: pixels beside a jump of distance, normal, layer or color get more samples,
// anywhere in the pixel (Whitted 1980; Mitchell 1987).  The first sample stays the pixel's distance and normal.
#pragma once
#include "trace/shade.hpp"

namespace globule::core {

inline constexpr float kCrease = 0.6f;                  ///< cosine between normals of neighboring pixels
inline constexpr std::uint8_t kEdge = 1, kEdgeHit = 2;  ///< marks: the first sample missed, or hit
inline constexpr float kJump = 2.0f;                    ///< from the plane of a neighbor's hit, in pixels
inline constexpr int kContrast = 24;                    ///< of 255, in any channel

struct MarkEdges {
    RaySource rays;
    Hits hits;
    const std::uint8_t* layer;    ///< what each pixel shows; null: all the same
    const std::uint8_t* picture;  ///< (n, 3), where contrasts count; null: they do not
    std::uint8_t* edge;
    GB_FN void operator()(std::size_t i) const {
        const int width = rays.camera.width, x = int(i % width), y = int(i / width);
        const bool found = rays.camera.share.owns(x, y) &&
                           ((x > 0 && differ(i, i - 1)) || (x + 1 < width && differ(i, i + 1)) ||
                               (y > 0 && differ(i, i - width)) || (y + 1 < rays.rows() && differ(i, i + width)));
        edge[i] = !found ? 0 : hits.t[i] < infinity() ? kEdgeHit : kEdge;
    }

private:
    /// Either hit lies off the other's plane, or they face elsewhere, or look different.
    GB_FN bool differ(std::size_t i, std::size_t j) const {
        if (layer && layer[i] != layer[j]) return true;
        for (int k = 0; picture && k < 3; ++k) {
            const int apart = int(picture[3 * i + k]) - int(picture[3 * j + k]);
            if (apart > kContrast || apart < -kContrast) return true;
        }
        const bool hit = hits.t[i] < infinity(), other = hits.t[j] < infinity();
        if (!hit || !other) return hit != other;
        const float3 n = normal(i), m = normal(j);
        if (dot(n, m) < kCrease) return true;
        float3 o, d, p, e;
        rays.get(i, o, d);
        rays.get(j, p, e);
        const float3 a = o + d * hits.t[i], b = p + e * hits.t[j], apart = b - a, beside = (p + e * hits.t[i]) - a;
        const float off = max(abs(dot(apart, n)), abs(dot(apart, m)));
        return off * off > kJump * kJump * dot(beside, beside);
    }
    GB_FN float3 normal(std::size_t i) const {
        return {hits.normal[3 * i], hits.normal[3 * i + 1], hits.normal[3 * i + 2]};
    }
};

/// The marked pixels' colors become the means of their first sample and the others.
struct AddEdgeSamples {
    Shade shade;  ///< of the other samples' hits; its images are the frame's, from the first pixel of these rays on
    GB_FN void operator()(std::size_t i) const {
        const RaySource& rays = shade.rays;
        const std::uint8_t edge = rays.only[i];
        if (!edge) return;
        float light[3], sum[3];
        for (int a = 0; a < 3; ++a) {
            light[a] = shade.color[3 * i + a];
            sum[a] = shade.shown(
                light[a], edge == kEdgeHit);  // a hit's and the background's light are displayed differently
        }
        for (std::uint32_t k = 0; k < rays.samples; ++k) {
            const std::size_t ray = k * rays.n + i;
            const bool hit = shade.hits.t[ray] < infinity();
            const float3 c = shade.light(ray, hit);
            const float v[3] = {c.x, c.y, c.z};
            for (int a = 0; a < 3; ++a) {
                light[a] += v[a];
                sum[a] += shade.shown(v[a], hit);
            }
        }
        const float n = float(rays.samples + 1);
        for (int a = 0; a < 3; ++a) {
            shade.color[3 * i + a] = light[a] / n;
            shade.picture[3 * i + a] = display(sum[a] / n);
        }
    }
};

}  // namespace globule::core
