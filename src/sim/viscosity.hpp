// Viscosity and adhesion between neighbors.
//
// Viscosity (Morris 1997):
//   rho_i a_i = 2 sum_j mu_ij V_j v_ij x_ij . grad W_ij / |x_ij|^2
// The other common form, 10 (v_ij . x_ij) grad W_ij / ..., keeps angular momentum too, but what it makes of
// a shear flow depends on the order of the particles: 0.70 of it in a cubic lattice, 1.01 in close packing,
// where this one gives 1.02 and 0.97.  Implicit: the same operator, as Weiler (2018) does with the other.
// A boundary's layer stands half a spacing behind its face; the velocity there continues the fluid's
// through zero at the face (Morris 1997), so that the fluid is at rest where the face is.
//
// Adhesion of fluids to boundaries and tissue is a pairwise attraction of Akinci's shape (2013); within a fluid nobody
// attracts: its tension is its surface's (surface.hpp).
#pragma once
#include "sim/density.hpp"

namespace globule::core::sim {

/// Largest attraction of a pair, over adhesion times spacing: 8 / (pi int x^4 s dx), s the shape below and
/// x = r / spacing, gives a sharp face of evenly spread particles its tension (Kirkwood & Buff 1949).
inline constexpr float kCohesion = 1.6673f;

struct Interaction {
    Spline spline;
    Period period;
    float viscosity_scale;  ///< 2; 0 where viscosity is somebody else's
    float extra_viscosity;  ///< of all pairs of fluid
    float spacing, volume;
    Sizes sizes;

    /// 2 mu V_j x . grad W / |x|^2 of one pair.
    template <class F> GB_FN F viscous(const F& slope, const F& mu, const F& v) const {
        return F(viscosity_scale) * mu * v * slope;
    }
    /// 1 where both are fluid, else 1 + wall's share: the velocity behind the wall mirrors mine.
    template <class F> GB_FN F mirror(const F& nearest) const {
        return F(1.0f) + F(0.5f * spacing) / max(nearest - F(0.5f * spacing), F(0.25f * spacing));
    }
    template <class F> GB_FN F attraction(const F& r) const {
        const F q = r * F(spline.inverse), a = max(F(1.0f) - q, F(0.0f)) * q, c = F(64.0f) * a * a * a;
        return select(q > F(0.5f), c, F(2.0f) * c - F(1.0f));
    }
    /// The attraction's force per distance, of two with an adhesion of 1; `reach`: r over the mean size.
    template <class F> GB_FN F pull(const F& reach, const F& r) const {
        return select(reach < F(spline.support),
            F(-kCohesion * spacing / volume) * attraction(reach) / max(r, F(1e-3f * spacing)), F(0.0f));
    }
};

/// Accelerations of all rows by what acts between neighbors.
template <class Packet_, bool periodic, bool sticks, bool mixed> struct PairForces {
    Lists<Packet_> lists;
    const Quad *place, *velocity;
    Rows rows;
    Interaction pair;
    const float* cohesion;  ///< per slot: root of a fluid's or held tissue's tension, of a boundary's adhesion; less
                            ///< than 0: of free tissue's tension
    float* diagonal;        ///< of the implicit operator less rho, over dt; or null
    Quad* acceleration;     ///< per row
    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        const std::uint32_t* slot = lists.rows + row;
        const Four<F> at = Packet::gather(place, slot), v = Packet::gather(velocity, slot);
        const F zero = F(0.0f), half = F(0.5f);
        const F wall = pair.mirror(Packet::load(rows.boundary + row));
        F size = F(1.0f);
        if constexpr (mixed) size = Packet::gather(pair.sizes.of, slot);
        F mine = zero;
        if constexpr (sticks) mine = Packet::gather(cohesion, slot);
        F x = zero, y = zero, z = zero, diag = zero;
        const std::uint32_t n = Packet::longest(lists.count + row);
        const std::size_t first = lists.at(row);
        for (std::uint32_t i = Packet::member(); i < n; i += Packet::team) {
            const std::size_t k = first + std::size_t(i) * Packet::stride;
            lists.fetch_next_index(k);
            const Four<F> other = Packet::gather(place, lists.index + k), u = Packet::gather(velocity, lists.index + k);
            const Vec3<F> d = pair.period.template shortest<periodic>(at.xyz() - other.xyz());
            const F r2 = dot(d, d), r = sqrt(r2);
            F w, slope;
            F volume = F(pair.volume), reach = r;
            [[maybe_unused]] F share = F(1.0f);  // of the attraction
            if constexpr (mixed) {
                const Pair<F> of = Pair<F>::of(size, Packet::gather(pair.sizes.of, lists.index + k));
                of.kernel(pair.spline, r, w, slope);
                volume *= of.volume;
                reach = r * of.inverse;
                share = of.attracts();
            } else {
                pair.spline(r, w, slope);
            }
            const auto solid = other.w > zero;
            const F mu = select(solid, v.w, half * (v.w + u.w)) + F(pair.extra_viscosity);
            const F s = pair.viscous(slope, mu, select(solid, other.w * wall, volume));
            diag -= s;
            x += s * (v.x - u.x);
            y += s * (v.y - u.y);
            z += s * (v.z - u.z);
            if constexpr (sticks) {
                const F theirs = Packet::gather(cohesion, lists.index + k);
                F f = pair.pull(reach, r) *
                      max(select(solid, mine * theirs, zero - mine * theirs), zero);  // tissue with fluid: below 0
                if constexpr (mixed) f *= share;
                x += f * d.x;
                y += f * d.y;
                z += f * d.z;
            }
        }
        if (!Packet::add_up(x, y, z, diag)) return;
        const F rho = Packet::load(rows.inverse_rho + row);
        if (diagonal) Packet::store(diagonal + row, diag);
        Packet::scatter_rows(acceleration, row, Four<F>{x * rho, y * rho, z * rho, zero});
    }
};

