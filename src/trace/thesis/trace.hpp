// The thesis's tracing of one ray (§5.2-5.4): leaves in order, their candidates, the search between the
// exterior spheres' events, what the hit looks like.  One thread a ray, float32 throughout.
#pragma once
#include "trace/thesis/bezier.hpp"
#include "trace/thesis/march_thresholds.hpp"
#include "trace/thesis/normals.hpp"
#include "trace/tile_rays.hpp"

namespace globule::core::thesis {

/// f along the ray, from the candidates.
template <class Kernel> struct FieldOnRay {
    Candidates& candidates;
    const Kernel& kernel;
    GB_FN float operator()(float t) const {
        const SortedParticles& particles = candidates.particles();
        const float3 p = candidates.ray().at(t);
        float f = 0.0f;
        candidates.count_sum();
        candidates.each([&](const Candidate& s) {
            if (t < s.enter || t > s.leave) return;
            const float a = particles.support[s.slot];
            const float3 v = p - particles.position(s.slot);
            float b, slope;
            kernel(min(dot(v, v) / (a * a), 1.0f), b, slope);
            f += particles.weight[s.slot] * b;
        });
        return f;
    }
};

/// Search: March, its step in typical supports, or Bezier<degree>.
template <class Kernel, class Search> struct TraceRays {
    DenseTree tree;
    const std::uint8_t* near;  ///< from MarkNear, or null without ghosts
    SortedParticles particles;
    Kernel kernel;
    Search search;
    ThesisRequest choice;
    float tau;
    float lone;          ///< lone_surface(), or NaN where weights differ
    const float* color;  ///< (n, 3), caller's order, or null
    float3 one_color;
    RaySource rays;
    Hits out;
    ThesisWork* work;  ///< (n,), or null

    static constexpr bool marches = requires(Search s) { s.step; };

    struct Nothing {};
    template <class Group> using Scratch = Nothing;
    template <class Group> using Layout = TileLayout<4, Group::width>;  ///< no wider than the narrowest group

    template <class Group> std::size_t n_tiles() const { return Layout<Group>{rays}.n_tiles(); }

    /// Tiles of pixels are only how rays are dealt out: each lane traces its own, alone.
    template <class Group> GB_FN void operator()(Group& g, Nothing&, std::size_t tile) const {
        g.per_lane(g.first_lanes(Group::width), [&](int lane) {
            const std::size_t i = Layout<Group>{rays}.ray(tile, lane);
            if (i < rays.n) trace_ray(i);
        });
    }

private:
    GB_FN void trace_ray(std::size_t i) const {
        out.t[i] = infinity();
        if (work) work[i] = {};
        Look seen{{0, 0, 0}, {0, 0, 0}};
        if (!tree.empty()) trace(i, seen);
        if (!out.normal) return;
        write3(out.normal, i, seen.normal);
        write3(out.albedo, i, seen.albedo);
    }

    GB_FN void trace(std::size_t i, Look& seen) const {
        float3 o, d;
        rays.get(i, o, d);
        const float reach = choice.ghosts ? tree.nodes[0].reach : 0.0f;
        const Grid grid{tree.header->space, tree.header->depth, reach};
        Visit root{0, 0, 0.0f, 0.0f, 0};
        if (!slab_test(grid, Ray(o, d), root)) return;
        // Counted from the root's box, not from the eye: far eyes cost no precision.
        const float start = root.enter;
        o = {float(o.x + double(start) * d.x), float(o.y + double(start) * d.y), float(o.z + double(start) * d.z)};
        const Ray ray(o, d);
        Stack stack(grid, ray, {tree.nodes, near});
        Candidates candidates(
            tree, particles, grid, ray, {choice.ghosts, choice.face_rule, choice.exterior || !marches});
        float sign = 1.0f;  // -1 where the ray begins inside the medium
        for (Visit leaf; stack.next(leaf);) {
            candidates.gather(leaf);
            if (start <= 0.0f && leaf.enter <= 0.0f && FieldOnRay<Kernel>{candidates, kernel}(0.0f) > tau) sign = -1.0f;
            float t;
            const bool found = find(candidates, leaf, sign, t);
            if (work) work[i] = candidates.work();
            if (!found) continue;
            out.t[i] = start + t;
            seen = look(candidates, kernel, color, one_color, choice.averaged_normals, t);
            return;
        }
    }

    GB_FN bool find(Candidates& candidates, const Visit& leaf, float sign, float& t) const {
        float from = leaf.enter, end = leaf.leave;
        if (choice.exterior && candidates.complete() && sign > 0.0f) {
            int n = 0;
            float last = from;
            for (; n < candidates.size() && candidates[n].enter < end; ++n) last = max(last, candidates[n].leave);
            if (n == 0) return false;
            if (n == 1 && lone == lone)
                return meet_lone(candidates[0], particles.support[candidates[0].slot], lone, from, end, t);
            from = max(from, candidates[0].enter);
            end = min(end, last);
        }
        if constexpr (marches) {
            const March march{search.step * tree.header->typical_support, search.n_thresholds, search.refine};
            return march(FieldOnRay<Kernel>{candidates, kernel}, tau, sign, from, end, t);
        } else {
            return search(candidates, tau, sign, from, end, t);
        }
    }
};

}  // namespace globule::core::thesis
