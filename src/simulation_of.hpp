// The one implementation of Simulation, over any Exec.
//
// The order of a step (each a named call below; dt is known before it begins, from the speeds that the
// last step ended with):
//   1  find_lists    neighbour lists, from the octree of the present positions
//                    -> pairs whose bond is cut are nobody's neighbours
//   2  densities     delta, G, alpha of every row; V grad W of every pair is kept
//   3  solve         velocities free of divergence
//   4  forces        gravity, viscosity, tension, what the user asked for
//                    and bonds, which take their substeps on State::velocity
//   5  solve         velocities that lead to rest density after dt
//   6  move          x += dt v (boundaries by their own velocities); guards
//                    -> fluid that fills its space (filled.hpp): no 3, 5 looks at the divergence, 6 shifts
//                    -> here instruments get the velocities of the next step, emitters emit, sinks remove
//   7  settle        octree of the new positions, state in its order, rows, what the host needs to know
// Between two steps, the tree is that of the positions: a picture of it takes no copy.
#pragma once
#include <map>
#include <optional>

#include "globule/sim/filled.hpp"
#include "globule/sim/show.hpp"
#include "globule/sim/viscosity.hpp"
#include "globule/sim/wcsph.hpp"
#include "motion_bytes.hpp"
#include "scene_access.hpp"
#include "simulation_state.hpp"
#include "tissue_of.hpp"

namespace globule {

template <class Exec>
class SimulationOf final : public Simulation {
public:
    using Tree = SparseTree;
    using Packet = typename Exec::Packet;
    using Lists = sim::Lists<Packet>;

    explicit SimulationOf(std::shared_ptr<Scene> scene)
        : scene_(std::move(scene)), access_(scene_->share()), exec_(*static_cast<Exec*>(access_.exec)),
          state_(exec_, *static_cast<Octree<Exec>*>(access_.octree)), tissue_(exec_), list_counts_(exec_), list_index_(exec_), gradients_(exec_),
          row_values_(exec_), change_(exec_), error_(exec_), accelerations_(exec_), forces_(exec_), progress_(exec_), error_sum_(exec_),
          compression_(exec_), most_count_(exec_), cohesion_(exec_), diagonal_(exec_), residual_(exec_), direction_(exec_),
          applied_(exec_), conjugate_(exec_), home_(exec_), impulse_(exec_), touch_(exec_), sinks_(exec_), n_gone_(exec_), totals_(exec_), color_(exec_), reflection_(exec_), weight_(exec_), rank_(exec_), ids_(exec_) {}

    void configure(const SimulationSettings& settings) override {
        settings_ = settings;
        state_.configure(settings);
        tissue_.set_spacing(settings.spacing);
    }
    void set_phase(int which, const sim::Phase& phase) override {
        state_.set_phase(which, phase);
        stale_ = true;
        exec_.for_each(state_.n, sim::SetMaterial{state_.view(), std::uint8_t(which), state_.w_of(which), phase.viscosity});
    }

    std::uint32_t add(std::size_t m, const float* positions, const float* velocities, float3 velocity, int phase) override {
        const std::uint32_t first = state_.append(m, positions, velocities, velocity, phase);
        settle();
        return first;
    }
    void remove(std::size_t m, const std::uint32_t* ids) override {
        std::uint32_t* gone = ids_.reserve(m);
        exec_.upload(gone, ids, 4 * m);
        std::uint32_t* flags = state_.flags();
        exec_.for_each(state_.n, sim::Fill{flags, 1u});
        exec_.clear(flags + state_.n, 4);
        exec_.for_each(m, sim::FlagGone{gone, state_.slot_of(), flags});
        state_.keep(flags);
        settle();
    }

    std::uint32_t emit(std::size_t m, const float* positions, const float* velocities, int phase) override {
        std::uint32_t first = state_.next_id;
        for (const Emitted& e : emitted_) first += std::uint32_t(e.positions.size() / 3);
        emitted_.push_back({{positions, positions + 3 * m}, {velocities, velocities + 3 * m}, phase});
        return first;
    }
    void set_sinks(const std::vector<sim::Sink>& sinks) override {
        n_sinks_ = int(sinks.size());
        exec_.upload(sinks_.reserve(sim::kMaxSinks), sinks.data(), sinks.size() * sizeof(sim::Sink));
        exec_.synchronize();
    }

