// What moves as a whole, over any Exec: boundaries that follow key frames, and rigid bodies that the fluid pushes.
#pragma once
#include "sim/fluid.hpp"
#include "sim/friction.hpp"
#include "sim/motion_bytes.hpp"

namespace globule::core {

template <class Exec>
class Bodies {
public:
    using Packet = typename Exec::Packet;

    Bodies(Exec& exec, SimulationState<Exec>& state, const SimulationSettings& settings)
        : exec_(exec), state_(state), settings_(settings), home_(exec), impulse_(exec), touch_(exec) {}

    void capture(int phase, const sim::Pose& now) {
        if (home_.capacity() < state_.next_id) {  // ids of other bodies keep their places
            Buffer<Quad, Exec> old(exec_);
            const std::size_t n = home_.capacity();
            exec_.for_each(n, sim::CopyQuads{home_.data(), old.reserve(n + 1)});
            home_.reserve(state_.next_id + state_.next_id / 2 + 64);
            exec_.clear(home_.data(), home_.capacity() * sizeof(Quad));
            exec_.for_each(n, sim::CopyQuads{old.data(), home_.data()});
            exec_.synchronize();
        }
        exec_.for_each(state_.n, sim::Capture{state_.view(), std::uint8_t(phase), now, home_.data()});
    }
    void move_to(int phase, const sim::Pose& next) { next_poses_[phase] = next; }
    void make_body(int phase, double mass, const double center[3], const double inertia[9], const double velocity[3], const double spin[3]) {
        RigidBody::M m;
        std::copy(inertia, inertia + 9, m.begin());
        RigidBody body(mass, {center[0], center[1], center[2]}, m);
        std::copy(velocity, velocity + 3, body.velocity.begin());
        std::copy(spin, spin + 3, body.spin.begin());
        bodies_.insert_or_assign(phase, body);
        capture(phase, body.pose());
    }
    std::vector<double> body(int phase) const {
        const RigidBody& b = bodies_.at(phase);
        std::vector<double> out;
        for (const auto* v : {&b.center(), &b.velocity, &b.spin}) out.insert(out.end(), v->begin(), v->end());
        const sim::Pose p = b.pose();
        for (double v : {p.x.x, p.y.x, p.z.x, p.x.y, p.y.y, p.z.y, p.x.z, p.y.z, p.z.z}) out.push_back(v);
        return out;
    }

    /// All of this as bytes of a checkpoint.
    std::vector<char> save() {
        std::vector<Quad> home(home_.capacity());
        if (!home.empty()) exec_.download(home.data(), home_.data(), home.size() * sizeof(Quad));
        return save_motion(home, next_poses_, bodies_);
    }
    void load(const std::vector<char>& bytes) {
        std::vector<Quad> home;
        std::map<int, sim::Pose> poses;
        std::map<int, RigidBody> bodies;
        load_motion(bytes, home, poses, bodies);
        check_home(home, poses, bodies);
        next_poses_ = std::move(poses);
        bodies_ = std::move(bodies);
        if (home.empty()) return;
        exec_.upload(home_.reserve(home.size()), home.data(), home.size() * sizeof(Quad));
        exec_.synchronize();
    }

    /// Of each rigid body, by phase.
    std::map<int, tissue::RigidMass> masses() const {
        std::map<int, tissue::RigidMass> out;
        for (const auto& [phase, body] : bodies_) out[phase] = {float(body.mass()), body.center_float()};
        return out;
    }
    void push(int phase, const sim::Impulse& impulse) { bodies_.at(phase).push(impulse.p, impulse.l); }

    bool none() const { return next_poses_.empty() && bodies_.empty(); }

    /// Boundaries get the velocities that lead them to their next poses; whether there are any.
    bool carry(float dt) {
        for (const auto& [phase, pose] : next_poses_)
            exec_.for_each(state_.n, sim::Carry{state_.view(), std::uint8_t(phase), pose, home_.data(), state_.period(), dt});
        return !next_poses_.empty();
    }

