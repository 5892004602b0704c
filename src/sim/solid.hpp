// Solids on the bonds' neighborhoods: total-Lagrangian SPH (Bonet & Lok 1999) with the zero-energy control of Silling
// 2017 and Ganzenmüller 2015, stable neo-Hookean stress (Smith 2018).  docs/design/solids.md derives what is stated
// here.
//
// Energy: Σ_i V_i [Ψ(F_i) + b_i/2V_i Σ_j c_ij |x_ij - F_i X_ij|²], F_i = Σ_j c_ij x_ij ⊗ C_i X_ij, C_i = (Σ_j c_ij X_ij
// ⊗ X_ij)⁻¹. F_i is the least-squares fit with the same weights c, so that the second term's derivative through F_i
// vanishes, and
//   f_i = Σ_j c_ij [(Q_i + Q_j) X_ij + (b_i + b_j) x_ij],  Q = V P(F) C - b F.
// Linear and angular momentum are conserved, as the energy knows neither place nor orientation.
#pragma once
#include "sim/couple.hpp"
#include "sim/memory.hpp"

namespace globule::core::tissue {

/// Energy that holds each neighbor at the place that F gives it, per volume, in shear moduli.  The outermost particles'
/// F is that of a place inside of them; without this share, bending would be too soft.
inline constexpr float kSteadiness = 3.0f;
/// The least of it that bodies keep whose shear modulus relaxes: theirs is that of the part that lasts.
inline constexpr double kLeastSteady = 0.1;
/// Particles whose gradient is less certain than this, in 1/spacings, have springs instead of a deformation gradient.
inline constexpr float kSteepest = 4.0f;

/// -W'(q) / q of the cubic spline whose support is two spacings, but for a factor; beyond one spacing it falls faster:
/// pairs across the lattice's squares would make torsion too stiff.
template <class F> GB_FN F solid_weight(const F& q) {
    const F beyond = max(F(2.0f) - q, F(0.0f));
    return select(q < F(1.0f), F(3.0f) - F(2.25f) * q, F(0.75f) * beyond * beyond * beyond * beyond / max(q, F(1.0f)));
}

/// What particles are made of, and their place in the body at rest; arrays have room for whole blocks.
struct Solid {
    Quad* rest = nullptr;         ///< position at rest
    const float* lame = nullptr;  ///< (2, stride) volume times μ, volume times λ
    float* correction = nullptr;  ///< (6, stride) C: xx xy xz yy yz zz
    Quad* rows = nullptr;         ///< (3, stride) rows of Q, and that coordinate at rest
    std::uint32_t stride = 0;
    float spacing = 0.0f;
};

/// C and b of each particle from the bonds that are whole.  b < 0: springs.
struct Correct {
    Bonds bonds;
    Solid solid;
    Quad* at;            ///< w: b
    const float* terms;  ///< as in Memory
    std::uint32_t n_terms;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        double lasting = 1.0;
        for (std::uint32_t k = 0; k < n_terms; ++k) lasting -= terms[k * std::size_t(kTermRows) * solid.stride + t];
        const double per_d = 1.0 / solid.spacing;
        const float3 here = solid.rest[t].xyz();
        double m[6] = {}, sum = 0.0;
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
            if (!(bonds.length[e] > 0.0f)) continue;
            const float3 r = solid.rest[bonds.other[e]].xyz() - here;
            const double c = solid_weight(float(bonds.length[e] * per_d)), x = r.x * per_d, y = r.y * per_d,
                         z = r.z * per_d;
            m[0] += c * x * x, m[1] += c * x * y, m[2] += c * x * z;
            m[3] += c * y * y, m[4] += c * y * z, m[5] += c * z * z;
            sum += c * (x * x + y * y + z * z);
        }
        double k[6] = {m[3] * m[5] - m[4] * m[4], m[2] * m[4] - m[1] * m[5], m[1] * m[4] - m[2] * m[3],
            m[0] * m[5] - m[2] * m[2], m[1] * m[2] - m[0] * m[4], m[0] * m[3] - m[1] * m[1]};
        const double det = m[0] * k[0] + m[1] * k[1] + m[2] * k[2];
        bool certain = det > 1e-9 * sum * sum * sum;
        if (certain) {
            double steep = 0.0;
            for (double& v : k) v /= det;
            for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
                if (!(bonds.length[e] > 0.0f)) continue;
                const float3 r = solid.rest[bonds.other[e]].xyz() - here;
                const double c = solid_weight(float(bonds.length[e] * per_d)), x = r.x * per_d, y = r.y * per_d,
                             z = r.z * per_d;
                const double gx = k[0] * x + k[1] * y + k[2] * z, gy = k[1] * x + k[3] * y + k[4] * z,
                             gz = k[2] * x + k[4] * y + k[5] * z;
                steep += c * sqrt(gx * gx + gy * gy + gz * gz);
            }
            certain = steep < kSteepest;
        }
        for (int a = 0; a < 6; ++a)
            solid.correction[a * std::size_t(solid.stride) + t] = certain ? float(k[a] * per_d * per_d) : 0.0f;
        at[t].w =
            certain ? float(kSteadiness * solid.lame[t] / sum * per_d * per_d * max(lasting, kLeastSteady)) : -1.0f;
    }
};

