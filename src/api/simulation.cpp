#include "globule/simulation.hpp"

#include <atomic>
#include <algorithm>
#include <numbers>
#include <numeric>

#include "api/impl.hpp"
#include "field/surface_kernels.hpp"

namespace globule {
namespace {

core::SimulationSettings packed(const SimulationSettings& s) {
    core::SimulationSettings p;
    p.spacing = float(positive("spacing", s.spacing));
    p.fine_fluids = s.fine_fluids;
    p.lo = three("domain.low", s.domain.low);
    p.hi = three("domain.high", s.domain.high);
    for (int k = 0; k < 3; ++k) {
        if (!(s.domain.low[k] < s.domain.high[k]))
            refuse("domain", "low below high in each axis", text(s.domain.low) + " and " + text(s.domain.high));
        p.periodic[k] = s.periodic[k];
        if (s.periodic[k] && s.domain.high[k] - s.domain.low[k] < 8 * s.spacing)
            throw Error(ErrorCode::invalid, "periodic: expected an axis at least 8 spacings long");
    }
    p.gravity = three("gravity", s.gravity);
    p.cfl = float(positive("cfl", s.cfl));
    p.longest_step = float(positive("max_dt", s.max_dt));
    p.density_error = float(positive("max_error", s.max_error));
    p.divergence_error = float(positive("divergence_error", s.divergence_error.value_or(s.max_error)));
    p.least_iterations = whole("min_iterations", s.min_iterations, 0, 1'000'000);
    if (s.max_iterations) p.most_iterations = whole("max_iterations", *s.max_iterations, 1, 1'000'000);
    p.viscosity_error = positive("viscosity_error", s.viscosity_error);
    p.weakly_compressible = s.weakly_compressible;
    if (s.sound_speed) positive("sound_speed", *s.sound_speed);
    if (s.weakly_compressible) {
        const double fall = std::abs(dot(s.gravity, s.domain.high - s.domain.low));
        p.sound_speed = float(s.sound_speed ? *s.sound_speed : 10.0 * std::sqrt(2.0 * fall));
    }
    p.extra_viscosity = number("extra_viscosity", s.extra_viscosity, 0);
    return p;
}

/// Of a phase's particles.
double spacing_of(const SimulationSettings& s, PhaseKind kind) {
    return s.fine_fluids && kind == PhaseKind::fluid ? 0.5 * s.spacing : s.spacing;
}

core::sim::Phase packed(const Phase& f, const SimulationSettings& settings) {
    const std::string of = "phases[\"" + f.name + "\"].";
    if (f.name.empty()) refuse("phases", "names", "an empty one");
    if (int(f.kind) < 0 || f.kind > PhaseKind::rigid)
        refuse(of + "kind", "fluid, tissue, boundary or rigid", std::to_string(int(f.kind)));
    core::sim::Phase p;
    p.kind = core::sim::Kind(f.kind);
    p.density = number((of + "density").c_str(), f.density, 1e-3, 1e6);
    p.viscosity = number((of + "viscosity").c_str(), f.viscosity, 0, 1e9);
    p.tension = number((of + "surface_tension").c_str(), f.surface_tension, 0, 1e3);
    p.adhesion = number((of + "adhesion").c_str(), f.adhesion, 0, 1e3);
    p.friction = number((of + "friction").c_str(), f.friction, 0);
    const core::float3 color = three((of + "color").c_str(), f.color, 0, 1);
    p.color[0] = color.x, p.color[1] = color.y, p.color[2] = color.z;
    p.reflection = number((of + "reflection").c_str(), f.reflection, 0, 1);
    p.refraction = number((of + "refraction").c_str(), f.refraction, 0, 1);
    p.implicit_viscosity = f.implicit;
    p.shown = f.shown.value_or(f.kind != PhaseKind::boundary);
    if (f.kind == PhaseKind::fluid) {
        const auto check = [&](const char* name, double step) {
            if (step < settings.least_dt)
                refuse(of + name, "a value that allows steps of at least " + text(settings.least_dt) + " s",
                    "one that allows " + text(step) + " s");
        };
        const double spacing = spacing_of(settings, f.kind);
        if (f.viscosity > 0 && !f.implicit) check("viscosity", 0.125 * spacing * spacing * f.density / f.viscosity);
        if (f.surface_tension > 0)
            check("surface_tension",
                0.4 * std::sqrt(f.density * spacing * spacing * spacing / (2 * std::numbers::pi * f.surface_tension)));
    }
    return p;
}

/// One layer of particles half a spacing outside of a box's faces, x slowest.  Along a periodic axis the layer has no
/// end, and no face closes it.
std::vector<float> box_walls(const Box& box, double spacing, const std::array<bool, 3>& periodic) {
    std::int64_t n[3], beyond[3];
    double total = 1;
    for (int k = 0; k < 3; ++k) {
        const double cells = std::max(std::rint((box.high[k] - box.low[k]) / spacing - 1e-6), 1.0);
        total *= cells + 2;
        if (!(cells < 1e7) || !(total < 1e15))
            refuse("spacing", "a domain of fewer spacings", text(cells) + " along an axis");
        n[k] = std::int64_t(cells);
        beyond[k] = periodic[k] ? 0 : 1;
    }
    std::vector<float> out;
    const auto on_face = [&](int k, std::int64_t i) {
        return !periodic[k] && (i == 0 || i == n[k] + 2 * beyond[k] - 1);
    };
    const auto put = [&](std::int64_t x, std::int64_t y, std::int64_t z) {
        const std::int64_t i[3] = {x, y, z};
        for (int k = 0; k < 3; ++k)
            out.push_back(
                float(box.low[k] + (double(i[k] - beyond[k]) + 0.5) * ((box.high[k] - box.low[k]) / double(n[k]))));
    };
    const std::int64_t last = n[2] + 2 * beyond[2] - 1;
    for (std::int64_t x = 0; x < n[0] + 2 * beyond[0]; ++x)
        for (std::int64_t y = 0; y < n[1] + 2 * beyond[1]; ++y) {
            if (on_face(0, x) || on_face(1, y)) {
                for (std::int64_t z = 0; z <= last; ++z) put(x, y, z);
            } else if (!periodic[2]) {
                put(x, y, 0);
                if (last > 0) put(x, y, last);
            }
        }
    return out;
}

core::sim::Pose pose(const char* name, const Matrix4& m) {
    for (const double v : m) number(name, v);
    const auto column = [&](int k) { return single({m[k], m[4 + k], m[8 + k]}); };
    return {column(0), column(1), column(2), column(3)};
}

/// A scene, and beside tissue those of fluids and of other things.
std::array<core::Handle<core::Scene>, 3> with_beside(const core::Handle<core::Scene>& scene) {
    const auto beside = [&](int k) {
        return core::Handle<core::Scene>{
            scene.backend(), {scene.object(), scene.call<&core::Scene::beside>(k)}, scene.gate()};
    };
    return {scene, beside(0), beside(1)};
}

}  // namespace

struct Simulation::Impl {
    Chosen chosen;
    int threads = 0;
    Poll* poll = nullptr;
    std::array<core::Handle<core::Scene>, 3> scenes;  ///< as with_beside
    core::Handle<core::Simulation> core;