    /// Rigid bodies: what the fluid's pressure did to them, gravity, contact; then their particles' next places.
    void turn(const Fluid<Exec>& fluid, float dt) {
        const sim::State s = state_.view();
        for (auto& [phase, body] : bodies_) {
            double p[3], none[3] = {};
            for (int k = 0; k < 3; ++k) p[k] = body.mass() * dt * (&settings_.gravity.x)[k];
            body.push(p, none);
            if (state_.n_rows == 0) continue;
            sim::Impulse* impulse = impulse_.reserve(1);
            const sim::PressureImpulse<Packet, sim::OfPhase> pressure{fluid.lists(), s, fluid.rows().boundary, {s.phase, std::uint8_t(phase)}, state_.period(), state_.sizes(),
                                                                      state_.volume(), state_.spline().support, dt, fluid.flux(), body.center_float()};
            exec_.reduce_in_order(state_.n_rows, pressure, sim::AddImpulse{}, sim::Impulse{}, impulse);
            sim::Impulse i;
            exec_.download(&i, impulse, sizeof i);
            body.push(i.p, i.l);
        }
        if (state_.n_rows > 0) meet(fluid, dt);
        for (auto& [phase, body] : bodies_) {
            body.advance(dt);
            exec_.for_each(state_.n, sim::Carry{s, std::uint8_t(phase), body.pose(), home_.data(), state_.period(), dt});
        }
    }

private:
    /// Contacts of bodies with walls, and with each other: impulses are equal and opposite.  What stands on one that stands on a wall needs several rounds.
    void meet(const Fluid<Exec>& fluid, float dt) {
        struct Meeting {
            RigidBody *body, *other;
            sim::Touch touch;
        };
        constexpr int kRounds = 8;
        std::vector<Meeting> meetings;
        const auto find = [&](int phase, RigidBody& body, const sim::PhaseSet& others, RigidBody* other) {
            const sim::Touch t = touch(fluid, phase, others);
            if (t.weight > 0) meetings.push_back({&body, other, t});
            return t.weight > 0;
        };
        sim::PhaseSet walls;
        for (std::size_t k = 0; k < state_.phase_table.size(); ++k)
            if (!bodies_.count(int(k))) walls.add(int(k));
        for (auto a = bodies_.begin(); a != bodies_.end(); ++a) {
            find(a->first, a->second, walls, nullptr);
            sim::PhaseSet others;
            for (auto b = std::next(a); b != bodies_.end(); ++b) others.add(b->first);
            if (std::next(a) == bodies_.end() || !(touch(fluid, a->first, others).weight > 0)) continue;
            for (auto b = std::next(a); b != bodies_.end(); ++b) {
                sim::PhaseSet one;
                one.add(b->first);
                find(a->first, a->second, one, &b->second);
            }
        }
        for (int round = 0; round < (bodies_.size() > 1 ? kRounds : 1); ++round)
            for (const Meeting& m : meetings) m.body->meet(m.touch, m.other, state_.period().length, dt);
    }
    sim::Touch touch(const Fluid<Exec>& fluid, int phase, const sim::PhaseSet& others) {
        sim::Touch* found = touch_.reserve(1);
        exec_.reduce_in_order(state_.n_rows, sim::TouchOf<Packet>{fluid.lists(), state_.view(), std::uint8_t(phase), others, state_.period(), settings_.spacing}, sim::AddTouch{}, sim::Touch{}, found);
        sim::Touch t;
        exec_.download(&t, found, sizeof t);
        return t;
    }

    /// Every particle of what moves needs a place of its own in it.
    void check_home(const std::vector<Quad>& home, const std::map<int, sim::Pose>& poses, const std::map<int, RigidBody>& bodies) {
        if (poses.empty() && bodies.empty()) return;
        std::vector<std::uint8_t> phase(state_.n);
        std::vector<std::uint32_t> id(state_.n);
        exec_.download(phase.data(), state_.view().phase, phase.size());
        exec_.download(id.data(), state_.view().id, id.size() * sizeof id[0]);
        for (std::size_t i = 0; i < id.size(); ++i) {
            if (!poses.count(phase[i]) && !bodies.count(phase[i])) continue;
            if (id[i] >= home.size()) throw Refused("checkpoint: expected a place of every particle of a body that moves, got fewer");
            const Quad& h = home[id[i]];
            if (!(std::abs(h.x) + std::abs(h.y) + std::abs(h.z) < INFINITY))
                throw Refused("checkpoint: expected finite places of a body that moves, got others");
        }
    }

    Exec& exec_;
    SimulationState<Exec>& state_;
    const SimulationSettings& settings_;
    Buffer<Quad, Exec> home_;
    Buffer<sim::Impulse, Exec> impulse_;
    Buffer<sim::Touch, Exec> touch_;
    std::map<int, sim::Pose> next_poses_;
    std::map<int, RigidBody> bodies_;
};

}  // namespace globule::core
