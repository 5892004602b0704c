// Tissue over any Exec: where its arrays lie, and the order of its stages.
#pragma once
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>

#include "globule/exec/buffer.hpp"
#include "globule/sim/ablate.hpp"
#include "globule/sim/pieces.hpp"
#include "tissue.hpp"

namespace globule {

template <class Exec>
class TissueOf {
public:
    explicit TissueOf(Exec& exec)
        : exec_(exec), at_(exec), next_(exec), velocity_(exec), acceleration_(exec), pull_(exec), before_(exec), id_(exec), hold_(exec),
          phase_(exec), first_(exec), other_(exec), length_(exec), stiffness_(exec), vessel_(exec), lambda_(exec), label_(exec),
          least_id_(exec), piece_(exec), count_(exec), vertices_(exec), triangles_(exec) {}

    std::uint32_t n() const { return n_; }

    void build(const TissueArrays& in) {
        n_ = in.n;
        contact_ = in.contact;
        std::vector<tissue::Packed> at(n_), velocity(n_);
        for (std::uint32_t t = 0; t < n_; ++t) {
            const float* p = in.positions + 3 * std::size_t(t);
            at[t] = {p[0], p[1], p[2], in.inverse_mass[t] * in.bound[t]};
            velocity[t] = {0, 0, 0, in.inverse_mass[t]};
        }
        put(at_, at.data(), n_);
        put(velocity_, velocity.data(), n_);
        put(id_, in.ids, n_);
        put(hold_, in.hold, n_);
        put(phase_, in.phase, n_);
        next_.reserve(n_);
        acceleration_.reserve(n_);
        before_.reserve(n_);
        exec_.clear(before_.data(), n_ * sizeof(float3));
        build_bonds(in, at);
        pieces_known_ = follows_ = pulled_ = false;
        exec_.synchronize();  // the vectors end here
    }

    void set_materials(const tissue::Materials& materials) { materials_ = materials; }

    /// Substeps that keep the static stiffness exact.
    int substeps_for(float dt) const { return std::max(1, int(std::ceil(double(dt) * fastest_))); }

    /// Moves the tissue by its own forces.
    int advance(const TissueStep& step) {
        if (n_ == 0) return 0;
        exec_.for_each(n_, tissue::Accelerate{acceleration_.data(), pulled_ ? pull_.data() : nullptr, step.gravity});
        return substeps(step);
    }

    std::uint32_t tear(float dt) {
        return counted([&](std::uint32_t* n_torn) {
            exec_.for_each(n_, tissue::TearAndCreep{bonds(), at_.data(), phase_.data(), materials_, dt, n_torn});
        });
    }

    void follow() {
        exec_.for_each(n_, tissue::Remember{at_.data(), before_.data()});
        follows_ = true;
    }

    std::uint32_t cut(const BladeSweep& blade) {
        if (n_ == 0 || blade.n_triangles == 0) return 0;
        const tissue::Sweep sweep = on_grid(blade);
        const float3* before = blade.n_moving && follows_ ? before_.data() : nullptr;
        return counted([&](std::uint32_t* n_cut) { exec_.for_each(n_, tissue::Cut{bonds(), at_.data(), before, sweep, n_cut}); });
    }

    /// Number of pieces; their labels are then in piece().
    std::uint32_t pieces() {
        if (pieces_known_) return n_pieces_;
        std::uint32_t* label = label_.reserve(n_);
        exec_.for_each(n_, tissue::OwnLabel{label});
        for (std::uint32_t changed = 1; changed;) {
            std::uint32_t* flag = count_.reserve(1);
            exec_.clear(flag, sizeof *flag);
            exec_.for_each(n_, tissue::Hook{bonds(), label, flag});
            exec_.for_each(n_, tissue::Jump{label});
            exec_.download(&changed, flag, sizeof changed);
        }
        std::uint32_t* least_id = least_id_.reserve(n_);
        exec_.for_each(n_, tissue::Fill{least_id, ~0u});
        n_pieces_ = count([&](std::uint32_t* n) {
            exec_.for_each(n_, tissue::LeastId{label, id_.data(), hold_.data(), least_id, n});
        });
        exec_.for_each(n_, tissue::TakeLeastId{label, least_id, piece_.reserve(n_)});
        pieces_known_ = true;
        return n_pieces_;
    }
    const std::uint32_t* piece() const { return piece_.data(); }