/// 1 for particles whose Q nobody reads: fixed, amid others that are, for ever.  Bonds may be cut and whole again.
struct FindQuiet {
    Bonds bonds;
    const std::uint8_t* hold;
    std::uint8_t* quiet;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        bool all = stays(hold[t]);
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock)
            all &= bonds.length[e] == 0.0f || stays(hold[bonds.other[e]]);
        quiet[t] = all;
    }
    GB_FN static bool stays(std::uint8_t hold) { return hold == kFixed || hold == kGone; }
};

/// Beside a fluid, what differs between neighbors' velocities decays.  Pressure acts once a step, on a solid whose
/// substeps have not felt it, and would else feed the motions that are shorter than a step.
struct Drag {
    static constexpr float kShare = 0.2f / 24.0f;  ///< of the difference, in a substep; a particle has some 24 bonds
    const float* response;  ///< of each particle, less than 1 beside a fluid; null: no fluid is there
    const Quad* velocity;
    float3* change;

    GB_FN bool acts_on(std::uint32_t t) const { return response && response[t] < 1.0f; }
    /// Reads whatever the bond is, so that no load waits for another one.
    GB_FN void find(const Bonds& bonds, std::uint32_t t) const {
        const float3 own = velocity[t].xyz();
        float3 sum{0, 0, 0};
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
            const std::uint32_t o = bonds.other[e];
            const float share = (bonds.length[e] > 0.0f) & (response[o] < 1.0f) ? kShare : 0.0f;
            sum = sum + (velocity[o].xyz() - own) * share;
        }
        change[t] = sum;
    }
};

