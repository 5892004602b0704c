// Particle simulations.
#include "arguments.hpp"
#include "globule/simulation.hpp"
#include "handles.hpp"

using namespace globule;
namespace nb = nanobind;
using core::item, core::owned, core::plain, core::work;

namespace {

Vec3 three(const nb::dict& d, const char* name) { return item<Vec3>(d, name); }
SimulationSettings settings(const nb::dict& d) {
    SimulationSettings s;
    s.spacing = item<double>(d, "spacing");
    s.fine_fluids = item<bool>(d, "fine_fluids");
    s.domain = {three(d, "lo"), three(d, "hi")};
    s.gravity = three(d, "gravity");
    s.periodic = item<std::array<bool, 3>>(d, "periodic");
    s.cfl = item<double>(d, "cfl");
    s.max_dt = item<double>(d, "longest_step");
    s.max_error = item<double>(d, "density_error");
    s.divergence_error = item<double>(d, "divergence_error");
    s.min_iterations = item<int>(d, "least_iterations");
    if (const int most = item<int>(d, "most_iterations")) s.max_iterations = most;
    s.viscosity_error = item<double>(d, "viscosity_error");
    s.weakly_compressible = item<bool>(d, "weakly_compressible");
    if (const double speed = item<double>(d, "sound_speed"); speed > 0) s.sound_speed = speed;
    s.extra_viscosity = item<double>(d, "extra_viscosity");
    s.least_dt = 0;  // Python has checked materials
    return s;
}

Phase phase(const nb::dict& d) {
    return {item<std::string>(d, "name"), PhaseKind(item<int>(d, "kind")), item<double>(d, "density"),
        item<double>(d, "viscosity"), item<bool>(d, "implicit"), item<double>(d, "surface_tension"),
        item<double>(d, "adhesion"), item<double>(d, "friction"), three(d, "color"), item<double>(d, "reflection"),
        item<double>(d, "refraction"), item<bool>(d, "shown")};
}

nb::dict report(const StepReport& r) {
    nb::dict d, seconds;
    for (const auto& [stage, s] : r.seconds) seconds[stage.c_str()] = s;
    d["time"] = r.time;
    d["step"] = r.step;
    d["dt"] = r.dt;
    d["iterations"] = r.iterations;
    d["divergence_iterations"] = r.divergence_iterations;
    d["viscosity_iterations"] = r.viscosity_iterations;
    d["n_removed"] = r.n_removed;
    d["error"] = r.error;
    d["divergence_error"] = r.divergence_error;
    d["compression"] = r.compression;
    d["most_compression"] = r.most_compression;
    d["high_compression"] = r.high_compression;
    d["most_error"] = r.most_error;
    d["most_divergence_error"] = r.most_divergence_error;
    d["n_halved"] = r.n_halved;
    d["n"] = r.n;
    d["n_solved"] = r.n_solved;
    d["n_escaped"] = r.n_escaped;
    d["most_speed"] = r.most_speed;
    d["seconds"] = seconds;
    return d;
}

}  // namespace

