// Runs the thesis's own tracing (trace/thesis) on a dense octree.
#pragma once
#include <limits>

#include "backends/backend.hpp"
#include "octree/build.hpp"
#include "trace/thesis/trace.hpp"

namespace globule::core {

/// What a trace needs beside the rays; `near` and `work` keep their room from frame to frame.
template <class Exec> struct ThesisTracer {
    Exec& exec;
    const Octree<Exec>& octree;
    Buffer<std::uint8_t, Exec>& near;
    Buffer<ThesisWork, Exec>& work;
    ThesisRequest choice;
    FieldRequest field;
    const float* color;
    float3 one_color;

    void operator()(const RaySource& rays, const Hits& hits) const {
        const bool fast = field.kernel == KernelName::murakami;
        if (choice.root == ThesisRoot::march) {
            const thesis::March march{choice.step, choice.n_thresholds, choice.refine};
            if (fast) run(Murakami{}, march, rays, hits);
            else run(AnyKernel{field.kernel}, march, rays, hits);
        } else if (fast) {
            run(Murakami{}, thesis::Bezier<4>{}, rays, hits);
        } else {
            run(AnyKernel{KernelName::wyvill}, thesis::Bezier<6>{}, rays, hits);
        }
    }

private:
    template <class Kernel, class Search>
    void run(const Kernel& kernel, const Search& search, const RaySource& rays, const Hits& hits) const {
        const DenseTree tree = octree.dense();
        const SortedParticles& particles = octree.particles();
        std::uint8_t* flags = nullptr;
        if (choice.ghosts) {
            flags = near.reserve(octree.n_dense_nodes());
            exec.clear(flags, octree.n_dense_nodes());
            const auto* keys = static_cast<const thesis::Key*>(octree.keys());
            exec.for_each(octree.size(), thesis::MarkNear{tree, particles, keys, flags});
        }
        const float lone = particles.weight.data
                               ? std::numeric_limits<float>::quiet_NaN()
                               : thesis::lone_surface(kernel, particles.weight.uniform, field.threshold);
        const thesis::TraceRays<Kernel, Search> trace{tree, flags, particles, kernel, search, choice, field.threshold,
            lone, color, one_color, rays, hits, choice.count ? work.reserve(rays.n) : nullptr};
        exec.for_each_tile(trace.template n_tiles<typename Exec::Group>(), trace);
    }
};

}  // namespace globule::core
