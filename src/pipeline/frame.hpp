// A frame where light makes no more turns: build → trace → resolve → composite → shade.  pipeline/picture.hpp has the others.
#pragma once
#include "pipeline/composite.hpp"
#include "pipeline/frame_pool.hpp"
#include "pipeline/trace.hpp"
#include "trace/edges.hpp"

namespace globule::core {

/// More samples of the pixels at silhouettes and creases.
template <class Exec>
void smooth_edges(Exec& exec, const Traced<Exec>& scene, const FieldRequest& field, const Lighting& lighting, FrameImages<Exec>& frame) {
    const typename Exec::Stage stage("edges");
    const std::size_t n = frame.rays.n;
    float* room = frame.sums.reserve(10 * n);
    RaySource rays = frame.rays;
    const Hits hits{room, room + n, room + 4 * n, frame.hits().undecided};
    std::uint8_t* edge = frame.edge();
    exec.for_each(n, MarkEdges{rays, frame.hits(), nullptr, nullptr, edge});
    rays.only = edge;
    for (int k = 1; k <= lighting.edge_samples; ++k) {
        rays.pass = std::uint32_t(k);
        scene.trace(exec, field, rays, hits);
        scene.resolve(exec, field, rays, hits);
        exec.for_each(n, AddEdgeSample{{rays, hits, lighting, frame.color(), frame.picture()}, edge, room + 7 * n, k, lighting.edge_samples});
    }
}

/// The particles have been built (pipeline/build.hpp); work goes to `exec`, nothing is waited for.
template <class Exec>
void make_frame(Exec& exec, const Traced<Exec>& scene, const FieldRequest& field, const Lighting& lighting, FrameImages<Exec>& frame) {
    const typename Exec::Stage stage("frame");
    const RaySource& rays = frame.rays;
    const Hits hits = frame.hits();
    scene.trace(exec, field, rays, hits);
    scene.resolve(exec, field, rays, hits);
    composite(exec, hits, rays.n);
    exec.for_each(rays.n, Shade{rays, hits, lighting, frame.color(), frame.picture()});
    if (lighting.edge_samples > 0 && !field.thesis) smooth_edges(exec, scene, field, lighting, frame);
}

/// Whether light makes no more than one turn in a picture.
inline bool is_plain(const PictureRequest& request, const Attributes& attributes) {
    const Lighting& l = request.lighting;
    const Material& m = l.materials[0];
    const auto acts = [](float of_material, const Attribute& own) {
        return of_material > 0.0f || (of_material < 0.0f && (own.data || own.uniform > 0.0f));
    };
    return request.layers.size() == 1 && request.layers[0].clips.empty() && !acts(m.reflection, attributes.reflection) &&
           !acts(m.transmission, attributes.refraction) && m.index == 0.0f && l.n_visibilities() == 0 && !l.sky_light && !l.show_sky &&
           !l.ground.present;
}

}  // namespace globule::core
