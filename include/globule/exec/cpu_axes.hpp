// Steps from cell to cell (trace/cells.hpp) on the CPU: the three axes side by side in four lanes, without
// a branch that would be guessed wrong.
#pragma once
#include <cstddef>
#include <cstring>

#include "globule/base/scalar.hpp"
#include "globule/base/wide.hpp"

namespace globule {

/// A CellWalk in registers, to be written back with write(); brick: cells a side.
template <class Walk, int brick_cells>
class CpuAxes {
public:
    float t;

    explicit CpuAxes(Walk& w) : t(w.t), walk_(w), edge_(w.grid->edge), per_(1.0f / edge_) {
        static_assert(offsetof(Walk, inv) == offsetof(Walk, d) + 12 && offsetof(Walk, at) == offsetof(Walk, d) + 24 &&
                      offsetof(Walk, x) == offsetof(Walk, d) + 36 && offsetof(Walk, t) == offsetof(Walk, x) + 12);
        // What the fourth lanes hold does not matter.
        std::memcpy(&d_.v, &w.d, sizeof d_.v);
        std::memcpy(&inverse_.v, &w.inv, sizeof d_.v);
        std::memcpy(&at_.v, &w.at, sizeof d_.v);
        std::memcpy(&cell_, &w.x, sizeof cell_);
        n_ = I{w.grid->nx, w.grid->ny, w.grid->nz, 0} * brick_cells;
        up_ = d_.v > 0.0f;
        flat_ = {magnitude(d_).v <= 1e-18f};
        inside_ = w.inside();
    }
    /// The walk itself, brought up to date.
    const Walk& write() {
        I all = cell_;
        std::memcpy(reinterpret_cast<char*>(&all) + 12, &t, sizeof t);
        all[0] = inside_ ? all[0] : -1;
        std::memcpy(&walk_.x, &all, sizeof all);
        return walk_;
    }
    bool inside() const { return inside_; }
    std::uint32_t brick() const {
        const I b = cell_ / brick_cells;
        return (std::uint32_t(b[2]) * walk_.grid->ny + std::uint32_t(b[1])) * walk_.grid->nx + std::uint32_t(b[0]);
    }
    int cell_in_brick() const {
        const I c = cell_ & (brick_cells - 1);
        return (c[2] * brick_cells + c[1]) * brick_cells + c[0];
    }
    float leave() const {
        const F s = sides(cell_, 1);
        return most(t, least(least(s.v[0], s.v[1]), s.v[2]));
    }
    void step(int size) {
        const I first = cell_ & -size;
        const F s = sides(first, size);
        const float next = least(least(s.v[0], s.v[1]), s.v[2]);
        t = most(t, next);
        // Across the first axis that is reached; on the others to where t lies in the box.
        static constexpr std::int32_t lowest[8] = {0, 1, 2, 1, 4, 1, 2, 1};
        const I axis = I{1, 2, 4, 0}, across = ((I{} + lowest[bits(Mask{s.v == F(next).v}) & 7]) & axis) != 0;
        const I ahead = up_ ? first + size : first - 1;
        const F there = (at_ + d_ * F(t)) * F(per_);
        const F in_box = most(F(__builtin_convertvector(first, V)), least(there, F(__builtin_convertvector(first + (size - 1), V))));
        cell_ = across ? ahead : __builtin_convertvector(in_box.v, I);
        inside_ = (bits(Mask{(cell_ >= 0) & (cell_ < n_)}) & 7) == 7 && next < infinity();
    }
    /// As octants_on.
    template <class Vec>
    static std::uint32_t octants(const Vec& from, const Vec& along, float end) {
        const F p = V{from.x, from.y, from.z, 0}, d = V{along.x, along.y, along.z, 0};
        const std::uint32_t first = bits(Mask{(p.v > 0.0f) | ((p.v == 0.0f) & (d.v > 0.0f))}) & 7;
        const I turns = ((p * d).v < 0.0f) & (magnitude(p).v < (F(end) * magnitude(d)).v);
        const F t = turns ? (-p / select(Mask{turns}, d, F(1.0f))).v : F(infinity()).v;
        std::uint32_t on = 1u << first;
        for (int k = 0; k < 3; ++k) on |= t.v[k] < infinity() ? 1u << (first ^ (bits(t <= F(t.v[k])) & 7)) : 0u;
        return on;
    }

private:
    using F = Wide<4>;
    using Mask = F::Mask;
    using V = F::Vec;
    using I = Mask::Vec;
    F sides(I first, int size) const {
        const F plane = __builtin_convertvector(first + (up_ & size), V);
        return select(flat_, F(infinity()), (plane * F(edge_) - at_) * inverse_);
    }

    Walk& walk_;
    F d_, inverse_, at_;
    I cell_, n_, up_;
    Mask flat_;
    float edge_, per_;
    bool inside_;
};

}  // namespace globule
