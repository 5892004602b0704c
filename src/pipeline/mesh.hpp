// The triangle mesh, or the capsules, of a scene: its hierarchy, and the launches of rays that meet it.
#pragma once
#include <vector>

#include "backends/backend.hpp"
#include "mesh/build.hpp"
#include "mesh/smooth_normals.hpp"
#include "pipeline/arrays.hpp"
#include "trace/nearest.hpp"
#include "trace/solid.hpp"

namespace globule::core {

/// The box of a triangle.
struct TriangleBoxes {
    const float* vertices;
    const std::uint32_t* faces;
    GB_FN float3 vertex(std::size_t corner) const {
        const float* p = vertices + std::size_t(3) * faces[corner];
        return {p[0], p[1], p[2]};
    }
    GB_FN Box operator()(std::size_t i) const {
        const float3 a = vertex(3 * i), b = vertex(3 * i + 1), c = vertex(3 * i + 2);
        return Box{a, a}.united({b, b}).united({c, c});
    }
};
struct GatherTriangles {
    TriangleBoxes of;
    const std::uint32_t* index;
    Quad* corners;
    GB_FN void operator()(std::size_t k) const {
        const float3 p = of.vertex(std::size_t(3) * index[k / 3] + k % 3);
        corners[k] = {p.x, p.y, p.z, 0.0f};
    }
};

/// The box of a capsule.
struct CapsuleBoxes {
    const float* vertices;
    const std::uint32_t* ends;
    const float* radius;
    float one_radius;
    GB_FN Quad end(std::size_t corner) const {
        const float* p = vertices + std::size_t(3) * ends[corner];
        return {p[0], p[1], p[2], radius ? radius[corner / 2] : one_radius};
    }
    GB_FN Box operator()(std::size_t i) const {
        const Quad p = end(2 * i), q = end(2 * i + 1);
        // Rounding must not cut off what lies in it.
        const float3 a = p.xyz(), b = q.xyz(), r = float3{1, 1, 1} * (p.w * 1.000001f);
        return Box{a - r, a + r}.united({b - r, b + r});
    }
};
struct GatherCapsules {
    CapsuleBoxes of;
    const std::uint32_t* index;
    Quad* ends;
    GB_FN void operator()(std::size_t k) const { ends[k] = of.end(std::size_t(2) * index[k / 2] + k % 2); }
};

/// First hits of rays, in world units; face: the caller's number, where t is finite.
template <class Items> struct MeetMesh {
    SolidShape<Items> solid;
    const float *origins, *directions;
    float *t, *normal;
    std::uint32_t* face;
    GB_FN void operator()(std::size_t i) const {
        const float3 o{origins[3 * i], origins[3 * i + 1], origins[3 * i + 2]},
            d{directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]};
        const bool usable = dot(d, d) > 0.5f;
        const Crossing c = usable ? solid.cross({}, o, d, 0.0f, infinity(), 0.0f) : Crossing{};
        const bool hit = c.item.t < infinity();
        t[i] = c.item.t;
        const float3 n = hit ? solid.pose.turned(solid.items.normal(c.item.slot, solid.pose.to_local(o + d * c.item.t)))
                             : float3{0, 0, 0};
        write3(normal, i, solid.closed || c.item.entering ? n : n * -1.0f);
        face[i] = hit ? c.item.index : 0xffffffffu;
    }
};

