// Rays to the surface: which tracer fits the tree, the kernel and the particles, and its launches.
#pragma once
#include <type_traits>

#include "pipeline/build.hpp"
#include "pipeline/cells.hpp"
#include "pipeline/mesh.hpp"
#include "pipeline/thesis.hpp"
#include "trace/resolve.hpp"
#include "trace/seen.hpp"
#include "trace/tile.hpp"
#include "trace/wave.hpp"

namespace globule::core {

/// fn(kernel, std::bool_constant<PerParticle>): particles that are all alike have faster code.
template <class Exec, class Fn> void with_kinds(Octree<Exec>& octree, KernelName name, const Fn& fn) {
    const SortedParticles& p = octree.particles();
    const bool alike = !p.support.data && !p.weight.data && p.weight.uniform > 0.0f;
    if (p.stretch && name == KernelName::murakami)
        fn(StretchedKernel<Murakami>{{}, p.stretch, octree.view().header}, std::true_type{});
    else if (p.stretch) fn(StretchedKernel<AnyKernel>{{name}, p.stretch, octree.view().header}, std::true_type{});
    else if (alike && name == KernelName::murakami) fn(Murakami{}, std::false_type{});
    else fn(AnyKernel{name}, std::true_type{});
}
/// Without clips rays have code of their own, which is up to 9 % faster.
template <class Fn> void with_clips(const Clips& clips, const Fn& fn) {
    if (clips.n) fn(std::true_type{});
    else fn(std::false_type{});
}
/// The threshold over the common weight, where there is one.
inline float scaled_threshold(const FieldRequest& field, const SortedParticles& p, bool per_particle) {
    return per_particle ? field.threshold : field.threshold / p.weight.uniform;
}

/// One scene as rays see it.
template <class Exec> struct Traced {
    Builder<Exec>& builder;
    CellStore<Exec>& cells;
    Buffer<std::uint8_t, Exec>& near;  ///< the thesis's tracer keeps its room from frame to frame
    Buffer<ThesisWork, Exec>& work;
    MeshStore<Exec>& mesh;  ///< instead of a field, where there is one

    Octree<Exec>& octree() const { return builder.now().octree; }
    const Attributes& attributes() const { return builder.now().attributes; }

    /// Nearly all rays: tile by tile through the octree, in float32.
    void trace(Exec& exec, const FieldRequest& field, const RaySource& rays, const Hits& hits) const {
        const typename Exec::Stage stage("trace");
        if (field.thesis)
            return ThesisTracer<Exec>{exec, octree(), near, work, *field.thesis, field, attributes().color,
                attributes().one_color}(rays, hits);
        with_kinds(octree(), field.kernel,
            [&](const auto& kernel, auto kind) { trace_tiles<false>(exec, field, kernel, kind, rays, hits); });
    }
    /// First hits and what they look like, where nothing is cut.
    void see(Exec& exec, const FieldRequest& field, const RaySource& rays, const Hits& hits) const {
        const typename Exec::Stage stage("see");
        with_kinds(octree(), field.kernel, [&](const auto& kernel, auto kind) {
            const Attributes& a = attributes();
            trace_tiles<false>(exec, field, kernel, kind, rays, hits, a.wetness.data);
            const ResolveRays<kind()> rest{octree().view(), octree().particles(), {field.kernel}, field.threshold,
                a.color, a.one_color, rays, hits, {}, hits.sign, nullptr, a.wetness.data, a.wet};
            exec.for_each_tile_of(hits.undecided.n, rest);
        });
    }
    /// How far shadow rays get, one for each pixel that `rays` wants.
    void see_shadows(Exec& exec, const FieldRequest& field, const RaySource& rays, const Hits& hits) const {
        with_kinds(octree(), field.kernel, [&](const auto& kernel, auto kind) {
            trace_tiles<true>(exec, field, kernel, kind, rays, hits);
            exec.for_each_tile_of(hits.undecided.n, ResolveRays<kind(), true>{octree().view(), octree().particles(),
                                                        {field.kernel}, field.threshold, nullptr, {}, rays, hits});
        });
    }
    /// The few rays that float32 could not decide, in float64.
    void resolve(Exec& exec, const FieldRequest& field, const RaySource& rays, const Hits& hits) const {
        const typename Exec::Stage stage("resolve");
        if (field.thesis) return;
        with_kinds(octree(), field.kernel, [&](const auto&, auto kind) {
            const ResolveRays<kind()> rest{octree().view(), octree().particles(), {field.kernel}, field.threshold,
                attributes().color, attributes().one_color, rays, hits};
            exec.for_each_tile_of(hits.undecided.n, rest);
        });
    }

    template <bool shadows, class Kernel, bool PerParticle>
    void trace_tiles(Exec& exec, const FieldRequest& field, const Kernel& kernel, std::bool_constant<PerParticle>,
        const RaySource& rays, const Hits& hits, const float* wetness = nullptr) const {
        const SortedParticles& p = octree().particles();
        const Attributes& a = attributes();
        const TraceTiles<Kernel, PerParticle, shadows> tiles{octree().view(), p, kernel,
            scaled_threshold(field, p, PerParticle), a.color, a.one_color, rays, hits, wetness, a.wet};
        exec.clear(hits.undecided.n, sizeof *hits.undecided.n);
        exec.for_each_tile(tiles.template n_tiles<typename Exec::Group>(), tiles);
    }

    /// fn(tracer) with the tracer through cells.
    template <class Fn> void with_tracer(const FieldRequest& field, const Fn& fn) const {
        with_kinds(octree(), field.kernel,
            [&]<class Kernel, bool PerParticle>(const Kernel& kernel, std::bool_constant<PerParticle>) {
                const SortedParticles& p = octree().particles();
                fn(CellTracer<typename Exec::Lanes, Kernel, PerParticle>{
                    octree().view(), p, kernel, scaled_threshold(field, p, PerParticle), cells.view()});
            });
    }
    /// everywhere: light goes inside, or clips open it; eye: see CellStore.
    void prepare_cells(Exec& exec, const FieldRequest& field, bool everywhere, const float3& eye) const {
        if (mesh.is_there()) return;
        const typename Exec::Stage stage("cells");
        with_tracer(field, [&](const auto& tracer) {
            cells.prepare(exec, field, tracer, octree().max_nodes(), octree().size(), everywhere, eye);
        });
    }
    /// Distances to the first crossing of rays that light sent on, through the cells.
    void march(Exec& exec, const FieldRequest& field, const Clips& clips, const WaveRays& rays, int layer,
        LayerHits& found, bool alone) const {
        const typename Exec::Stage stage("march");
        if (mesh.is_there()) return mesh.march(exec, clips, rays, layer, found);
        if (alone && rays.primary() && clips.n == 0) {  // neighbors: by tiles
            found.sign = nullptr;
            found.cap = nullptr;
            const Hits distances{found.t, nullptr, nullptr, found.undecided};
            trace(exec, field, rays.source, distances);
            return resolve(exec, field, rays.source, distances);
        }
        with_tracer(field, [&](const auto& tracer) {
            using Tracer = std::decay_t<decltype(tracer)>;
            exec.clear(found.undecided.n, sizeof *found.undecided.n);
            with_clips(clips, [&]<bool clipped>(std::bool_constant<clipped>) {
                exec.for_each_walk(
                    rays.source.n_items(), March<Tracer, clipped>{{{tracer, clips}, found}, rays, layer});
            });
            const ResolveRays<Tracer::PerParticle> rest{tracer.tree, octree().particles(), {field.kernel},
                field.threshold, nullptr, {}, rays.source, {found.t, nullptr, nullptr, found.undecided}, clips,
                found.sign, found.cap};
            exec.for_each_tile_of(found.undecided.n, rest);
        });
    }
    /// What is nearest of this layer and those before.
    void keep(Exec& exec, const FieldRequest& field, const Clips& clips, const WaveRays& rays, int layer,
        const LayerHits& found, const WaveHits& hits) const {
        if (mesh.is_there()) return mesh.keep(exec, clips, rays, layer, found, hits);
        with_tracer(field, [&](const auto& tracer) {
            using Tracer = std::decay_t<decltype(tracer)>;
            exec.for_each_uneven(rays.source.n_items(),
                Keep<FieldSurface<Tracer>>{
                    {tracer, attributes(), !(field.thesis && rays.primary())}, clips, rays, layer, found, hits});
        });
    }
    /// Light that this layer lets through to the hits.
    void occlude(Exec& exec, const FieldRequest& field, const Clips& clips, const Lighting& lighting,
        const WaveRays& rays, const WaveHits& hits, int layer, float* visibility) const {
        const typename Exec::Stage stage("occlude");
        if (mesh.is_there()) return mesh.occlude(exec, clips, lighting, rays, hits, layer, visibility);
        with_tracer(field, [&](const auto& tracer) {
            using Tracer = std::decay_t<decltype(tracer)>;
            with_clips(clips, [&]<bool clipped>(std::bool_constant<clipped>) {
                exec.for_each_walk(rays.source.n_items() * lighting.n_visibilities(),
                    Occlude<Tracer, clipped>{{tracer, clips}, attributes(), lighting, rays, hits, layer, visibility});
            });
        });
    }
};

}  // namespace globule::core
