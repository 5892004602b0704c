// Blood of tissue: cut ends that let it out, and what it wets.
#pragma once
#include "sim/tissue.hpp"

namespace globule::core {

template <class Exec> template <class Packet> void TissueImpl<Exec>::change(const sim::Step<Packet>& step) {
    if (n_ == 0) return;
    if (tears_) tear(step.dt);
    follow();
    std::uint32_t stains = 0;
    for (const BloodVessel& v : vessels_) stains |= 1u << v.phase;
    if (!stains) return;
    std::uint8_t* touched = touched_.reserve(n_);
    Exec& exec = is_solid_ ? *side_ : exec_;  // which ask_strain() waits for
    if (is_solid_) side_->follow(exec_);
    exec.clear(touched, n_);
    exec.for_each(step.lists.n_rows, tissue::Touch<Packet>{step.lists, step.state, members(), stains,
                                         1.3f * contact_ * (0.5f + 0.5f * size_of_fluid_), touched});
    exec.for_each(n_, tissue::Wet{touched, step.dt, wetness_.data()});
}

template <class Exec>
void TissueImpl<Exec>::bleed(const Tree& tree, const SortedParticles& particles, const sim::Sizes& sizes, float dt) {
    tissue::Vessels flowing;
    bleeds_ = false;
    for (std::size_t v = 0; v < vessels_.size(); ++v)
        if (vessels_[v].pool >= drop_volume()) bleeds_ = true, flowing.speed[v + 1] = vessels_[v].speed;
    bleeds_ &= n_scars_ > 0;
    if (!bleeds_) return;
    tissue::Drop *asking = asking_.reserve(n_),
                 *found = found_.reserve(std::max(std::size_t(n_) + 1, std::tuple_size_v<FirstDrops>));
    std::uint8_t* open = open_.reserve(tissue::kMaxVessels + 1);
    side_->clear(found, sizeof *found);
    side_->clear(open, tissue::kMaxVessels + 1);
    side_->for_each(n_, tissue::Seep{bonds(), hold_.data(), flowing, contact_, dt, volume_.data(), whose_.data(),
                            next_volume_.reserve(n_), next_whose_.reserve(n_), open});
    volume_.swap(next_volume_);
    whose_.swap(next_whose_);
    side_->for_each(n_, tissue::Bleed{bonds(), at_.data(), hold_.data(), flowing, float(drop_volume()), volume_.data(),
                            whose_.data(), open, &found->vessel, asking});
    side_->for_each_tile_of(&found->vessel, tissue::FindRoom{tree, particles, asking, velocity_.data(), flowing, sizes,
                                                contact_, size_of_fluid_, &found->t, found + 1});
    first_drops_.ask(*side_, reinterpret_cast<const FirstDrops*>(found));
}

template <class Exec> std::vector<tissue::Drop> TissueImpl<Exec>::drops() {
    std::vector<tissue::Drop> out;
    if (!bleeds_) return out;
    const FirstDrops& first = first_drops_.wait();                // the side's work is done then
    std::vector<tissue::Drop> found(first.begin(), first.end());  // first of all, how many there are
    const std::size_t read = found.size(), n_found = found[0].t;
    found.resize(n_found + 1);
    if (n_found + 1 > read) exec_.download(&found[read], found_.data() + read, (n_found + 1 - read) * sizeof found[0]);
    found.erase(found.begin());
    std::sort(found.begin(), found.end(), [](const tissue::Drop& a, const tissue::Drop& b) { return a.t < b.t; });
    if (n_found > kDropsAtOnce) found.resize(kDropsAtOnce);
    std::vector<std::uint32_t> who;
    const float d = contact_ * size_of_fluid_, apart = 0.81f * d * d;
    for (const tissue::Drop& d : found) {
        BloodVessel& v = vessels_[d.vessel - 1];
        const auto near = [&](const tissue::Drop& o) { return dot(o.at - d.at, o.at - d.at) < apart; };
        if (v.pool < drop_volume() || std::any_of(out.begin(), out.end(), near)) continue;
        v.pool -= drop_volume();
        out.push_back(d);
        who.push_back(d.t);
    }
    put(spent_, who.data(), who.size());
    exec_.for_each(who.size(), tissue::Spend{spent_.data(), volume_.data(), float(drop_volume())});
    return out;
}

}  // namespace globule::core
