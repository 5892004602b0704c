// What a solid remembers of its motion: parts of its stress that relax (Prony series), and strain that stays.
//
// The shear energy of a solid is μ/2 tr(C G), C = FᵀF, G = 1 at rest.  Each part of the material has a G of its own,
// the inverse metric of the shape in which the part is free of shear stress (Green & Tobolsky 1946; Simo & Hughes
// 1998), and G moves towards C⁻¹.  G belongs to the material: turning the body changes neither C nor G.  Stored is G -
// 1, which keeps the digits of small strains. docs/design/solids.md derives what is stated here.
#pragma once
#include "sim/bonds.hpp"

namespace globule::core::tissue {

inline constexpr std::uint32_t kMostTerms = 2;
inline constexpr std::uint32_t kTermRows = 8;  ///< of a term: share of the shear modulus, 1/s, and six of G - 1
/// No metric goes on beyond this trace of G - 1 (3 + this: of G): the stiffness of what is crushed further would outrun
/// the substeps.
inline constexpr float kFarthest = 3.0f;
/// Below this volume over that at rest F has no inverse that is worth having, and nothing flows.
inline constexpr float kFlattest = 0.05f;

template <class F> struct Symmetric {
    F xx, xy, xz, yy, yz, zz;

    GB_FN F trace() const { return xx + yy + zz; }
    GB_FN Symmetric times(const F& s) const { return {xx * s, xy * s, xz * s, yy * s, yz * s, zz * s}; }
    GB_FN Symmetric plus(const Symmetric& o) const {
        return {xx + o.xx, xy + o.xy, xz + o.xz, yy + o.yy, yz + o.yz, zz + o.zz};
    }
    /// Adds s to the diagonal.
    GB_FN Symmetric and_one(const F& s) const { return {xx + s, xy, xz, yy + s, yz, zz + s}; }
    /// tr(A B)
    GB_FN F dot(const Symmetric& o) const {
        return xx * o.xx + yy * o.yy + zz * o.zz + F(2.0f) * (xy * o.xy + xz * o.xz + yz * o.yz);
    }
    GB_FN Symmetric cofactor() const {
        return {yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy, xx * zz - xz * xz, xy * xz - xx * yz,
            xx * yy - xy * xy};
    }
};

/// MᵀM of rows.
template <class F>
GB_FN Symmetric<F> square(const F& m00, const F& m01, const F& m02, const F& m10, const F& m11, const F& m12,
    const F& m20, const F& m21, const F& m22) {
    return {m00 * m00 + m10 * m10 + m20 * m20, m00 * m01 + m10 * m11 + m20 * m21, m00 * m02 + m10 * m12 + m20 * m22,
        m01 * m01 + m11 * m11 + m21 * m21, m01 * m02 + m11 * m12 + m21 * m22, m02 * m02 + m12 * m12 + m22 * m22};
}

template <class Packet> GB_FN Symmetric<typename Packet::F> load_symmetric(const float* p, std::size_t n) {
    return {Packet::load(p), Packet::load(p + n), Packet::load(p + 2 * n), Packet::load(p + 3 * n),
        Packet::load(p + 4 * n), Packet::load(p + 5 * n)};
}
template <class Packet> GB_FN void store_symmetric(float* p, std::size_t n, const Symmetric<typename Packet::F>& s) {
    Packet::store(p, s.xx), Packet::store(p + n, s.xy), Packet::store(p + 2 * n, s.xz);
    Packet::store(p + 3 * n, s.yy), Packet::store(p + 4 * n, s.yz), Packet::store(p + 5 * n, s.zz);
}

/// 1 - exp(-x), x >= 0: right to x⁴ / 24, from 0 to 1 for every x, and without loss where x is small.
template <class F> GB_FN F decay(const F& x) {
    const F grown = x * (F(1.0f) + x * (F(0.5f) + x * F(1.0f / 6.0f)));
    return grown / (F(1.0f) + grown);
}

/// D, and what it goes to: the share s of the way, but not beyond kFarthest.
template <class F> GB_FN Symmetric<F> moved(const Symmetric<F>& d, const Symmetric<F>& to, const F& s) {
    const F now = d.trace(), then = to.trace(), most = F(kFarthest);
    const F room = max(most - now, F(0.0f)) / max(then - now, F(1e-6f));
    const F share = select(then > most, min(s, room), s);
    return d.plus(to.plus(d.times(F(-1.0f))).times(share));
}

/// Moves G - 1 of the part that does not relax, if its elastic shear is beyond the yield strain.  In a bar that is
/// pulled, shear measures the bar's own strain: σ = sqrt(3/2) |dev σ| and σ = E ε, so that ε = sqrt(3/2) |dev h| / (1 +
/// ν), h the logarithmic elastic strain. I1 and I2 are the traces of B and B⁻¹, B the elastic part of F Fᵀ, without
/// change of volume.
template <class F>
GB_FN Symmetric<F> yielded(const Symmetric<F>& d, const Symmetric<F>& metric, const Symmetric<F>& inverse, const F& J,
    const F& mu, const F& lambda, const F& yield, const F& rate, float dt) {
    const F zero = F(0.0f), one = F(1.0f), third = F(1.0f / 3.0f);
    const Symmetric<F> g = d.and_one(one), other = g.cofactor();  // det G = 1: its inverse
    const F known = max(J, F(kFlattest)), square_of_J = known * known;
    F y = F(3.0f) / (one + known + known);  // J^(-2/3)
    for (int k = 0; k < 4; ++k) y = y * (F(4.0f) - square_of_J * y * y * y) * third;
    const F i1 = y * metric.dot(g), across = inverse.dot(other), i2 = across / y;
    const F m = max(F(0.5f) * (i1 + i2) - F(3.0f), zero);                           // Σ (cosh 2h - 1)
    const F h2 = F(0.5f) * m / (one + m * F(1.0f / 12.0f));                         // Σ h²: m = 2 Σh² + (Σh²)²/3 + ...
    const F stretch = F(2.0f) * (lambda + mu) / (F(3.0f) * lambda + F(2.0f) * mu);  // 1 / (1 + ν)
    const F strain = max(sqrt(max(F(1.5f) * h2, zero)) * stretch, F(1e-9f));
    const F keep = one - max(one - yield / strain, zero) * decay(rate * F(1.5f * dt) * stretch);
    const F fall = F(0.5f) * (i1 + i2 + i2 - (F(9.0f) + F(6.0f) * i1) / i2);  // of m along the way
    const F share = max(min(m * (one - keep * keep) / max(fall, F(1e-6f)), one), zero);
    const Symmetric<F> to = inverse.times(F(3.0f) / across).and_one(zero - one);
    Symmetric<F> next = moved(d, to, share).and_one(one);
    const Symmetric<F> c = next.cofactor();
    const F det = next.xx * c.xx + next.xy * c.xy + next.xz * c.xz;  // >= 1: between two of the same
    next = next.times(max((F(4.0f) - det) * third, F(0.5f))).and_one(zero - one);
    const auto flows = (yield > zero) & (strain > yield) & (J > F(kFlattest));
    return {select(flows, next.xx, d.xx), select(flows, next.xy, d.xy), select(flows, next.xz, d.xz),
        select(flows, next.yy, d.yy), select(flows, next.yz, d.yz), select(flows, next.zz, d.zz)};
}

/// A solid that remembers nothing.
struct NoMemory { static constexpr bool any = false; };

/// Where each particle remembers, and how.
struct Memory {
    static constexpr bool any = true;
    float* terms;  ///< (n_terms, kTermRows, stride)
    float* stays;  ///< (6, stride) G - 1 of the part that does not relax; null: no phase ever yielded
    const std::uint8_t* phase;
    Materials materials;
    std::uint32_t n_terms, stride, n;
    float dt;

