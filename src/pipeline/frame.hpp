// A frame where light makes no more turns: build → trace → resolve → shade.  pipeline/picture.hpp has the others.
#pragma once
#include "pipeline/frame_pool.hpp"
#include "pipeline/trace.hpp"
#include "trace/edges.hpp"

namespace globule::core {

/// More samples of the pixels at silhouettes and creases.
template <class Exec>
void smooth_edges(Exec& exec, const Traced<Exec>& scene, const FieldRequest& field, const Lighting& lighting,
    FrameImages<Exec>& frame) {
    const typename Exec::Stage stage("edges");
    std::uint8_t* edge = frame.edge();
    exec.for_each(frame.rays.n, MarkEdges{frame.rays, frame.hits(), nullptr, nullptr, edge});
    // All samples of a band of rows at a time, so that the rays of an edge's pixels fill tiles: as many rays as pixels.
    RaySource rays = frame.rays;
    rays.pass = 1;
    rays.samples = std::uint32_t(lighting.edge_samples);
    const int height = frame.rays.rows(), width = frame.rays.camera.width,
              band = ceil_div(ceil_div(height, lighting.edge_samples), 8) * 8;
    const std::size_t most = std::size_t(min(band, height)) * width * rays.samples;
    float* room = frame.sums.reserve(7 * most);
    const Hits hits{room, room + most, room + 4 * most, frame.undecided(most)};
    for (int row = 0; row < height; row += band) {
        const std::size_t first = std::size_t(row) * width;
        rays.first_row = frame.rays.first_row + std::uint32_t(row);
        rays.n = std::size_t(min(band, height - row)) * width;
        rays.only = edge + first;
        scene.trace(exec, field, rays, hits);
        scene.resolve(exec, field, rays, hits);
        exec.for_each(
            rays.n, AddEdgeSamples{{rays, hits, lighting, frame.color() + 3 * first, frame.picture() + 3 * first}});
    }
}

/// The particles have been built (pipeline/build.hpp); work goes to `exec`, nothing is waited for.
template <class Exec>
void make_frame(Exec& exec, const Traced<Exec>& scene, const FieldRequest& field, const Lighting& lighting,
    FrameImages<Exec>& frame) {
    const typename Exec::Stage stage("frame");
    const RaySource& rays = frame.rays;
    const Hits hits = frame.hits();
    scene.trace(exec, field, rays, hits);
    scene.resolve(exec, field, rays, hits);
    exec.for_each(rays.n, Shade{rays, hits, lighting, frame.color(), frame.picture()});
    if (lighting.edge_samples > 0 && !field.thesis) smooth_edges(exec, scene, field, lighting, frame);
}

/// Whether a material's share of light, or that of the particles, is more than nothing.
inline bool acts(float of_material, const Attribute& own) {
    return of_material > 0.0f || (of_material < 0.0f && (own.data || own.uniform > 0.0f));
}

/// Whether what light does at a layer's surface ends there: it lets none through, and sends none on that is followed.
inline bool ends_light(const Lighting& lighting, const Material& m, const Attributes& attributes) {
    if (attributes.reflection.data || acts(m.transmission, attributes.refraction)) return false;
    return lighting.bounces == 0 || !(acts(m.reflection, attributes.reflection) || m.index != 0.0f);
}

/// Whether light makes no more than one turn in a picture.
inline bool is_plain(const PictureRequest& request, const Attributes& attributes) {
    const Lighting& l = request.lighting;
    const Material& m = l.materials[0];
    return request.layers.size() == 1 && request.layers[0].clips.empty() && !request.layers[0].remote &&
           !acts(-1.0f, attributes.wetness) && !acts(m.reflection, attributes.reflection) &&
           !acts(m.transmission, attributes.refraction) && m.index == 0.0f && l.n_visibilities() == 0 && !l.sky_light &&
           !l.show_sky && !l.ground.present;
}

}  // namespace globule::core