    std::atomic<bool> stop{false};

    // Behind the gate.
    SimulationSettings settings;
    std::vector<Phase> phases;
    std::size_t n = 0;
    std::uint32_t captured = 0, bodies = 0;  ///< bits of phases; of a checkpoint, which alone knows, all

    core::Gates gates() const { return core::Gates({core.gate().get()}); }
    template <auto Method, class... A> auto call(const core::Gates& inside, A&&... arguments) const {
        return core.call_inside<Method>(inside, std::forward<A>(arguments)...);
    }
    template <auto Method, class... A> auto ask(A&&... arguments) const {
        const core::Gates inside = gates();
        return call<Method>(inside, std::forward<A>(arguments)...);
    }

    int number_of(const WhichPhase& which) const {
        const int* number = std::get_if<int>(&which);
        if (number && *number >= 0 && *number < int(phases.size())) return *number;
        std::string all;
        for (std::size_t k = 0; k < phases.size(); ++k) {
            if (!number && phases[k].name == std::get<std::string>(which)) return int(k);
            all += (k ? ", " : "") + phases[k].name;
        }
        refuse("phase", "one of " + all, number ? std::to_string(*number) : "\"" + std::get<std::string>(which) + "\"");
    }
    /// A new name is another phase.
    void set_phase(const core::Gates& inside, const Phase& phase) {
        const core::sim::Phase sent = packed(phase, settings);
        const auto old = std::ranges::find(phases, phase.name, &Phase::name);
        if (old == phases.end() && phases.size() == core::sim::kMaxPhases)
            refuse("phases", "at most " + std::to_string(core::sim::kMaxPhases) + ", walls included", "another");
        if (old != phases.end() && phase.kind != old->kind)
            throw Error(
                ErrorCode::invalid, "phases[\"" + phase.name + "\"].kind: expected that of the start, got another");
        call<&core::Simulation::set_phase>(inside, int(old - phases.begin()), sent);
        if (old == phases.end()) phases.push_back(phase);
        else *old = phase;
    }
    bool shows(PhaseKind kind) const {
        return std::ranges::any_of(
            phases, [&](const Phase& p) { return p.kind == kind && p.shown.value_or(kind != PhaseKind::boundary); });
    }
    core::sim::Drawn drawn() const {
        return shows(PhaseKind::tissue)  ? core::sim::Drawn::tissue
               : shows(PhaseKind::fluid) ? core::sim::Drawn::smooth
                                         : core::sim::Drawn::balls;
    }
    /// Shows the particles as they are in another scene; how many there are.
    std::size_t take(const core::Handle<core::Scene>& to, std::optional<core::sim::Drawn> what = {}) const {
        const core::Gates inside({core.gate().get(), to.gate().get()});
        const auto [shown, exec] = call<&core::Simulation::look>(inside, what ? *what : drawn());
        to.call_inside<&core::Scene::take>(inside, shown, exec);
        return n;
    }
    /// Handles of what scenes show, as with_beside.
    std::vector<Layer> layers(const std::array<core::Handle<core::Scene>, 3>& scenes, const Chosen& on,
        const std::shared_ptr<const std::size_t>& n_of_owner) const;
    std::uint32_t add(const core::Gates& inside, const float* positions, std::size_t m, const float* velocities,
        core::float3 velocity, int phase) {
        const std::uint32_t first = call<&core::Simulation::add>(inside, m, positions, velocities, velocity, phase);
        n = call<&core::Simulation::size>(inside);
        return first;
    }
    double next_dt(const core::Gates& inside) const {
        const double dt = call<&core::Simulation::next_dt>(inside), time = call<&core::Simulation::time>(inside);
        if (!(time + dt > time))
            throw Error(ErrorCode::diverged, "the steps come to " + text(dt) + " s at " + text(time) +
                                                 " s: expected less gravity, lower speeds, or other materials");
        return dt;
    }
    StepReport step(const core::Gates& inside, double dt) {
        const core::StepReport r = call<&core::Simulation::step>(inside, dt);
        n = call<&core::Simulation::size>(inside);
        if (r.lost) {
            const core::float3 p = r.lost->position;
            throw Error(ErrorCode::diverged,
                "particle " + std::to_string(r.lost->id) + " (" + phases.at(std::size_t(r.lost->phase)).name + ") at " +
                    text(Vec3{p.x, p.y, p.z}) + " got a velocity that is not a number in step " +
                    std::to_string(r.step) + " at " + text(r.time) + " s");
        }
        return r;
    }

