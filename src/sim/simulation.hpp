// The one implementation of Simulation, over any Exec.
//
// The order of a step (each a named call below; dt is known before it begins, from the speeds that the
// last step ended with):
//   1  find_lists    neighbor lists, from the octree of the present positions
//                    -> pairs whose bond is cut are nobody's neighbors; where rigid bodies touch
//   2  densities     delta, G, alpha of every row; V grad W of every pair is kept
//   3  forces        gravity, viscosity, tension, what the user asked for
//                    and bonds, which take their substeps on State::velocity
//   4  solve         velocities that compress nothing
//                    -> velocities of rigid bodies are unknowns of 3 and 4; then they turn, and keep others out
//   5  solve         for one move, what is too dense moves apart (split.hpp)
//                    -> kinetic energy that 4 did not take but gave: 3 to 5 anew with half the step
//   6  move          x += dt v (boundaries by their own velocities); guards
//                    -> fluid that fills its space (filled.hpp): no 5, 6 shifts
//                    -> here instruments get the velocities of the next step, emitters emit, sinks remove
//   7  settle        octree of the new positions, state in its order, rows, what the host needs to know
// Between two steps, the tree is that of the positions: a picture of it takes no copy.
#pragma once
#include "sim/bodies.hpp"
#include "sim/fluid.hpp"
#include "sim/show.hpp"
#include "backends/backend.hpp"
#include "sim/tissue.hpp"

