// Steps from cell to cell (trace/cells.hpp) on the CPU: the three axes side by side in four lanes, without
// a branch that would be guessed wrong.
#pragma once
#include <cstddef>
#include <cstring>

#include "globule/base/scalar.hpp"
#include "globule/base/wide.hpp"

namespace globule {

struct CpuAxes {
    /// As CellWalk::step.
    template <class Walk>
    static void step(Walk& w, int size, int cells_in_brick) {
        const Ray r(w);
        const I first = r.cell & -size;
        const F sides = r.sides(first, size, w.grid->edge);
        const float next = least(least(sides.v[0], sides.v[1]), sides.v[2]);
        w.t = most(w.t, next);
        // Across the first axis that is reached; on the others to where t lies in the box.
        static constexpr std::int32_t lowest[8] = {0, 1, 2, 1, 4, 1, 2, 1};
        const I axis = I{1, 2, 4, 0}, across = (I{} + lowest[bits(Mask{sides.v == F(next).v}) & 7] & axis) != 0;
        const I ahead = r.up ? first + size : first - 1;
        const F at = (r.at + r.d * F(w.t)) * F(1.0f / w.grid->edge);
        const F in_box = most(F(__builtin_convertvector(first, V)), least(at, F(__builtin_convertvector(first + (size - 1), V))));
        const I cell = across ? ahead : __builtin_convertvector(in_box.v, I);
        const I n = I{w.grid->nx, w.grid->ny, w.grid->nz, 0} * cells_in_brick;
        const bool in = (bits(Mask{(cell >= 0) & (cell < n)}) & 7) == 7 && next < infinity();
        std::memcpy(&w.x, &cell, 3 * sizeof w.x);
        w.x = in ? w.x : -1;
    }
    /// As CellWalk::leave.
    template <class Walk>
    static float leave(const Walk& w) {
        const Ray r(w);
        const F sides = r.sides(r.cell, 1, w.grid->edge);
        return most(w.t, least(least(sides.v[0], sides.v[1]), sides.v[2]));
    }
    /// As octants_on.
    template <class Vec>
    static std::uint32_t octants_on(const Vec& from, const Vec& along, float end) {
        const F p = V{from.x, from.y, from.z, 0}, d = V{along.x, along.y, along.z, 0}, zero(0.0f);
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
    /// A walk's fields as vectors; what the fourth lanes hold does not matter.
    struct Ray {
        F d, inverse, at;
        I cell, up;
        template <class Walk>
        explicit Ray(const Walk& w) {
            static_assert(offsetof(Walk, inv) == offsetof(Walk, d) + 12 && offsetof(Walk, at) == offsetof(Walk, d) + 24 &&
                          offsetof(Walk, x) == offsetof(Walk, d) + 36 && sizeof(Walk) >= offsetof(Walk, x) + 16);
            std::memcpy(&d.v, &w.d, sizeof d.v);
            std::memcpy(&inverse.v, &w.inv, sizeof d.v);
            std::memcpy(&at.v, &w.at, sizeof d.v);
            std::memcpy(&cell, &w.x, sizeof cell);
            up = d.v > 0.0f;
        }
        F sides(I first, int size, float edge) const {
            const F plane = __builtin_convertvector(first + (up & size), V);
            return select(Mask{magnitude(d).v <= 1e-18f}, F(infinity()), (plane * F(edge) - at) * inverse);
        }
    };
};

}  // namespace globule
