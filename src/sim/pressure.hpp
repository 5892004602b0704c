// The pressure solver of DFSPH (Bender & Koschier 2015, 2017), for velocities and for places alike.
//
// P is an impulse, pressure times dt.  One iteration is two walks of the lists:
//   push    v_i -= (dP_i G_i + sum_j dP_j g_ij) / rho_i         what the last change of P does to velocities
//   relax   D_i  = v_i . G_i - sum_j v_j . g_ij                 rate of change of the density
//           X_i  = Y_i + omega alpha_i (D_i + what is too much already), less what may flow into a gap;
//                  not below 0 at a surface, not below the least impulse inside (a proximal step)
//           Y_i <- X_i + beta (X_i - what it was)               momentum (Beck & Teboulle 2009), from 0 again where the
//                                                               last step led uphill (O'Donoghue & Candes 2015)
//           r_i  = (X_i - Y_i) / (omega alpha_i)                0 at the solution: too little pressure counts, and too
//           much
// Velocities: nothing is undone, so that a solve takes energy and never gives any, from whatever P it starts.
// Places (least impulse 0, no momentum): what is too dense moves apart, and its velocity stays.
// A boundary's particles have no pressure of their own.  The velocities in memory always belong to the P
// before the last relax, whose r is the one that is judged and reported.
#pragma once
#include "sim/density.hpp"

namespace globule::core::sim {

/// How far a solve has come; lives on the device, so that the loop need not wait for the host.
struct Progress {
    double error;  ///< mean of |r| dt: of the density, relative
    double most;   ///< the largest
    double over;   ///< the share of particles with more than kOver times the mean that is allowed
    std::uint32_t iterations;
    std::uint32_t done;  ///< also where there were as many iterations as may be
    float t, beta;       ///< momentum of the iterates
};

template <class Packet_> struct Push {
    static constexpr int packet_blocks = 1;  ///< at least, at one time on a GPU's processor
    Lists<Packet_> lists;
    Rows rows;
    const float* change;  ///< dP, per slot
    Quad* velocity;
    const Progress* progress;
    float inverse_support;
    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        if (progress->done) return;
        const std::uint32_t* slot = lists.rows + row;
        // What is used after the walk is asked for before it: a GPU waits for memory once.
        const F s = Packet::load(rows.inverse_rho + row) * F(inverse_support);
        Four<F> v = Packet::gather(velocity, slot);
        const F p = Packet::own(Packet::gather(change, slot));
        F x = p * Packet::load(rows.gx + row), y = p * Packet::load(rows.gy + row), z = p * Packet::load(rows.gz + row);
        const std::uint32_t n = Packet::longest(lists.count + row);
        lists.with_slots(row, [&](const auto& gather) {
            for (std::uint32_t k = Packet::member(); k < n; k += Packet::team) {
                const std::size_t at = lists.at(row, k);
                lists.fetch_next_pair(at);
                const auto& pair = lists.read_pair(at);
                const F q = gather(change, at, pair);
                const Vec3<F> g = pair.gradient();
                x += q * g.x;
                y += q * g.y;
                z += q * g.z;
            }
        });
        if (!Packet::add_up(x, y, z)) return;
        v.x -= s * x;
        v.y -= s * y;
        v.z -= s * z;
        Packet::scatter(velocity, slot, v);
    }
};

template <class Packet_> struct Relax {
    static constexpr int packet_blocks = 1;  ///< at least, at one time on a GPU's processor
    Lists<Packet_> lists;
    Rows rows;
    const float* alpha;  ///< per row
    const Quad* velocity;
    float* pressure;      ///< P, per slot: where velocities are judged
    float* change;        ///< dP, per slot
    float* iterate;       ///< P without momentum, per row
    float *error, *turn;  ///< |r|; above 0 where the last step of P led too far, per row
    const Progress* progress;
    float inverse_support;
    float per_dt;
    float most_excess;   ///< of the density, that is to be undone: 0 where velocities are solved for
    float least_excess;  ///< 0: gaps do not close
    const float* bulk;   ///< per row: above 0 where pressures may be below 0; null: everywhere
    float least_impulse;
    float omega;
    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        if (progress->done) return;
        const std::uint32_t* slot = lists.rows + row;
        // What is used after the walk is asked for before it: a GPU waits for memory once.
        const F zero = F(0.0f), a = Packet::load(alpha + row), density = Packet::load(rows.density + row);
        const F inside = bulk ? Packet::load(bulk + row) : F(1.0f), beta = F(progress->beta);
        const F before = Packet::gather(pressure, slot), last = Packet::load(iterate + row);
        const Four<F> v = Packet::gather(velocity, slot);
        F sum = Packet::own(
            v.x * Packet::load(rows.gx + row) + v.y * Packet::load(rows.gy + row) + v.z * Packet::load(rows.gz + row));
        const std::uint32_t n = Packet::longest(lists.count + row);
        lists.with_slots(row, [&](const auto& gather) {
            for (std::uint32_t k = Packet::member(); k < n; k += Packet::team) {
                const std::size_t at = lists.at(row, k);
                lists.fetch_next_pair(at);
                const auto& pair = lists.read_pair(at);
                const Four<F> u = gather(velocity, at, pair);
                const Vec3<F> g = pair.gradient();
                sum -= u.x * g.x + u.y * g.y + u.z * g.z;
            }
        });
        if (!Packet::add_up(sum)) return;
        const F excess = max(min(density - F(1.0f), F(most_excess)), F(least_excess));
        const F least = select(inside > zero, F(least_impulse), zero), step = F(omega) * a;
        // A gap may close: D up to its rate costs nothing (a proximal step).
        const F free = step * F(per_dt) * max(zero - excess, zero);
        const F raw = before + step * (sum * F(inverse_support) + F(per_dt) * max(excess, zero));
        const F x = max(raw - free, zero) + max(min(raw, zero), least);
        const F after = max(x + beta * (x - last), least);
        Packet::store(iterate + row, x);
        Packet::scatter(pressure, slot, after);
        Packet::scatter(change, slot, after - before);
        const F r = (x - before) / max(step, F(1e-30f));
        Packet::store(error + row, select(a > zero, max(r, zero - r), zero));
        Packet::store(turn + row, select(a > zero, (before - x) * (x - last) / max(a, F(1e-30f)), zero));
    }
};