    template <class T> std::vector<T> read(const core::Gates& inside, const char* name, std::size_t columns) const {
        std::vector<T> out(n * columns);
        if (n) call<&core::Simulation::read>(inside, std::string(name), static_cast<void*>(out.data()));
        return out;
    }
    /// In id order, the first `wanted` of `columns` numbers.
    template <class T> std::vector<T> in_order(const char* name, std::size_t columns, std::size_t wanted) const {
        const core::Gates inside = gates();
        const std::vector<std::uint32_t> ids = read<std::uint32_t>(inside, "id", 1);
        const std::vector<T> all = read<T>(inside, name, columns);
        std::vector<std::uint32_t> order(n);
        std::iota(order.begin(), order.end(), 0u);
        std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return ids[a] < ids[b]; });
        std::vector<T> out(n * wanted);
        for (std::size_t i = 0; i < n; ++i)
            for (std::size_t k = 0; k < wanted; ++k) out[wanted * i + k] = all[columns * order[i] + k];
        return out;
    }
};

Simulation::Simulation(const SimulationSettings& settings, const SimulationOptions& o)
    : impl_(std::make_shared<Impl>()) {
    Impl& s = *impl_;
    s.settings = settings;
    std::vector<Phase> phases = o.phases;
    if (o.walls && std::ranges::find(phases, "walls", &Phase::name) == phases.end())
        phases.push_back({.name = "walls", .kind = PhaseKind::boundary});
    if (phases.size() > core::sim::kMaxPhases)
        refuse("phases", "at most " + std::to_string(core::sim::kMaxPhases) + ", walls included",
            std::to_string(phases.size()));
    for (auto p = phases.begin(); p != phases.end(); ++p)
        if (std::ranges::find(p + 1, phases.end(), p->name, &Phase::name) != phases.end())
            refuse("phases", "different names", "\"" + p->name + "\" twice");
    const core::SimulationSettings sent = packed(settings);
    for (const Phase& p : phases) packed(p, settings);
    const int threads = whole("threads", o.threads, 0, 4096);
    const std::vector<float> walls =
        o.walls ? box_walls(settings.domain, settings.spacing, settings.periodic) : std::vector<float>();
    s.chosen = choose(o.device);
    s.threads = threads;
    s.poll = o.poll;
    // Scenes beside are there before the simulation looks whom it has to show.
    s.scenes = with_beside(core::make_scene(*s.chosen.backend, s.chosen.index, threads, o.poll));
    s.core = core::make_simulation(s.scenes[0]);
    const core::Gates inside = s.gates();
    s.call<&core::Simulation::configure>(inside, sent);
    for (const Phase& p : phases) s.set_phase(inside, p);
    if (!walls.empty()) s.add(inside, walls.data(), walls.size() / 3, nullptr, {0, 0, 0}, s.number_of("walls"));
}

