// The cells of one field (trace/build_cells.hpp), made when light first needs them and kept while particles and field stay.
#pragma once
#include "backends/backend.hpp"
#include "exec/buffer.hpp"
#include "trace/build_cells.hpp"

namespace globule::core {

template <class Exec>
class CellStore {
public:
    explicit CellStore(Exec& exec) : grid_(exec), bricks_(exec), lists_(exec), blocks_(exec) {}

    /// The particles are others now, or a build was stopped half way.
    void forget() { known_ = false; }

    Cells view() const { return {grid_.data(), bricks_.data(), lists_.data(), blocks_.data()}; }

    /// Builds them for what the tracer traces, unless they are there.
    template <class Tracer>
    void prepare(Exec& exec, const FieldRequest& field, const Tracer& tracer, std::size_t max_nodes) {
        if (known_ && kernel_ == field.kernel && threshold_ == field.threshold) return;
        known_ = false;
        using Tree = std::decay_t<decltype(tracer.tree)>;
        using Lanes = typename Exec::Lanes;
        constexpr std::size_t block = Lanes::width * block_stride(Tracer::PerParticle, Tracer::Kernel::stretched);
        CellGrid* grid = grid_.reserve(1);
        std::uint32_t* bricks = bricks_.reserve(kMaxBricks);
        for (;;) {
            exec.for_each(1, PlanCells<Tree>{tracer.tree, Tracer::Kernel::stretched, grid});
            exec.clear(bricks, kMaxBricks * sizeof *bricks);
            exec.for_each(max_nodes, MarkBricks<Tree>{tracer.tree, max_nodes, grid, bricks});
            exec.for_each_tile_of(&grid->n_bricks,
                                  BuildCells<Lanes, Tree, std::decay_t<decltype(tracer.kernel)>, Tracer::PerParticle>{
                                      tracer.tree, tracer.particles, tracer.kernel, tracer.tau, grid, bricks, lists_.data(), blocks_.data(),
                                      std::uint32_t(lists_.capacity() / kBrickCells), std::uint32_t(blocks_.capacity() / block)});
            CellGrid g;
            exec.download(&g, grid, sizeof g);
            if (std::size_t(g.n_lists) * kBrickCells <= lists_.capacity() && std::size_t(g.n_blocks) * block <= blocks_.capacity()) break;
            lists_.reserve(std::size_t(g.n_lists + g.n_lists / 4 + 16) * kBrickCells);
            blocks_.reserve(std::size_t(g.n_blocks + g.n_blocks / 4 + 64) * block);
        }
        kernel_ = field.kernel;
        threshold_ = field.threshold;
        known_ = true;
    }

private:
    Buffer<CellGrid, Exec> grid_;
    Buffer<std::uint32_t, Exec> bricks_;
    Buffer<CellList, Exec> lists_;
    Buffer<float, Exec> blocks_;
    KernelName kernel_{};
    float threshold_ = 0.0f;
    bool known_ = false;
};

}  // namespace globule::core