    void capture(int phase, const sim::Pose& now) override {
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
    void move_to(int phase, const sim::Pose& next) override { next_poses_[phase] = next; }
    void make_body(int phase, double mass, const double center[3], const double inertia[9], const double velocity[3], const double spin[3]) override {
        RigidBody::M m;
        std::copy(inertia, inertia + 9, m.begin());
        RigidBody body(mass, {center[0], center[1], center[2]}, m);
        std::copy(velocity, velocity + 3, body.velocity.begin());
        std::copy(spin, spin + 3, body.spin.begin());
        bodies_.insert_or_assign(phase, body);
        capture(phase, body.pose());
    }
    std::vector<double> body(int phase) override {
        const RigidBody& b = bodies_.at(phase);
        std::vector<double> out;
        for (const auto* v : {&b.center(), &b.velocity, &b.spin}) out.insert(out.end(), v->begin(), v->end());
        const sim::Pose p = b.pose();
        for (double v : {p.x.x, p.y.x, p.z.x, p.x.y, p.y.y, p.z.y, p.x.z, p.y.z, p.z.z}) out.push_back(v);
        return out;
    }

    std::vector<char> motion() override {
        std::vector<Quad> home(home_.capacity());
        if (!home.empty()) exec_.download(home.data(), home_.data(), home.size() * sizeof(Quad));
        return save_motion(home, next_poses_, bodies_);
    }
    void set_motion(const std::vector<char>& bytes) override {
        std::vector<Quad> home;
        load_motion(bytes, home, next_poses_, bodies_);
        if (home.empty()) return;
        exec_.upload(home_.reserve(home.size()), home.data(), home.size() * sizeof(Quad));
        exec_.synchronize();
    }

    sim::Totals totals() override {
        sim::Totals* out = totals_.reserve(1);
        exec_.reduce_in_order(state_.n_rows, sim::TotalsOf{state_.view(), state_.rows(), state_.volume(), settings_.gravity}, sim::AddTotals{},
                              sim::Totals{}, out);
        sim::Totals t;
        exec_.download(&t, out, sizeof t);
        return t;
    }

    double next_dt() override {
        // v dt + g dt^2 <= 0.4 cfl d: at rest, gravity limits the first step.
        const double v = std::sqrt(double(state_.summary.most_speed2)), far = 0.4 * settings_.cfl * settings_.spacing;
        const double g = std::sqrt(double(dot(settings_.gravity, settings_.gravity)));
        double dt = settings_.longest_step;
        const double d = settings_.spacing;
        for (const sim::Phase& p : state_.phase_table) {
            if (p.kind != sim::Kind::fluid && p.kind != sim::Kind::tissue) continue;
            if (p.tension > 0) dt = std::min(dt, 0.4 * std::sqrt(p.density * d * d * d / (2 * 3.14159265358979 * p.tension)));
            const double mu = p.viscosity + settings_.extra_viscosity;
            if (mu > 0 && !p.implicit_viscosity) dt = std::min(dt, 0.125 * d * d * p.density / mu);
        }
        if (settings_.weakly_compressible) dt = std::min(dt, far / (settings_.sound_speed + v));
        if (v > 0 || g > 0) dt = std::min(dt, 2 * far / (v + std::sqrt(v * v + 4 * g * far)));
        return dt;
    }

    StepReport step(double asked) override {
        StepReport r;
        r.dt = asked > 0 ? asked : next_dt();
        const float dt = float(r.dt);
        r.n_solved = state_.n_rows;
        mark("");
        for (const auto& [phase, pose] : next_poses_)
            exec_.for_each(state_.n, sim::Carry{state_.view(), std::uint8_t(phase), pose, home_.data(), dt});
        gather_tissue();
        bleed(dt);
        if (state_.n_rows > 0) {
            find_lists();
            tissue_.change(lists_, state_.view(), dt);
            mark("neighbors");
            densities();
            mark("density");
            if (settings_.weakly_compressible) {
                forces(dt, r);
                mark("forces");
                tissue_.push(state_.view(), dt);
                mark("tissue");
                push_by_density(dt);
                mark("pressure");
            } else if ((filled_ = is_filled())) {
                forces(dt, r);
                mark("forces");
                solve_filled(dt, r);
                mark("pressure");
            } else {
                const sim::Progress divergence = solve(rows_.alpha_divergence, state_.view().divergence_impulse, dt, 0.0f, settings_.divergence_error, 1);
                mark("divergence");
                forces(dt, r);
                mark("forces");
                tissue_.push(state_.view(), dt);
                mark("tissue");
                const sim::Progress density = solve(rows_.alpha, state_.view().impulse, dt, infinity(), kAim * settings_.density_error, settings_.least_iterations);
                mark("pressure");
                r.iterations = int(density.iterations);
                r.error = density.error;
                r.divergence_iterations = int(divergence.iterations);
                r.divergence_error = divergence.error;
            }
        }
        if (state_.n_rows > 0) tissue_.hold_on(state_.view(), dt);
        turn_bodies(dt);
        move(dt);
        if (n_sinks_ > 0 || !emitted_.empty()) {
            take_and_give(r);
            mark("move");
            state_.settle();
        } else {
            mark("move");
            state_.settle_positions();
        }
        state_.summarize();
        mark("octree");
        time_ += r.dt;
        ++n_steps_;
        stale_ = true;
        report(r);
        return r;
    }

    std::size_t size() override { return state_.n; }
    double time() override { return time_; }
    std::uint64_t n_steps() override { return n_steps_; }
    std::uint32_t next_id() override { return state_.next_id; }

    void read(const std::string& name, void* out) override {
        const auto [data, bytes] = array(name);
        exec_.download(out, data, bytes * state_.n);
    }
    void write(const std::string& name, const void* in) override {
        const auto [data, bytes] = array(name);
        exec_.upload(data, in, bytes * state_.n);
        exec_.synchronize();
    }
    void resize(std::size_t n, std::uint32_t next_id, double time, std::uint64_t n_steps) override {
        state_.resize(n);
        state_.next_id = next_id;
        time_ = time;
        n_steps_ = n_steps;
    }
    void settle() override {
        state_.settle();
        state_.summarize();
        stale_ = true;
    }

    void set_forces(const float* forces) override {
        has_forces_ = forces != nullptr;
        if (!forces) return;
        exec_.upload(forces_.reserve(3 * state_.n), forces, 12 * state_.n);
        exec_.synchronize();
    }

    void neighbors(std::vector<std::uint32_t>& rows, Neighbors& out) override {
        find_lists();
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

    Tissue& tissue() override {
        gather_tissue();
        return tissue_;
    }

    void show() override {
        if (!stale_) return;
        stale_ = false;
        const std::size_t n = state_.n;
        if (n == 0) return;
        // Scenes know particles by their rank among the ids that are left.
        std::uint32_t* rank = rank_.reserve(state_.next_id + 1 + n);
        std::uint32_t* index = rank + state_.next_id + 1;
        exec_.for_each(state_.next_id + 1, sim::IsThere{state_.slot_of(), state_.next_id, rank});
        exec_.exclusive_scan(std::size_t(state_.next_id) + 1, rank);
        bool all_shown = true, mirrors = false;
        for (const sim::Phase& p : state_.phase_table) {
            all_shown &= p.shown != 0;
            mirrors |= p.reflection > 0.0f || p.refraction > 0.0f;
        }
        float* weight = all_shown ? nullptr : weight_.reserve(n + 64);
        float* reflection = mirrors ? reflection_.reserve(2 * n) : nullptr;
        exec_.for_each(n, sim::Show{state_.view(), state_.phases(), rank, index, weight, color_.reserve(3 * n), reflection,
                                    reflection ? reflection + n : nullptr});
        if (!tissue_.vessels().empty()) tissue_.stain(rank, state_.slot_of(), state_.phase_table[tissue_.phase_of_blood(1)].color, color_.data());
        state_.tree().relabel(index, {weight, 1.0f});
        access_.rebuilt(color_.data(), reflection, reflection ? reflection + n : nullptr);
    }

private:
    void find_lists() {
        const std::size_t padded = ceil_div<std::size_t>(state_.n_rows, 64) * 64;
        for (bool enough = false; !enough;) {
            std::uint32_t* longest = most_count_.reserve(1);
            exec_.clear(longest, 4);
            lists_.n_rows = state_.n_rows;
            lists_.places = places_;
            lists_.n = std::uint32_t(state_.n);
            lists_.rows = state_.rows();
            lists_.count = list_counts_.reserve(padded);
            lists_.index = list_index_.reserve(padded * places_);
            const float h = state_.spline().support;
            exec_.for_each_tile(ceil_div<std::size_t>(state_.n_rows, Exec::Group::width),
                                sim::FindLists<Tree, Packet>{state_.tree().sparse(), lists_, state_.view().place, h, state_.period(), longest});
            exec_.download(&longest_list_, longest, 4);
            enough = longest_list_ <= places_;
            if (!enough) places_ = ceil_div(longest_list_ + longest_list_ / 4, 8u) * 8;
        }
        typename Packet::Short* g = gradients_.reserve(3 * padded * places_);
        lists_.gx = g;
        lists_.gy = g + padded * places_;
        lists_.gz = g + 2 * padded * places_;
        tissue_.veto(lists_, state_.view());
    }

    void densities() {
        const std::size_t padded = ceil_div<std::size_t>(state_.n_rows, 64) * 64;
        float* v = row_values_.reserve(8 * padded);
        float** arrays[] = {&rows_.density, &rows_.gx, &rows_.gy, &rows_.gz, &rows_.inverse_rho,
                            &rows_.alpha, &rows_.alpha_divergence, &rows_.boundary};
        for (float** array : arrays) {
            *array = v;
            v += padded;
        }
        const sim::State s = state_.view();
        const auto sum = [&]<bool periodic>(std::bool_constant<periodic>) {
            exec_.for_each_packet(state_.n_rows, sim::Densities<Packet, periodic>{lists_, s.place, rows_, state_.spline(), state_.period(),
                                                                                  state_.volume(), state_.lattice_squares()});
        };
        with_period(sum);
        exec_.reduce_in_order(state_.n_rows, sim::CompressionOf{rows_, 2.0f * sim::kFreeGradient}, sim::AddCompression{}, sim::Compression{}, compression_.reserve(1));
    }

    bool is_filled() {
        if (tissue_.n() > 0) return false;
        sim::Compression c{};
        exec_.download(&c, compression_.data(), sizeof c);
        return c.n_free <= sim::kFreeShare * c.n && c.density >= sim::kLeastFilling * c.n;
    }

    /// Velocities without divergence, of fluid that fills its space.
    void solve_filled(float dt, StepReport& r) {
        const sim::State s = state_.view();
        Quad* diagonal = direction_.reserve(state_.n + 64);
        Quad* rest = applied_.reserve(state_.n + 64);
        Quad* plain = accelerations_.reserve(state_.n_rows + 64);
        exec_.for_each(state_.n + 1, sim::NoCorrection{diagonal, rest});
        with_period([&]<bool periodic>(std::bool_constant<periodic>) {
            exec_.for_each_packet(state_.n_rows, sim::InverseMoments<Packet, periodic>{lists_, s.place, state_.period(), state_.spline().inverse, diagonal, rest});
        });
        exec_.for_each_packet(state_.n_rows, sim::CorrectGradients<Packet>{lists_, s.place, diagonal, rest, rows_, plain, state_.spline().support, state_.lattice_squares()});
        exec_.clear(s.impulse, 4 * state_.n);
        const sim::Progress p = solve(rows_.alpha, s.divergence_impulse, dt, 0.0f, sim::kFilledAim * settings_.divergence_error, settings_.least_iterations, true);
        r.iterations = int(p.iterations);
        r.error = p.error;
    }

    sim::Progress solve(const float* alpha, float* impulse, float dt, float most_excess, double tolerance, int least, bool both_signs = false) {
        const std::size_t n = state_.n_rows;
        const float inverse_support = state_.spline().inverse;
        float* change = change_.reserve(state_.n + 64);
        float* error = error_.reserve(n + 64);
        double* sum = error_sum_.reserve(1);
        sim::Progress* progress = progress_.reserve(1);
        exec_.clear(progress, sizeof *progress);
        exec_.clear(change, 4 * (state_.n + 64));
        exec_.for_each(n, sim::WarmStart{lists_.rows, alpha, impulse, change, kWarmShare});
        const sim::State s = state_.view();
        sim::Progress p{};
        const float least_bound = both_signs ? 0.0f : -infinity();
        constexpr int at_once = Exec::on_device ? 2 : 1;  // iterations between two looks at the device's progress
        do {
            for (int i = 0; i < at_once; ++i) {
                exec_.for_each_packet(n, sim::Push<Packet>{lists_, rows_, change, s.velocity, progress, inverse_support});
                exec_.for_each_packet(n, sim::Relax<Packet>{lists_, rows_, alpha, s.velocity, impulse, change, error, progress, inverse_support, 1.0f / dt, most_excess, least_bound, both_signs ? -infinity() : 0.0f, kOmega});
                exec_.reduce_in_order(n, sim::ErrorOf{error}, sim::AddDouble{}, 0.0, sum);
                exec_.for_each(1, sim::Judge{sum, double(dt) / double(n), tolerance, std::uint32_t(least), progress});
            }
            exec_.download(&p, progress, sizeof p);
        } while (!p.done && int(p.iterations) < settings_.most_iterations);
        exec_.for_each(n, sim::Applied{lists_.rows, impulse, change, 1.0f / dt, most_excess > 0.0f, flux(), s.pressure});
        return p;
    }

    /// Weakly compressible: pressures follow from the densities, and are applied once.
    void push_by_density(float dt) {
        const sim::State s = state_.view();
        float* change = change_.reserve(state_.n + 64);
        sim::Progress* progress = progress_.reserve(1);
        exec_.clear(progress, sizeof *progress);
        exec_.clear(change, 4 * (state_.n + 64));
        exec_.for_each(state_.n_rows, sim::TaitPressure{lists_.rows, rows_, settings_.sound_speed, dt, s.pressure, change});
        exec_.for_each_packet(state_.n_rows, sim::Push<Packet>{lists_, rows_, change, s.velocity, progress, state_.spline().inverse});
    }

    void forces(float dt, StepReport& r) {
        const sim::State s = state_.view();
        tissue_.take_velocities(s);
        const std::size_t n = state_.n_rows;
        bool viscous = settings_.extra_viscosity > 0, implicit = false, tension = false;
        for (const sim::Phase& p : state_.phase_table) {
            viscous |= p.viscosity > 0;
            implicit |= p.viscosity > 0 && p.implicit_viscosity;
            tension |= p.tension > 0 || p.adhesion > 0;
        }
        const Quad* acceleration = nullptr;
        if ((viscous && !implicit) || tension) acceleration = pair_forces(implicit ? 0.0f : 1.0f, tension, nullptr);
        exec_.for_each(n, sim::Kick{lists_.rows, rows_.inverse_rho, acceleration, settings_.gravity, dt, s.velocity});
        if (has_forces_) {
            Quad* a = accelerations_.reserve(n + 64);
            exec_.for_each(n, sim::UserForces{lists_.rows, rows_.inverse_rho, 1.0f / state_.volume(), forces_.data(), a});
            exec_.for_each(n, sim::Kick{lists_.rows, rows_.inverse_rho, a, {0, 0, 0}, dt, s.velocity});
            has_forces_ = false;
        }
        if (implicit) r.viscosity_iterations = implicit_viscosity(dt);
    }

    sim::Interaction interaction(float share) const {
        return {state_.spline(), state_.period(), 2.0f * share, settings_.extra_viscosity, settings_.spacing, state_.volume()};
    }
    const Quad* pair_forces(float viscous_share, bool tension, float* diagonal) {
        const sim::State s = state_.view();
        Quad* out = accelerations_.reserve(state_.n_rows + 64);
        float* cohesion = cohesion_.reserve(state_.n + 64);
        if (tension) exec_.for_each(state_.n + 1, sim::CohesionOf{s, state_.phases(), cohesion});
        const auto run = [&]<bool periodic, bool with_tension>(std::bool_constant<periodic>, std::bool_constant<with_tension>) {
            exec_.for_each_packet(state_.n_rows, sim::PairForces<Packet, periodic, with_tension>{lists_, s.place, s.velocity, rows_, interaction(viscous_share),
                                                                                                  cohesion, diagonal, out});
        };
        with_period([&](auto periodic) {
            if (tension) run(periodic, std::true_type{});
            else run(periodic, std::false_type{});
        });
        return out;
    }

    /// Conjugate gradients for what viscosity adds to the velocities; the iterations taken.
    int implicit_viscosity(float dt) {
        const sim::State s = state_.view();
        const std::size_t n = state_.n_rows;
        float* diagonal = diagonal_.reserve(n + 64);
        Quad* residual = residual_.reserve(n + 64);
        Quad* applied = applied_.reserve(n + 64);
        Quad* direction = direction_.reserve(state_.n + 64);
        sim::Conjugate* c = conjugate_.reserve(1);
        const Quad* acceleration = pair_forces(1.0f, false, diagonal);
        exec_.clear(direction, (state_.n + 64) * sizeof(Quad));
        exec_.clear(c, sizeof *c);
        exec_.for_each(n, sim::StartConjugate{lists_.rows, rows_.inverse_rho, diagonal, acceleration, s.velocity, dt, residual, direction});
        exec_.reduce_in_order(n, sim::ResidualSquare{residual}, sim::AddDouble{}, 0.0, &c->rz_new);
        exec_.for_each(1, sim::JudgeConjugate{c, settings_.viscosity_error});
        sim::Conjugate state{};
        constexpr int at_once = Exec::on_device ? 4 : 1;
        do {
            for (int i = 0; i < at_once; ++i) {
                with_period([&]<bool periodic>(std::bool_constant<periodic>) {
                    exec_.for_each_packet(n, sim::ApplyViscosity<Packet, periodic>{lists_, s.place, direction, rows_, interaction(1.0f), c, dt, applied});
                });
                exec_.reduce_in_order(n, sim::DirectionSquare{lists_.rows, direction, applied}, sim::AddDouble{}, 0.0, &c->pq);
                exec_.for_each(n, sim::StepConjugate{lists_.rows, c, direction, applied, s.velocity, residual});
                exec_.reduce_in_order(n, sim::ResidualSquare{residual}, sim::AddDouble{}, 0.0, &c->rz_new);
                exec_.for_each(n, sim::TurnConjugate{lists_.rows, c, residual, direction});
                exec_.for_each(1, sim::JudgeConjugate{c, settings_.viscosity_error});
            }
            exec_.download(&state, c, sizeof state);
        } while (!state.done && state.iterations < std::uint32_t(settings_.most_iterations));
        return int(state.iterations) - 1;
    }

    /// fn(std::bool_constant: is any axis periodic).
    template <class Fn>
    void with_period(const Fn& fn) {
        if (state_.period().any()) fn(std::true_type{});
        else fn(std::false_type{});
    }

    /// Rigid bodies: what the fluid's pressure did to them, gravity, contact; then their particles' next places.
    void turn_bodies(float dt) {
        const sim::State s = state_.view();
        for (auto& [phase, body] : bodies_) {
            double p[3], none[3] = {};
            for (int k = 0; k < 3; ++k) p[k] = body.mass() * dt * (&settings_.gravity.x)[k];
            body.push(p, none);
            if (state_.n_rows > 0) {
                sim::Impulse* impulse = impulse_.reserve(1);
                sim::Touch* touch = touch_.reserve(1);
                exec_.reduce_in_order(state_.n_rows, sim::PressureImpulse<Packet>{lists_, s, rows_.boundary, std::uint8_t(phase), state_.period(),
                                                                                  state_.volume(), state_.spline().support, dt, flux(), body.center_float()},
                                      sim::AddImpulse{}, sim::Impulse{}, impulse);
                exec_.reduce_in_order(state_.n_rows, sim::TouchOf<Packet>{lists_, s, std::uint8_t(phase), state_.period(), settings_.spacing}, sim::AddTouch{}, sim::Touch{}, touch);
                sim::Impulse i;
                sim::Touch t;
                exec_.download(&i, impulse, sizeof i);
                exec_.download(&t, touch, sizeof t);
                body.push(i.p, i.l);
                body.meet(t, dt);
            }
            body.advance(dt);
            exec_.for_each(state_.n, sim::Carry{s, std::uint8_t(phase), body.pose(), home_.data(), dt});
        }
    }

    /// Momentum that an impulse carries across a face; corrected gradients carry all of it.
    float flux() const { return filled_ ? 1.0f : sim::kFlux; }

    void gather_tissue() { tissue_.gather(state_.view(), state_.phases(), state_.slot_of(), state_.volume()); }

    /// Blood comes in at the end of the step, where its velocity will have led it.
    void bleed(float dt) {
        for (const tissue::Drop& d : tissue_.bleed(state_.tree().sparse(), state_.view(), dt)) {
            const float3 at = d.at + d.velocity * dt;
            emitted_.push_back({{at.x, at.y, at.z}, {d.velocity.x, d.velocity.y, d.velocity.z}, tissue_.phase_of_blood(d.vessel)});
        }
    }

    /// Sinks take fluid out, emitted particles come in; positions are in the state afterwards.
    void take_and_give(StepReport& r) {
        exec_.for_each(state_.n, sim::TakePositions{state_.positions(), state_.view().place});
        if (n_sinks_ > 0) {
            std::uint32_t* n_gone = n_gone_.reserve(1);
            exec_.clear(n_gone, 4);
            std::uint32_t* flags = state_.flags();
            exec_.for_each(state_.n + 1, sim::FlagKept{state_.view(), state_.phases(), state_.positions(), sinks_.data(), n_sinks_, flags, n_gone});
            std::uint32_t gone;
            exec_.download(&gone, n_gone, 4);
            if (gone > 0) state_.keep(flags);
            r.n_removed = gone;
        }
        for (const Emitted& e : emitted_) state_.append(e.positions.size() / 3, e.positions.data(), e.velocities.data(), {}, e.phase);
        emitted_.clear();
    }

    void move(float dt) {
        if (state_.n_rows > 0) exec_.for_each(state_.n_rows, sim::Contact<Packet>{lists_, rows_.boundary, state_.view(), state_.period(), settings_.spacing});
        if (filled_) {
            const float d = settings_.spacing, far = least(sim::kShift * std::sqrt(state_.summary.most_speed2) * dt, sim::kMostShift * d) * d;
            exec_.for_each(state_.n_rows, sim::Shift{lists_.rows, rows_.inverse_rho, accelerations_.data(), far * state_.spline().inverse / dt, state_.view().velocity,
                                                     residual_.reserve(state_.n_rows + 64)});
        }
        float* positions = state_.positions();
        exec_.for_each(state_.n, sim::Move{state_.view(), dt, state_.tree().sparse().header, state_.period(), settings_.lo, positions, state_.not_a_number()});
        if (filled_) exec_.for_each(state_.n_rows, sim::GiveBack{lists_.rows, residual_.data(), state_.view().velocity});
        filled_ = false;
        if (state_.n_rows > 0) tissue_.add_rest(state_.view());
    }

    void report(StepReport& r) {
        sim::Compression c{};
        if (r.n_solved > 0) exec_.download(&c, compression_.data(), sizeof c);
        r.compression = c.n > 0 ? c.sum / c.n : 0.0;
        r.most_compression = c.most;
        r.time = time_;
        r.step = n_steps_;
        r.n = state_.n;
        r.n_escaped = state_.summary.n_outside;
        r.most_speed = std::sqrt(double(state_.summary.most_speed2));
        for (int i = 1; i < n_marks_; ++i) r.seconds.push_back({stage_[i], exec_.elapsed(kFirstMark + i - 1, kFirstMark + i)});
        n_marks_ = 0;
        if (state_.summary.not_a_number) tell_not_a_number(state_.summary.not_a_number - 1);
    }

    /// Stops with the story of a particle whose velocity is not a number.
    void tell_not_a_number(std::uint32_t id) {
        std::uint32_t slot;
        exec_.download(&slot, state_.slot_of() + id, 4);
        Quad at;
        std::uint8_t phase;
        exec_.download(&at, state_.view().place + slot, sizeof at);
        exec_.download(&phase, state_.view().phase + slot, 1);
        exec_.clear(state_.not_a_number(), 4);
        throw SimulationError{id, phase, {at.x, at.y, at.z}, time_, n_steps_};
    }

    void mark(const char* stage) {
        stage_[n_marks_] = stage;
        exec_.mark(kFirstMark + n_marks_++);
    }

    std::pair<char*, std::size_t> array(const std::string& name) {
        const sim::State s = state_.view();
        const auto of = [](auto* p) { return std::pair<char*, std::size_t>{reinterpret_cast<char*>(p), sizeof *p}; };
        if (name == "place") return of(s.place);
        if (name == "velocity") return of(s.velocity);
        if (name == "id") return of(s.id);
        if (name == "phase") return of(s.phase);
        if (name == "pressure") return of(s.pressure);
        if (name == "impulse") return of(s.impulse);
        if (name == "divergence_impulse") return of(s.divergence_impulse);
        throw std::invalid_argument("simulation: no array named " + name);
    }

    struct Emitted {
        std::vector<float> positions, velocities;
        int phase;
    };

    static constexpr double kAim = 0.8;  // the error is predicted along straight lines: what comes is a fifth more
    static constexpr float kWarmShare = 0.5f, kOmega = 0.5f;
    static constexpr int kFirstMark = 4;  // the scene has those before

    std::shared_ptr<Scene> scene_;
    SceneAccess access_;
    Exec& exec_;
    SimulationSettings settings_;
    SimulationState<Exec> state_;
    TissueOf<Exec> tissue_;
    Lists lists_{};
    sim::Rows rows_{};
    std::uint32_t places_ = 64, longest_list_ = 0;
    Buffer<std::uint32_t, Exec> list_counts_, list_index_;
    Buffer<typename Packet::Short, Exec> gradients_;
    Buffer<float, Exec> row_values_, change_, error_;
    Buffer<Quad, Exec> accelerations_;
    Buffer<float, Exec> forces_;
    Buffer<sim::Progress, Exec> progress_;
    Buffer<double, Exec> error_sum_;
    Buffer<sim::Compression, Exec> compression_;
    Buffer<std::uint32_t, Exec> most_count_;
    Buffer<float, Exec> cohesion_, diagonal_;
    Buffer<Quad, Exec> residual_, direction_, applied_;
    Buffer<sim::Conjugate, Exec> conjugate_;
    Buffer<Quad, Exec> home_;
    Buffer<sim::Impulse, Exec> impulse_;
    Buffer<sim::Touch, Exec> touch_;
    Buffer<sim::Sink, Exec> sinks_;
    Buffer<std::uint32_t, Exec> n_gone_;
    Buffer<sim::Totals, Exec> totals_;
    std::map<int, sim::Pose> next_poses_;
    std::map<int, RigidBody> bodies_;
    std::vector<Emitted> emitted_;
    int n_sinks_ = 0;
    Buffer<float, Exec> color_, reflection_, weight_;
    Buffer<std::uint32_t, Exec> rank_, ids_;
    bool stale_ = true, has_forces_ = false, filled_ = false;
    double time_ = 0.0;
    std::uint64_t n_steps_ = 0;
    int n_marks_ = 0;
    const char* stage_[16] = {};
};

}  // namespace globule