template <class Exec> class MeshStore {
public:
    explicit MeshStore(Exec& exec)
        : hierarchy_(exec),
          corners_(exec),
          vertices_(exec),
          radius_(exec),
          normals_(exec),
          color_(exec),
          faces_(exec),
          places_(exec),
          order_(exec),
          begins_(exec),
          many_(exec),
          parts_(exec),
          corner_normals_(exec),
          sums_(exec),
          origins_(exec),
          directions_(exec),
          results_(exec),
          indices_(exec) {}

    bool is_there() const { return there_; }
    bool is_closed() const { return mesh_.closed; }

    void build(Exec& exec, const MeshArrays& in) {
        const typename Exec::Stage stage("mesh");
        there_ = false;
        capsules_there_ = in.capsules;
        const std::size_t n = in.n_faces, n_corners = in.capsules ? Capsules::n_corners : Triangles::n_corners;
        const float* vertices = bring(exec, vertices_, in.vertices, 3 * in.n_vertices);
        const std::uint32_t* faces = bring(exec, faces_, in.faces, n_corners * n);
        const float* color = bring(exec, color_, in.color, 3 * (in.color_of_faces ? n : in.n_vertices));
        Quad* corners = corners_.reserve(n_corners * n);
        if (in.capsules) {
            const CapsuleBoxes boxes{vertices, faces, bring(exec, radius_, in.radius, n), in.one_radius};
            hierarchy_.build(n, boxes);
            exec.for_each(n_corners * n, GatherCapsules{boxes, hierarchy_.tree().index, corners});
            capsules_ = {hierarchy_.tree(), {corners}, in.closed, faces, nullptr, color, in.color_of_faces,
                in.one_color, mesh_.pose};
            mesh_.closed = in.closed;
        } else {
            const TriangleBoxes boxes{vertices, faces};
            hierarchy_.build(n, boxes);
            exec.for_each(n_corners * n, GatherTriangles{boxes, hierarchy_.tree().index, corners});
            mesh_ = {hierarchy_.tree(), {corners}, in.closed, faces, smooth(exec, boxes, in), color, in.color_of_faces,
                in.one_color, mesh_.pose};
        }
        let_callers_go_on(exec, in.vertices, in.color, in.radius);
        there_ = true;
    }
    /// Waits for the device.
    float extent(Exec& exec) const {
        BoxTreeHeader h;
        exec.download(&h, hierarchy_.tree().header, sizeof h);
        const float3 size = h.box.hi - h.box.lo;
        return max(max(max(size.x, size.y), size.z), 0.0f);
    }
    void place(const Pose& pose) { mesh_.pose = capsules_.pose = pose; }

    void intersect(Exec& exec, std::size_t n, const FloatArray& origins, const FloatArray& directions, float* t,
        float* normal, std::uint32_t* face) {
        float* out = results_.reserve(4 * n);
        std::uint32_t* faces = indices_.reserve(n);
        const float *o = bring(exec, origins_, origins, 3 * n), *d = bring(exec, directions_, directions, 3 * n);
        with_solid([&]<class Items>(const SolidShape<Items>& solid) {
            exec.for_each_uneven(n, MeetMesh<Items>{solid, o, d, out, out + n, faces});
        });
        exec.download(t, out, n * sizeof(float));
        exec.download(normal, out + n, 3 * n * sizeof(float));
        exec.download(face, faces, n * sizeof(std::uint32_t));
    }

    void march(Exec& exec, const Clips& clips, const WaveRays& rays, int layer, LayerHits& found) const {
        with_solid([&]<class Items>(const SolidShape<Items>& solid) {
            exec.for_each_sparse(rays.source.n_items(), MarchSolid<Items>{solid, clips, rays, layer, found});
        });
    }
    void keep(Exec& exec, const Clips& clips, const WaveRays& rays, int layer, const LayerHits& found,
        const WaveHits& hits) const {
        with_solid([&]<class Items>(const SolidShape<Items>& solid) {
            exec.for_each_uneven(
                rays.source.n_items(), Keep<SolidSurface<Items>>{{solid}, clips, rays, layer, found, hits});
        });
    }
    void occlude(Exec& exec, const Clips& clips, const Lighting& lighting, const WaveRays& rays, const WaveHits& hits,
        int layer, float* visibility) const {
        with_solid([&]<class Items>(const SolidShape<Items>& solid) {
            exec.for_each_sparse(rays.source.n_items() * lighting.n_visibilities(),
                OccludeSolid<Items>{solid, clips, lighting, rays, hits, layer, visibility});
        });
    }

private:
    template <class Fn> void with_solid(const Fn& fn) const {
        if (capsules_there_) fn(capsules_);
        else fn(mesh_);
    }
    const float* smooth(Exec& exec, const TriangleBoxes& of, const MeshArrays& in) {
        const std::size_t n = 3 * in.n_faces;
        if (!in.corners.data || n == 0) return nullptr;
        Quad* own = corner_normals_.reserve(n);
        exec.for_each(n, CornerNormals{of.vertices, of.faces, own});
        std::vector<std::uint32_t> crowded, parts{0};
        for (std::size_t v = 0; v < in.n_places; ++v) {
            const std::uint32_t at = in.corners_begin.data[v + 1] - in.corners_begin.data[v];
            if (at < kManyCorners) continue;
            crowded.push_back(std::uint32_t(v));
            parts.push_back(parts.back() + ceil_div(at, kPart));
        }
        const CornersByPlace by_place{
            bring(exec, order_, in.corners, n), bring(exec, begins_, in.corners_begin, in.n_places + 1)};
        const ManyCorners many{bring(exec, many_, {crowded.data()}, crowded.size()),
            bring(exec, parts_, {parts.data()}, parts.size()), std::uint32_t(crowded.size())};
        float3* sums = sums_.reserve(std::size_t(parts.back()) * DirectionCells::n);
        exec.for_each_task(parts.back(), AddByDirection{own, by_place, many, sums});
        exec.for_each(crowded.size() * DirectionCells::n, AddParts{many, sums});
        float* normals = normals_.reserve(3 * n);
        exec.for_each_uneven(n, SmoothNormals{own, bring(exec, places_, in.place_of_corner, n), by_place, many, sums,
                                    in.smooth_cosine, normals});
        return normals;
    }

    BoxHierarchy<Exec> hierarchy_;
    Buffer<Quad, Exec> corners_;
    Buffer<float, Exec> vertices_, radius_, normals_, color_;
    Buffer<std::uint32_t, Exec> faces_, places_, order_, begins_, many_, parts_;
    Buffer<Quad, Exec> corner_normals_;
    Buffer<float3, Exec> sums_;
    Buffer<float, Exec> origins_, directions_, results_;
    Buffer<std::uint32_t, Exec> indices_;
    SolidShape<Triangles> mesh_{};
    SolidShape<Capsules> capsules_{};
    bool there_ = false, capsules_there_ = false;
};

}  // namespace globule::core
