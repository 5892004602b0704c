// Fluid that fills its space, without a free surface.
//
// There the density at the particles is least in a lattice, and solving for rest density allows no other order:
// the fluid is as stiff as a solid.  So is one whose divergence is the rate of that density.  Instead:
// gradients that are exact for linear fields (Bonet & Lok 1999), antisymmetric in a pair so that momentum is kept,
//   M_i = -sum_j g_ij x_ij^T,   g_ij <- (M_i^-1 + M_j^-1) g_ij / 2,
// a divergence of 0 from pressures of both signs, and particles that are shifted from where they are dense
// (Lind 2012), their velocities kept.  Pairs with a boundary's particle, which has no pressure, count twice, so
// that the same pressure everywhere pushes nobody into a wall; M makes good for it.
#pragma once
#include "sim/pressure.hpp"

namespace globule::core::sim {

inline constexpr double kFreeShare = 0.002;    ///< of all particles: more are a surface
inline constexpr double kLeastFilling = 0.99;  ///< mean density: with less, gaps are on their way to open
inline constexpr double kFilledAim = 0.1;  ///< of the divergence's tolerance: no density solve makes good what is left
inline constexpr float kShift = 1.5f,
                       kMostShift = 0.2f;  ///< spacings^2 of density gradient per spacing of the fastest's way; at most

/// M^-1 of every row's particle, as (xx, yy, zz) and (xy, xz, yz); boundaries have 1.
template <class Packet_, bool periodic> struct InverseMoments {
    Lists<Packet_> lists;
    const Quad* place;
    Period period;
    float inverse_support;
    Quad *diagonal, *rest;  ///< per slot
    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        const Four<F> mine = Packet::gather(place, lists.rows + row);
        const F zero = F(0.0f), one = F(1.0f), s = F(-inverse_support);
        F xx = zero, yy = zero, zz = zero, xy = zero, xz = zero, yz = zero;
        const std::uint32_t n = Packet::longest(lists.count + row);
        std::size_t at = lists.at(row);
        for (std::uint32_t k = 0; k < n; ++k, at += Packet::stride) {
            lists.fetch_next(at);
            const Four<F> other = Packet::gather(place, lists.index + at);
            const Vec3<F> d = period.template shortest<periodic>(mine.xyz() - other.xyz());
            const F m = s * select(other.w > zero, F(2.0f), one);
            const auto [gx, gy, gz] = lists.gradient(at) * m;
            xx += gx * d.x;
            yy += gy * d.y;
            zz += gz * d.z;
            xy += gx * d.y;
            xz += gx * d.z;
            yz += gy * d.z;
        }
        const F a = yy * zz - yz * yz, b = xz * yz - xy * zz, c = xy * yz - xz * yy, det = xx * a + xy * b + xz * c;
        const auto good = det > F(0.3f);  // else too one-sided to be corrected
        const F f = one / select(good, det, one);
        Packet::scatter(diagonal, lists.rows + row,
            {select(good, f * a, one), select(good, f * (xx * zz - xz * xz), one),
                select(good, f * (xx * yy - xy * xy), one), zero});
        Packet::scatter(rest, lists.rows + row,
            {select(good, f * b, zero), select(good, f * c, zero), select(good, f * (xy * xz - xx * yz), zero), zero});
    }
};
struct NoCorrection {
    Quad *diagonal, *rest;
    GB_FN void operator()(std::size_t i) const {
        diagonal[i] = {1.0f, 1.0f, 1.0f, 0.0f};
        rest[i] = {0.0f, 0.0f, 0.0f, 0.0f};
    }
};

template <class Packet_> struct CorrectGradients {
    Lists<Packet_> lists;
    const Quad *place, *diagonal, *rest;
    Rows out;
    Quad* plain;  ///< G as it was, per row
    float support, lattice_squares;
    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        const Four<F> d = Packet::gather(diagonal, lists.rows + row), r = Packet::gather(rest, lists.rows + row);
        const F zero = F(0.0f), half = F(0.5f), one = F(1.0f), h = F(support),
                rho = Packet::load(out.inverse_rho + row);
        F gx = zero, gy = zero, gz = zero, squares = zero;
        const std::uint32_t n = Packet::longest(lists.count + row);
        std::size_t at = lists.at(row);
        for (std::uint32_t k = 0; k < n; ++k, at += Packet::stride) {
            lists.fetch_next(at);
            const Four<F> e = Packet::gather(diagonal, lists.index + at), s = Packet::gather(rest, lists.index + at),
                          other = Packet::gather(place, lists.index + at);
            const F m = select(other.w > zero, one, half);
            const auto [x, y, z] = lists.gradient(at) * m;
            const auto [a, b, c] = lists.keep_gradient(at, {(d.x + e.x) * x + (r.x + s.x) * y + (r.y + s.y) * z,
                                                               (r.x + s.x) * x + (d.y + e.y) * y + (r.z + s.z) * z,
                                                               (r.y + s.y) * x + (r.z + s.z) * y + (d.z + e.z) * z});
            gx += a;
            gy += b;
            gz += c;
            squares += (a * a + b * b + c * c) * max(-other.w, zero);
        }
        const F sum = (gx * gx + gy * gy + gz * gz) * rho + squares;
        const F alpha = select(rho > zero, h * h / max(sum, F(kLeastStiffness * lattice_squares) * rho), zero);
        Packet::scatter_rows(plain, row,
            Four<F>{Packet::load(out.gx + row), Packet::load(out.gy + row), Packet::load(out.gz + row), zero});
        Packet::store(out.gx + row, gx);
        Packet::store(out.gy + row, gy);
        Packet::store(out.gz + row, gz);
        Packet::store(out.alpha + row, alpha);
    }
};

/// For one move: velocities that lead away from where particles are dense.
struct Shift {
    const std::uint32_t* rows;
    const float* inverse_rho;
    const Quad* gradient;  ///< of the density, times the support
    float share;
    Quad *velocity, *kept;
    GB_FN void operator()(std::size_t row) const {
        Quad& v = velocity[rows[row]];
        kept[row] = v;
        if (!(inverse_rho[row] > 0.0f)) return;
        const Quad g = gradient[row];
        v = {v.x - share * g.x, v.y - share * g.y, v.z - share * g.z, v.w};
    }
};
struct GiveBack {
    const std::uint32_t* rows;
    const Quad* kept;
    Quad* velocity;
    GB_FN void operator()(std::size_t row) const { velocity[rows[row]] = kept[row]; }
};

}  // namespace globule::core::sim
