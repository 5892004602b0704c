// Rigid bodies as unknowns of the fluid's solves.
//
// Fluid pushes a body with the opposite of what it feels of it, by pressure, viscosity, tension and adhesion: momentum
// is kept.  A body that learnt of this only after a solve would swing where it is lighter than the fluid that it moves
// along: the pressure of water that is to stop a ball of a fifth of its density throws the ball up twice as fast as it
// fell.  So a body's velocity follows every iteration.
//   pressure   U += sum_i V_i dP_i c_i / M, c_i = sum_j g_ij over the body's particles; its spin likewise.
//              Contacts then take what goes into them, from the sum of all pushes.
//              The step along alpha_i has to be shorter by what the body gives way: |c_i| sum_k V_k |c_k| / M, at least
//              the sum of a row of the matrix c M^-1 c
//   viscosity  U and spin are unknowns of the conjugate gradients; the matrix stays symmetric, since forces act where
//   velocities are
//              told: at the body's particles
#pragma once
#include <map>

#include "sim/rigid_body.hpp"
#include "sim/rigid_unknown.hpp"

namespace globule::core {
namespace sim {

/// Shorter steps of P beside a body, by how much it gives way.
template <class Packet> struct Yield {
    HoldOf<Packet> hold;
    const Unknown* body;
    float* alpha;  ///< per row
    GB_FN void operator()(std::size_t row) const {
        if (!(alpha[row] > 0.0f) || !(hold.nearest[row] < hold.support)) return;
        const auto h = hold(row);
        const double turns = body->inverse[0] + body->inverse[4] + body->inverse[8];  // at least the largest eigenvalue
        const double more =
            length(h.force) * body->reach.force / body->mass + length(h.moment) * body->reach.moment * turns;
        alpha[row] = float(1.0 / (1.0 / alpha[row] + more / (double(hold.support) * hold.support)));
    }
};
struct TakePush {
    Unknown* body;
    int n;
    Meetings meetings;
    const Progress* progress;
    GB_FN void operator()(std::size_t) const {
        if (progress->done) return;
        for (int b = 0; b < n; ++b) Unknown::add(body[b].free, 1.0, body[b].moved_by(body[b].drag.force));
        meetings(body, n);
    }
};

/// These run in one thread, over n bodies, as TakePush does.
struct StartUnknowns {
    Unknown* body;
    int n;
    Conjugate* state;
    float dt;
    GB_FN void operator()(std::size_t) const {
        double bodies = 0.0;
        for (int b = 0; b < n; ++b) {
            Unknown& d = body[b];
            const double cost = dt * d.drag.weight,
                         u2 = cost > 0.0
                                  ? Unknown::dot6(
                                        {{d.drag.force.p[0], d.drag.force.p[1], d.drag.force.p[2]}, {}}, d.drag.force) /
                                        (d.drag.weight * d.drag.weight)
                                  : 0.0;
            bodies += d.mass * d.mass / (d.mass + cost) * u2;
            d.share = d.mass / (d.mass + dt * d.drag.weight);
            Unknown::add(d.residual, dt, d.drag.force);
            d.direction = d.preconditioned();
            state->rz_new += Unknown::dot6(d.residual, d.direction);
        }
        state->least = max(kLeastOfFirst, min(1.0, bodies / max(state->rz_new, 1e-300)));
    }
    /// A light body's momentum is little beside what stiff honey does in the first iteration: errors are judged by the
    /// body's, down to this share.
    static constexpr double kLeastOfFirst = 1e-6;
};
struct MultiplyUnknowns {
    Unknown* body;
    int n;
    Conjugate* state;
    float dt;
    GB_FN void operator()(std::size_t) const {
        if (state->done) return;
        for (int b = 0; b < n; ++b) {
            Unknown& d = body[b];
            Unknown::turn(d.inertia, d.direction.l, d.product.l);
            for (int k = 0; k < 3; ++k) d.product.p[k] = d.mass * d.direction.p[k];
            Unknown::add(d.product, -double(dt), d.drag.force);
            state->pq += Unknown::dot6(d.direction, d.product);
        }
    }
};
struct StepUnknowns {
    Unknown* body;
    int n;
    Conjugate* state;
    GB_FN void operator()(std::size_t) const {
        if (state->done) return;
        const double a = state->pq > 0.0 ? state->rz / state->pq : 0.0;
        for (int b = 0; b < n; ++b) {
            Unknown& d = body[b];
            Unknown::add(d.change, a, d.direction);
            Unknown::add(d.residual, -a, d.product);
            state->rz_new += Unknown::dot6(d.residual, d.preconditioned());
        }
    }
};
struct TurnUnknowns {
    Unknown* body;
    int n;
    const Conjugate* state;
    GB_FN void operator()(std::size_t) const {
        if (state->done) return;
        const double s = state->rz > 0.0 ? state->rz_new / state->rz : 0.0;
        for (int b = 0; b < n; ++b) {
            Impulse z = body[b].preconditioned();
            Unknown::add(z, s, body[b].direction);
            body[b].direction = z;
        }
    }
};
struct EndUnknowns {
    Unknown* body;
    int n;
    GB_FN void operator()(std::size_t) const {
        for (int b = 0; b < n; ++b) Unknown::add(body[b].motion, 1.0, body[b].change);
    }
};
/// A body's particles get velocities: its own, or a search direction.
struct Spread {
    State state;
    Period period;
    const Unknown* body;
    std::uint8_t phase;
    bool direction;
    Quad* out;  ///< per slot
    GB_FN void operator()(std::size_t i) const {
        if (state.phase[i] != phase) return;
        const Impulse& m = direction ? body->direction : body->motion;
        const float3 arm = period.template shortest<true>(state.place[i].xyz() - body->center);
        const float3 v = float3{float(m.p[0]), float(m.p[1]), float(m.p[2])} +
                         cross(float3{float(m.l[0]), float(m.l[1]), float(m.l[2])}, arm);
        out[i] = {v.x, v.y, v.z, out[i].w};
    }
};

}  // namespace sim

/// The bodies of a simulation while a step makes velocities: on the host between solves, on the device within one.
template <class Exec> class RigidSolve {
public:
    RigidSolve(Exec& exec, SimulationState<Exec>& state, std::map<int, RigidBody>& bodies)
        : exec_(exec),
          state_(state),
          bodies_(bodies),
          touch_(exec),
          device_(exec),
          device_meetings_(exec),
          alpha_(exec) {}

    /// Contacts, once a step, where everybody is now.
    template <class Lists> void find_meetings(const Lists& lists, float spacing, float dt) {
        meetings_.clear();
        spacing_ = spacing;
        dt_ = dt;
        if (bodies_.empty() || state_.n_rows == 0) return;
        gather();
        sim::PhaseSet walls;
        for (std::size_t k = 0; k < state_.phase_table.size(); ++k)
            if (!bodies_.count(int(k))) walls.add(int(k));
        int n_a = 0;
        for (auto a = bodies_.begin(); a != bodies_.end(); ++a, ++n_a) {
            find(lists, *a, walls, n_a, -1);
            sim::PhaseSet others;
            for (auto b = std::next(a); b != bodies_.end(); ++b) others.add(b->first);
            if (std::next(a) == bodies_.end() || !touches(lists, *a, others)) continue;
            int n_b = n_a + 1;
            for (auto b = std::next(a); b != bodies_.end(); ++b, ++n_b) {
                sim::PhaseSet one;
                one.add(b->first);
                find(lists, *a, one, n_a, n_b);
            }
        }
        if (meetings_.empty()) return;
        exec_.upload(
            device_meetings_.reserve(meetings_.size()), meetings_.data(), meetings_.size() * sizeof(sim::Meeting));
        exec_.synchronize();
    }
    /// Velocities that contacts allow.
    void meet() {
        if (meetings_.empty()) return;
        gather();
        meetings(meetings_.data(), kRounds)(host_.data(), n());
        give();
    }

    bool none() const { return bodies_.empty(); }

    /// A step's forces begin.
    void start() {
        upload();
        spread(state_.view().velocity, false);
    }
    /// Adhesion.
    template <class Fluid> void attract(const Fluid& fluid, const float* cohesion, float dt) {
        if (bodies_.empty()) return;
        drag(fluid, state_.view().velocity, 0.0f, cohesion);
        take(dt);
    }
    /// Surface tension.
    template <class Fluid> void pull(const Fluid& fluid, float dt) {
        if (bodies_.empty()) return;
        for (std::size_t b = 0; b < host_.size(); ++b)
            fluid.find_pull(host_[b].phase, host_[b].center, &device_.data()[b].drag);
        take(dt);
    }
    /// Gravity.
    void kick(const float3& gravity, float dt) {
        if (bodies_.empty()) return;
        for (auto& [phase, body] : bodies_)
            for (int k = 0; k < 3; ++k) body.velocity[k] += double(dt) * (&gravity.x)[k];
        upload();
        spread(state_.view().velocity, false);
    }

    /// Implicit viscosity, in this order; of velocities after all other forces.
    template <class Fluid> void start(const Fluid& fluid, sim::Conjugate* c, float dt) {
        if (bodies_.empty()) return;
        drag(fluid, state_.view().velocity, 1.0f, nullptr);
        exec_.for_each(1, sim::StartUnknowns{device_.data(), n(), c, dt});
    }
    void spread_direction(Quad* direction) { spread(direction, true); }
    template <class Fluid> void multiply(const Fluid& fluid, const Quad* direction, sim::Conjugate* c, float dt) {
        if (bodies_.empty()) return;
        drag(fluid, direction, 1.0f, nullptr);
        exec_.for_each(1, sim::MultiplyUnknowns{device_.data(), n(), c, dt});
    }
    void step(sim::Conjugate* c) {
        if (!bodies_.empty()) exec_.for_each(1, sim::StepUnknowns{device_.data(), n(), c});
    }
    void turn(const sim::Conjugate* c) {
        if (!bodies_.empty()) exec_.for_each(1, sim::TurnUnknowns{device_.data(), n(), c});
    }
    void end_viscosity() {
        if (bodies_.empty()) return;
        exec_.for_each(1, sim::EndUnknowns{device_.data(), n()});
        spread(state_.view().velocity, false);
        fetch();
    }

    /// Pressure: alpha of each row beside bodies that give way.
    template <class Fluid> const float* start_pressure(const Fluid& fluid, const float* alpha) {
        if (bodies_.empty()) return alpha;
        start_pressure();
        float* own = alpha_.reserve(fluid.lists().n_rows + 64);
        exec_.copy(own, alpha, (fluid.lists().n_rows + 64) * sizeof *own);
        for (std::size_t b = 0; b < host_.size(); ++b) {
            const auto hold = fluid.hold_of(host_[b].phase, host_[b].center);
            exec_.reduce_in_order(hold.lists.n_rows, sim::ArmOf<typename Exec::Packet>{hold}, sim::AddArm{}, sim::Arm{},
                &device_.data()[b].reach);
            exec_.for_each(hold.lists.n_rows, sim::Yield<typename Exec::Packet>{hold, device_.data() + b, own});
        }
        return own;
    }
    void start_pressure() { upload(); }
    /// After the fluid's own push.
    template <class Fluid> void push_back(const Fluid& fluid, const float* change, const sim::Progress* progress) {
        if (bodies_.empty()) return;
        for (std::size_t b = 0; b < host_.size(); ++b) {
            const sim::PushOf<typename Exec::Packet> push{fluid.hold_of(host_[b].phase, host_[b].center), change};
            exec_.reduce_in_order(push.hold.lists.n_rows, push, sim::AddDrag{}, sim::Drag{}, &device_.data()[b].drag);
        }
        exec_.for_each(
            1, sim::TakePush{device_.data(), n(), meetings(device_meetings_.data(), kRoundsWithin), progress});
        spread(state_.view().velocity, false);
    }
    /// Contacts anew at the step's end: rounds within the solve may have been too few.
    void end_pressure() { fetch(true); }

private:
    int n() const { return int(bodies_.size()); }
    sim::Meetings meetings(sim::Meeting* all, int rounds) const {
        return {all, int(meetings_.size()), rounds, kSmall * spacing_ / dt_};
    }
    template <class Lists>
    sim::TouchOf<typename Exec::Packet> touch_of(
        const Lists& lists, const std::pair<const int, RigidBody>& body, const sim::PhaseSet& others, int octant) {
        return {lists, state_.view(), std::uint8_t(body.first), others, state_.period(), spacing_,
            body.second.center_float(), octant};
    }
    template <class Lists>
    bool touches(const Lists& lists, const std::pair<const int, RigidBody>& body, const sim::PhaseSet& others) {
        sim::Touch t, *found = touch_.reserve(1);
        exec_.reduce_in_order(lists.n_rows, touch_of(lists, body, others, -1), sim::AddTouch{}, sim::Touch{}, found);
        exec_.download(&t, found, sizeof t);
        return t.weight > 0.0;
    }
    template <class Lists>
    void find(
        const Lists& lists, const std::pair<const int, RigidBody>& body, const sim::PhaseSet& others, int a, int b) {
        if (!touches(lists, body, others)) return;
        sim::Touch t[sim::kOctants], *found = touch_.reserve(sim::kOctants);
        for (int o = 0; o < sim::kOctants; ++o)
            exec_.reduce_in_order(
                lists.n_rows, touch_of(lists, body, others, o), sim::AddTouch{}, sim::Touch{}, found + o);
        exec_.download(t, found, sizeof t);
        for (const sim::Touch& one : t)
            if (sim::Meeting m; m.prepare(host_, a, b, one, state_.period(), spacing_, dt_)) meetings_.push_back(m);
    }
    void gather() {
        host_.clear();
        for (const auto& [phase, body] : bodies_) {
            sim::Unknown u;
            u.phase = std::uint8_t(phase);
            u.center = body.center_float();
            u.mass = body.mass() / state_.volume();
            const RigidBody::M inertia = body.inertia_now(), inverse = body.inverse_inertia_now();
            for (int k = 0; k < 9; ++k) {
                u.inertia[k] = inertia[k] / state_.volume();
                u.inverse[k] = inverse[k] * state_.volume();
            }
            std::copy(body.velocity.begin(), body.velocity.end(), u.motion.p);
            std::copy(body.spin.begin(), body.spin.end(), u.motion.l);
            u.free = u.motion;
            host_.push_back(u);
        }
    }
    void upload() {
        if (bodies_.empty()) return;
        gather();
        exec_.upload(device_.reserve(host_.size()), host_.data(), host_.size() * sizeof host_[0]);
        exec_.synchronize();
    }
    void download() { exec_.download(host_.data(), device_.data(), host_.size() * sizeof host_[0]); }
    /// The velocities that a solve has made.
    void fetch(bool free = false) {
        if (bodies_.empty()) return;
        download();
        for (sim::Unknown& u : host_)
            if (free) u.motion = u.free;
        give();
    }
    /// The forces that were found, as they are.
    void take(float dt) {
        download();
        for (sim::Unknown& u : host_) sim::Unknown::add(u.motion, dt, u.moved_by(u.drag.force));
        give();
        upload();
    }
    void give() {
        auto u = host_.begin();
        for (auto& [phase, body] : bodies_) {
            std::copy(u->motion.p, u->motion.p + 3, body.velocity.begin());
            std::copy(u->motion.l, u->motion.l + 3, body.spin.begin());
            ++u;
        }
    }
    template <class Fluid> void drag(const Fluid& fluid, const Quad* velocity, float share, const float* cohesion) {
        for (std::size_t b = 0; b < host_.size(); ++b)
            fluid.find_drag(velocity, share, cohesion, host_[b].phase, host_[b].center, &device_.data()[b].drag);
    }
    void spread(Quad* out, bool direction) {
        if (bodies_.empty()) return;
        for (std::size_t b = 0; b < host_.size(); ++b)
            exec_.for_each(state_.n,
                sim::Spread{state_.view(), state_.period(), device_.data() + b, host_[b].phase, direction, out});
    }

    static constexpr int kRounds = 5000;      // of contacts, at most: what is light under what is heavy takes many
    static constexpr int kRoundsWithin = 16;  // the same within a solve, whose next iteration goes on with them
    static constexpr double kSmall = 1e-6;    // spacings in a step

    Exec& exec_;
    SimulationState<Exec>& state_;
    std::map<int, RigidBody>& bodies_;
    float spacing_ = 0.0f, dt_ = 1.0f;
    std::vector<sim::Unknown> host_;
    std::vector<sim::Meeting> meetings_;
    Buffer<sim::Touch, Exec> touch_;
    Buffer<sim::Unknown, Exec> device_;
    Buffer<sim::Meeting, Exec> device_meetings_;
    Buffer<float, Exec> alpha_;
};

}  // namespace globule::core
