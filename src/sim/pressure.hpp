// The pressure solver of DFSPH (Bender & Koschier 2015, 2017), for the density and for its change alike.
//
// P is an impulse, pressure times dt.  One iteration is two walks of the lists:
//   push    v_i -= (dP_i G_i + sum_j dP_j g_ij) / rho_i         what the last change of P does to velocities
//   relax   D_i  = v_i . G_i - sum_j v_j . g_ij                 rate of change of the density
//           e_i  = D_i + (delta_i - 1) / dt   or   D_i          what is too much of it
//           P_i  = max(0, P_i + omega alpha_i e_i)       filled.hpp: of both signs
// A boundary's particles have no pressure of their own.  The velocities in memory always belong to the P
// before the last relax, whose error is the one that is judged and reported.
#pragma once
#include "sim/density.hpp"

namespace globule::core::sim {

/// How far a solve has come; lives on the device, so that the loop need not wait for the host.
struct Progress {
    double error;             ///< mean of max(e, 0) dt: of the density, relative
    std::uint32_t iterations;
    std::uint32_t done;
};

template <class Packet_>
struct Push {
    Lists<Packet_> lists;
    Rows rows;
    const float* change;  ///< dP, per slot
    Quad* velocity;
    const Progress* progress;
    float inverse_support;
    template <class Packet>
    GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        if (progress->done) return;
        const std::uint32_t* slot = lists.rows + row;
        const F p = Packet::gather(change, slot);
        F x = p * Packet::load(rows.gx + row), y = p * Packet::load(rows.gy + row), z = p * Packet::load(rows.gz + row);
        const std::uint32_t n = Packet::longest(lists.count + row);
        std::size_t at = lists.at(row);
        for (std::uint32_t k = 0; k < n; ++k, at += Packet::stride) {
            const F q = Packet::gather(change, lists.index + at);
            x += q * Packet::load(lists.gx + at);
            y += q * Packet::load(lists.gy + at);
            z += q * Packet::load(lists.gz + at);
        }
        const F s = Packet::load(rows.inverse_rho + row) * F(inverse_support);
        Four<F> v = Packet::gather(velocity, slot);
        v.x -= s * x;
        v.y -= s * y;
        v.z -= s * z;
        Packet::scatter(velocity, slot, v);
    }
};

template <class Packet_>
struct Relax {
    Lists<Packet_> lists;
    Rows rows;
    const float* alpha;    ///< per row
    const Quad* velocity;
    float* pressure;       ///< P, per slot
    float* change;         ///< dP, per slot
    float* error;          ///< max(e, 0) or |e| per row
    const Progress* progress;
    float inverse_support;
    float per_dt;
    float most_excess;     ///< of the density, that is to be undone: 0 in the divergence solve
    float least_excess;    ///< 0: gaps do not close
    float least_impulse;   ///< 0, or without bounds, where the error counts both ways
    float omega;
    template <class Packet>
    GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        if (progress->done) return;
        const std::uint32_t* slot = lists.rows + row;
        const Four<F> v = Packet::gather(velocity, slot);
        F sum = v.x * Packet::load(rows.gx + row) + v.y * Packet::load(rows.gy + row) + v.z * Packet::load(rows.gz + row);
        const std::uint32_t n = Packet::longest(lists.count + row);
        std::size_t at = lists.at(row);
        for (std::uint32_t k = 0; k < n; ++k, at += Packet::stride) {
            const Four<F> u = Packet::gather(velocity, lists.index + at);
            sum -= u.x * Packet::load(lists.gx + at) + u.y * Packet::load(lists.gy + at) + u.z * Packet::load(lists.gz + at);
        }
        const F zero = F(0.0f), a = Packet::load(alpha + row);
        const F excess = max(min(Packet::load(rows.density + row) - F(1.0f), F(most_excess)), F(least_excess));
        const F e = sum * F(inverse_support) + F(per_dt) * excess;
        const F before = Packet::gather(pressure, slot);
        const F after = max(before + F(omega) * a * e, F(least_impulse));
        Packet::scatter(pressure, slot, after);
        Packet::scatter(change, slot, after - before);
        Packet::store(error + row, select(a > zero, max(e, least_impulse < 0.0f ? zero - e : zero), zero));
    }
};

/// Warm start: half of the last step's pressure is taken as it is.
struct WarmStart {
    const std::uint32_t* rows;
    const float* alpha;
    float* pressure;
    float* change;
    float share;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = rows[row];
        const float p = alpha[row] > 0.0f ? share * pressure[slot] : 0.0f;
        pressure[slot] = p;
        change[slot] = p;
    }
};

/// Momentum that P carries across a face, over P: a fluid without order is near to close packing, where
/// -sum_j V x dW/dx is this (cubic lattice: 1.020).
inline constexpr float kFlux = 0.966f;

/// The pressure that velocities have seen: without what the last relax would have added.
struct Applied {
    const std::uint32_t* rows;
    const float *impulse, *change;
    float per_dt;
    bool add;
    float flux;
    float* pressure;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = rows[row];
        const float p = (impulse[slot] - change[slot]) * per_dt * flux;
        pressure[slot] = add ? pressure[slot] + p : p;
    }
};

struct ErrorOf {
    const float* error;
    GB_FN double operator()(std::size_t row) const { return error[row]; }
};
struct AddDouble {
    GB_FN double operator()(double a, double b) const { return a + b; }
};

struct Judge {
    const double* sum;
    double to_mean;  ///< dt / number of particles
    double tolerance;
    std::uint32_t least_iterations;
    Progress* progress;
    GB_FN void operator()(std::size_t) const {
        if (progress->done) return;
        progress->error = *sum * to_mean;
        progress->iterations += 1;
        progress->done = progress->iterations >= least_iterations && progress->error <= tolerance;
    }
};

}  // namespace globule::core::sim
