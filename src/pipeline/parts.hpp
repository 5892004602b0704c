// Parts of rays through one piece of a scene, for who sends rays from piece to piece.
#pragma once
#include "exec/buffer.hpp"
#include "pipeline/trace.hpp"
#include "trace/segment.hpp"

namespace globule::core {

/// Host memory in and out.
template <class Exec> class PartTracer {
public:
    explicit PartTracer(Exec& exec) : floats_(exec), integers_(exec), bytes_(exec), undecided_(exec) {}

    /// The cells are there, everywhere.
    void march(Exec& exec, const Traced<Exec>& scene, const FieldRequest& field, const Clips& clips, const RayParts& in,
        float* t, std::int32_t* cap, float* looks) {
        const std::size_t n = in.n;
        if (n == 0) return;
        float* room = floats_.reserve(23 * n);
        const Parts parts = bring(exec, in, room);
        float *found_t = room + 8 * n, *origins = found_t + n, *directions = origins + 3 * n,
              *found_looks = directions + 3 * n;
        std::int32_t* found_cap = integers_.reserve(n);
        std::uint32_t* undecided = undecided_.reserve(n + 1);
        const LayerHits found{found_t, found_cap, parts.side, nullptr, {undecided, undecided + 1}};
        exec.clear(undecided, sizeof *undecided);
        exec.clear(found_looks, 8 * n * sizeof(float));
        scene.with_tracer(field, [&](const auto& tracer) {
            using Tracer = std::decay_t<decltype(tracer)>;
            exec.for_each_walk(n, MarchPart<Tracer>{{{tracer, clips}, found}, parts});
            exec.for_each(n, SplitRays{parts.ray, origins, directions});
            const RaySource source{{}, origins, directions, n};
            exec.for_each_tile_of(
                undecided, ResolveRays<Tracer::PerParticle>{tracer.tree, scene.octree().particles(), {field.kernel},
                               field.threshold, nullptr, {}, source, {found.t, nullptr, nullptr, found.undecided},
                               clips, found.sign, found.cap});
            exec.for_each_uneven(n, LookAtParts<Tracer>{{tracer, scene.attributes()}, parts, found, found_looks});
        });
        exec.download(t, found.t, n * sizeof(float));
        exec.download(cap, found.cap, n * sizeof(std::int32_t));
        exec.download(looks, found_looks, 8 * n * sizeof(float));
        exec.download(in.side, parts.side, n);
    }

    void occlude(Exec& exec, const Traced<Exec>& scene, const FieldRequest& field, const Clips& clips,
        const Material& material, const RayParts& in, const ShadowParts& shadow) {
        const std::size_t n = in.n;
        if (n == 0) return;
        float* room = floats_.reserve(11 * n);
        const Parts parts = bring(exec, in, room);
        float *distance = room + 8 * n, *left = distance + n, *on = left + n;
        std::int32_t* crossings = integers_.reserve(n);
        std::int8_t* test = parts.side + n;
        exec.upload(distance, shadow.distance, n * sizeof(float));
        exec.upload(left, shadow.left, n * sizeof(float));
        exec.upload(crossings, shadow.crossings, n * sizeof(std::int32_t));
        exec.upload(test, shadow.test, n);
        Lighting lighting{};
        lighting.materials[0] = material;
        scene.with_tracer(field, [&](const auto& tracer) {
            using Tracer = std::decay_t<decltype(tracer)>;
            exec.for_each_walk(
                n, OccludePart<Tracer>{{{tracer, clips}, scene.attributes(), lighting, {}, {}, 0, nullptr}, parts,
                       distance, left, on, crossings, test});
        });
        exec.download(shadow.left, left, n * sizeof(float));
        exec.download(shadow.on, on, n * sizeof(float));
        exec.download(shadow.crossings, crossings, n * sizeof(std::int32_t));
        exec.download(shadow.test, test, n);
        exec.download(in.side, parts.side, n);
    }

private:
    Parts bring(Exec& exec, const RayParts& in, float* room) {
        const std::size_t n = in.n;
        std::int8_t* side = bytes_.reserve(2 * n);
        exec.upload(room, in.ray, 6 * n * sizeof(float));
        exec.upload(room + 6 * n, in.from, n * sizeof(float));
        exec.upload(room + 7 * n, in.to, n * sizeof(float));
        exec.upload(side, in.side, n);
        return {room, room + 6 * n, room + 7 * n, side};
    }

    Buffer<float, Exec> floats_;
    Buffer<std::int32_t, Exec> integers_;
    Buffer<std::int8_t, Exec> bytes_;
    Buffer<std::uint32_t, Exec> undecided_;
};

}  // namespace globule::core