/// F of each particle, and from it Q.  With a memory, it goes on by a substep, of quiet ones, too.
template <class Memory> struct Strain {
    Bonds bonds;
    Solid solid;
    const Quad* at;
    const std::uint8_t* quiet;
    Drag drag;
    [[no_unique_address]] Memory memory;

    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        std::uint32_t own[Packet::width];
        for (int lane = 0; lane < Packet::width; ++lane) own[lane] = min(std::uint32_t(row) + lane, bonds.n - 1);
        if constexpr (!Memory::any) {
            bool all_quiet = true;
            for (int lane = 0; lane < Packet::width; ++lane) all_quiet &= quiet[own[lane]] != 0;
            if (all_quiet) return;
        }
        for (int lane = 0; lane < Packet::width && row + lane < bonds.n; ++lane)
            if (drag.acts_on(own[lane])) drag.find(bonds, own[lane]);
        const Four<F> x = Packet::gather(at, own), X = Packet::gather(solid.rest, own);
        const F zero = F(0.0f), one = F(1.0f), per_d = F(1.0f / solid.spacing);
        F d00 = zero, d01 = zero, d02 = zero, d10 = zero, d11 = zero, d12 = zero, d20 = zero, d21 = zero, d22 = zero;
        for (std::uint32_t e = bonds.begin(std::uint32_t(row)), end = bonds.end(std::uint32_t(row)); e < end;
            e += kBlock) {
            const F l = Packet::load(bonds.length + e);
            const Four<F> y = Packet::gather(at, bonds.other + e), Y = Packet::gather(solid.rest, bonds.other + e);
            const F c = select(l > zero, solid_weight(l * per_d), zero);
            const F R0 = c * (Y.x - X.x), R1 = c * (Y.y - X.y), R2 = c * (Y.z - X.z);
            const F r0 = y.x - x.x, r1 = y.y - x.y, r2 = y.z - x.z;
            d00 = d00 + r0 * R0, d01 = d01 + r0 * R1, d02 = d02 + r0 * R2;
            d10 = d10 + r1 * R0, d11 = d11 + r1 * R1, d12 = d12 + r1 * R2;
            d20 = d20 + r2 * R0, d21 = d21 + r2 * R1, d22 = d22 + r2 * R2;
        }
        const float* C = solid.correction + row;
        const std::size_t n = solid.stride;
        const F c00 = Packet::load(C), c01 = Packet::load(C + n), c02 = Packet::load(C + 2 * n);
        const F c11 = Packet::load(C + 3 * n), c12 = Packet::load(C + 4 * n), c22 = Packet::load(C + 5 * n);
        const F f00 = d00 * c00 + d01 * c01 + d02 * c02, f01 = d00 * c01 + d01 * c11 + d02 * c12,
                f02 = d00 * c02 + d01 * c12 + d02 * c22;
        const F f10 = d10 * c00 + d11 * c01 + d12 * c02, f11 = d10 * c01 + d11 * c11 + d12 * c12,
                f12 = d10 * c02 + d11 * c12 + d12 * c22;
        const F f20 = d20 * c00 + d21 * c01 + d22 * c02, f21 = d20 * c01 + d21 * c11 + d22 * c12,
                f22 = d20 * c02 + d21 * c12 + d22 * c22;
        // P = μ F + ((λ + μ)(J - 1) - μ) cof F
        const F k00 = f11 * f22 - f12 * f21, k01 = f12 * f20 - f10 * f22, k02 = f10 * f21 - f11 * f20;
        const F k10 = f02 * f21 - f01 * f22, k11 = f00 * f22 - f02 * f20, k12 = f01 * f20 - f00 * f21;
        const F k20 = f01 * f12 - f02 * f11, k21 = f02 * f10 - f00 * f12, k22 = f00 * f11 - f01 * f10;
        const F J = f00 * k00 + f01 * k01 + f02 * k02;
        const F mu = Packet::load(solid.lame + row), lambda = Packet::load(solid.lame + n + row), b = max(x.w, zero);
        const F s = (lambda + mu) * (J - one) - mu;
        [[maybe_unused]] Symmetric<F> past{};  // P = F (μ + past) + ...
        if constexpr (Memory::any) {
            const F known = max(J, F(kFlattest));
            const Symmetric<F> inverse =
                square(k00, k01, k02, k10, k11, k12, k20, k21, k22).times(one / (known * known));
            past = memory.template go_on<Packet>(
                row, square(f00, f01, f02, f10, f11, f12, f20, f21, f22), inverse, J, mu, lambda);
        }
        const auto line = [&](const F& f0, const F& f1, const F& f2, const F& k0, const F& k1, const F& k2,
                              const F& place, int a) {
            F p0 = mu * f0 + s * k0, p1 = mu * f1 + s * k1, p2 = mu * f2 + s * k2;
            if constexpr (Memory::any) {
                p0 = p0 + f0 * past.xx + f1 * past.xy + f2 * past.xz;
                p1 = p1 + f0 * past.xy + f1 * past.yy + f2 * past.yz;
                p2 = p2 + f0 * past.xz + f1 * past.yz + f2 * past.zz;
            }
            const F q0 = p0 * c00 + p1 * c01 + p2 * c02 - b * f0, q1 = p0 * c01 + p1 * c11 + p2 * c12 - b * f1;
            const F q2 = p0 * c02 + p1 * c12 + p2 * c22 - b * f2;
            Packet::scatter_rows(solid.rows + a * n, row, {q0, q1, q2, place});
        };
        line(f00, f01, f02, k00, k01, k02, X.x, 0);
        line(f10, f11, f12, k10, k11, k12, X.y, 1);
        line(f20, f21, f22, k20, k21, k22, X.z, 2);
    }
};