namespace {

/// Particles that come.
struct Coming {
    Inputs in{core::kHost};
    std::size_t m = 0;
    core::FloatArray positions, velocities;
    core::float3 one{0, 0, 0};

    Coming(const ArrayView& p, const Property<Vec3>& v) {
        positions = in.rows("positions", p, 3, m);
        if (v.each().given()) velocities = in.floats("velocities", v.each(), 3, m);
        check_range("positions", positions, m, 3, -kInfinity, kInfinity);
        check_range("velocities", velocities, m, 3, -kInfinity, kInfinity);
        if (v.one()) one = three("velocities", *v.one());
    }
};

}  // namespace

std::uint32_t Simulation::add(const ArrayView& positions, const WhichPhase& phase, const Property<Vec3>& velocities) {
    Inside::of(*this, "simulation");
    const Coming c(positions, velocities);
    const core::Gates inside = impl_->gates();
    const int which = impl_->number_of(phase);
    if (c.m == 0) return impl_->call<&core::Simulation::next_id>(inside);
    return impl_->add(inside, c.positions.data, c.m, c.velocities.data, c.one, which);
}

std::uint32_t Simulation::emit(const ArrayView& positions, const WhichPhase& phase, const Property<Vec3>& velocities) {
    Inside::of(*this, "simulation");
    Coming c(positions, velocities);
    if (!c.velocities.data) {
        std::vector<float> each;
        for (std::size_t i = 0; i < c.m; ++i) each.insert(each.end(), {c.one.x, c.one.y, c.one.z});
        c.velocities = c.in.keep(std::move(each));
    }
    const core::Gates inside = impl_->gates();
    return impl_->call<&core::Simulation::emit>(
        inside, c.m, c.positions.data, c.velocities.data, impl_->number_of(phase));
}