void bind_simulation(nb::module_& m) {
    nb::class_<Simulation>(m, "Simulation")
        .def("__init__",
            [](Simulation* self, const std::string& device, int threads, const nb::dict& d) {
                const SimulationSettings s = settings(d);
                new (self) Simulation(work([&] {
                    return Simulation(
                        s, {.phases = {}, .device = device, .threads = threads, .poll = &core::poll_signals});
                }));
            })
        .def(
            "scene", [](Simulation& s) { return core::PyScene{work([&] { return Inside::shared(s.scene())->core; })}; })
        .def("snapshot",
            [](Simulation& s, const std::string& device) {
                return core::PyScene{work([&] { return Inside::snapshot(s, device); }), {}};
            })
        .def("take", [](Simulation& s, const core::PyScene& to,
                         int drawn) { work([&] { Inside::take(s, to.core, core::sim::Drawn(drawn)); }); })
        .def("configure", [](Simulation& s, const nb::dict& d) { work([&, o = settings(d)] { s.configure(o); }); })
        .def("set_phase", [](Simulation& s, const nb::dict& d) { work([&, p = phase(d)] { s.set_phase(p); }); })
        .def(
            "add",
            [](Simulation& s, const ArrayView& positions, int phase, const ArrayView& each, const Vec3& one) {
                const Property<Vec3> velocities = each.given() ? Property<Vec3>(each) : Property<Vec3>(one);
                return work([&] { return s.add(positions, phase, velocities); });
            },
            nb::arg("positions"), nb::arg("phase"), nb::arg("velocities").none(), nb::arg("velocity"))
        .def("remove",
            [](Simulation& s, const ArrayView& ids) {
                const auto* first = static_cast<const std::uint32_t*>(ids.data());
                work([&] { s.remove({first, first + ids.shape().size()}); });
            })
        .def("emit",
            [](Simulation& s, const ArrayView& positions, int phase, const ArrayView& velocities) {
                return work([&] { return s.emit(positions, phase, velocities); });
            })
        .def("set_inlets",
            [](Simulation& s, const std::vector<std::array<double, 8>>& inlets) {
                std::vector<Inlet> all;  // center, direction, radius, length
                for (const auto& v : inlets) all.push_back({{v[0], v[1], v[2]}, {v[3], v[4], v[5]}, v[6], v[7]});
                work([&] { s.set_inlets(all); });
            })
        .def("set_sinks",
            [](Simulation& s, const std::vector<std::array<double, 10>>& sinks) {
                std::vector<Sink> all;  // lo, hi, center, radius
                for (const auto& v : sinks)
                    all.push_back({{{v[0], v[1], v[2]}, {v[3], v[4], v[5]}}, {v[6], v[7], v[8]}, v[9]});
                work([&] { s.set_sinks(all); });
            })
        .def("capture", [](Simulation& s, int phase, const Matrix4& m) { work([&] { s.capture(phase, m); }); })
        .def("move_to", [](Simulation& s, int phase, const Matrix4& m) { work([&] { s.move_to(phase, m); }); })
        .def("make_body",
            [](Simulation& s, int phase, double mass, const std::array<double, 9>& inertia, const Vec3& center,
                const Vec3& velocity,
                const Vec3& spin) { work([&] { s.make_body(phase, mass, inertia, {center, velocity, spin}); }); })
        .def("body",
            [](Simulation& s, int phase) {
                const BodyMotion b = work([&] { return s.body(phase); });
                return nb::make_tuple(b.center, b.velocity, b.spin, b.rotation);
            })
        .def("motion",
            [](Simulation& s) {
                const std::vector<char> bytes = work([&] { return s.motion(); });
                return nb::bytes(bytes.data(), bytes.size());
            })
        .def("set_motion",
            [](Simulation& s, nb::bytes b) {
                const std::vector<char> bytes(b.c_str(), b.c_str() + b.size());
                work([&] { s.set_motion(bytes); });
            })
        .def("totals",
            [](Simulation& s) {
                const Totals t = work([&] { return s.totals(); });
                nb::dict d;
                d["mass"] = t.mass;
                d["kinetic"] = t.kinetic;
                d["potential"] = t.potential;
                d["momentum"] = nb::tuple(nb::cast(t.momentum));
                d["angular_momentum"] = nb::tuple(nb::cast(t.angular_momentum));
                d["center"] = nb::tuple(nb::cast(t.center));
                return d;
            })
        .def("step", [](Simulation& s, double dt) { return report(work([&] { return s.step(dt); })); })
        .def("next_dt", plain<&Simulation::next_dt>)
        .def("draw", [](Simulation& s, int what) { work([&] { s.draw(Drawn(what)); }); })
        .def("size", plain<&Simulation::size>)
        .def("time", plain<&Simulation::time>)
        .def("n_steps", plain<&Simulation::n_steps>)
        .def("next_id", plain<&Simulation::next_id>)
        .def("read", plain<&Simulation::read>)
        .def("write", plain<&Simulation::write>)
        .def("resize", plain<&Simulation::resize>)
        .def("settle", plain<&Simulation::settle>)
        .def("set_forces", plain<&Simulation::set_forces>)
        .def("neighbors",
            [](Simulation& s) {
                std::vector<std::uint32_t> rows;
                Neighbors found;
                work([&] { s.neighbors(rows, found); });
                return nb::make_tuple(
                    owned(std::move(rows)), owned(std::move(found.offsets)), owned(std::move(found.indices)));
            })
        .def("flow", plain<&Simulation::flow>)
        .def("force_on",
            [](Simulation& s, int phase, const std::array<double, 3>& about) {
                return nb::tuple(nb::cast(work([&] { return s.force_on(phase, about); })));
            })
        .def("tissue", plain<&Simulation::tissue>);
}
