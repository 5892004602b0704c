// Where tissue meets the density solve: who is where, pairs that it sees, contacts, what its pressure does to
// instruments, friction.
#pragma once
#include "sim/tissue.hpp"

namespace globule::core {

template <class Exec>
bool TissueImpl<Exec>::gather(
    const sim::State& state, const sim::Phase* phases, const std::uint32_t* slot_of, float volume) {
    if (n_ == 0 || gathered_ || is_written_) return false;
    gathered_ = true;
    std::uint32_t n[2], *counters = count_.reserve(2);
    if (!settled_) exec_.clear(counters, sizeof n);
    exec_.for_each(n_, tissue::Gather{state, phases, id_.data(), slot_of, slot_.data(), at_.data(), velocity_.data(),
                           hold_.data(), volume, counters, counters + 1});
    if (settled_) return false;
    settled_ = true;
    exec_.download(n, counters, sizeof n);
    scar(n[0]);
    if (n[0]) exec_.for_each(n_, tissue::DropBonds{bonds(), hold_.data()});
    return n[1] > 0;
}

template <class Exec> template <class Packet> const float* TissueImpl<Exec>::veto(const sim::Step<Packet>& step) {
    if (n_ == 0) return nullptr;
    if (!is_solid_) {
        if (n_scars_ > 0)
            exec_.for_each(
                step.lists.n_rows, tissue::Veto<Packet>{step.lists, step.state, members(), bonds(), slot_.data()});
        return nullptr;
    }
    float* within = within_.reserve(step.lists.n_rows + 64);
    exec_.clear(within, (step.lists.n_rows + 64) * sizeof *within);
    const float reach = kWithin * contact_;
    const tissue::OwnPairs<Packet> pairs{
        step.lists, step.state, members(), rest_at_.data(), body_.data(), reach * reach};
    const std::uint8_t* scarred = n_scars_ > 0 ? scarred_.data() : nullptr;
    std::uint32_t* beside = beside_cuts_.reserve(step.lists.n_rows + 1);
    exec_.clear(beside, sizeof *beside);
    exec_.for_each(step.lists.n_rows,
        tissue::LeaveOut<Packet>{pairs, scarred, step.spline, step.volume, within, beside, beside + 1});
    if (scarred)
        exec_.for_each_tile_of(beside,
            tissue::LeaveOutBeside<Packet>{pairs, bonds(), step.period, step.spline, step.volume, within, beside + 1});
    return within;
}

template <class Exec>
template <class Packet>
void TissueImpl<Exec>::find_contacts(const sim::Step<Packet>& step, bool rubs, bool fluids) {
    if (n_ == 0) return;
    Quad* plane = plane_.reserve(n_);
    float* speed = plane_speed_.reserve(n_);
    std::uint8_t* beside = beside_.reserve(n_);
    exec_.clear(plane, n_ * sizeof *plane);
    exec_.clear(speed, n_ * sizeof *speed);
    exec_.clear(beside, n_);
    Quad* rub = rubs ? plane_rub_.reserve(n_) : nullptr;
    if (rub) exec_.clear(rub, n_ * sizeof *rub);
    exec_.for_each(step.lists.n_rows,
        tissue::FindContacts<Packet>{step, members(), body_.data(), is_solid_ ? rest_at_.data() : nullptr,
            scarred_.data(), spared_.data(), plane, speed, rub, beside});
    walls_ = {plane, speed, rub};
    wet_ = is_solid_ && fluids;
    if (!wet_) return;
    const float ahead = step.dt / contact_;
    exec_.for_each(n_, tissue::Weigh{step.state, slot_.data(), beside, hold_.data(), velocity_.data(), lame_.data(),
                           stride(), ahead * ahead, response_.reserve(n_)});
}

template <class Exec> template <class Packet> void TissueImpl<Exec>::feel_pressure(const sim::Step<Packet>& step) {
    for (int g = 0; g < tissue::kMaxGrasps && n_ > 0 && feels_; ++g) {
        if (!(grasped_ >> g & 1u)) continue;
        const tissue::Held held{members(), step.state.id, hold_.data(), std::uint8_t(tissue::kGrasped + g)};
        const sim::PressureImpulse<Packet, tissue::Held> pressure{step, held, motions_.center[g]};
        exec_.reduce_in_order(
            step.lists.n_rows, pressure, sim::AddImpulse{}, sim::Impulse{}, felt_sums_.data()->pressed + 2 * g);
    }
}

template <class Exec>
template <class Packet, class OnRigid>
void TissueImpl<Exec>::rub(
    const sim::Step<Packet>& step, const std::map<int, tissue::RigidMass>& rigids, const OnRigid& on_rigid) {
    if (n_ == 0) return;
    tissue::PressedPairs<Packet> pairs{step, members(), is_solid_ ? nullptr : body_.data(),
        {loads_.reserve(step.state.n), rigid_loads_.reserve(sim::kMaxPhases)}};
    exec_.for_each(step.lists.n_rows, tissue::FindLoads<Packet>{pairs});
    for (const auto& [phase, rigid] : rigids) {
        pairs.loads.mass[phase] = rigid.mass;
        exec_.reduce_in_order(step.lists.n_rows, tissue::LoadOf<Packet>{pairs, std::uint8_t(phase)}, sim::AddDouble{},
            0.0, rigid_loads_.data() + phase);
    }
    Quad* change = change_.reserve(step.lists.n_rows);
    exec_.for_each(step.lists.n_rows, tissue::RubPressed<Packet>{pairs, change});
    for (const auto& [phase, rigid] : rigids) {
        sim::Impulse impulse, *sum = one_sum_.reserve(1);
        exec_.reduce_in_order(step.lists.n_rows,
            tissue::RubImpulse<Packet, sim::OfPhase>{pairs, {step.state.phase, std::uint8_t(phase)}, rigid.center},
            sim::AddImpulse{}, sim::Impulse{}, sum);
        exec_.download(&impulse, sum, sizeof impulse);
        on_rigid(phase, impulse);
    }
    for (int g = 0; g < tissue::kMaxGrasps && feels_; ++g) {
        if (!(grasped_ >> g & 1u)) continue;
        const tissue::Held held{members(), step.state.id, hold_.data(), std::uint8_t(tissue::kGrasped + g)};
        exec_.reduce_in_order(step.lists.n_rows,
            tissue::RubImpulse<Packet, tissue::Held>{pairs, held, motions_.center[g]}, sim::AddImpulse{},
            sim::Impulse{}, felt_sums_.data()->pressed + 2 * g + 1);
    }
    exec_.for_each(step.lists.n_rows, tissue::TakeChange{step.lists.rows, change, step.state.velocity});
}

}  // namespace globule::core
