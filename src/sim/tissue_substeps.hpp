// The substeps of a step of tissue: forces, instruments, friction of cut faces.
#pragma once
#include "sim/tissue.hpp"

namespace globule::core {

template <class Exec> tissue::Felt TissueImpl<Exec>::begin_felt(float dt, const float3& gravity) {
    felt_dt_ = dt;
    felt_shapes_ = shapes_.n;
    feels_ = grasped_ != 0 || shapes_.n > 0;
    felt_asked_ = false;
    felt_grasps_ = grasped_;
    if (!feels_) return {};
    const std::size_t size = 2 * std::size_t(1 + shapes_.n) * n_;
    exec_.clear(felt_.reserve(size), size * sizeof(float3));
    exec_.clear(felt_sums_.reserve(1), sizeof(tissue::FeltSums));
    return {felt_.data(), n_, gravity};
}

template <class Exec> void TissueImpl<Exec>::begin_rub() {
    const bool rubs = rubs_ || walls_.rub || shapes_.any_friction();
    if (rubs && !loaded_) {
        exec_.clear(contact_loads_.reserve(2 * std::size_t(n_)), 2 * std::size_t(n_) * sizeof(Quad));
        loaded_ = true;
    }
    const tissue::MeanLoads loads{
        rubs ? contact_loads_.data() : nullptr, float(fastest_) / kSubstepsOfLoad, kGapOfContact * contact_};
    walls_.loads = shapes_.loads = loads;
    if (rubs) shapes_.loads.of += n_;
}

template <class Exec> void TissueImpl<Exec>::ask_strain(const Quad* at) {
    tissue::Strained *out = strained_.reserve(1 + std::size_t(n_)), *each = out + 1;
    side_->follow(exec_);
    side_->for_each(n_, tissue::Stiffening{bonds(), solid(), at, velocity_.data(), yielded_ ? stays_.data() : nullptr,
                            quiet_.data(), each});
    side_->reduce_in_order(n_, tissue::StrainedOf{each}, tissue::MostStrained{}, tissue::Strained{1.0, 0.0}, out);
    most_strained_.ask(*side_, out);
}

template <class Exec> double TissueImpl<Exec>::hurry(float dt) const {
    const tissue::Strained most = most_strained_.wait();  // the side's work is done then
    return std::sqrt(std::min(std::max(1.0, most.stiffness / kBorne), kMostStiffening)) *  // 1 where it is no number
           std::min(std::max(1.0, most.rate * dt / kStrainOfPart), kMostByStrain);
}

template <class Exec> int TissueImpl<Exec>::jumps(float dt) const {
    float fastest = 0.0f;
    for (int g = 0; g < tissue::kMaxGrasps; ++g)
        if (grasped_ >> g & 1u)
            fastest =
                std::max(fastest, length(motions_.velocity[g]) + length(motions_.spin[g]) * kReachOfGrasp * contact_);
    return int(std::min(std::ceil(fastest * dt / (kJumpOfPart * contact_)), kMostJumps));
}

template <class Exec> void TissueImpl<Exec>::prepare_solid() {
    correct();
    if (yields_ && !yielded_) {
        const std::size_t size = 6 * std::size_t(stride());
        exec_.clear(stays_.reserve(size), size * sizeof(float));
        yielded_ = true;
    }
}

template <class Exec> int TissueImpl<Exec>::take_solid_substeps(float whole_dt, int asked, const float3& gravity) {
    moved();
    prepare_solid();
    const tissue::Felt felt = begin_felt(whole_dt, gravity);
    begin_rub();
    const tissue::Drag drag{wet_ ? response_.data() : nullptr, velocity_.data(), drag_.data()};
    Quad *at = at_.data(), *next = next_.data();
    const int n_parts = asked > 0 ? 1 : std::max(ceil_div(substeps(whole_dt), kSubstepsOfPart), jumps(whole_dt));
    const float part_dt = whole_dt / float(n_parts);
    int n_done = 0;
    for (int part = 0; part < n_parts; ++part) {
        if (asked == 0 && !std::exchange(asked_strain_, false)) ask_strain(at);
        const int n_substeps = asked > 0 ? asked : substeps(part_dt * float(hurry(part_dt)));
        const float dt = part_dt / float(n_substeps);
        for (int s = 0; s < n_substeps; ++s) {
            shapes_.move(dt);
            walls_.elapsed += dt;
            if (n_terms_ || yielded_) {
                const tissue::Memory memory{terms_.data(), yielded_ ? stays_.data() : nullptr, phase_.data(),
                    materials_, n_terms_, stride(), n_, dt};
                exec_.for_each_packet(
                    n_, tissue::Strain<tissue::Memory>{bonds(), solid(), at, quiet_.data(), drag, memory});
            } else {
                exec_.for_each_packet(
                    n_, tissue::Strain<tissue::NoMemory>{bonds(), solid(), at, quiet_.data(), drag, {}});
            }
            exec_.for_each_packet(
                n_, tissue::Push{bonds(), solid(), at, next, velocity_.data(), acceleration_.data(), hold_.data(),
                        phase_.data(), materials_, motions_, shapes_, walls_, felt, drag, dt});
            rub_cuts(at, next, dt, dt, felt);
            std::swap(at, next);
        }
        n_done += n_substeps;
    }
    if (at != at_.data()) at_.swap(next_);
    return n_done;
}

template <class Exec>
int TissueImpl<Exec>::take_substeps(float whole_dt, int asked, int iterations, const float3& gravity) {
    if (is_solid_) return take_solid_substeps(whole_dt, asked, gravity);
    moved();
    const int n_substeps = asked > 0 ? asked : substeps(whole_dt);
    const float dt = whole_dt / float(n_substeps);
    exec_.for_each(n_, tissue::Predict{at_.data(), velocity_.data(), acceleration_.data(), hold_.data(), motions_, dt});
    const tissue::Felt felt = begin_felt(whole_dt, gravity);
    begin_rub();
    float* lambda = iterations > 1 ? lambda_.reserve(n_entries_) : nullptr;
    Quad *at = at_.data(), *next = next_.data();
    const auto relax = [&]<bool single>(std::bool_constant<single>, int s, int k) {
        exec_.for_each_packet(n_, tissue::Relax<single>{bonds(), at, next, velocity_.data(), acceleration_.data(),
                                      hold_.data(), phase_.data(), lambda, materials_, motions_, shapes_, walls_, felt,
                                      dt, contact_, k == 0, k + 1 == iterations, s + 1 < n_substeps});
        if (k + 1 == iterations) rub_cuts(at, next, dt, s + 1 < n_substeps ? 2.0f * dt : dt, felt);
        std::swap(at, next);
    };
    for (int s = 0; s < n_substeps; ++s) {
        shapes_.move(dt);
        walls_.elapsed += dt;
        if (iterations == 1) relax(std::true_type{}, s, 0);
        else
            for (int k = 0; k < iterations; ++k) relax(std::false_type{}, s, k);
    }
    if (at != at_.data()) at_.swap(next_);
    return n_substeps;
}

template <class Exec>
void TissueImpl<Exec>::rub_cuts(const Quad* at, Quad* next, float dt, float ahead, const tissue::Felt& felt) {
    if (!rubs_ || n_scars_ == 0) return;
    float3* impulse = rub_.reserve(n_);
    exec_.for_each(n_, tissue::Rub{bonds(), at, velocity_.data(), hold_.data(), phase_.data(), materials_, dt, contact_,
                           is_solid_, impulse});
    exec_.for_each(
        n_, tissue::TakeRub{scarred_.data(), hold_.data(), impulse, next, velocity_.data(), motions_, felt, ahead});
}

}  // namespace globule::core