    void grasp(const float3& center, float radius, int number) {
        exec_.for_each(n_, tissue::Grasp<tissue::Packed>{at_.data(), hold_.data(), center, radius, std::uint8_t(number)});
    }

    /// Takes the particles inside the shape away, with all their bonds.
    std::uint32_t remove(const tissue::Shape& region) {
        const std::uint32_t n_removed = counted([&](std::uint32_t* n) {
            exec_.for_each(n_, tissue::TakeAway{at_.data(), hold_.data(), region, n});
        });
        if (n_removed) exec_.for_each(n_, tissue::DropBonds{bonds(), hold_.data()});
        return n_removed;
    }

    std::uint32_t n_bonds() {
        return count([&](std::uint32_t* n) { exec_.for_each(n_, tissue::CountBonds{bonds(), n}); });
    }

    void get(float* positions, float* velocities, std::uint32_t* piece, std::uint8_t* hold) {
        take_out(at_, positions);
        take_out(velocity_, velocities);
        if (piece) {
            pieces();
            exec_.download(piece, piece_.data(), n_ * sizeof *piece);
        }
        if (hold) exec_.download(hold, hold_.data(), n_);
    }
    void accelerate(const float* accelerations) {
        pulled_ = accelerations != nullptr;
        if (pulled_) put(pull_, reinterpret_cast<const float3*>(accelerations), n_);
        exec_.synchronize();
    }
    void set(const float* positions, const float* velocities) {
        put_in(at_, positions);
        put_in(velocity_, velocities);
    }

private:
    tissue::Bonds bonds() {
        return {n_, first_.data(), other_.data(), length_.data(), stiffness_.data(), has_vessels_ ? vessel_.data() : nullptr};
    }

    /// Rows of 32 particles' k-th bonds; shorter rows are filled up with bonds of no length.
    void build_bonds(const TissueArrays& in, const std::vector<tissue::Packed>& at) {
        using tissue::kBlock;
        const std::uint32_t n_blocks = ceil_div<std::uint32_t>(n_, kBlock);
        std::vector<std::uint32_t> first(n_blocks + 1, 0);
        for (std::uint32_t b = 0; b < n_blocks; ++b) {
            std::uint64_t widest = 0;
            for (std::uint32_t t = b * kBlock; t < std::min(n_, (b + 1) * kBlock); ++t)
                widest = std::max(widest, in.offsets[t + 1] - in.offsets[t]);
            const std::uint64_t end = first[b] + widest * kBlock;
            if (end > 0xffffffffull) throw std::runtime_error("bonds: expected fewer than 2^31 bonds");
            first[b + 1] = std::uint32_t(end);
        }
        n_entries_ = first[n_blocks];
        std::vector<std::uint32_t> other(n_entries_);
        std::vector<float> length(n_entries_, 0.0f), stiffness(n_entries_, 0.0f);
        std::vector<std::uint8_t> vessel(in.vessel ? n_entries_ : 0, 0);
        for (std::uint32_t b = 0; b < n_blocks; ++b)
            for (std::uint32_t e = first[b]; e < first[b + 1]; ++e) other[e] = std::min(n_ - 1, b * kBlock + (e - first[b]) % kBlock);
        double fastest = 0.0;
        for (std::uint32_t t = 0; t < n_; ++t)
            for (std::uint64_t i = in.offsets[t]; i < in.offsets[t + 1]; ++i) {
                const std::uint32_t e = first[t / kBlock] + std::uint32_t(i - in.offsets[t]) * kBlock + t % kBlock;
                other[e] = in.other[i];
                length[e] = in.length[i];
                stiffness[e] = in.stiffness[i];
                if (in.vessel) vessel[e] = in.vessel[i];
                fastest = std::max(fastest, double(in.stiffness[i]) * (double(at[t].w) + at[in.other[i]].w));
            }
        fastest_ = std::sqrt(fastest);
        has_vessels_ = in.vessel != nullptr;
        put(first_, first.data(), first.size());
        put(other_, other.data(), n_entries_);
        put(length_, length.data(), n_entries_);
        put(stiffness_, stiffness.data(), n_entries_);
        if (has_vessels_) put(vessel_, vessel.data(), n_entries_);
        exec_.synchronize();
    }

