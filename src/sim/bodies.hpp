// What moves as a whole, over any Exec: boundaries that follow key frames, and rigid bodies that the fluid pushes.
#pragma once
#include "sim/fluid.hpp"
#include "sim/friction.hpp"
#include "sim/motion_bytes.hpp"

namespace globule::core {

template <class Exec> class Bodies {
public:
    using Packet = typename Exec::Packet;

    Bodies(Exec& exec, SimulationState<Exec>& state, const SimulationSettings& settings)
        : exec_(exec),
          state_(state),
          settings_(settings),
          home_(exec),
          bump_(exec),
          share_(exec),
          solve_(exec, state, bodies_) {}

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
    void make_body(int phase, double mass, const double center[3], const double inertia[9], const double velocity[3],
        const double spin[3]) {
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

    RigidSolve<Exec>& solve() { return solve_; }
    bool none() const { return next_poses_.empty() && bodies_.empty(); }

    /// Boundaries get the velocities that lead them to their next poses; whether there are any.
    bool carry(float dt) {
        for (const auto& [phase, pose] : next_poses_)
            exec_.for_each(
                state_.n, sim::Carry{state_.view(), std::uint8_t(phase), pose, home_.data(), state_.period(), dt});
        return !next_poses_.empty();
    }

    /// Rigid bodies: contact; then their particles' next places.
    void turn(float dt) {
        solve_.meet();
        for (auto& [phase, body] : bodies_) {
            body.advance(dt);
            body.wrap(settings_.lo, state_.period().length);
            exec_.for_each(state_.n,
                sim::Carry{state_.view(), std::uint8_t(phase), body.pose(), home_.data(), state_.period(), dt});
        }
    }
    /// Rigid bodies: what they keep out pushes them back.  The share of it, by phase, after which both move on
    /// together, or null: all.
    const float* push_back(const sim::Contact<Packet>& contact) {
        if (bodies_.empty()) return nullptr;
        std::vector<float> shares(sim::kMaxPhases, 1.0f);
        for (auto& [phase, body] : bodies_) {
            sim::Bump* bump = bump_.reserve(1);
            exec_.reduce_in_order(contact.step.lists.n_rows,
                sim::BumpOf<Packet>{contact, std::uint8_t(phase), state_.volume(), body.center_float()}, sim::AddBump{},
                sim::Bump{}, bump);
            sim::Bump b;
            exec_.download(&b, bump, sizeof b);
            const float share = shares[phase] = float(body.mass() / (body.mass() + b.mass));
            for (int k = 0; k < 3; ++k) {
                b.impulse.p[k] *= share;
                b.impulse.l[k] *= share;
            }
            body.push(b.impulse.p, b.impulse.l);
        }
        float* share = share_.reserve(shares.size());
        exec_.upload(share, shares.data(), shares.size() * sizeof *share);
        exec_.synchronize();
        return share;
    }

private:
    /// Every particle of what moves needs a place of its own in it.
    void check_home(
        const std::vector<Quad>& home, const std::map<int, sim::Pose>& poses, const std::map<int, RigidBody>& bodies) {
        if (poses.empty() && bodies.empty()) return;
        std::vector<std::uint8_t> phase(state_.n);
        std::vector<std::uint32_t> id(state_.n);
        exec_.download(phase.data(), state_.view().phase, phase.size());
        exec_.download(id.data(), state_.view().id, id.size() * sizeof id[0]);
        for (std::size_t i = 0; i < id.size(); ++i) {
            if (!poses.count(phase[i]) && !bodies.count(phase[i])) continue;
            if (id[i] >= home.size())
                throw Refused("checkpoint: expected a place of every particle of a body that moves, got fewer");
            const Quad& h = home[id[i]];
            if (!(std::abs(h.x) + std::abs(h.y) + std::abs(h.z) < INFINITY))
                throw Refused("checkpoint: expected finite places of a body that moves, got others");
        }
    }

    Exec& exec_;
    SimulationState<Exec>& state_;
    const SimulationSettings& settings_;
    Buffer<Quad, Exec> home_;
    Buffer<sim::Bump, Exec> bump_;
    Buffer<float, Exec> share_;
    std::map<int, sim::Pose> next_poses_;
    std::map<int, RigidBody> bodies_;
    RigidSolve<Exec> solve_;
};

}  // namespace globule::core