/// Forces; then velocities, then positions (symplectic Euler).
struct Push {
    Bonds bonds;
    Solid solid;
    const Quad* at;  ///< w: b
    Quad* next;
    Quad* velocity;  ///< velocity, inverse mass
    const float3* acceleration;
    const std::uint8_t* hold;
    const std::uint8_t* phase;
    Materials materials;
    Motions motions;
    Shapes shapes;
    Walls walls;
    Felt felt;
    Drag drag;
    float dt;

    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        std::uint32_t own[Packet::width];
        for (int lane = 0; lane < Packet::width; ++lane) own[lane] = min(std::uint32_t(row) + lane, bonds.n - 1);
        bool any_asks = false;
        for (int lane = 0; lane < Packet::width; ++lane)
            any_asks |= hold[own[lane]] == kFree || (felt.felt && hold[own[lane]] >= kGrasped);
        const std::size_t n = solid.stride;
        const Quad *rows0 = solid.rows, *rows1 = solid.rows + n, *rows2 = solid.rows + 2 * n;
        const Four<F> x = Packet::gather(at, own), q0 = Packet::gather(rows0, own), q1 = Packet::gather(rows1, own),
                      q2 = Packet::gather(rows2, own);
        const F zero = F(0.0f), half = F(0.5f), per_d = F(1.0f / solid.spacing), touching = F(solid.spacing);
        F f0 = zero, f1 = zero, f2 = zero;
        const std::uint32_t end = any_asks ? bonds.end(std::uint32_t(row)) : 0;
        for (std::uint32_t e = bonds.begin(std::uint32_t(row)); e < end; e += kBlock) {
            const F l = Packet::load(bonds.length + e), k = Packet::load(bonds.stiffness + e);
            const Four<F> y = Packet::gather(at, bonds.other + e), p0 = Packet::gather(rows0, bonds.other + e);
            const Four<F> p1 = Packet::gather(rows1, bonds.other + e), p2 = Packet::gather(rows2, bonds.other + e);
            const F r0 = y.x - x.x, r1 = y.y - x.y, r2 = y.z - x.z;
            const F R0 = p0.w - q0.w, R1 = p1.w - q1.w, R2 = p2.w - q2.w;
            const F c = select(l > zero, solid_weight(l * per_d), zero);
            // Springs where an end has no F; cut faces keep a distance, and never pull.
            const F distance = sqrt(r0 * r0 + r1 * r1 + r2 * r2);
            const F ends = select(x.w < zero, half, zero) + select(y.w < zero, half, zero);
            const F spring =
                k * select(l > zero, ends * (distance - l), select(l < zero, min(distance - touching, zero), zero));
            const F along = c * (max(x.w, zero) + max(y.w, zero)) + select(distance > zero, spring / distance, zero);
            f0 = f0 + (c * ((q0.x + p0.x) * R0 + (q0.y + p0.y) * R1 + (q0.z + p0.z) * R2) + along * r0);
            f1 = f1 + (c * ((q1.x + p1.x) * R0 + (q1.y + p1.y) * R1 + (q1.z + p1.z) * R2) + along * r1);
            f2 = f2 + (c * ((q2.x + p2.x) * R0 + (q2.y + p2.y) * R1 + (q2.z + p2.z) * R2) + along * r2);
        }
        for (int lane = 0; lane < Packet::width && row + lane < bonds.n; ++lane)
            move(std::uint32_t(row) + lane, {Packet::get(f0, lane), Packet::get(f1, lane), Packet::get(f2, lane)});
    }

    GB_FN void move(std::uint32_t t, const float3& force) const {
        const Quad here = at[t], v = velocity[t];
        float3 x = here.xyz(), u = v.xyz();
        if (hold[t] != kFree) {
            felt.add_held(t, hold[t], x, force * dt, v.w, dt, motions);
            u = motions.velocity_at(hold[t], x, u);
            x = x + u * dt;
        } else {
            u = u + (acceleration[t] + force * v.w) * dt;
            if (drag.acts_on(t)) u = u + drag.change[t];
            const float damping = materials.damping[phase[t]];
            if (damping > 0.0f) u = u * exp(-damping * dt);
            x = x + u * dt;
            felt.keep_out(shapes, t, x, u, v.w, materials.friction[phase[t]], dt);
            walls.keep_out(t, x, u, dt);
        }
        velocity[t] = {u.x, u.y, u.z, v.w};
        next[t] = {x.x, x.y, x.z, here.w};
    }
};

