// Rays to the surface of a solid (mesh/: triangles or capsules), through what the clips keep of it: what trace/cut.hpp
// is to a field.
#pragma once
#include "mesh/capsules.hpp"
#include "mesh/triangles.hpp"
#include "trace/clip.hpp"
#include "trace/looks.hpp"
#include "trace/occlude.hpp"

namespace globule::core {

/// Where a ray first crosses a solid's surface or a cut face; t infinite: nowhere.
struct Crossing {
    ItemHit item;
    std::int32_t cap = -1;  ///< the clip whose cut face it is
};

/// A mesh, or capsules, as rays see it.
template <class Items> struct SolidShape {
    BoxTree tree;
    Items items;
    bool closed;                 ///< has an inside; else a sheet
    const std::uint32_t* faces;  ///< (n, 3) or (n, 2) vertices, the caller's order
    const float* normals;        ///< (3 n, 3) of corners; null: the items' own
    const float* color;          ///< per vertex or per face, or null
    bool color_of_faces;
    float3 one_color;
    Pose pose;

    /// sign: where the ray begins, +1 outside, -1 inside, both on a surface; 0 not known, at the camera.
    GB_FN_APART Crossing cross(
        const Clips& clips, const float3& o, const float3& d, float from, float to, float sign) const {
        const float3 p = pose.to_local(o), e = pose.turned_back(d);
        const float near = sign != 0.0f ? tree.header->near : 0.0f;
        Crossing c;
        int here = closed ? int(sign) : 0;
        if (clips.n == 0) {
            c.item = next(p, e, from - (here ? near : 0.0f), to, here, near);
            c.item.t = max(c.item.t, from);
            return c;
        }
        // A surface of another layer, at which the ray begins, may lie in a cut face of this one, which the ray passes
        // too.
        float begin, end;
        int at_begin, at_end;
        for (float at = from - near; clips.next(o, d, at, begin, end, at_begin, at_end) && begin < to; at = end) {
            if (begin > at && closed) {  // through a cut face
                const bool known = here < 0 && begin <= from + near;
                const ItemHit after = known ? ItemHit{} : next(p, e, begin, infinity(), 0, near);
                if (after.t < infinity() && !after.entering) return cut(after, at_begin, max(begin, from), true);
                here = known ? -1 : 1;
            }
            c.item = next(p, e, begin, min(end, to), here, near);
            if (c.item.t < infinity()) {
                c.item.t = max(c.item.t, from);
                return c;
            }
            if (end >= to) break;
            if (here <= 0 && closed) {
                const ItemHit after = next(p, e, end, infinity(), 0, near);
                if (here < 0 || (after.t < infinity() && !after.entering))
                    return cut(after, at_end, max(end, from), false);
            }
            here = closed ? 1 : 0;
        }
        c.item = {};
        return c;
    }
    /// Whether anything at all lies between: faster, without clips.
    GB_FN bool blocks(const float3& o, const float3& d, float to, float sign) const {
        const RayRange range{pose.to_local(o), pose.turned_back(d), closed ? -tree.header->near : 0.0f, to,
            closed ? int(sign) : 0, closed ? 0.0f : tree.header->near};
        return walk_boxes<true>(tree, items, range).t < infinity();
    }

    /// What the surface looks like where a ray met it.  Its normal is turned against rays that enter and along rays
    /// that leave.
    GB_FN_APART Looks looks(const float3& o, const float3& d, float t, std::uint32_t slot, bool entering) const {
        const std::uint32_t index = tree.index[slot];
        const float3 at = pose.to_local(o + d * t);
        float3 normal = items.normal(slot, at), mixed = one_color;
        if (normals || (color && !color_of_faces)) {
            const float3 share = items.shares(slot, at);
            const auto mix = [&](const float* of, std::size_t a, std::size_t b, std::size_t c) {
                const auto row = [&](std::size_t i) { return float3{of[3 * i], of[3 * i + 1], of[3 * i + 2]}; };
                return row(a) * share.x + row(b) * share.y + row(c) * share.z;
            };
            const std::size_t i = std::size_t(Items::n_corners) * index, last = i + Items::n_corners - 1;
            if (normals) normal = mix(normals, i, i + 1, last);
            if (color && !color_of_faces) mixed = mix(color, faces[i], faces[i + 1], faces[last]);
        }
        if (color && color_of_faces)
            mixed = {
                color[std::size_t(3) * index], color[std::size_t(3) * index + 1], color[std::size_t(3) * index + 2]};
        normal = normalize(pose.turned(normal));
        if (!closed && !entering) normal = normal * -1.0f;
        // Rounding, or a normal between corners, must not make an entry of an exit.
        const float along = dot(normal, d), sign = !closed || entering ? -1.0f : 1.0f;
        if (along * sign < 1e-3f) normal = normalize(normal + d * (sign * 1e-3f - along));
        return {normal, mixed, 0.0f, 0.0f};
    }

private:
    /// side: looks for faces where the ray enters (+1) or leaves (-1) alone, so that it cannot meet again the surface
    /// it begins on.
    GB_FN_APART ItemHit next(const float3& p, const float3& e, float from, float to, int side, float near) const {
        return walk_boxes<false>(tree, items, {p, e, from, to, side, closed ? 0.0f : near});
    }
    GB_FN static Crossing cut(ItemHit color_of, std::int32_t cap, float t, bool entering) {
        color_of.t = t;
        color_of.entering = entering;
        return {color_of, cap};
    }
};

/// Rays to their first crossing of a solid.
template <class Items> struct MarchSolid {
    SolidShape<Items> solid;
    Clips clips;
    WaveRays rays;
    int layer;
    LayerHits out;
    GB_FN void operator()(std::size_t k) const {
        const std::size_t i = rays.source.swizzled(k);
        if (i >= rays.source.n) return;
        float3 o, d;
        rays.source.get(i, o, d);
        const float sign = rays.primary() ? 0.0f : rays.inside[i] >> layer & 1 ? -1.0f : 1.0f;
        const Crossing c = solid.cross(clips, o, d, 0.0f, infinity(), sign);
        out.t[i] = c.item.t;
        out.cap[i] = c.cap;
        out.sign[i] = std::int8_t(c.item.entering || !solid.closed ? 1 : -1);
        out.item[i] = c.item.slot << 1 | (c.item.entering ? 1u : 0u);
    }
};

/// What Keep asks about a solid.
template <class Items> struct SolidSurface {
    SolidShape<Items> solid;
    GB_FN Looks looks(const float3& o, const float3& d, float t, const LayerHits& found, std::size_t i) const {
        return solid.looks(o, d, t, found.item[i] >> 1, found.item[i] & 1);
    }
    GB_FN static float3 normal(const Looks& looks) { return looks.gradient; }
};

/// Shadow and ambient rays through a solid: what part of the light comes through, (n_visibilities, n).
template <class Items> struct OccludeSolid {
    SolidShape<Items> solid;
    Clips clips;
    Lighting lighting;
    WaveRays rays;
    WaveHits hits;
    int layer;
    float* visibility;
    GB_FN void operator()(std::size_t k) const {
        ShadowRay ray;
        if (!ray.start(k, lighting, rays, hits, layer, visibility)) return;
        const Material& m = lighting.materials[layer];
        const float through = max(m.transmission, 0.0f);  // a mesh has no factors of its own
        float sign = solid.closed && ray.inside >> layer & 1 ? -1.0f : 1.0f, left = 1.0f, from = 0.0f;
        if (through <= 0.0f && clips.n == 0) {
            if (solid.blocks(ray.o, ray.d, ray.distance, sign)) *ray.out = 0.0f;
            return;
        }
        for (int crossings = 0; crossings < kMaxCrossings && left >= 0.004f; ++crossings) {
            const Crossing c = solid.cross(clips, ray.o, ray.d, from, ray.distance, sign);
            const float t = min(c.item.t, ray.distance);
            if (sign < 0.0f && t < infinity()) left *= m.mean_beer(t - from);
            if (!(c.item.t < ray.distance)) break;
            left *= through;
            from = solid.closed ? t : t + solid.tree.header->near;
            if (solid.closed) sign = -sign;
        }
        *ray.out *= left < 0.004f ? 0.0f : left;
    }
};

}  // namespace globule::core
