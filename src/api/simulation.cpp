#include "globule/simulation.hpp"

#include <atomic>
#include <algorithm>
#include <numbers>
#include <numeric>

#include "api/impl.hpp"
#include "field/surface_kernels.hpp"

namespace globule {
namespace {

constexpr double kLeastStep = 1.0 / 30 / 1e6;  ///< s: materials that allow only shorter steps are refused

core::SimulationSettings packed(const SimulationSettings& s) {
    core::SimulationSettings p;
    p.spacing = float(positive("spacing", s.spacing));
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

core::sim::Phase packed(const Phase& f, double spacing) {
    const std::string of = "phases[\"" + f.name + "\"].";
    if (f.kind != PhaseKind::fluid && f.kind != PhaseKind::boundary)
        refuse(of + "kind", "fluid or boundary", std::to_string(int(f.kind)));
    core::sim::Phase p;
    p.kind = core::sim::Kind(f.kind);
    p.density = number((of + "density").c_str(), f.density, 1e-3, 1e6);
    p.viscosity = number((of + "viscosity").c_str(), f.viscosity, 0, 1e9);
    p.tension = number((of + "surface_tension").c_str(), f.surface_tension, 0, 1e3);
    p.adhesion = number((of + "adhesion").c_str(), f.adhesion, 0, 1e3);
    const core::float3 color = three((of + "color").c_str(), f.color, 0, 1);
    p.color[0] = color.x, p.color[1] = color.y, p.color[2] = color.z;
    p.reflection = number((of + "reflection").c_str(), f.reflection, 0, 1);
    p.refraction = number((of + "refraction").c_str(), f.refraction, 0, 1);
    p.implicit_viscosity = f.implicit;
    p.shown = f.shown.value_or(f.kind == PhaseKind::fluid);
    if (f.kind == PhaseKind::fluid) {
        const auto check = [&](const char* name, double step) {
            if (step < kLeastStep)
                refuse(of + name, "a value that allows steps of at least " + text(kLeastStep) + " s",
                    "one that allows " + text(step) + " s");
        };
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

StepReport told(const core::StepReport& r) {
    StepReport out;
    out.time = r.time, out.dt = r.dt, out.step = r.step;
    out.iterations = r.iterations, out.divergence_iterations = r.divergence_iterations,
    out.viscosity_iterations = r.viscosity_iterations;
    out.error = r.error, out.divergence_error = r.divergence_error;
    out.most_error = r.most_error, out.most_divergence_error = r.most_divergence_error;
    out.compression = r.compression, out.high_compression = r.high_compression,
    out.most_compression = r.most_compression;
    out.n_halved = r.n_halved;
    out.n = r.n, out.n_solved = r.n_solved, out.n_escaped = r.n_escaped;
    out.most_speed = r.most_speed;
    out.seconds = r.seconds;
    return out;
}

}  // namespace

struct Simulation::Impl {
    Chosen chosen;
    core::Handle<core::Scene> scene;
    core::Handle<core::Simulation> core;

    std::atomic<bool> stop{false};

    // Behind the gate.
    SimulationSettings settings;
    std::vector<Phase> phases;
    std::size_t n = 0;

    core::Gates gates() const { return core::Gates({core.gate().get()}); }
    template <auto Method, class... A> auto call(const core::Gates& inside, A&&... arguments) const {
        return core.call_inside<Method>(inside, std::forward<A>(arguments)...);
    }
    template <auto Method> auto ask() const {
        const core::Gates inside = gates();
        return call<Method>(inside);
    }

    int number_of(const std::string& phase) const {
        if (phase.empty()) return 0;
        std::string all;
        for (std::size_t k = 0; k < phases.size(); ++k) {
            if (phases[k].name == phase) return int(k);
            all += (k ? ", " : "") + phases[k].name;
        }
        refuse("phase", "one of " + all, "\"" + phase + "\"");
    }
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
        return told(r);
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
    s.phases = o.phases;
    if (o.phases.empty()) refuse("phases", "at least one", "none");
    if (o.walls && std::none_of(o.phases.begin(), o.phases.end(), [](const Phase& p) { return p.name == "walls"; })) {
        Phase walls;
        walls.name = "walls";
        walls.kind = PhaseKind::boundary;
        s.phases.push_back(walls);
    }
    if (s.phases.size() > core::sim::kMaxPhases)
        refuse("phases", "at most " + std::to_string(core::sim::kMaxPhases) + ", walls included",
            std::to_string(s.phases.size()));
    for (std::size_t k = 0; k < s.phases.size(); ++k) {
        if (s.phases[k].name.empty()) refuse("phases", "names", "an empty one");
        for (std::size_t j = 0; j < k; ++j)
            if (s.phases[j].name == s.phases[k].name)
                refuse("phases", "different names", "\"" + s.phases[k].name + "\" twice");
    }
    const core::SimulationSettings sent = packed(settings);
    std::vector<core::sim::Phase> materials;
    for (const Phase& p : s.phases) materials.push_back(packed(p, settings.spacing));
    const int threads = whole("threads", o.threads, 0, 4096);
    const std::vector<float> walls =
        o.walls ? box_walls(settings.domain, settings.spacing, settings.periodic) : std::vector<float>();
    s.chosen = choose(o.device);
    s.scene = core::make_scene(*s.chosen.backend, s.chosen.index, threads, nullptr);
    s.core = core::make_simulation(s.scene);
    const core::Gates inside = s.gates();
    s.call<&core::Simulation::configure>(inside, sent);
    for (std::size_t k = 0; k < materials.size(); ++k)
        s.call<&core::Simulation::set_phase>(inside, int(k), materials[k]);
    if (!walls.empty()) s.add(inside, walls.data(), walls.size() / 3, nullptr, {0, 0, 0}, s.number_of("walls"));
}

std::uint32_t Simulation::add(const ArrayView& positions, const std::string& phase, const Property<Vec3>& velocities) {
    Inside::of(*this, "simulation");
    Inputs in(core::kHost);
    std::size_t m;
    const core::FloatArray p = in.rows("positions", positions, 3, m);
    const core::FloatArray v =
        velocities.each().given() ? in.floats("velocities", velocities.each(), 3, m) : core::FloatArray{};
    check_range("positions", p, m, 3, -kInfinity, kInfinity);
    check_range("velocities", v, m, 3, -kInfinity, kInfinity);
    const core::float3 one = velocities.one() ? three("velocities", *velocities.one()) : core::float3{0, 0, 0};
    const core::Gates inside = impl_->gates();
    const int which = impl_->number_of(phase);
    if (m == 0) return impl_->call<&core::Simulation::next_id>(inside);
    return impl_->add(inside, p.data, m, v.data, one, which);
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

std::optional<StepReport> Simulation::run(double seconds) {
    Inside::of(*this, "simulation");
    number("seconds", seconds, 0);
    impl_->stop = false;
    const double end = time() + seconds;
    std::optional<StepReport> report;
    for (;;) {
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
    if (settings.domain.low != old.domain.low || settings.domain.high != old.domain.high)
        throw Error(ErrorCode::invalid, "domain: expected that of the start, got another");
    impl_->call<&core::Simulation::configure>(inside, sent);
    impl_->settings = settings;
}
void Simulation::set_phase(const Phase& phase) {
    Inside::of(*this, "simulation");
    const core::Gates inside = impl_->gates();
    const int which = impl_->number_of(phase.name);
    Phase& old = impl_->phases[std::size_t(which)];
    if (phase.kind != old.kind)
        throw Error(ErrorCode::invalid, "phases[\"" + phase.name + "\"].kind: expected that of the start, got another");
    impl_->call<&core::Simulation::set_phase>(inside, which, packed(phase, impl_->settings.spacing));
    old = phase;
}

std::size_t Simulation::size() const { return Inside::of(*this, "simulation").ask<&core::Simulation::size>(); }
double Simulation::time() const { return Inside::of(*this, "simulation").ask<&core::Simulation::time>(); }
std::uint64_t Simulation::n_steps() const { return Inside::of(*this, "simulation").ask<&core::Simulation::n_steps>(); }
double Simulation::next_dt() const {
    const Impl& s = Inside::of(*this, "simulation");
    const core::Gates inside = s.gates();
    return s.next_dt(inside);
}
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

Scene Simulation::scene() const {
    const Impl& s = Inside::of(*this, "simulation");
    auto scene = std::make_shared<Inside::SceneImpl>();
    scene->core = s.scene;
    scene->chosen = s.chosen;
    scene->kernel = core::KernelName::murakami;
    // What is shown of a fluid has a smooth surface; here is no tissue.
    scene->smooth = std::ranges::any_of(
        s.phases, [](const Phase& p) { return p.kind == PhaseKind::fluid && p.shown.value_or(true); });
    const core::Gates inside = s.gates();
    s.call<&core::Simulation::draw>(inside, scene->smooth ? core::sim::Drawn::smooth : core::sim::Drawn::balls);
    scene->threshold = scene->smooth ? double(core::surface::kThreshold) : defaults_of(scene->kernel).threshold;
    scene->support = scene->largest_support = (scene->smooth ? double(core::surface::kAxis) : 2.0) * s.settings.spacing;
    scene->n_of_owner = {impl_, &s.n};
    return Inside::scene(std::move(scene));
}

}  // namespace globule
