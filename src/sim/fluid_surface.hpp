// The free surface of fluids with tension over any Exec: who is at it, its facets, and what they pull.
#pragma once
#include "sim/facets.hpp"
#include "sim/particles.hpp"
#include "sim/rigid_drag.hpp"

namespace globule::core {

template <class Exec> class FluidSurface {
public:
    using Packet = typename Exec::Packet;
    using Lists = sim::Lists<Packet>;

    FluidSurface(Exec& exec, SimulationState<Exec>& state, const SimulationSettings& settings)
        : exec_(exec),
          state_(state),
          settings_(settings),
          quads_(exec),
          words_(exec),
          row_of_(exec),
          directions_(exec) {}

    /// Whether any fluid has tension.
    bool is_there() const { return is_there_; }

    /// Facets of the positions that the lists and the densities in `rows` belong to; rows are padded to so many.
    void find(const Lists& lists, const sim::Rows& rows, std::size_t padded) {
        is_there_ = has_others_ = false;
        for (const sim::Phase& p : state_.phase_table) {
            is_there_ |= p.kind == sim::Kind::fluid && p.tension > 0;
            has_others_ |= p.kind == sim::Kind::tissue || p.kind == sim::Kind::rigid;
        }
        if (!is_there_) return;
        reserve(padded);
        const sim::State s = state_.view();
        const float d = spacing(), other = 0.5f * (settings_.spacing + d), h = state_.spline().support;
        exec_.clear(skin_.n_rows, 4);
        exec_.for_each(state_.n + 1, sim::MarkSkin{s, state_.phases(), skin_, d});
        exec_.for_each(lists.n_rows,
            sim::ListSteep{lists.rows, lists.count, s, state_.phases(), rows, sim::kSurfaceGradient * h / d, skin_});
        sim::with_period(state_.period(), [&]<bool periodic>(std::bool_constant<periodic>) {
            const sim::MarkTension<Packet, periodic> mark{
                lists, s, state_.period(), directions_.data(), 1.0f / d, state_.phases(), skin_};
            const sim::FindFacets<Packet, periodic> facets{
                lists, skin_, state_.period(), directions_.data(), d, sim::kReach * sim::kReach * other * other};
            exec_.for_each_tile_of(skin_.n_rows, mark);
            exec_.for_each_tile_of(skin_.n_rows, facets);
        });
    }
    /// Adds tension's accelerations to those of the rows.
    void pull(const Lists& lists, const sim::Rows& rows, Quad* acceleration) {
        sim::with_period(state_.period(), [&]<bool periodic>(std::bool_constant<periodic>) {
            const float s = state_.size_of_fluid();
            exec_.for_each(lists.n_rows, sim::PullSurface<Packet, periodic>{lists, tension(), rows.inverse_rho,
                                             1.0f / (state_.volume() * s * s * s), acceleration});
            if (!has_others_) return;
            std::uint32_t* row_of = row_of_.reserve(state_.n + 64);
            exec_.for_each(lists.n_rows, sim::RowOf{lists.rows, row_of});
            exec_.for_each(lists.n_rows, sim::PullTissue<Packet, periodic>{{lists, tension(), row_of}, rows.inverse_rho,
                                             1.0f / state_.volume(), acceleration});
        });
    }
    /// After that: what it does to a rigid body.
    void pull_body(const Lists& lists, std::uint8_t phase, const float3& center, sim::Drag* out) const {
        sim::with_period(state_.period(), [&]<bool periodic>(std::bool_constant<periodic>) {
            const sim::PullBody<Packet, periodic> of{{lists, tension(), row_of_.data()}, state_.view(), state_.period(),
                phase, center, 1.0f / state_.volume()};
            exec_.reduce_in_order(lists.n_rows, of, sim::AddDrag{}, sim::Drag{}, out);
        });
    }

private:
    sim::Tension tension() const {
        return {state_.view().place, skin_, state_.period(), sim::kSurfaceOffset * spacing()};
    }
    /// Of the fluids.
    float spacing() const { return settings_.spacing * state_.size_of_fluid(); }
    void reserve(std::size_t padded) {
        Quad* quads = quads_.reserve(2 * (state_.n + 64));
        constexpr std::size_t words = 2 * sim::kMostFacets + 2 + sim::kDirections / 32;
        std::uint32_t* word = words_.reserve(words * padded + 1);
        const auto take = [&](std::size_t n) {
            std::uint32_t* taken = word;
            word += n * padded;
            return taken;
        };
        skin_ = {quads, quads + state_.n + 64, take(2 * sim::kMostFacets), take(1), take(sim::kDirections / 32),
            take(1), word, padded};
        if (directions_.data()) return;
        const sim::Directions directions;
        exec_.upload(directions_.reserve(1), &directions, sizeof directions);
    }

    Exec& exec_;
    SimulationState<Exec>& state_;
    const SimulationSettings& settings_;
    bool is_there_ = false, has_others_ = false;
    sim::Skin skin_{};
    Buffer<Quad, Exec> quads_;
    Buffer<std::uint32_t, Exec> words_, row_of_;
    Buffer<sim::Directions, Exec> directions_;
};

}  // namespace globule::core