void Simulation::remove(const std::vector<std::uint32_t>& ids) {
    Inside::of(*this, "simulation");
    const core::Gates inside = impl_->gates();
    const std::uint32_t end = impl_->call<&core::Simulation::next_id>(inside);
    for (const std::uint32_t id : ids)
        if (id >= end) refuse("ids", "numbers that add() gave", std::to_string(id));
    if (ids.empty()) return;
    impl_->call<&core::Simulation::remove>(inside, ids.size(), ids.data());
    impl_->n = impl_->call<&core::Simulation::size>(inside);
}

StepReport Simulation::step(std::optional<double> dt) {
    Inside::of(*this, "simulation");
    if (dt) positive("dt", *dt);
    const core::Gates inside = impl_->gates();
    return impl_->step(inside, dt ? *dt : impl_->next_dt(inside));
}

std::optional<StepReport> Simulation::run(double seconds, const std::function<bool(const StepReport&)>& each) {
    Inside::of(*this, "simulation");
    number("seconds", seconds, 0);
    impl_->stop = false;
    const double end = time() + seconds;
    std::optional<StepReport> report;
    while (!report || !each || each(*report)) {
        const core::Gates inside = impl_->gates();  // for each step: others may look between two
        if (impl_->stop)
            throw Error(
                ErrorCode::cancelled, "run: cancelled at " + text(impl_->call<&core::Simulation::time>(inside)) + " s");
        const double rest = end - impl_->call<&core::Simulation::time>(inside);
        if (!(rest > 1e-9 * std::max(end, 1e-3))) break;
        const double dt = impl_->next_dt(inside);
        report = impl_->step(inside, rest <= dt ? rest : rest < 2 * dt ? rest / 2 : dt);
    }
    return report;
}

void Simulation::cancel() const noexcept {
    if (impl_) impl_->stop = true;
}

void Simulation::configure(const SimulationSettings& settings) {
    Inside::of(*this, "simulation");
    const core::SimulationSettings sent = packed(settings);
    const core::Gates inside = impl_->gates();
    const SimulationSettings& old = impl_->settings;
    if (settings.spacing != old.spacing)
        refuse("spacing", text(old.spacing) + " as at the start", text(settings.spacing));
    if (settings.fine_fluids != old.fine_fluids)
        throw Error(ErrorCode::invalid, "fine_fluids: expected that of the start, got another");
    if (settings.domain.low != old.domain.low || settings.domain.high != old.domain.high)
        throw Error(ErrorCode::invalid, "domain: expected that of the start, got another");
    impl_->call<&core::Simulation::configure>(inside, sent);
    impl_->settings = settings;
}
void Simulation::set_phase(const Phase& phase) {
    Inside::of(*this, "simulation");
    const core::Gates inside = impl_->gates();
    impl_->set_phase(inside, phase);
}

void Simulation::set_inlets(const std::vector<Inlet>& inlets) {
    std::vector<core::sim::Inlet> all;
    for (const Inlet& i : inlets)
        all.push_back({three("center", i.center), three("direction", i.direction), number("radius", i.radius, 0),
            number("length", i.length, 0)});
    Inside::of(*this, "simulation").ask<&core::Simulation::set_inlets>(all);
}
void Simulation::set_sinks(const std::vector<Sink>& sinks) {
    std::vector<core::sim::Sink> all;
    for (const Sink& s : sinks)
        all.push_back({three("low", s.box.low), three("high", s.box.high), three("center", s.center),
            number("radius", s.radius, 0)});
    Inside::of(*this, "simulation").ask<&core::Simulation::set_sinks>(all);
}