struct CohesionOf {
    State state;
    const Phase* phases;
    float* out;
    GB_FN void operator()(std::size_t i) const {
        if (i >= state.n) {
            out[i] = 0.0f;
            return;
        }
        const Phase& p = phases[state.phase[i]];
        out[i] = state.place[i].w >= 0.0f ? sqrt(p.kind == Kind::tissue ? p.tension : p.adhesion)  // held tissue
                 : p.kind == Kind::fluid  ? sqrt(p.tension)
                                          : -sqrt(p.tension);
    }
};

// Implicit viscosity: (rho - dt L) v = rho v* by conjugate gradients with the diagonal as preconditioner;
// the unknown is what is added to v*, so that moving boundaries need no care.

struct Conjugate {
    double rz, pq, rz_new, first;
    double least;  ///< share of the first that errors are judged by, or 0: all
    std::uint32_t iterations, done;
};

template <class Packet_, bool periodic, bool mixed> struct ApplyViscosity {
    Lists<Packet_> lists;
    const Quad *place, *direction;  ///< w of direction: viscosity
    Rows rows;
    Interaction pair;
    const Conjugate* state;
    float dt;
    Quad* out;  ///< per row
    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        if (state->done) return;
        const std::uint32_t* slot = lists.rows + row;
        const Four<F> at = Packet::gather(place, slot), v = Packet::gather(direction, slot);
        const F zero = F(0.0f), half = F(0.5f);
        const F wall = pair.mirror(Packet::load(rows.boundary + row));
        F size = F(1.0f);
        if constexpr (mixed) size = Packet::gather(pair.sizes.of, slot);
        F x = zero, y = zero, z = zero;
        const std::uint32_t n = Packet::longest(lists.count + row);
        std::size_t k = lists.at(row);
        for (std::uint32_t i = 0; i < n; ++i, k += Packet::stride) {
            lists.fetch_next_index(k);
            const Four<F> other = Packet::gather(place, lists.index + k),
                          u = Packet::gather(direction, lists.index + k);
            const Vec3<F> d = pair.period.template shortest<periodic>(at.xyz() - other.xyz());
            const F r2 = dot(d, d);
            F w, slope;
            F volume = F(pair.volume);
            if constexpr (mixed) {
                const Pair<F> of = Pair<F>::of(size, Packet::gather(pair.sizes.of, lists.index + k));
                of.kernel(pair.spline, sqrt(r2), w, slope);
                volume *= of.volume;
            } else {
                pair.spline(sqrt(r2), w, slope);
            }
            const auto solid = other.w > zero;
            const F mu = select(solid, v.w, half * (v.w + u.w)) + F(pair.extra_viscosity);
            const F s = pair.viscous(slope, mu, select(solid, other.w * wall, volume));
            x += s * (v.x - u.x);
            y += s * (v.y - u.y);
            z += s * (v.z - u.z);
        }
        const F rho = Packet::load(rows.inverse_rho + row), solved = select(rho > zero, F(1.0f), zero);
        const F mass = solved / select(rho > zero, rho, F(1.0f)), t = F(dt) * solved;
        Packet::scatter_rows(out, row, Four<F>{mass * v.x - t * x, mass * v.y - t * y, mass * v.z - t * z, zero});
    }
};