namespace globule::core {

template <class Exec> class SimulationImpl final : public Simulation {
public:
    using Packet = typename Exec::Packet;

    explicit SimulationImpl(std::shared_ptr<Scene> scene)
        : scene_(std::move(scene)),
          access_(scene_->share()),
          exec_(*static_cast<Exec*>(access_.exec)),
          state_(exec_, *static_cast<Octree<Exec>*>(access_.octree)),
          fluid_(exec_, state_, settings_),
          bodies_(exec_, state_, settings_),
          tissue_(exec_),
          forces_(exec_),
          sinks_(exec_),
          inlets_(exec_),
          totals_(exec_),
          color_(exec_),
          reflection_(exec_),
          weight_(exec_),
          shown_(exec_),
          wetness_(exec_),
          rank_(exec_),
          ids_(exec_) {
        access_.before_use([this] { show(); });
        tissue_.before_use([this] {
            begin();
            gather_tissue();
        });
    }
    ~SimulationImpl() override { access_.before_use(nullptr); }

    int device() const noexcept override { return exec_.device(); }
    Interrupt* whole() noexcept override { return &exec_.interrupt(); }
    void begin() override {
        if (broken_) throw Stale("simulation: an earlier call failed half way: make it anew, or load a checkpoint");
    }
    void invalidate() noexcept override { broken_ = true; }
    void cancel() noexcept override {}

    void configure(const SimulationSettings& settings) override {
        settings_ = settings;
        disturbed();
        state_.configure(settings);
        tissue_.set_spacing(settings.spacing, state_.size_of_fluid());
    }
    void set_phase(int which, const sim::Phase& given) override {
        sim::Phase phase = given;
        if (phase.kind == sim::Kind::fluid)
            phase.viscosity = std::max(phase.viscosity, sim::least_viscosity(phase, spacing_of(phase)));
        state_.set_phase(which, phase);
        stale_ = true;
        disturbed();
        exec_.for_each(
            state_.n, sim::SetMaterial{state_.view(), std::uint8_t(which), state_.w_of(which), phase.viscosity});
    }

    std::uint32_t add(
        std::size_t m, const float* positions, const float* velocities, float3 velocity, int phase) override {
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
        emitted_.push_back({{positions, positions + 3 * m}, {velocities, velocities + 3 * m}, phase, true});
        return first;
    }
    void set_inlets(const std::vector<sim::Inlet>& inlets) override {
        n_inlets_ = int(inlets.size());
        exec_.upload(inlets_.reserve(inlets.size() + 1), inlets.data(), inlets.size() * sizeof(sim::Inlet));
    }
    void set_sinks(const std::vector<sim::Sink>& sinks) override {
        if (sinks.size() > std::size_t(sim::kMaxSinks))
            throw Refused("sinks: expected at most " + std::to_string(sim::kMaxSinks));
        n_sinks_ = int(sinks.size());
        exec_.upload(sinks_.reserve(sim::kMaxSinks), sinks.data(), sinks.size() * sizeof(sim::Sink));
    }

    void capture(int phase, const sim::Pose& now) override { bodies_.capture(phase, now); }
    void move_to(int phase, const sim::Pose& next) override { bodies_.move_to(phase, next); }
    void make_body(int phase, double mass, const double center[3], const double inertia[9], const double velocity[3],
        const double spin[3]) override {
        bodies_.make_body(phase, mass, center, inertia, velocity, spin);
    }
    std::vector<double> body(int phase) override { return bodies_.body(phase); }

    std::vector<char> motion() override { return bodies_.save(); }
    void set_motion(const std::vector<char>& bytes) override { bodies_.load(bytes); }

    sim::Totals totals() override {
        sim::Totals* out = totals_.reserve(1);
        exec_.reduce_in_order(state_.n_rows,
            sim::TotalsOf{state_.view(), state_.rows(), state_.sizes(), state_.volume(), settings_.gravity},
            sim::AddTotals{}, sim::Totals{}, out);
        sim::Totals t;
        exec_.download(&t, out, sizeof t);
        const sim::Impulse owed = tissue_.owed();
        for (int k = 0; k < 3; ++k) {
            t.momentum[k] += owed.p[k];
            t.angular[k] += owed.l[k];
        }
        return t;
    }

    double next_dt() override {
        // v dt + g dt^2 <= far: at rest, gravity limits the first step.
        const double v = std::sqrt(double(state_.summary.speeds.limiting2)), far = farthest_move();
        const double g = std::sqrt(double(dot(settings_.gravity, settings_.gravity))) / state_.size_of_fluid();
        double dt = longest_step();
        if (settings_.weakly_compressible) dt = std::min(dt, far / (settings_.sound_speed + v));
        if (v > 0 || g > 0) dt = std::min(dt, 2 * far / (v + std::sqrt(v * v + 4 * g * far)));
        // Pressure p can give a speed of sqrt(p / rho) to what it meets unevenly, as under a tall column that starts.
        const double p = settings_.weakly_compressible ? 0.0 : std::sqrt(double(state_.summary.speeds.pressing2));
        if (p > 0) dt = std::max(std::min(dt, far / p), kLeastByPressure * dt);
        return dt;
    }

    StepReport step(double asked) override {
        const typename Exec::Stage stage("step");
        StepReport r;
        r.dt = asked > 0 ? asked : next_dt();
        float dt = float(r.dt);
        mark("");
        if (bodies_.carry(dt)) tissue_.moved();
        gather_tissue();
        r.n_solved = state_.n_rows;
        const bool begun = fluid_.has_started_lists();
        tissue_.begin_aside();
        if (state_.n_rows > 0) find_lists();
        tissue_.bleed(state_.tree().view(), state_.tree().particles(), state_.sizes(), dt);
        if (state_.n_rows > 0 && by_approach()) fluid_.leave_out_alone();
        const double earlier = begun ? exec_.elapsed(kListMark, kListMark + 1) : 0.0;
        take_blood(dt);
        bool split = false;
        bodies_.solve().find_meetings(fluid_.lists(), settings_.spacing, dt);
        if (state_.n_rows == 0) bodies_.solve().kick(settings_.gravity, dt);
        if (state_.n_rows > 0) {
            tissue_.change(context(dt));
            tissue_.find_contacts(context(dt), rubs(), !settings_.weakly_compressible && any_fluid());
            mark("neighbors");
            fluid_.densities();
            mark("density");
            if (settings_.weakly_compressible) {
                push(dt, r);
                fluid_.push_by_density(dt, bodies_.solve());
                tissue_.feel_pressure(context(dt));
                rub(dt);
                tissue_.take_pressed(state_.view(), dt);
                mark("pressure");
            } else if (tissue_.n() == 0 && !settings_.fine_fluids && fluid_.fills_its_space()) {
                push(dt, r);
                fluid_.correct_filled(dt, bodies_.solve());
                mark("pressure");
            } else {
                split = true;
                fluid_.keep_before();
                // Who else moves may give energy.
                const bool may_undo = tissue_.n() == 0 && bodies_.none() && emitted_.empty() && !has_forces_;
                for (const int n_marks = n_marks_;; n_marks_ = n_marks) {
                    push(dt, r);
                    fluid_.keep_kicked();
                    fluid_.correct_divergence(dt, bodies_.solve());
                    mark("divergence");
                    tissue_.feel_pressure(context(dt));
                    rub(dt);
                    tissue_.take_pressed(state_.view(), dt);
                    tissue_.hold_on(state_.view(), dt);
                    bodies_.turn(dt);
                    contact(dt, true);
                    fluid_.correct_density(dt);
                    mark("pressure");
                    if (!may_undo || r.n_halved == kMostHalvings || !is_given(fluid_.kinetic(), dt)) break;
                    fluid_.undo();
                    dt *= 0.5f;
                    r.dt = double(dt);
                    ++r.n_halved;
                }
            }
            if (!split) tissue_.hold_on(state_.view(), dt);
        }
        if (!split) bodies_.turn(dt);
        move(dt, split);
        const bool others = take_and_give(r);
        mark("move");
        if (others) state_.settle();
        else state_.settle_positions();
        tissue_.moved();
        tissue_.ask_felt();
        const bool solved = r.n_solved > 0;
        summarize(solved ? fluid_.compression() : nullptr,
            solved && !settings_.weakly_compressible ? fluid_.outcomes() : nullptr);
        const sim::Progress &velocities = state_.summary.solves[0].progress,
                            &places = state_.summary.solves[1].progress, &whole = split ? places : velocities;
        r.iterations = int(whole.iterations);
        r.error = whole.error;
        if (split) {
            r.most_error = places.most;
            r.divergence_iterations = int(velocities.iterations);
            r.divergence_error = velocities.error;
            r.most_divergence_error = velocities.most;
        }
        mark("octree");
        if (Exec::on_device && state_.n_rows > 0) {
            exec_.mark(kListMark);
            fluid_.start_lists();
            exec_.mark(kListMark + 1);
        }
        time_ += r.dt;
        ++n_steps_;
        stale_ = true;
        report(r, earlier);
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
        disturbed();
    }
    void resize(std::size_t n, std::uint32_t next_id, double time, std::uint64_t n_steps) override {
        state_.resize(n);
        state_.next_id = next_id;
        time_ = time;
        n_steps_ = n_steps;
    }
    void settle() override {
        disturbed();
        state_.settle();
        summarize();
        stale_ = true;
    }

    void set_forces(const float* forces) override {
        has_forces_ = forces != nullptr;
        if (!forces) return;
        exec_.upload(forces_.reserve(3 * state_.n), forces, 12 * state_.n);
        exec_.synchronize();
    }

    void neighbors(std::vector<std::uint32_t>& rows, Neighbors& out) override {
        gather_tissue();
        find_lists();
        fluid_.read_lists(rows, out);
    }

    void flow(float* density, float* vorticity) override {
        gather_tissue();
        if (state_.n_rows == 0) {
            std::fill_n(density, state_.n, 0.0f);
            std::fill_n(vorticity, 3 * state_.n, 0.0f);
            return;
        }
        find_lists();
        fluid_.flow(density, vorticity);
    }

    std::array<double, 6> force_on(int phase, float3 about) override {
        gather_tissue();
        if (state_.n_rows == 0) return {};
        find_lists();
        const sim::Impulse found = fluid_.force_on(std::uint8_t(phase), about);
        std::array<double, 6> out;
        for (int k = 0; k < 3; ++k) {
            out[k] = found.p[k] * state_.volume();
            out[3 + k] = found.l[k] * state_.volume();
        }
        return out;
    }

    void draw(sim::Drawn what) override {
        if (drawn_ == what) return;
        drawn_ = what;
        stale_ = true;
    }

    std::pair<SceneAccess::Shown, void*> look(sim::Drawn what) override {
        const Interrupt::Hold hold(exec_.interrupt());
        return {seen(what, true), &exec_};
    }

    Tissue* tissue() override {
        gather_tissue();
        return &tissue_;
    }

private:
    /// Brings the scene up to date.
    void show() {
        begin();
        if (!stale_) return;
        const Interrupt::Hold hold(exec_.interrupt());
        const bool balls = drawn_ == sim::Drawn::balls;
        const SceneAccess::Shown shown = seen(drawn_, !balls);
        state_.tree().relabel(
            rank_.data() + state_.next_id + 1, {balls && !all_shown() ? weight_.data() : nullptr, 1.0f});
        access_.rebuilt(shown);
        stale_ = false;
    }
    bool all_shown() const {
        return std::ranges::all_of(state_.phase_table, [](const sim::Phase& p) { return p.shown != 0; });
    }
    /// Which particles are seen, in which color.
    SceneAccess::Shown seen(sim::Drawn what, bool with_places) {
        const std::size_t n = state_.n;
        if (n == 0) state_.settle();  // no step builds the octree of nothing
        // Scenes know particles by their rank among the ids that are left.
        std::uint32_t* rank = rank_.reserve(state_.next_id + 1 + n);
        std::uint32_t* index = rank + state_.next_id + 1;
        exec_.for_each(state_.next_id + 1, sim::IsThere{state_.slot_of(), state_.next_id, rank});
        exec_.exclusive_scan(std::size_t(state_.next_id) + 1, rank);
        bool mirrors = false, fluids = false, things = false;
        for (const sim::Phase& p : state_.phase_table) {
            if (p.shown) (p.kind == sim::Kind::fluid ? fluids : things) |= p.kind != sim::Kind::tissue;
            mirrors |= p.reflection > 0.0f || p.refraction > 0.0f;
        }
        const bool balls = what == sim::Drawn::balls, apart = what == sim::Drawn::tissue;
        float* weight = all_shown() || !balls ? nullptr : weight_.reserve(n + 64);
        float* places = with_places ? shown_.reserve((apart ? 9 : 3) * n) : nullptr;
        float *of_fluids = apart && fluids ? places + 3 * n : nullptr,
              *of_things = apart && things ? places + 6 * n : nullptr;
        float* reflection = mirrors ? reflection_.reserve(2 * n) : nullptr;
        exec_.for_each(n, sim::Show{state_.view(), state_.phases(), rank, index, weight, places, of_fluids, of_things,
                              apart, color_.reserve(3 * n), reflection, reflection ? reflection + n : nullptr});
        float* wetness = tissue_.has_vessels() ? wetness_.reserve(n) : nullptr;
        const float* blood = state_.phase_table[wetness ? tissue_.phase_of_blood(1) : 0].color;
        if (wetness) {
            exec_.clear(wetness, n * sizeof(float));
            tissue_.stain(rank, state_.slot_of(), blood, color_.data(), wetness);
        }
        const float d = settings_.spacing, of_fluid = d * state_.size_of_fluid();
        return {n, places, of_fluids, of_things, !balls, apart || balls ? d : of_fluid, of_fluid, color_.data(),
            reflection, reflection ? reflection + n : nullptr, wetness, {blood[0], blood[1], blood[2]}};
    }

    /// Kinetic energy that a solve gave: more than a fiftieth, and than what gravity gives in a step.
    bool is_given(const sim::Kinetic& k, float dt) const {
        const double fall = dot(settings_.gravity, settings_.gravity) * double(dt) * dt;
        return k.after > 1.02 * k.before + 0.5 * k.mass * fall;
    }
    static constexpr int kMostHalvings = 4;
    static constexpr double kLeastByPressure =
        0.2;  // of the step that speeds allow: an impact's pressure is over at once

    float spacing_of(const sim::Phase& p) const {
        return p.kind == sim::Kind::fluid ? settings_.spacing * state_.size_of_fluid() : settings_.spacing;
    }
    /// Of particles of size 1.
    double farthest_move() const { return 0.4 * settings_.cfl * settings_.spacing; }
    /// That forces other than pressure allow, whatever the speeds.
    double longest_step() const {
        double dt = settings_.longest_step;
        for (const sim::Phase& p : state_.phase_table) {
            if (p.kind != sim::Kind::fluid && p.kind != sim::Kind::tissue) continue;
            const double d = spacing_of(p);
            if (p.tension > 0)
                dt = std::min(dt, 0.4 * std::sqrt(p.density * d * d * d / (2 * 3.14159265358979 * p.tension)));
            const double mu = p.viscosity + settings_.extra_viscosity;
            if (mu > 0 && !p.implicit_viscosity) dt = std::min(dt, 0.125 * d * d * p.density / mu);
        }
        return dt;
    }
    bool by_approach() { return tissue_.n() > 0 && !settings_.weakly_compressible && !state_.period().any(); }
    /// Beside tissue, whose every step is dear, a fluid in free fall does not shorten the steps.
    void summarize(const sim::Compression* compression = nullptr, const sim::Outcome* solves = nullptr) {
        const sim::Ahead ahead{float(longest_step()), float(farthest_move())};
        state_.summarize(
            by_approach() ? &ahead : nullptr, length(settings_.gravity), float(farthest_move()), compression, solves);
    }

    /// Of lists that are there, until particles move.
    sim::Step<Packet> context(float dt) {
        return {fluid_.lists(), state_.view(), state_.phases(), fluid_.rows(), state_.period(), state_.sizes(),
            state_.spline(), settings_.spacing, state_.volume(), dt, fluid_.flux()};
    }
    /// Somebody other than a step changed something: what is known of the particles may be wrong.
    void disturbed() {
        tissue_.disturbed();
        fluid_.forget_lists();
    }
    void find_lists() {
        fluid_.find_lists();
        fluid_.set_within(tissue_.veto(context(0.0f)));
    }
    /// What acts on velocities beside pressure: forces, then bonds.
    void push(float dt, StepReport& r) {
        tissue_.take_velocities(state_.view());
        r.viscosity_iterations = fluid_.forces(dt, has_forces_ ? forces_.data() : nullptr, bodies_.solve());
        has_forces_ = false;
        mark("forces");
        tissue_.push(state_.view(), dt, settings_.gravity);
        mark("tissue");
    }

    bool any_fluid() {
        return std::any_of(state_.phase_table.begin(), state_.phase_table.end(),
            [](const sim::Phase& p) { return p.kind == sim::Kind::fluid; });
    }
    /// Whether tissue has friction with anything.
    bool rubs() const {
        return std::any_of(state_.phase_table.begin(), state_.phase_table.end(),
            [](const sim::Phase& p) { return p.friction > 0.0f; });
    }
    void rub(float dt) {
        if (!rubs()) return;
        tissue_.rub(context(dt), bodies_.masses(),
            [&](int phase, const sim::Impulse& impulse) { bodies_.push(phase, impulse); });
    }

    void gather_tissue() {
        take_tissue();
        if (state_.summary.n_outside > n_outside_ && tissue_.n() > 0) {
            let_go();
            take_tissue();
        }
        n_outside_ = state_.summary.n_outside;
    }
    void take_tissue() {
        if (tissue_.gather(state_.view(), state_.phases(), state_.slot_of(), state_.volume())) {
            state_.find_rows();
            fluid_.forget_lists();
        }
    }
    /// Who has left the domain rests there: bonds to it would hold and shake the tissue that goes on.
    void let_go() {
        for (const float3& axis : {float3{1, 0, 0}, float3{0, 1, 0}, float3{0, 0, 1}}) {
            tissue_.remove({tissue::Shape::half_space, settings_.lo, axis, 0.0f, {}});
            tissue_.remove({tissue::Shape::half_space, settings_.hi, axis * -1.0f, 0.0f, {}});
        }
    }

    /// Blood comes in at the end of the step, where its velocity will have led it.
    void take_blood(float dt) {
        for (const tissue::Drop& d : tissue_.drops()) {
            const float3 at = d.at + d.velocity * dt;
            const int phase = tissue_.phase_of_blood(d.vessel);
            if (emitted_.empty() || emitted_.back().phase != phase || emitted_.back().led)
                emitted_.push_back({{}, {}, phase, false});
            emitted_.back().positions.insert(emitted_.back().positions.end(), {at.x, at.y, at.z});
            emitted_.back().velocities.insert(
                emitted_.back().velocities.end(), {d.velocity.x, d.velocity.y, d.velocity.z});
        }
    }

    /// Sinks take fluid out, emitted particles come in; whether there are others now, whose positions are in the state
    /// then.
    bool take_and_give(StepReport& r) {
        if (any_led_) {
            exec_.for_each(
                state_.n, sim::LetGo{state_.view(), state_.phases(), state_.positions(), inlets_.data(), n_inlets_});
            any_led_ = n_inlets_ > 0;
        }
        if (n_sinks_ == 0 && emitted_.empty()) return false;
        exec_.for_each(state_.n, sim::TakePositions{state_.positions(), state_.view().place});
        if (n_sinks_ > 0) {
            std::uint32_t* flags = state_.flags();
            exec_.for_each(state_.n + 1,
                sim::FlagKept{state_.view(), state_.phases(), state_.positions(), sinks_.data(), n_sinks_, flags});
            r.n_removed = state_.keep(flags);
        }
        const bool others = r.n_removed > 0 || !emitted_.empty();
        for (const Emitted& e : emitted_) {
            state_.append(e.positions.size() / 3, e.positions.data(), e.velocities.data(), {}, e.phase, e.led);
            any_led_ |= e.led;
        }
        emitted_.clear();
        return others;
    }

    /// Nobody enters what is solid.  Velocities that last push rigid bodies back.
    void contact(float dt, bool lasts) {
        if (state_.n_rows == 0) return;
        sim::Contact<Packet> contact{context(dt), nullptr};
        if (lasts) contact.share = bodies_.push_back(contact);
        exec_.for_each(contact.step.lists.n_rows, contact);
    }
    void move(float dt, bool split) {
        contact(dt, !split);
        fluid_.shift(dt);
        float* positions = state_.positions();
        exec_.for_each(state_.n, sim::Move{state_.view(), dt, state_.tree().view().header, state_.period(),
                                     settings_.lo, state_.phases(), positions, state_.not_a_number()});
        fluid_.end_shift();
        if (split) fluid_.end_split(dt);
        if (state_.n_rows > 0) tissue_.add_rest(state_.view(), state_.phases());
        if (state_.n_rows > 0 && by_approach()) tissue_.count_as(state_.view(), float(farthest_move()));
    }

    /// `earlier`: seconds that the step's lists had taken before it began.
    void report(StepReport& r, double earlier) {
        const sim::Compression& c = state_.summary.compression;
        r.compression = c.all > 0 ? c.sum / c.all : 0.0;
        r.most_compression = c.most;
        r.high_compression = c.exceeded_by(0.001);
        r.time = time_;
        r.step = n_steps_;
        r.n = state_.n;
        r.n_escaped = state_.summary.n_outside;
        r.most_speed = std::sqrt(double(state_.summary.speeds.most2));
        for (int i = 1; i < n_marks_; ++i)
            r.seconds.push_back({stage_[i], exec_.elapsed(kFirstMark + i - 1, kFirstMark + i)});
        if (earlier > 0.0) r.seconds.front().second += earlier;
        n_marks_ = 0;
        if (state_.summary.not_a_number) r.lost = lost_particle(state_.summary.not_a_number - 1);
    }

    /// A particle whose velocity is not a number.
    LostParticle lost_particle(std::uint32_t id) {
        std::uint32_t slot;
        exec_.download(&slot, state_.slot_of() + id, 4);
        Quad at;
        std::uint8_t phase;
        exec_.download(&at, state_.view().place + slot, sizeof at);
        exec_.download(&phase, state_.view().phase + slot, 1);
        exec_.clear(state_.not_a_number(), 4);
        return {id, phase, {at.x, at.y, at.z}};
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
        if (name == "growth") return of(s.growth);
        if (name == "divergence_impulse") return of(s.divergence_impulse);
        throw Refused("simulation: no array named " + name);
    }

    struct Emitted {
        std::vector<float> positions, velocities;
        int phase;
        bool led;
    };

    static constexpr int kFirstMark = 4, kListMark = 14;  // the scene has those before

    std::shared_ptr<Scene> scene_;
    SceneAccess access_;
    Exec& exec_;
    SimulationSettings settings_;
    SimulationState<Exec> state_;
    Fluid<Exec> fluid_;
    Bodies<Exec> bodies_;
    TissueImpl<Exec> tissue_;
    Buffer<float, Exec> forces_;
    Buffer<sim::Sink, Exec> sinks_;
    Buffer<sim::Inlet, Exec> inlets_;
    Buffer<sim::Totals, Exec> totals_;
    std::vector<Emitted> emitted_;
    int n_sinks_ = 0, n_inlets_ = 0;
    bool any_led_ = true;  ///< fluid that keeps its velocity: a checkpoint may have some
    Buffer<float, Exec> color_, reflection_, weight_, shown_, wetness_;
    Buffer<std::uint32_t, Exec> rank_, ids_;
    sim::Drawn drawn_ = sim::Drawn::balls;
    bool stale_ = true, has_forces_ = false, broken_ = false;
    std::uint32_t n_outside_ = 0;  ///< of the domain, when tissue was last taken out of the state
    double time_ = 0.0;
    std::uint64_t n_steps_ = 0;
    int n_marks_ = 0;
    const char* stage_[16] = {};
};

}  // namespace globule::core