void Simulation::capture(const WhichPhase& phase, const Matrix4& now) {
    Inside::of(*this, "simulation");
    const core::Gates inside = impl_->gates();
    const int which = impl_->number_of(phase);
    impl_->call<&core::Simulation::capture>(inside, which, pose("now", now));
    impl_->captured |= 1u << which;
}
void Simulation::move_to(const WhichPhase& phase, const Matrix4& next) {
    const Impl& s = Inside::of(*this, "simulation");
    const core::Gates inside = s.gates();
    const int which = s.number_of(phase);
    if (!(s.captured >> which & 1))
        refuse("phase", "one that capture() knows", "\"" + s.phases[std::size_t(which)].name + "\"");
    s.call<&core::Simulation::move_to>(inside, which, pose("next", next));
}
void Simulation::make_body(
    const WhichPhase& phase, double mass, const std::array<double, 9>& inertia, const BodyMotion& start) {
    Inside::of(*this, "simulation");
    positive("mass", mass);
    const Vec3 x{inertia[0], inertia[1], inertia[2]}, y{inertia[3], inertia[4], inertia[5]};
    if (!(dot(cross(x, y), {inertia[6], inertia[7], inertia[8]}) > 0))
        throw Error(ErrorCode::invalid, "inertia: expected a positive determinant, got another");
    for (const Vec3* v : {&start.center, &start.velocity, &start.spin}) three("start", *v);
    const core::Gates inside = impl_->gates();
    const int which = impl_->number_of(phase);
    if (impl_->phases[std::size_t(which)].kind != PhaseKind::rigid)
        refuse("phase", "one of kind rigid", "\"" + impl_->phases[std::size_t(which)].name + "\"");
    impl_->call<&core::Simulation::make_body>(
        inside, which, mass, start.center.data(), inertia.data(), start.velocity.data(), start.spin.data());
    impl_->bodies |= 1u << which;
}
BodyMotion Simulation::body(const WhichPhase& phase) const {
    const Impl& s = Inside::of(*this, "simulation");
    const core::Gates inside = s.gates();
    const int which = s.number_of(phase);
    if (!(s.bodies >> which & 1)) refuse("phase", "a body", "\"" + s.phases[std::size_t(which)].name + "\"");
    const std::vector<double> v = s.call<&core::Simulation::body>(inside, which);
    BodyMotion m{{v[0], v[1], v[2]}, {v[3], v[4], v[5]}, {v[6], v[7], v[8]}};
    std::copy_n(v.begin() + 9, 9, m.rotation.begin());
    return m;
}

Tissue Simulation::tissue() const {
    const Impl& s = Inside::of(*this, "simulation");
    core::Tissue* tissue = s.ask<&core::Simulation::tissue>();
    return Inside::tissue({s.core.backend(), std::shared_ptr<core::Tissue>(s.core.object(), tissue), s.core.gate()});
}

std::size_t Simulation::size() const { return Inside::of(*this, "simulation").ask<&core::Simulation::size>(); }
double Simulation::time() const { return Inside::of(*this, "simulation").ask<&core::Simulation::time>(); }
std::uint64_t Simulation::n_steps() const { return Inside::of(*this, "simulation").ask<&core::Simulation::n_steps>(); }
double Simulation::next_dt() const { return Inside::of(*this, "simulation").ask<&core::Simulation::next_dt>(); }
const std::string& Simulation::device() const { return Inside::of(*this, "simulation").chosen.device.name; }

std::vector<std::uint32_t> Simulation::ids() const {
    return Inside::of(*this, "simulation").in_order<std::uint32_t>("id", 1, 1);
}
std::vector<float> Simulation::positions() const {
    return Inside::of(*this, "simulation").in_order<float>("place", 4, 3);
}
std::vector<float> Simulation::velocities() const {
    return Inside::of(*this, "simulation").in_order<float>("velocity", 4, 3);
}
std::vector<float> Simulation::pressure() const {
    return Inside::of(*this, "simulation").in_order<float>("pressure", 1, 1);
}
std::vector<std::uint8_t> Simulation::phase() const {
    return Inside::of(*this, "simulation").in_order<std::uint8_t>("phase", 1, 1);
}

