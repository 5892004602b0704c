// The cells of one field (trace/build_cells.hpp), made when light first needs them and kept while particles and field
// stay.
#pragma once
#include "backends/backend.hpp"
#include "exec/buffer.hpp"
#include "trace/build_cells.hpp"

namespace globule::core {

template <class Exec> class CellStore {
public:
    explicit CellStore(Exec& exec) : grid_(exec), bricks_(exec), next_(exec), lists_(exec), blocks_(exec) {}

    /// The particles are others now, or a build was stopped half way.
    void forget() { known_ = false; }

    Cells view() const { return {grid_.data(), bricks_.data(), lists_.data(), blocks_.data()}; }

    /// Builds them for what the tracer traces, unless they are there.
    /// everywhere: rays go inside; else only cells that rays from an eye outside can reach.
    template <class Tracer>
    void prepare(Exec& exec, const FieldRequest& field, const Tracer& tracer, std::size_t max_nodes, std::size_t n,
        bool everywhere, const float3& eye) {
        if (known_ && kernel_ == field.kernel && threshold_ == field.threshold &&
            (made_.everywhere || !(everywhere || made_.holds(eye))))
            return;
        known_ = false;
        using Lanes = typename Exec::Lanes;
        constexpr std::size_t block = Lanes::width * block_stride(Tracer::PerParticle, Tracer::Kernel::stretched);
        constexpr int kRounds = 3;  // between two looks whether there are more: fluids have no others
        const std::size_t most = max(std::size_t(kMaxBricks), n / 2),
                          room = most + most / 128;  // float32 rounds numbers past 2^24
        CellGrid* grid = grid_.reserve(1);
        std::uint32_t *bricks = bricks_.reserve(room), *next = next_.reserve(room);
        const auto list = [&] {
            exec.for_each(1, BeginBricks{grid});
            exec.for_each(Exec::on_device ? room : grid->n_bricks, ListBricks{grid, bricks, next});
        };
        for (;;) {
            exec.for_each(1, PlanCells{tracer.tree, Tracer::Kernel::stretched, float(most), everywhere, eye, grid});
            exec.clear(bricks, room * sizeof *bricks);
            exec.for_each(max_nodes, MarkBricks{tracer.tree, max_nodes, grid, bricks});
            list();
            do {
                for (int round = 0; round < (everywhere ? 1 : kRounds); ++round) {
                    exec.for_each_tile_of(&grid->n_next,
                        BuildCells<Lanes, std::decay_t<decltype(tracer.kernel)>, Tracer::PerParticle>{tracer.tree,
                            tracer.particles, tracer.kernel, tracer.tau, grid, bricks, next, lists_.data(),
                            blocks_.data(), std::uint32_t(lists_.capacity() / kBrickCells),
                            std::uint32_t(blocks_.capacity() / block)});
                    list();
                }
                exec.download(&made_, grid, sizeof made_);
            } while (made_.n_next);
            if (std::size_t(made_.n_lists) * kBrickCells <= lists_.capacity() &&
                std::size_t(made_.n_blocks) * block <= blocks_.capacity())
                break;
            lists_.reserve(std::size_t(made_.n_lists + made_.n_lists / 4 + 16) * kBrickCells);
            blocks_.reserve(std::size_t(made_.n_blocks + made_.n_blocks / 4 + 64) * block);
        }
        exec.for_each(made_.n_bricks, CloseBricks{grid, bricks});
        kernel_ = field.kernel;
        threshold_ = field.threshold;
        known_ = true;
    }

private:
    Buffer<CellGrid, Exec> grid_;
    Buffer<std::uint32_t, Exec> bricks_, next_;
    CellGrid made_{};  ///< as the device has it
    Buffer<CellList, Exec> lists_;
    Buffer<float, Exec> blocks_;
    KernelName kernel_{};
    float threshold_ = 0.0f;
    bool known_ = false;
};

}  // namespace globule::core