/// Σ_j c_ij x_ij ⊗ X_ij C_i, row by row.
GB_FN void gradient(const Bonds& bonds, const Solid& solid, const Quad* at, std::uint32_t t, double f[9]) {
    const float3 here = at[t].xyz(), rest = solid.rest[t].xyz();
    double d[9] = {};
    for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
        if (!(bonds.length[e] > 0.0f)) continue;
        const float3 r = at[bonds.other[e]].xyz() - here, R = solid.rest[bonds.other[e]].xyz() - rest;
        const double c = solid_weight(bonds.length[e] / solid.spacing), x[3] = {r.x, r.y, r.z}, X[3] = {R.x, R.y, R.z};
        for (int a = 0; a < 9; ++a) d[a] += c * x[a / 3] * X[a % 3];
    }
    const auto C = [&](int a) { return double(solid.correction[a * std::size_t(solid.stride) + t]); };
    const double c[9] = {C(0), C(1), C(2), C(1), C(3), C(4), C(2), C(4), C(5)};
    for (int a = 0; a < 9; ++a) {
        f[a] = 0.0;
        for (int k = 0; k < 3; ++k) f[a] += d[a / 3 * 3 + k] * c[3 * k + a % 3];
    }
}
/// Σ_j c_ij |C_i X_ij|, in 1/m.
GB_FN double steepness(const Bonds& bonds, const Solid& solid, std::uint32_t t) {
    const float3 rest = solid.rest[t].xyz();
    const auto C = [&](int a) { return solid.correction[a * std::size_t(solid.stride) + t]; };
    double sum = 0.0;
    for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
        if (!(bonds.length[e] > 0.0f)) continue;
        const float3 R = solid.rest[bonds.other[e]].xyz() - rest;
        const float3 g{C(0) * R.x + C(1) * R.y + C(2) * R.z, C(1) * R.x + C(3) * R.y + C(4) * R.z,
            C(2) * R.x + C(4) * R.y + C(5) * R.z};
        sum += solid_weight(bonds.length[e] / solid.spacing) * length(g);
    }
    return sum;
}
/// cof F; returns J.
GB_FN double cofactor(const double f[9], double k[9]) {
    for (int a = 0; a < 9; ++a) {
        const int i = a / 3, j = a % 3, i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
        k[a] = f[3 * i1 + j1] * f[3 * i2 + j2] - f[3 * i1 + j2] * f[3 * i2 + j1];
    }
    return f[0] * k[0] + f[1] * k[1] + f[2] * k[2];
}

