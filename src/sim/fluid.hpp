// The fluid solver's stages over any Exec, in the order in which a step calls them:
//
//   find_lists           neighbors of every row (start_lists begins early, while the host has other things to do)
//   densities            densities, gradients, the free surface
//   forces               gravity, viscosity, tension, what the user asks for
//   correct_divergence   velocities that compress nothing; or correct_filled, where there is no free surface
//   correct_density      for one move, what is too dense moves apart
// Between steps, flow() tells densities and vorticities.
//
// Arrays by row are `padded` to full packets, those by slot have room for 64 more: packets read past the end.
#pragma once
#include "sim/alone.hpp"
#include "sim/filled.hpp"
#include "sim/flow.hpp"
#include "sim/split.hpp"
#include "sim/fluid_surface.hpp"
#include "sim/rigid_solve.hpp"
#include "sim/wcsph.hpp"
#include "sim/particles.hpp"

namespace globule::core {

template <class Exec> class Fluid {
public:
    using Packet = typename Exec::Packet;
    using Lists = sim::Lists<Packet>;

    Fluid(Exec& exec, SimulationState<Exec>& state, const SimulationSettings& settings)
        : exec_(exec),
          state_(state),
          settings_(settings),
          list_counts_(exec),
          list_index_(exec),
          kept_rows_(exec),
          kept_lists_(exec),
          kept_within_(exec),
          list_pairs_(exec),
          list_bases_(exec),
          row_values_(exec),
          change_(exec),
          error_(exec),
          accelerations_(exec),
          outcome_(exec),
          residuals_(exec),
          iterate_(exec),
          lift_(exec),
          kept_(exec),
          before_(exec),
          kicked_(exec),
          compression_(exec),
          most_count_(exec),
          drags_(exec),
          cohesion_(exec),
          diagonal_(exec),
          residual_(exec),
          direction_(exec),
          applied_(exec),
          conjugate_(exec),
          surface_(exec, state, settings) {}

    const Lists& lists() const { return lists_; }
    const sim::Rows& rows() const { return rows_; }

    /// Begins to look for neighbors.  A step does so for the next one: the device is busy while the host has other
    /// things to do.
    void start_lists() {
        const std::size_t rows = padded(state_.n_rows);
        std::uint32_t* longest = most_count_.reserve(1);
        exec_.clear(longest, 4);
        lists_.n_rows = state_.n_rows;
        lists_.places = places_;
        lists_.n = std::uint32_t(state_.n);
        lists_.rows = state_.rows();
        lists_.count = list_counts_.reserve(rows);
        lists_.index = list_index_.reserve(rows * places_);
        const float h = state_.spline().support;
        sim::with_sizes(state_.sizes(), [&]<bool mixed>(std::bool_constant<mixed>) {
            const sim::FindLists<Packet, mixed> find{state_.tree().view(),
                {state_.tree().particles(), h, state_.sizes()}, lists_, state_.view().place, state_.period(), longest};
            exec_.for_each_tile(ceil_div<std::size_t>(state_.n_rows, Exec::Group::width), find);
        });
        longest_.ask(exec_, longest);
        started_ = true;
    }
    /// Positions, rows or the support are others than when lists were begun.
    void forget_lists() { started_ = false; }
    bool has_started_lists() const { return started_; }
    void find_lists() {
        for (bool enough = false; !enough;) {
            if (!started_) start_lists();
            started_ = false;
            longest_list_ = longest_.wait();
            enough = longest_list_ <= places_;
            if (!enough) places_ = ceil_div(longest_list_ + longest_list_ / 4, 8u) * 8;
        }
        n_alone_ = 0;
        make_room_for_pairs();
    }

    /// Density of the rows that their lists do not tell of, or null.
    void set_within(const float* within) { within_ = within; }

    /// Tissue that has nobody in its list is no row of the solves any more: what is inside of a solid, whose own pairs
    /// are not in the lists.  It falls, and its substeps do the rest.  Waits for the device.
    void leave_out_alone() {
        if (!within_) return;
        const std::size_t all = lists_.n_rows;
        std::uint32_t* before = kept_rows_.reserve(all + 1);
        exec_.for_each(all + 1, sim::FlagTouching<Packet>{lists_, state_.view(), state_.phases(), before});
        exec_.exclusive_scan(all + 1, before);
        std::uint32_t n = 0;
        exec_.download(&n, before + all, sizeof n);
        const std::size_t rows = padded(n);
        Lists kept = lists_;
        std::uint32_t* words = kept_lists_.reserve(2 * rows + 64 + rows * places_);
        float* within = kept_within_.reserve(rows + 64);
        kept.n_rows = n;
        kept.rows = words;
        kept.count = words + rows + 64;
        kept.index = kept.count + rows;
        exec_.for_each(all + 64, sim::KeepTouching<Packet>{lists_, kept, before, within_, words, within});
        n_alone_ = all - n;
        all_rows_ = {lists_.rows, before, all};
        lists_ = kept;
        within_ = within;
        make_room_for_pairs();
    }

    /// The lists as compressed rows of slots.
    void read_lists(std::vector<std::uint32_t>& rows, Neighbors& out) {
        const std::size_t n = state_.n_rows, room = list_index_.capacity();
        rows.resize(n);
        std::vector<std::uint32_t> counts(n), index(room);
        exec_.download(rows.data(), state_.rows(), 4 * n);
        exec_.download(counts.data(), lists_.count, 4 * n);
        exec_.download(index.data(), lists_.index, 4 * room);
        out.offsets.assign(1, 0);
        out.indices.clear();
        for (std::size_t i = 0; i < n; ++i) {
            for (std::uint32_t k = 0; k < counts[i]; ++k)
                if (const std::uint32_t j = index[lists_.at(i, k)]; j != lists_.n) out.indices.push_back(j);
            out.offsets.push_back(out.indices.size());
        }
    }

    /// Densities over rest density, and vorticities, 1/s, by slot; 0 for what the solver does not move.  The lists are
    /// there.
    void flow(float* density, float* vorticity) {
        const std::size_t n = lists_.n_rows;
        Quad* found = applied_.reserve(state_.n + 64);
        exec_.clear(found, (state_.n + 64) * sizeof(Quad));
        weigh();
        sim::with_period(state_.period(), [&]<bool periodic>(std::bool_constant<periodic>) {
            exec_.for_each_packet(n, sim::Flow<Packet, periodic>{lists_, state_.view().place, state_.view().velocity,
                                         rows_, state_.period(), state_.spline().inverse, found});
        });
        std::vector<Quad> all(state_.n);
        exec_.download(all.data(), found, all.size() * sizeof(Quad));
        for (std::size_t i = 0; i < all.size(); ++i) {
            density[i] = all[i].w;
            vorticity[3 * i] = all[i].x;
            vorticity[3 * i + 1] = all[i].y;
            vorticity[3 * i + 2] = all[i].z;
        }
    }

    /// What fluid and tissue do to a boundary or body, by the pressures of the last step and the viscosity of the
    /// velocities that are there; over the volume of a particle of size 1.  The lists are there.
    sim::Impulse force_on(std::uint8_t phase, const float3& about) {
        weigh();
        sim::Drag found[2], *out = drags_.reserve(2);
        const float* pressure =
            settings_.weakly_compressible ? state_.view().pressure : state_.view().divergence_impulse;
        exec_.reduce_in_order(
            lists_.n_rows, sim::PushOf<Packet>{hold_of(phase, about), pressure}, sim::AddDrag{}, sim::Drag{}, out);
        find_drag(state_.view().velocity, 1.0f, nullptr, phase, about, out + 1);
        exec_.download(found, out, sizeof found);
        return sim::AddImpulse{}(found[0].force, found[1].force);
    }

    void densities() {
        const std::size_t n = lists_.n_rows;
        weigh();
        surface_.find(lists_, rows_, padded_rows());
        const float g = length(settings_.gravity);
        const float3 up = g > 0.0f ? settings_.gravity * (-1.0f / (g * settings_.spacing)) : float3{0, 0, 0};
        exec_.reduce_in_order(n,
            sim::CompressionOf{rows_, 2.0f * sim::kFreeGradient, lists_.rows, state_.view().place, up},
            sim::AddCompression{}, sim::Compression{}, compression_.reserve(1));
        if (n_alone_) exec_.for_each(1, sim::AddAlone{double(n_alone_), compression_.data()});
    }

    /// Of the positions that densities() saw, where the device has it.
    const sim::Compression* compression() const { return compression_.data(); }

    /// Velocities before a step, and after its forces: what the step may be undone to, and what its solves may not
    /// exceed.
    void keep_before() { keep(before_); }
    void keep_kicked() { keep(kicked_); }
    void undo() {
        exec_.for_each(lists_.n_rows,
            sim::Undo{lists_.rows, before_.data(), state_.view().velocity, state_.view().divergence_impulse});
    }

    void correct_divergence(float dt, RigidSolve<Exec>& bodies) {
        const Criterion all{
            std::min(kVelocityAim * settings_.divergence_error, kMostVelocityAim), kOver, kOverShare, kMost};
        solve({rows_.alpha, state_.view().divergence_impulse, 0.0f, all, 1, false, rows_.bulk, -kAtmosphere * dt, 1.0f,
                  kOmega, 1.0f},
            dt, outcome_of(sim::Solved::velocities), divergence_took_, &bodies);
    }
    /// Of the velocities that are there now, which are kept.  The outcome has the kinetic energy before and after the
    /// first solve.
    void correct_density(float dt) {
        keep(kept_);
        sim::Outcome* outcome = outcome_of(sim::Solved::places);
        exec_.reduce_in_order(lists_.n_rows, sim::KineticOf{rows_.inverse_rho, kicked_.data(), kept_.data()},
            sim::AddKinetic{}, sim::Kinetic{}, &outcome->kinetic);
        const double mean = kAim * settings_.density_error;
        const Criterion all{mean, kOver, kLiftShare, std::max(kLiftMost, kLiftLeast / mean)};
        moved_apart_ = solve({rows_.alpha, lift(), kMostExcess, all, settings_.least_iterations, false, rows_.bulk,
                                 0.0f, 0.0f, kOmegaPlain, 0.0f},
            dt, outcome, density_took_, nullptr);
        exec_.for_each(lists_.n_rows, sim::LimitPush{lists_.rows, kept_.data(), kMostPush * settings_.spacing / dt,
                                          state_.sizes(), state_.view().velocity});
    }
    /// Of that solve; may wait for the device.
    sim::Kinetic kinetic() {
        if (!moved_apart_)
            exec_.download(&moved_apart_.emplace(), outcome_of(sim::Solved::places), sizeof(sim::Outcome));
        return moved_apart_->kinetic;
    }
    /// Of both solves of the step, on the device: of places there may have been none.
    const sim::Outcome* outcomes() { return outcome_of(sim::Solved::velocities); }
    /// After the move: the velocities of the first solve.
    void end_split(float dt) {
        exec_.for_each(lists_.n_rows, sim::EndSplit{lists_.rows, kept_.data(), before_.data(), 1.0f / dt,
                                          state_.view().velocity, state_.view().growth});
    }

    /// Whether it has no free surface, of the positions that densities() saw.
    bool fills_its_space() {
        sim::Compression c{};
        exec_.download(&c, compression(), sizeof c);
        // A tenth of a layer is less than any column's surface, disordered ones included.
        const double free = std::min(sim::kFreeShare, 0.1 / std::max(c.layers(), 1.0));
        return c.n_free <= free * c.n && c.density >= sim::kLeastFilling * c.n;
    }
    /// Velocities without divergence, of fluid that fills its space; the next move shifts.
    void correct_filled(float dt, RigidSolve<Exec>& bodies) {
        filled_ = true;
        const sim::State s = state_.view();
        Quad* diagonal = direction_.reserve(state_.n + 64);
        Quad* rest = applied_.reserve(state_.n + 64);
        Quad* plain = accelerations_.reserve(lists_.n_rows + 64);
        exec_.for_each(state_.n + 1, sim::NoCorrection{diagonal, rest});
        sim::with_period(state_.period(), [&]<bool periodic>(std::bool_constant<periodic>) {
            exec_.for_each_packet(lists_.n_rows, sim::InverseMoments<Packet, periodic>{lists_, s.place, state_.period(),
                                                     state_.spline().inverse, diagonal, rest});
        });
        exec_.for_each_packet(lists_.n_rows, sim::CorrectGradients<Packet>{lists_, s.place, diagonal, rest, rows_,
                                                 plain, state_.spline().support, state_.lattice_squares()});
        exec_.clear(s.growth, 4 * state_.n);
        const Criterion mean{sim::kFilledAim * settings_.divergence_error, kOver, 1.0, infinity()};
        solve({rows_.alpha, s.divergence_impulse, 0.0f, mean, settings_.least_iterations, true, nullptr, -infinity(),
                  1.0f, kOmega, 1.0f},
            dt, outcome_of(sim::Solved::velocities), divergence_took_, &bodies);
    }
    /// Velocities that lead particles from where they are dense, for one move; what was theirs is kept.
    void shift(float dt) {
        if (!filled_) return;
        const float d = settings_.spacing,
                    far = min(sim::kShift * std::sqrt(state_.summary.speeds.most2) * dt, sim::kMostShift * d) * d;
        exec_.for_each(lists_.n_rows,
            sim::Shift{lists_.rows, rows_.inverse_rho, accelerations_.data(), far * state_.spline().inverse / dt,
                state_.view().velocity, residual_.reserve(lists_.n_rows + 64)});
    }
    void end_shift() {
        if (filled_)
            exec_.for_each(lists_.n_rows, sim::GiveBack{lists_.rows, residual_.data(), state_.view().velocity});
        filled_ = false;
    }
    /// Momentum that an impulse carries across a face; corrected gradients carry all of it.
    float flux() const { return filled_ ? 1.0f : sim::kFlux; }

    /// Weakly compressible: pressures follow from the densities, and are applied once.
    void push_by_density(float dt, RigidSolve<Exec>& bodies) {
        const sim::State s = state_.view();
        float* change = change_.reserve(state_.n + 64);
        sim::Progress* progress = &outcome_of(sim::Solved::velocities)->progress;
        exec_.clear(progress, sizeof *progress);
        exec_.clear(change, 4 * (state_.n + 64));
        exec_.clear(s.growth, 4 * state_.n);
        exec_.for_each(
            lists_.n_rows, sim::TaitPressure{lists_.rows, rows_, settings_.sound_speed, dt, s.pressure, change});
        exec_.for_each_packet(
            lists_.n_rows, sim::Push<Packet>{lists_, rows_, change, s.velocity, progress, state_.spline().inverse});
        bodies.start_pressure();
        bodies.push_back(*this, change, progress);
        bodies.end_pressure();
    }

    /// Gravity, viscosity, tension, adhesion, and what the user asks for (may be null); the iterations of implicit
    /// viscosity. Rigid bodies feel viscosity, tension and adhesion, too.
    int forces(float dt, const float* user, RigidSolve<Exec>& bodies) {
        bodies.start();
        const sim::State s = state_.view();
        const std::size_t n = lists_.n_rows;
        bool viscous = settings_.extra_viscosity > 0, implicit = false, sticks = false;
        for (const sim::Phase& p : state_.phase_table) {
            viscous |= p.viscosity > 0;
            implicit |= p.viscosity > 0 && p.implicit_viscosity;
            sticks |= p.adhesion > 0 || (p.tension > 0 && p.kind == sim::Kind::tissue);
        }
        const Quad* acceleration = nullptr;
        implicit |= viscous && !bodies.none();  // a light body's drag would throw it to and fro
        if ((viscous && !implicit) || sticks) acceleration = pair_forces(implicit ? 0.0f : 1.0f, sticks, nullptr);
        if (sticks) bodies.attract(*this, cohesion_.data(), dt);
        if (surface_.is_there()) {
            acceleration = pull_surface(acceleration != nullptr);
            bodies.pull(*this, dt);
        }
        exec_.for_each(n, sim::Kick{lists_.rows, rows_.inverse_rho, acceleration, settings_.gravity, dt, s.velocity});
        if (n_alone_)
            exec_.for_each(all_rows_.n,
                sim::Fall{all_rows_.slots, all_rows_.before, s, settings_.gravity, user, 1.0f / state_.volume(), dt});
        if (user) {
            Quad* a = accelerations_.reserve(n + 64);
            exec_.for_each(
                n, sim::UserForces{lists_.rows, rows_.inverse_rho, 1.0f / state_.volume(), state_.sizes(), user, a});
            exec_.for_each(n, sim::Kick{lists_.rows, rows_.inverse_rho, a, {0, 0, 0}, dt, s.velocity});
        }
        bodies.kick(settings_.gravity, dt);
        return implicit ? implicit_viscosity(dt, bodies) : 0;
    }
    void find_pull(std::uint8_t phase, const float3& center, sim::Drag* out) const {
        surface_.pull_body(lists_, phase, center, out);
    }
    sim::HoldOf<Packet> hold_of(std::uint8_t phase, const float3& center) const {
        return {lists_, state_.view(), rows_.boundary, state_.period(), state_.sizes(), state_.spline().support, phase,
            center};
    }
    /// What a body of one phase feels of the fluid's velocities, by slot; cohesion: by slot, or null.
    void find_drag(const Quad* velocity, float viscous_share, const float* cohesion, std::uint8_t phase,
        const float3& center, sim::Drag* out) const {
        sim::with_period(state_.period(), [&]<bool periodic>(std::bool_constant<periodic>) {
            sim::with_sizes(state_.sizes(), [&]<bool mixed>(std::bool_constant<mixed>) {
                const sim::DragOf<Packet, periodic, mixed> of{lists_, state_.view(), velocity, rows_.boundary,
                    interaction(viscous_share), cohesion, phase, center};
                exec_.reduce_in_order(lists_.n_rows, of, sim::AddDrag{}, sim::Drag{}, out);
            });
        });
    }

private:
    void weigh() {
        reserve_rows();
        const Quad* place = state_.view().place;
        sim::with_period(state_.period(), [&]<bool periodic>(std::bool_constant<periodic>) {
            sim::with_sizes(state_.sizes(), [&]<bool mixed>(std::bool_constant<mixed>) {
                exec_.for_each_packet(lists_.n_rows,
                    sim::Densities<Packet, periodic, mixed>{lists_, place, rows_, state_.spline(), state_.period(),
                        state_.volume(), state_.lattice_squares(), within_, state_.sizes()});
            });
        });
    }
    static std::size_t padded(std::size_t rows) { return ceil_div<std::size_t>(rows, 64) * 64; }
    std::size_t padded_rows() const { return padded(lists_.n_rows); }
    void make_room_for_pairs() {
        lists_.pairs = list_pairs_.reserve(padded_rows() * places_ / Packet::width);
        lists_.bases = list_bases_.reserve(padded_rows() / Packet::stride);
    }
    void reserve_rows() {
        const std::size_t padded = padded_rows();
        float* v = row_values_.reserve(8 * padded);
        for (float** array : {&rows_.density, &rows_.gx, &rows_.gy, &rows_.gz, &rows_.inverse_rho, &rows_.alpha,
                 &rows_.boundary, &rows_.bulk}) {
            *array = v;
            v += padded;
        }
    }

    /// Tension's accelerations, added to those that are there.
    const Quad* pull_surface(bool add) {
        Quad* out = accelerations_.reserve(lists_.n_rows + 64);
        if (!add) exec_.clear(out, lists_.n_rows * sizeof(Quad));
        surface_.pull(lists_, rows_, out);
        return out;
    }

    /// P of the solve for places, which starts from nothing.
    float* lift() {
        float* p = lift_.reserve(state_.n + 64);
        exec_.clear(p, 4 * (state_.n + 64));
        return p;
    }
    void keep(Buffer<Quad, Exec>& where) {
        exec_.for_each(
            lists_.n_rows, sim::KeepVelocity{lists_.rows, state_.view().velocity, where.reserve(lists_.n_rows + 64)});
    }

    /// When a solve is done: by the mean, by the share of particles above `over` times that mean, and by the largest,
    /// over that mean, too.
    struct Criterion { double mean, over, share, most; };
    /// What a solve asks of the velocities.
    struct Aim {
        const float* alpha;
        float* impulse;     ///< P; in and out in Pa where it starts from it
        float most_excess;  ///< of the density that counts: none, where velocities alone are solved for
        Criterion criterion;
        int iterations;     ///< at least
        bool filled;        ///< gaps do not close
        const float* bulk;  ///< as Relax has it
        float least;        ///< impulse, in the bulk
        float share;        ///< of the last pressure that it starts with
        float omega, momentum;
    };
    /// What came of it, where the host had to look.  `took`: iterations of the last solve of this kind; on the device
    /// the host looks at the progress only after as many.  `bodies`: those that give way, or null.
    std::optional<sim::Outcome> solve(
        const Aim& aim, float dt, sim::Outcome* outcome, int& took, RigidSolve<Exec>* bodies) {
        const std::size_t n = lists_.n_rows;
        const sim::State s = state_.view();
        const float inverse_support = state_.spline().inverse;
        float* change = change_.reserve(state_.n + 64);
        float* error = error_.reserve(2 * (n + 64));
        float* turn = error + n + 64;
        float* iterate = iterate_.reserve(n + 64);
        sim::Residuals* found = residuals_.reserve(1);
        sim::Progress* progress = &outcome->progress;
        exec_.clear(progress, sizeof *progress);
        exec_.clear(change, 4 * (state_.n + 64));
        exec_.clear(iterate + n, 4 * 64);  // the last packet's rows past the end are added up too, times 0
        const float* alpha = bodies ? bodies->start_pressure(*this, aim.alpha) : aim.alpha;
        exec_.for_each(
            n, sim::WarmStart{lists_.rows, alpha, aim.impulse, change, iterate, aim.bulk, aim.share * dt, aim.least});

        const Criterion& c = aim.criterion;
        const float least_excess = aim.filled ? 0.0f : -infinity();
        const sim::Push<Packet> push{lists_, rows_, change, s.velocity, progress, inverse_support};
        const sim::Relax<Packet> relax{lists_, rows_, alpha, s.velocity, aim.impulse, change, iterate, error, turn,
            progress, inverse_support, 1.0f / dt, aim.most_excess, least_excess, aim.bulk, aim.least, aim.omega};
        const sim::Compression* there = aim.most_excess > 0.0f ? nullptr : compression();
        const sim::Judge judge{found, dt, double(state_.n_rows), c.mean, c.most * c.mean, c.share,
            std::uint32_t(aim.iterations), most_iterations(), settings_.most_iterations == 0, aim.momentum, there,
            settings_.density_error, progress};
        const sim::ResidualsOf residuals{error, turn, float(c.over * c.mean / dt), there};
        std::optional<sim::Outcome> out;
        bool pushes = aim.share > 0.0f;  // else P is 0 yet
        const bool alone = !bodies || bodies->none();
        if (!alone || !exec_.for_rounds(n, pushes, sim::Rounds<Packet>{push, relax, residuals, judge})) {
            int at_once = Exec::on_device ? max(took, aim.iterations) : 1;
            do {
                for (int i = 0; i < at_once; ++i) {
                    if (pushes) exec_.for_each_packet_team(n, push);
                    if (pushes && !alone) bodies->push_back(*this, change, progress);
                    pushes = true;
                    exec_.for_each_packet_team(n, relax);
                    exec_.reduce_in_order(n, residuals, sim::AddResiduals{}, sim::Residuals{}, found, judge);
                }
                exec_.download(&out.emplace(), outcome, sizeof *outcome);
                at_once = max(1, int(out->progress.iterations) / 4);
            } while (!out->progress.done);
            took = int(out->progress.iterations);
        }
        if (bodies) bodies->end_pressure();
        if (aim.share > 0.0f)
            exec_.for_each(n, sim::Applied{lists_.rows, aim.impulse, change, 1.0f / dt, flux(), s.pressure});
        return out;
    }
    /// Of the solves of a step, on the device.
    sim::Outcome* outcome_of(sim::Solved which) { return outcome_.reserve_zero(2) + int(which); }

    std::uint32_t most_iterations() const {
        return settings_.most_iterations > 0 ? settings_.most_iterations : settings_.kIterations;
    }
    sim::Interaction interaction(float share) const {
        return {state_.spline(), state_.period(), 2.0f * share, settings_.extra_viscosity, settings_.spacing,
            state_.volume(), state_.sizes()};
    }
    const Quad* pair_forces(float viscous_share, bool sticks, float* diagonal) {
        const sim::State s = state_.view();
        Quad* out = accelerations_.reserve(lists_.n_rows + 64);
        float* cohesion = cohesion_.reserve(state_.n + 64);
        if (sticks) exec_.for_each(state_.n + 1, sim::CohesionOf{s, state_.phases(), cohesion});
        const auto add = [&]<bool periodic, bool sticky, bool mixed>(
                             std::bool_constant<periodic>, std::bool_constant<sticky>, std::bool_constant<mixed>) {
            const sim::PairForces<Packet, periodic, sticky, mixed> forces{
                lists_, s.place, s.velocity, rows_, interaction(viscous_share), cohesion, diagonal, out};
            exec_.for_each_packet_team(lists_.n_rows, forces);
        };
        sim::with_period(state_.period(), [&](auto periodic) {
            sim::with_sizes(state_.sizes(), [&](auto mixed) {
                if (sticks) add(periodic, std::true_type{}, mixed);
                else add(periodic, std::false_type{}, mixed);
            });
        });
        return out;
    }

    /// Conjugate gradients for what viscosity adds to the velocities; the iterations taken.
    int implicit_viscosity(float dt, RigidSolve<Exec>& bodies) {
        const sim::State s = state_.view();
        const std::size_t n = lists_.n_rows;
        float* diagonal = diagonal_.reserve(n + 64);
        Quad* residual = residual_.reserve(n + 64);
        Quad* applied = applied_.reserve(n + 64);
        Quad* direction = direction_.reserve(state_.n + 64);
        sim::Conjugate* c = conjugate_.reserve(1);
        const Quad* acceleration = pair_forces(1.0f, false, diagonal);
        exec_.clear(direction, (state_.n + 64) * sizeof(Quad));
        exec_.clear(c, sizeof *c);
        exec_.for_each(n, sim::StartConjugate{lists_.rows, rows_.inverse_rho, diagonal, acceleration, s.velocity, dt,
                              residual, direction});
        exec_.reduce_in_order(
            n, sim::ResidualSquare{lists_.rows, residual, state_.sizes()}, sim::AddDouble{}, 0.0, &c->rz_new);
        bodies.start(*this, c, dt);
        exec_.for_each(1, sim::JudgeConjugate{c, settings_.viscosity_error});
        sim::Conjugate state{};
        constexpr int at_once = Exec::on_device ? 4 : 1;
        do {
            for (int i = 0; i < at_once; ++i) {
                bodies.spread_direction(direction);
                sim::with_period(state_.period(), [&]<bool periodic>(std::bool_constant<periodic>) {
                    sim::with_sizes(state_.sizes(), [&]<bool mixed>(std::bool_constant<mixed>) {
                        exec_.for_each_packet(n, sim::ApplyViscosity<Packet, periodic, mixed>{lists_, s.place,
                                                     direction, rows_, interaction(1.0f), c, dt, applied});
                    });
                });
                exec_.reduce_in_order(n, sim::DirectionSquare{lists_.rows, direction, applied, state_.sizes()},
                    sim::AddDouble{}, 0.0, &c->pq);
                bodies.multiply(*this, direction, c, dt);
                exec_.for_each(n, sim::StepConjugate{lists_.rows, c, direction, applied, s.velocity, residual});
                exec_.reduce_in_order(
                    n, sim::ResidualSquare{lists_.rows, residual, state_.sizes()}, sim::AddDouble{}, 0.0, &c->rz_new);
                bodies.step(c);
                exec_.for_each(n, sim::TurnConjugate{lists_.rows, c, residual, direction});
                bodies.turn(c);
                exec_.for_each(1, sim::JudgeConjugate{c, settings_.viscosity_error});
            }
            exec_.download(&state, c, sizeof state);
        } while (!state.done && state.iterations < most_iterations());
        bodies.end_viscosity();
        return int(state.iterations) - 1;
    }

    static constexpr double kAim = 0.8;  // the error is predicted along straight lines: what comes is a fifth more
    static constexpr double kVelocityAim =
        0.1;  // of the divergence's tolerance: what is left adds up from step to step
    static constexpr double kMostVelocityAim = 2e-4;
    static constexpr double kOver = 4.0, kOverShare = 0.0005,
                            kMost = 50.0;  // times the mean, the share of the particles, times the mean
    static constexpr double kLiftShare = 0.001, kLiftMost = 10.0,
                            kLiftLeast = 0.03;  // the same for places; no less than 3 % for the largest
    static constexpr float kOmega = 0.3f;       // momentum asks for shorter steps than 0.5
    static constexpr float kOmegaPlain = 0.5f;
    static constexpr float kAtmosphere = 101325.0f;
    static constexpr float kMostExcess = 0.1f;  // of the density, that one step undoes
    static constexpr float kMostPush = 0.1f;    // spacings

    Exec& exec_;
    SimulationState<Exec>& state_;
    const SimulationSettings& settings_;
    Lists lists_{};
    sim::Rows rows_{};
    std::uint32_t places_ = 64, longest_list_ = 0;
    const float* within_ = nullptr;
    struct AllRows {
        const std::uint32_t *slots, *before;  ///< how many of the rows before each are left
        std::size_t n;
    } all_rows_{};  ///< where some are left out
    std::size_t n_alone_ = 0;
    bool filled_ = false, started_ = false;
    int divergence_took_ = 1, density_took_ = 1;
    std::optional<sim::Outcome> moved_apart_;
    Buffer<std::uint32_t, Exec> list_counts_, list_index_, kept_rows_, kept_lists_;
    Buffer<float, Exec> kept_within_;
    Buffer<sim::Pairs<Packet>, Exec> list_pairs_;
    Buffer<typename Packet::Bases, Exec> list_bases_;
    Buffer<float, Exec> row_values_, change_, error_;
    Buffer<Quad, Exec> accelerations_;
    Buffer<sim::Outcome, Exec> outcome_;
    Buffer<sim::Residuals, Exec> residuals_;
    Buffer<float, Exec> iterate_, lift_;
    Buffer<Quad, Exec> kept_, before_, kicked_;
    Buffer<sim::Compression, Exec> compression_;
    Buffer<std::uint32_t, Exec> most_count_;
    typename Exec::template Answer<std::uint32_t> longest_;
    Buffer<sim::Drag, Exec> drags_;
    Buffer<float, Exec> cohesion_, diagonal_;
    Buffer<Quad, Exec> residual_, direction_, applied_;
    Buffer<sim::Conjugate, Exec> conjugate_;
    FluidSurface<Exec> surface_;
};

}  // namespace globule::core
