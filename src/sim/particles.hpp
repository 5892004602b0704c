// The particles of a simulation in a backend's memory: two copies of the state, so that one can be put
// in the octree's order into the other, the tree itself (the scene's), and the rows that the solver moves.
#pragma once
#include <array>
#include <stdexcept>

#include "octree/build.hpp"
#include "sim/approach.hpp"
#include "sim/boundary.hpp"
#include "sim/motion.hpp"
#include "backends/simulation.hpp"

namespace globule::core {

template <class Exec> class SimulationState {
public:
    SimulationState(Exec& exec, Octree<Exec>& tree)
        : exec_(exec),
          tree_(tree),
          copies_{Copy(exec), Copy(exec)},
          positions_(exec),
          new_positions_(exec),
          new_velocities_(exec),
          slot_of_(exec),
          phases_(exec),
          flags_(exec),
          rows_(exec),
          index_(exec),
          size_(exec),
          summary_(exec),
          speeds_(exec),
          limiting2_(exec),
          fast_(exec),
          not_a_number_(exec) {
        exec_.upload(phases_.reserve(sim::kMaxPhases), phase_table.data(), sizeof phase_table);
        exec_.clear(not_a_number_.reserve(1), 4);
    }

    std::array<sim::Phase, sim::kMaxPhases> phase_table{};
    std::size_t n = 0;
    std::uint32_t next_id = 0;
    std::size_t n_rows = 0;
    sim::Summary summary{};

    sim::State view() { return copies_[now_].view(n); }
    const sim::Phase* phases() const { return phases_.data(); }
    const std::uint32_t* rows() const { return rows_.data(); }
    float* positions() { return positions_.reserve(3 * n); }
    std::uint32_t* slot_of() { return slot_of_.data(); }
    std::uint32_t* not_a_number() { return not_a_number_.data(); }
    Octree<Exec>& tree() { return tree_; }

    void set_phase(int which, const sim::Phase& phase) {
        phase_table[which] = phase;
        exec_.upload(phases_.data(), phase_table.data(), sizeof phase_table);
    }

    void configure(const SimulationSettings& s) {
        spline_ = sim::Spline::of(2.0f * s.spacing);
        const sim::LatticeSums sums(spline_, s.spacing);
        volume_ = float(1.0 / sums.all);
        gamma_ = sim::kWallShare * float(sums.plane / sums.all);
        lattice_squares_ = float(sums.squares);
        fine_ = s.fine_fluids;
        const float3 size = s.hi - s.lo;
        period_.length = {s.periodic[0] ? size.x : 0.0f, s.periodic[1] ? size.y : 0.0f, s.periodic[2] ? size.z : 0.0f};
        // Boundaries stand half a spacing outside of the domain's faces.
        const float out = 2.0f * s.spacing;
        params_ = {32, 10, false, true, {s.lo.x - out, s.lo.y - out, s.lo.z - out},
            {s.hi.x + out, s.hi.y + out, s.hi.z + out}};
        if (widest(s) > 1024.0f * 2.0f * s.spacing) {  // a deepest cell would hold too many
            params_.key_bits = 64;
            params_.depth = 21;
        }
    }
    const sim::Spline& spline() const { return spline_; }
    const sim::Period& period() const { return period_; }
    float volume() const { return volume_; }
    float lattice_squares() const { return lattice_squares_; }
    /// Of the slots, since they were settled.
    sim::Sizes sizes() const { return {fine_ ? size_.data() : nullptr}; }
    float size_of_fluid() const { return fine_ ? sim::kFine : 1.0f; }

    /// place.w of a particle of this phase before its boundary's volumes are known.
    float w_of(int phase) const {
        const sim::Phase& p = phase_table[phase];
        return p.kind == sim::Kind::fluid || p.kind == sim::Kind::tissue ? -1.0f / p.density : volume_;
    }

    /// Behind the others, in no order yet: settle() follows.
    /// led: fluid that keeps its velocity and pushes others as a wall does.
    std::uint32_t append(
        std::size_t m, const float* positions, const float* velocities, float3 velocity, int phase, bool led = false) {
        if (n + m > 0x7fffffffull) throw Refused("simulation: expected fewer than 2^31 particles");
        if (m > 0xffffff00ull - next_id)
            throw Refused("simulation: expected fewer than 2^32 particles in all, those that have left included");
        make_room(n + m);
        float* p = new_positions_.reserve(3 * m);
        exec_.upload(p, positions, 12 * m);
        float* v = nullptr;
        if (velocities) exec_.upload(v = new_velocities_.reserve(3 * m), velocities, 12 * m);
        exec_.for_each(m, sim::Append{view(), p, v, std::uint8_t(phase),
                              led ? volume_ * std::pow(size_of_fluid(), 3.0f) : w_of(phase), velocity, next_id});
        const sim::Kind kind = phase_table[phase].kind;
        volumes_stale_ |= kind == sim::Kind::boundary || kind == sim::Kind::rigid;
        n += m;
        next_id += std::uint32_t(m);
        return next_id - std::uint32_t(m);
    }

    /// Room for as many, what is there kept.
    void make_room(std::size_t wanted) {
        if (wanted <= copies_[now_].capacity()) return;
        Copy& larger = copies_[1 - now_];
        larger.reserve(wanted + wanted / 2);
        sim::State to = larger.view(n);
        exec_.for_each(n, sim::CopyState{view(), to});
        now_ = 1 - now_;
    }

    /// Keeps the slots whose flag is 1 ... in their order; `flags` has n + 1 entries and is used up.  How many go.
    std::uint32_t keep(std::uint32_t* flags) {
        exec_.exclusive_scan(n + 1, flags);
        std::uint32_t kept;
        exec_.download(&kept, flags + n, 4);
        const std::uint32_t n_gone = std::uint32_t(n) - kept;
        if (n_gone == 0) return 0;
        std::uint32_t* index = index_.reserve(n);
        exec_.for_each(n, sim::WriteKept{flags, view().id, slot_of_.data(), index});
        reorder(index, kept, nullptr, nullptr, nullptr);
        return n_gone;
    }
    std::uint32_t* flags() { return flags_.reserve(n + 65); }

    /// The octree of the present positions, and the state in its order.
    void settle() {
        float* p = positions_.reserve(3 * n + 3);
        exec_.for_each(n, sim::WritePositions{view().place, p});
        settle_positions();
    }
    /// The same where positions() has been written already.
    void settle_positions() {
        ParticleInput in;
        in.n = n;
        in.positions = positions_.data();
        in.support = {nullptr, spline_.support};
        in.weight = {nullptr, 1.0f};
        tree_.build(in, params_);
        const SortedParticles& sorted = tree_.particles();
        reorder(sorted.index, n, sorted.x, sorted.y, sorted.z);
        if (volumes_stale_) {
            const float gamma = gamma_;
            exec_.for_each_uneven(
                n, sim::BoundaryVolumes{tree_.view(), view(), phases_.data(), spline_, period_, gamma});
            volumes_stale_ = false;
        }
        flag_rows();
    }

    /// The rows anew, where the tree stays but who is held does not; waits for the device.
    void find_rows() {
        flag_rows();
        std::uint32_t found;
        exec_.download(&found, flags_.data() + n, sizeof found);
        n_rows = found;
    }

    /// What the host needs to know before the next step; waits for the device.  `ahead`: where fluids count by how they
    /// approach others; `compression`, `solves` (2): of the step that ends, or null.
    void summarize(const sim::Ahead* ahead, float gravity, float far, const sim::Compression* compression,
        const sim::Outcome* solves) {
        const sim::State s = view();
        const TreeHeader* header = tree_.view().header;
        float* limiting2 = nullptr;
        if (ahead) {
            limiting2 = limiting2_.reserve(n);
            std::uint32_t* fast = fast_.reserve(n + 1);
            exec_.clear(fast, sizeof *fast);
            exec_.for_each(n, sim::OwnSpeed{s, phases_.data(), sizes(), *ahead, limiting2, fast, fast + 1});
            exec_.for_each_tile_of(
                fast, sim::Approach{tree_.view(), s, sizes(), *ahead, 0.5f * spline_.support, fast + 1, limiting2});
        }
        exec_.reduce(n,
            sim::SpeedsOf{s.velocity, limiting2, s.growth, s.place, s.pressure, sizes(), gravity, far, header},
            sim::Fastest{}, sim::Speeds{0.0f, 0.0f, 0.0f}, speeds_.reserve(1));
        sim::Summary* out = summary_.reserve(1);
        exec_.for_each(1,
            sim::Summarize{speeds_.data(), flags_.data() + n, not_a_number_.data(), header, compression, solves, out});
        exec_.download(&summary, out, sizeof summary);
        n_rows = summary.n_rows;
        if (summary.n_wanted > summary.n_nodes) tree_.header();  // the next build makes room
    }

    /// Room for n particles that are written from outside; no id leads anywhere until they are settled.
    void resize(std::size_t count) {
        exec_.for_each(slot_of_.capacity(), sim::Fill{slot_of_.data(), sim::kGone});
        n = 0;
        make_room(count);
        n = count;
    }

private:
    struct Copy {
        Buffer<Quad, Exec> place, velocity;
        Buffer<std::uint32_t, Exec> id;
        Buffer<std::uint8_t, Exec> phase;
        Buffer<float, Exec> pressure, growth, divergence_impulse;
        explicit Copy(Exec& e)
            : place(e), velocity(e), id(e), phase(e), pressure(e), growth(e), divergence_impulse(e) {}
        std::size_t capacity() const { return place.capacity() ? place.capacity() - 64 : 0; }
        void reserve(std::size_t n) {
            place.reserve(n + 64);
            velocity.reserve(n + 64);
            id.reserve(n + 64);
            phase.reserve(n + 64);
            pressure.reserve(n + 64);
            growth.reserve(n + 64);
            divergence_impulse.reserve(n + 64);
        }
        sim::State view(std::size_t n) {
            return {n, place.data(), velocity.data(), id.data(), phase.data(), pressure.data(), growth.data(),
                divergence_impulse.data()};
        }
    };

    static float widest(const SimulationSettings& s) {
        return max(max(s.hi.x - s.lo.x, s.hi.y - s.lo.y), s.hi.z - s.lo.z);
    }

    void reorder(const std::uint32_t* index, std::size_t count, const float* x, const float* y, const float* z) {
        const sim::State from = view();
        Copy& other = copies_[1 - now_];
        if (!other.place.data() || other.capacity() < count) other.reserve(max(count, copies_[now_].capacity()));
        if (next_id > slot_of_.capacity()) {
            slot_of_.reserve(next_id + next_id / 2 + 64);
            exec_.for_each(slot_of_.capacity(), sim::Fill{slot_of_.data(), sim::kGone});
        }
        exec_.for_each(
            count + 1, sim::Reorder{from, other.view(count), index, x, y, z, phases_.data(), slot_of_.data()});
        now_ = 1 - now_;
        n = count;
    }

    void flag_rows() {
        if (fine_) exec_.for_each(n + 64, sim::SizeOf{view(), phases_.data(), size_.reserve(n + 128)});
        std::uint32_t* flags = flags_.reserve(n + 65);
        exec_.for_each(n + 1, sim::FlagRows{view(), phases_.data(), tree_.view().header, flags});
        exec_.exclusive_scan(n + 1, flags);
        exec_.for_each(n + 64, sim::WriteRows{flags, std::uint32_t(n), rows_.reserve(n + 128)});
    }

    Exec& exec_;
    Octree<Exec>& tree_;
    Copy copies_[2];
    int now_ = 0;
    Buffer<float, Exec> positions_, new_positions_, new_velocities_;
    Buffer<std::uint32_t, Exec> slot_of_;
    Buffer<sim::Phase, Exec> phases_;
    Buffer<std::uint32_t, Exec> flags_, rows_, index_;
    Buffer<float, Exec> size_;
    Buffer<sim::Summary, Exec> summary_;
    Buffer<sim::Speeds, Exec> speeds_;
    Buffer<float, Exec> limiting2_;
    Buffer<std::uint32_t, Exec> fast_;  ///< their number, then who
    Buffer<std::uint32_t, Exec> not_a_number_;
    TreeParams params_;
    sim::Spline spline_{};
    sim::Period period_;
    float volume_ = 0, gamma_ = 0, lattice_squares_ = 0;
    bool volumes_stale_ = false, fine_ = false;
};

}  // namespace globule::core