    /// Every part goes on by dt, F held: none of this adds energy.  Returns Σ μ_k (G_k - 1).
    template <class Packet, class F = typename Packet::F>
    GB_FN Symmetric<F> go_on(std::size_t row, const Symmetric<F>& metric, const Symmetric<F>& inverse, const F& J,
        const F& mu, const F& lambda) const {
        const F zero = F(0.0f), one = F(1.0f);
        const Symmetric<F> to = inverse.and_one(zero - one);
        Symmetric<F> sum{zero, zero, zero, zero, zero, zero};
        F lasting = one;
        for (std::uint32_t k = 0; k < n_terms; ++k) {
            float* term = terms + k * std::size_t(kTermRows) * stride + row;
            const F share = Packet::load(term), rate = Packet::load(term + stride);
            lasting = lasting - share;
            const F way = select(J > F(kFlattest), decay(rate * F(dt)), zero);
            const Symmetric<F> d = moved(load_symmetric<Packet>(term + 2 * std::size_t(stride), stride), to, way);
            store_symmetric<Packet>(term + 2 * std::size_t(stride), stride, d);
            sum = sum.plus(d.times(share * mu));
        }
        if (stays) {
            const auto of_phase = [&](const float* values) {
                return Packet::map([&](int lane) { return values[phase[min(std::uint32_t(row) + lane, n - 1)]]; });
            };
            const F yield = of_phase(materials.yield_strain), rate = of_phase(materials.creep_rate);
            const Symmetric<F> d =
                yielded(load_symmetric<Packet>(stays + row, stride), metric, inverse, J, mu, lambda, yield, rate, dt);
            store_symmetric<Packet>(stays + row, stride, d);
            sum = sum.plus(d.times(lasting * mu));
        }
        return sum;
    }
};

/// What the memory of particle t adds to its elastic energy: Σ μ_k/2 [tr C (G_k - 1) - ln det G_k].
GB_FN double energy_of_memory(const float* terms, std::uint32_t n_terms, const float* stays, std::uint32_t stride,
    std::size_t t, const double* f, double mu) {
    const Symmetric<double> metric = square(f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8]);
    const auto load = [&](const float* p) {
        const std::size_t n = stride;
        return Symmetric<double>{p[t], p[n + t], p[2 * n + t], p[3 * n + t], p[4 * n + t], p[5 * n + t]};
    };
    double energy = 0.0, lasting = 1.0;
    for (std::uint32_t k = 0; k < n_terms; ++k) {
        const float* term = terms + k * std::size_t(kTermRows) * stride;
        const double share = term[t];
        lasting -= share;
        const Symmetric<double> d = load(term + 2 * std::size_t(stride)), g = d.and_one(1.0), c = g.cofactor();
        energy += 0.5 * mu * share * (metric.dot(d) - log(g.xx * c.xx + g.xy * c.xy + g.xz * c.xz));
    }
    return stays ? energy + 0.5 * mu * lasting * metric.dot(load(stays)) : energy;
}

}  // namespace globule::core::tissue