    int substeps(const TissueStep& step) {
        const int n_substeps = step.substeps > 0 ? step.substeps : substeps_for(step.dt);
        const float dt = step.dt / float(n_substeps);
        exec_.for_each(n_, tissue::Predict{at_.data(), velocity_.data(), acceleration_.data(), hold_.data(), step.motions, dt});
        float* lambda = step.iterations > 1 ? lambda_.reserve(n_entries_) : nullptr;
        tissue::Shapes shapes = step.shapes;
        tissue::Packed *at = at_.data(), *next = next_.data();
        for (int s = 0; s < n_substeps; ++s) {
            shapes.move(dt);
            for (int k = 0; k < step.iterations; ++k) {
                exec_.for_each(n_, tissue::Relax{bonds(), at, next, velocity_.data(), acceleration_.data(), hold_.data(), phase_.data(),
                                                 lambda, materials_, step.motions, shapes, dt, contact_, k == 0,
                                                 k + 1 == step.iterations, s + 1 < n_substeps});
                std::swap(at, next);
            }
        }
        if (at != at_.data()) exec_.for_each(n_, tissue::CopyPacked{at, at_.data()});
        return n_substeps;
    }
    /// The grid is a power of two times finer than float32 positions of that size need, and the same for
    /// every sweep through this tissue.
    tissue::Sweep on_grid(const BladeSweep& blade) {
        tissue::Sweep sweep;
        sweep.grid.cells_per_unit = std::exp2(std::floor(std::log2(65536.0 / contact_)));
        std::vector<tissue::GridPoint> vertices(blade.n_vertices);
        double lo[3] = {1e300, 1e300, 1e300}, hi[3] = {-1e300, -1e300, -1e300};
        for (std::uint32_t v = 0; v < blade.n_vertices; ++v) {
            const double* p = blade.vertices + 3 * std::size_t(v);
            vertices[v] = {sweep.grid.snap(p[0], 0), sweep.grid.snap(p[1], 1), sweep.grid.snap(p[2], 2)};
            for (int k = 0; k < 3; ++k) lo[k] = std::min(lo[k], p[k]), hi[k] = std::max(hi[k], p[k]);
        }
        const double margin = 1e-3 * contact_;
        sweep.lo = {float(lo[0] - margin), float(lo[1] - margin), float(lo[2] - margin)};
        sweep.hi = {float(hi[0] + margin), float(hi[1] + margin), float(hi[2] + margin)};
        put(vertices_, vertices.data(), vertices.size());
        put(triangles_, blade.triangles, 3 * std::size_t(blade.n_triangles));
        exec_.synchronize();
        sweep.vertices = vertices_.data();
        sweep.triangles = triangles_.data();
        sweep.n = blade.n_triangles;
        sweep.n_moving = blade.n_moving;
        return sweep;
    }