/// How many times as stiff as in a block at rest a particle may be.  Strained: ∂P/∂F = μ + (λ + μ) cof F ⊗ cof F + ((λ
/// + μ)(J - 1) - μ) ∂cof F/∂F, whose last factor is at most |F|.  With few neighbors on one side: F follows each of
/// them more steeply than in the corner of a block.
inline constexpr double kSteepCorner = 3.0;  ///< Σ c |C X|, 1/spacings
struct Strained {
    double stiffness,
        rate;  ///< over that of a block at rest; 1/s, at which the lengths of pairs change, or their directions
};
struct Stiffening {
    Bonds bonds;
    Solid solid;
    const Quad *at, *velocity;
    const float* stays;         ///< as in Memory: a yielded shape's metric G multiplies μ
    const std::uint8_t* quiet;  ///< those can do no harm
    Strained* out;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        out[i] = quiet[t] ? Strained{1.0, 0.0} : Strained{stiffness(t), rate(t)};
    }
    GB_FN double rate(std::uint32_t t) const {
        if (!(at[t].w > 0.0f)) return 0.0;  // springs
        const float3 own = velocity[t].xyz();
        float most = 0.0f;
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
            const float l = bonds.length[e];
            if (l > 0.0f) most = max(most, length(velocity[bonds.other[e]].xyz() - own) / l);
        }
        return most;
    }
    GB_FN double stiffness(std::uint32_t t) const {
        if (!(at[t].w > 0.0f)) return 1.0;  // springs
        double f[9], k[9], squares = 0.0, area = 0.0;
        gradient(bonds, solid, at, t, f);
        const double J = cofactor(f, k), mu = solid.lame[t], lambda = solid.lame[solid.stride + t];
        for (int a = 0; a < 9; ++a) squares += f[a] * f[a], area += k[a] * k[a];
        const double yielded = stays ? max(double(stays[t]) + stays[3 * std::size_t(solid.stride) + t] +
                                               stays[5 * std::size_t(solid.stride) + t],
                                           0.0)
                                     : 0.0;
        const double s = (lambda + mu) * (J - 1.0) - mu,
                     strained = (mu * (1.0 + yielded) + (lambda + mu) * area + max(s, -s) * sqrt(squares)) /
                                (5.0 * mu + 3.0 * lambda);
        const double steep = steepness(bonds, solid, t) * solid.spacing / kSteepCorner;
        return strained * max(steep * steep, 1.0);
    }
};
struct StrainedOf {
    const Strained* each;
    GB_FN Strained operator()(std::size_t i) const { return each[i]; }
};
struct MostStrained {
    GB_FN Strained operator()(const Strained& a, const Strained& b) const {
        return {a.stiffness > b.stiffness ? a.stiffness : b.stiffness, a.rate > b.rate ? a.rate : b.rate};
    }
};

/// Energy of each particle, J; springs stand with half at either end.
struct SolidEnergy {
    Bonds bonds;
    Solid solid;
    const Quad* at;
    const float *terms, *stays;  ///< as in Memory
    std::uint32_t n_terms;
    GB_FN double operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        const float3 here = at[t].xyz(), rest = solid.rest[t].xyz();
        const double b = at[t].w;
        double f[9], k[9], springs = 0.0, squares = 0.0, steady = 0.0;
        const auto each = [&](const auto& fn) {
            for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock) {
                if (!(bonds.length[e] > 0.0f)) continue;
                const float3 r = at[bonds.other[e]].xyz() - here, R = solid.rest[bonds.other[e]].xyz() - rest;
                const double x[3] = {r.x, r.y, r.z}, X[3] = {R.x, R.y, R.z};
                fn(e, double(solid_weight(bonds.length[e] / solid.spacing)), x, X);
            }
        };
        if (b < 0.0) {
            each([&](std::uint32_t e, double, const double* x, const double*) {
                const double stretch = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]) - bonds.length[e];
                springs += 0.25 * bonds.stiffness[e] * stretch * stretch;
            });
            return springs;
        }
        gradient(bonds, solid, at, t, f);
        const double J = cofactor(f, k);
        for (const double v : f) squares += v * v;
        each([&](std::uint32_t, double w, const double* x, const double* X) {
            for (int a = 0; a < 3; ++a) {
                const double off = x[a] - f[3 * a] * X[0] - f[3 * a + 1] * X[1] - f[3 * a + 2] * X[2];
                steady += w * off * off;
            }
        });
        const double mu = solid.lame[t], lambda = solid.lame[solid.stride + t];
        const double energy = 0.5 * mu * (squares - 3.0) - mu * (J - 1.0) +
                              0.5 * (lambda + mu) * (J - 1.0) * (J - 1.0) + 0.5 * b * steady;
        return n_terms || stays ? energy + energy_of_memory(terms, n_terms, stays, solid.stride, t, f, mu) : energy;
    }
};

}  // namespace globule::core::tissue