Totals Simulation::totals() const {
    const core::sim::Totals t = Inside::of(*this, "simulation").ask<&core::Simulation::totals>();
    const double mass = t.mass != 0 ? t.mass : 1;
    return {t.mass, t.kinetic, t.potential, {t.momentum[0], t.momentum[1], t.momentum[2]},
        {t.angular[0], t.angular[1], t.angular[2]}, {t.center[0] / mass, t.center[1] / mass, t.center[2] / mass}};
}

void Simulation::draw(Drawn what) {
    Inside::of(*this, "simulation").ask<&core::Simulation::draw>(core::sim::Drawn(what));
}
Scene Simulation::scene() const { return layers()[0].scene; }
std::vector<Layer> Simulation::layers() const {
    const Impl& s = Inside::of(*this, "simulation");
    const core::Gates inside = s.gates();
    s.call<&core::Simulation::draw>(inside, s.drawn());
    return s.layers(s.scenes, s.chosen, {impl_, &s.n});
}

std::vector<Layer> Simulation::snapshot(const std::string& device, const std::vector<Layer>& into) const {
    const Impl& s = Inside::of(*this, "simulation");
    Chosen chosen = s.chosen;
    core::Handle<core::Scene> scene;
    if (into.empty()) {
        scene = Inside::snapshot(*this, device, &chosen);
    } else {
        const Inside::SceneImpl& first = *Inside::shared(into[0].scene);
        if (!first.of_snapshot) refuse("into", "what snapshot() returned", "another scene");
        if (first.chosen.backend != s.chosen.backend)
            refuse("into", "a snapshot on a device of the kind of " + s.chosen.device.name, first.chosen.device.name);
        scene = first.core;
        chosen = first.chosen;
    }
    const auto scenes = with_beside(scene);
    const auto n = std::make_shared<const std::size_t>(s.take(scene));
    const core::Gates inside = s.gates();
    std::vector<Layer> all = s.layers(scenes, chosen, n);
    for (const Layer& layer : all) Inside::shared(layer.scene)->of_snapshot = true;
    return all;
}
core::Handle<core::Scene> Inside::snapshot(const Simulation& simulation, const std::string& device, Chosen* chosen) {
    const Simulation::Impl& s = of(simulation, "simulation");
    Chosen c = device.empty() ? s.chosen : choose(device);
    if (c.backend != s.chosen.backend) refuse("device", "one of the kind of " + s.chosen.device.name, c.device.name);
    if (chosen) *chosen = c;
    return core::make_scene(*c.backend, c.index, s.threads, s.poll);
}
void Inside::take(const Simulation& simulation, const core::Handle<core::Scene>& to, core::sim::Drawn what) {
    of(simulation, "simulation").take(to, what);
}

std::vector<Layer> Simulation::Impl::layers(const std::array<core::Handle<core::Scene>, 3>& scenes, const Chosen& on,
    const std::shared_ptr<const std::size_t>& n_of_owner) const {
    const bool tissue = shows(PhaseKind::tissue), fluid = shows(PhaseKind::fluid);
    const auto layer = [&](const core::Handle<core::Scene>& core, bool smooth, double spacing) {
        auto scene = std::make_shared<Inside::SceneImpl>();
        scene->core = core;
        scene->chosen = on;
        scene->kernel = core::KernelName::murakami;
        scene->smooth = smooth;
        scene->threshold = smooth ? double(core::surface::kThreshold) : defaults_of(scene->kernel).threshold;
        scene->support = scene->largest_support = (smooth ? double(core::surface::kAxis) : 2.0) * spacing;
        scene->n_of_owner = n_of_owner;
        return Layer{Inside::scene(std::move(scene))};
    };
    const double of_fluids = spacing_of(settings, PhaseKind::fluid);
    std::vector<Layer> all{layer(scenes[0], tissue || fluid, fluid && !tissue ? of_fluids : settings.spacing)};
    if (tissue && fluid) all.push_back(layer(scenes[1], true, of_fluids));
    if (tissue && (shows(PhaseKind::boundary) || shows(PhaseKind::rigid)))
        all.push_back(layer(scenes[2], false, settings.spacing));
    return all;
}