    template <class Launch>
    std::uint32_t count(const Launch& launch) {
        if (n_ == 0) return 0;
        std::uint32_t n = 0, *counter = count_.reserve(1);
        exec_.clear(counter, sizeof n);
        launch(counter);
        exec_.download(&n, counter, sizeof n);
        return n;
    }
    /// Bonds that went change the pieces.
    template <class Launch>
    std::uint32_t counted(const Launch& launch) {
        const std::uint32_t n = count(launch);
        if (n) pieces_known_ = false;
        return n;
    }

    template <class T>
    void put(Buffer<T, Exec>& buffer, const T* from, std::size_t n) {
        if (n) exec_.upload(buffer.reserve(n), from, n * sizeof(T));
    }
    void take_out(const Buffer<tissue::Packed, Exec>& buffer, float* to) {
        if (!to) return;
        std::vector<tissue::Packed> all(n_);
        exec_.download(all.data(), buffer.data(), n_ * sizeof(tissue::Packed));
        for (std::size_t t = 0; t < n_; ++t) std::memcpy(to + 3 * t, &all[t], 3 * sizeof(float));
    }
    void put_in(Buffer<tissue::Packed, Exec>& buffer, const float* from) {
        if (!from) return;
        std::vector<tissue::Packed> all(n_);
        exec_.download(all.data(), buffer.data(), n_ * sizeof(tissue::Packed));
        for (std::size_t t = 0; t < n_; ++t) std::memcpy(&all[t], from + 3 * t, 3 * sizeof(float));
        put(buffer, all.data(), n_);
        exec_.synchronize();
    }

    Exec& exec_;
    std::uint32_t n_ = 0, n_entries_ = 0, n_pieces_ = 0;
    float contact_ = 0.0f;
    double fastest_ = 0.0;  ///< 1/s: the number of substeps a second
    bool has_vessels_ = false, pieces_known_ = false, follows_ = false, pulled_ = false;
    tissue::Materials materials_;
    Buffer<tissue::Packed, Exec> at_, next_, velocity_;
    Buffer<float3, Exec> acceleration_, pull_, before_;
    Buffer<std::uint32_t, Exec> id_;
    Buffer<std::uint8_t, Exec> hold_, phase_;
    Buffer<std::uint32_t, Exec> first_, other_;
    Buffer<float, Exec> length_, stiffness_;
    Buffer<std::uint8_t, Exec> vessel_;
    Buffer<float, Exec> lambda_;
    Buffer<std::uint32_t, Exec> label_, least_id_, piece_, count_;
    Buffer<tissue::GridPoint, Exec> vertices_;
    Buffer<std::uint32_t, Exec> triangles_;
};

/// Tissue alone, with its own means.
template <class Exec>
class TissueAlone final : public Tissue {
public:
    template <class... Args>
    explicit TissueAlone(Args&&... args) : exec_(std::forward<Args>(args)...), tissue_(exec_) {}
    void build(const TissueArrays& arrays) override { tissue_.build(arrays); }
    void set_materials(const tissue::Materials& materials) override { tissue_.set_materials(materials); }
    int advance(const TissueStep& step) override { return tissue_.advance(step); }
    std::uint32_t tear(float dt) override { return tissue_.tear(dt); }
    void follow() override { tissue_.follow(); }
    std::uint32_t cut(const BladeSweep& sweep) override { return tissue_.cut(sweep); }
    std::uint32_t pieces() override { return tissue_.pieces(); }
    void grasp(const float3& center, float radius, int number) override { tissue_.grasp(center, radius, number); }
    std::uint32_t remove(const tissue::Shape& region) override { return tissue_.remove(region); }
    std::uint32_t n_bonds() override { return tissue_.n_bonds(); }
    void get(float* positions, float* velocities, std::uint32_t* piece, std::uint8_t* hold) override {
        tissue_.get(positions, velocities, piece, hold);
    }
    void set(const float* positions, const float* velocities) override { tissue_.set(positions, velocities); }
    void accelerate(const float* accelerations) override { tissue_.accelerate(accelerations); }

private:
    Exec exec_;
    TissueOf<Exec> tissue_;
};

}  // namespace globule