/// r = dt L v*, p = z = r / D.
struct StartConjugate {
    const std::uint32_t* rows;
    const float *inverse_rho, *diagonal;
    const Quad *acceleration, *velocity;
    float dt;
    Quad *residual, *direction;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = rows[row];
        const float rho = inverse_rho[row] > 0.0f ? 1.0f / inverse_rho[row] : 0.0f;
        const float3 r = acceleration[row].xyz() * (rho * dt);
        const float d = rho > 0.0f ? 1.0f / (rho + dt * diagonal[row]) : 0.0f;
        residual[row] = {r.x, r.y, r.z, d};
        direction[slot] = {d * r.x, d * r.y, d * r.z, velocity[slot].w};
    }
};
struct ResidualSquare {
    const std::uint32_t* rows;
    const Quad* residual;
    Sizes sizes;  ///< of two sizes, the operator is symmetric with the volumes as weights
    GB_FN double operator()(std::size_t row) const {
        const Quad r = residual[row];
        return sizes.volume(rows[row]) * double(r.w) * (double(r.x) * r.x + double(r.y) * r.y + double(r.z) * r.z);
    }
};
struct DirectionSquare {
    const std::uint32_t* rows;
    const Quad *direction, *applied;
    Sizes sizes;
    GB_FN double operator()(std::size_t row) const {
        const Quad p = direction[rows[row]], q = applied[row];
        return sizes.volume(rows[row]) * (double(p.x) * q.x + double(p.y) * q.y + double(p.z) * q.z);
    }
};
struct StepConjugate {
    const std::uint32_t* rows;
    const Conjugate* state;
    const Quad *direction, *applied;
    Quad *velocity, *residual;
    GB_FN void operator()(std::size_t row) const {
        if (state->done) return;
        const float a = state->pq > 0.0 ? float(state->rz / state->pq) : 0.0f;
        const std::uint32_t slot = rows[row];
        const Quad p = direction[slot], q = applied[row];
        Quad &v = velocity[slot], &r = residual[row];
        v = {v.x + a * p.x, v.y + a * p.y, v.z + a * p.z, v.w};
        r = {r.x - a * q.x, r.y - a * q.y, r.z - a * q.z, r.w};
    }
};
struct TurnConjugate {
    const std::uint32_t* rows;
    const Conjugate* state;
    const Quad* residual;
    Quad* direction;
    GB_FN void operator()(std::size_t row) const {
        if (state->done) return;
        const float b = state->rz > 0.0 ? float(state->rz_new / state->rz) : 0.0f;
        const Quad r = residual[row];
        Quad& p = direction[rows[row]];
        p = {r.w * r.x + b * p.x, r.w * r.y + b * p.y, r.w * r.z + b * p.z, p.w};
    }
};
struct JudgeConjugate {
    Conjugate* state;
    double tolerance;
    GB_FN void operator()(std::size_t) const {
        if (state->done) return;
        state->rz = state->rz_new;
        if (state->iterations == 0) state->first = state->rz * (state->least > 0.0 ? state->least : 1.0);
        state->done = state->rz <= tolerance * tolerance * state->first;
        state->iterations += 1;
    }
};

}  // namespace globule::core::sim