/// Starts from a share of the last step's pressure.
struct WarmStart {
    const std::uint32_t* rows;
    const float* alpha;
    float* pressure;  ///< in: Pa, out: P
    float* change;
    float* iterate;
    const float* bulk;
    float dt, least_impulse;  ///< dt: times the share
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = rows[row];
        const float p =
            alpha[row] > 0.0f ? max(dt * pressure[slot], !bulk || bulk[row] > 0.0f ? least_impulse : 0.0f) : 0.0f;
        pressure[slot] = p;
        change[slot] = p;
        iterate[row] = p;
    }
};

/// Momentum that P carries across a face, over P: a fluid without order is near to close packing, where
/// -sum_j V x dW/dx is this (cubic lattice: 1.020).
inline constexpr float kFlux = 0.966f;

/// The pressure that velocities have seen: without what the last relax would have added.
struct Applied {
    const std::uint32_t* rows;
    float* impulse;  ///< in: P, out: Pa
    const float* change;
    float per_dt, flux;
    float* pressure;
    GB_FN void operator()(std::size_t row) const {
        const std::uint32_t slot = rows[row];
        pressure[slot] = (impulse[slot] - change[slot]) * per_dt * flux;
        impulse[slot] *= per_dt;
    }
};

/// Of all rows: sum and largest of |r|, how many are above a limit, and what tells a turn.
struct Residuals { double sum, most, n_over, turn; };
struct ResidualsOf {
    const float *error, *turn;
    float limit;
    const Compression* there;  ///< as Judge has it
    GB_FN Residuals operator()(std::size_t row) const {
        const double most = there ? there->share_of_layers() * limit : limit;
        return {error[row], error[row], error[row] > most ? 1.0 : 0.0, turn[row]};
    }
};
struct AddResiduals {
    GB_FN Residuals operator()(const Residuals& a, const Residuals& b) const {
        return {a.sum + b.sum, a.most > b.most ? a.most : b.most, a.n_over + b.n_over, a.turn + b.turn};
    }
};
struct AddDouble {
    GB_FN double operator()(double a, double b) const { return a + b; }
};

inline constexpr double kTighten = 1.5;
inline constexpr float kFirstT = 3.0f;  ///< momentum as after some iterations, as a solve starts near its solution;
                                        ///< also an iteration after a restart
struct Judge {
    const Residuals* found;
    double dt, n;
    double tolerance;  ///< of the mean
    double most;       ///< of the largest
    double over;       ///< of the share of particles above the limit that ResidualsOf counts with
    std::uint32_t least_iterations;
    std::uint32_t most_iterations;
    bool by_layers;            ///< velocities: or as many as layers
    float momentum;            ///< 0: none
    const Compression* there;  ///< of what is to become velocities, or null: more than is allowed, and layers, ask for
                               ///< smaller errors
    double allowed;
    Progress* progress;
    GB_FN bool is_over() const { return progress->done; }
    GB_FN void operator()(std::size_t) const {
        progress->error = found->sum * dt / n;
        progress->most = found->most * dt;
        progress->over = found->n_over / n;
        progress->iterations += 1;
        const double share = there && there->n > 0.0
                                 ? min(1.0, kTighten * allowed * there->all / max(there->sum, 1e-30))
                                 : 1.0,
                     s = share * share * (there ? there->share_of_layers() : 1.0);
        // Pressure goes two spacings an iteration: in fewer than a column has layers it would not come through.
        const double at_most = max<double>(most_iterations, by_layers && there ? there->layers() : 0.0);
        progress->done = (progress->iterations >= least_iterations && progress->error <= s * tolerance &&
                             progress->most <= s * most && progress->over <= over) ||
                         progress->iterations >= at_most;
        const float t = found->turn > 0.0 ? 1.0f : max(progress->t, kFirstT),
                    next = 0.5f * (1.0f + sqrt(1.0f + 4.0f * t * t));
        progress->beta = momentum * (t - 1.0f) / next;
        progress->t = next;
    }
};

/// One iteration: push, relax, judge.
template <class Packet_> struct Rounds {
    using State = Progress;
    using Sum = Residuals;
    Push<Packet_> push;
    Relax<Packet_> relax;
    ResidualsOf residuals;
    Judge judges;

    GB_FN Progress* state() const { return judges.progress; }
    /// With another state and sum.
    GB_FN Rounds with(Progress* progress, const Residuals* found) const {
        Rounds r = *this;
        r.push.progress = r.relax.progress = r.judges.progress = progress;
        r.judges.found = found;
        return r;
    }
    template <class Packet> GB_FN void lead(std::size_t row) const { push.template run<Packet>(row); }
    template <class Packet> GB_FN void follow(std::size_t row) const { relax.template run<Packet>(row); }
    GB_FN Residuals item(std::size_t row) const { return residuals(row); }
    GB_FN static Residuals combine(const Residuals& a, const Residuals& b) { return AddResiduals{}(a, b); }
    GB_FN void judge() const { judges(0); }
};

}  // namespace globule::core::sim