namespace {

struct StateArray {
    const char* name;
    DType type;
    std::size_t columns;
};
const StateArray& state_array(const std::string& name) {
    using enum DType;
    static constexpr StateArray arrays[] = {{"place", float32, 4}, {"velocity", float32, 4}, {"id", uint32, 1},
        {"phase", uint8, 1}, {"pressure", float32, 1}, {"growth", float32, 1}, {"divergence_impulse", float32, 1}};
    for (const StateArray& a : arrays)
        if (name == a.name) return a;
    refuse("name", "that of an array of the state", "\"" + name + "\"");
}

}  // namespace

void Simulation::read(const std::string& name, const MutableArrayView& out) const {
    const Impl& s = Inside::of(*this, "simulation");
    const StateArray& a = state_array(name);
    const core::Gates inside = s.gates();
    const void* to = on_host(name, out, a.type, a.columns * s.n);
    if (to && s.n) s.call<&core::Simulation::read>(inside, name, const_cast<void*>(to));
}
void Simulation::write(const std::string& name, const ArrayView& values) {
    const Impl& s = Inside::of(*this, "simulation");
    const StateArray& a = state_array(name);
    const core::Gates inside = s.gates();
    const void* from = on_host(name, values, a.type, a.columns * s.n);
    const auto below = [&](const auto* values, std::size_t end) {
        for (std::size_t i = 0; i < s.n; ++i)
            if (values[i] >= end) refuse(name, "numbers below " + std::to_string(end), std::to_string(values[i]));
    };
    if (!from || !s.n) return;
    if (name == "phase") below(static_cast<const std::uint8_t*>(from), s.phases.size());
    if (name == "id") below(static_cast<const std::uint32_t*>(from), s.call<&core::Simulation::next_id>(inside));
    s.call<&core::Simulation::write>(inside, name, from);
}
void Simulation::set_forces(const ArrayView& forces) {
    const Impl& s = Inside::of(*this, "simulation");
    const core::Gates inside = s.gates();
    s.call<&core::Simulation::set_forces>(inside, on_host<float>("forces", forces, 3 * s.n));
}
void Simulation::neighbors(std::vector<std::uint32_t>& rows, Neighbors& lists) const {
    Inside::of(*this, "simulation").ask<&core::Simulation::neighbors>(rows, lists);
}
void Simulation::flow(const MutableArrayView& density, const MutableArrayView& vorticity) const {
    const Impl& s = Inside::of(*this, "simulation");
    const core::Gates inside = s.gates();
    float *d = out_on_host<float>("density", density, s.n), *v = out_on_host<float>("vorticity", vorticity, 3 * s.n);
    if (!d || !v) refuse("flow", "two arrays", "one");
    s.call<&core::Simulation::flow>(inside, d, v);
}

std::array<double, 6> Simulation::force_on(int phase, const std::array<double, 3>& about) const {
    return Inside::of(*this, "simulation")
        .ask<&core::Simulation::force_on>(phase, core::float3{float(about[0]), float(about[1]), float(about[2])});
}

std::uint32_t Simulation::next_id() const { return Inside::of(*this, "simulation").ask<&core::Simulation::next_id>(); }
void Simulation::resize(std::size_t n, std::uint32_t next_id, double time, std::uint64_t n_steps) {
    Inside::of(*this, "simulation");
    const core::Gates inside = impl_->gates();
    impl_->call<&core::Simulation::resize>(inside, n, next_id, time, n_steps);
    impl_->n = n;
}
void Simulation::settle() { Inside::of(*this, "simulation").ask<&core::Simulation::settle>(); }
std::vector<char> Simulation::motion() const {
    return Inside::of(*this, "simulation").ask<&core::Simulation::motion>();
}
void Simulation::set_motion(const std::vector<char>& bytes) {
    Inside::of(*this, "simulation").ask<&core::Simulation::set_motion>(bytes);
    const core::Gates inside = impl_->gates();
    impl_->captured = impl_->bodies = ~0u;
}

}  // namespace globule
