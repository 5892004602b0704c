// Particle simulations: addresses in, addresses out, as in arguments.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "arguments.hpp"
#include "picture.hpp"
#include "handles.hpp"
#include "tissue.hpp"

using namespace globule::core;

namespace {

struct PySimulation { Handle<Simulation> core; };

SimulationSettings settings(const nb::dict& d) {
    SimulationSettings s;
    s.spacing = item<float>(d, "spacing");
    s.fine_fluids = item<bool>(d, "fine_fluids");
    s.lo = vec(item<std::vector<float>>(d, "lo"));
    s.hi = vec(item<std::vector<float>>(d, "hi"));
    s.gravity = vec(item<std::vector<float>>(d, "gravity"));
    const auto periodic = item<std::vector<bool>>(d, "periodic");
    for (int k = 0; k < 3; ++k) s.periodic[k] = periodic.at(k);
    s.cfl = item<float>(d, "cfl");
    s.longest_step = item<float>(d, "longest_step");
    s.density_error = item<float>(d, "density_error");
    s.divergence_error = item<float>(d, "divergence_error");
    s.least_iterations = item<int>(d, "least_iterations");
    s.most_iterations = item<int>(d, "most_iterations");
    s.viscosity_error = item<double>(d, "viscosity_error");
    s.weakly_compressible = item<bool>(d, "weakly_compressible");
    s.sound_speed = item<float>(d, "sound_speed");
    s.extra_viscosity = item<float>(d, "extra_viscosity");
    return s;
}

/// 16 numbers, a 4 x 4 world_from_body row by row.
sim::Pose pose(const std::vector<float>& m) {
    return {{m.at(0), m.at(4), m.at(8)}, {m.at(1), m.at(5), m.at(9)}, {m.at(2), m.at(6), m.at(10)},
        {m.at(3), m.at(7), m.at(11)}};
}

sim::Phase phase(const nb::dict& d) {
    sim::Phase p;
    p.kind = sim::Kind(item<int>(d, "kind"));
    p.density = item<float>(d, "density");
    p.viscosity = item<float>(d, "viscosity");
    p.tension = item<float>(d, "tension");
    p.adhesion = item<float>(d, "adhesion");
    p.friction = item<float>(d, "friction");
    const auto color = item<std::vector<float>>(d, "color");
    for (int k = 0; k < 3; ++k) p.color[k] = color.at(k);
    p.reflection = item<float>(d, "reflection");
    p.refraction = item<float>(d, "refraction");
    p.implicit_viscosity = item<bool>(d, "implicit_viscosity");
    p.shown = item<bool>(d, "shown");
    return p;
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

nb::dict step(PySimulation& s, double dt) {
    const StepReport r = call<&Simulation::step>(s.core, dt);
    nb::dict d = report(r);
    if (r.lost)
        d["lost"] = nb::make_tuple(
            r.lost->id, r.lost->phase, nb::make_tuple(r.lost->position.x, r.lost->position.y, r.lost->position.z));
    return d;
}

/// A method that takes and gives plain values.
template <auto Method, class... A> auto plain(PySimulation& s, A... arguments) {
    return call<Method>(s.core, arguments...);
}

}  // namespace

void bind_simulation(nb::module_& m) {
    nb::class_<PySimulation>(m, "Simulation")
        .def("__init__",
            [](PySimulation* self, PyScene& scene) {
                new (self) PySimulation{work([&] { return make_simulation(scene.core); })};
            })
        .def("configure", [](PySimulation& s, const nb::dict& d) { call<&Simulation::configure>(s.core, settings(d)); })
        .def("set_phase", [](PySimulation& s, int which,
                              const nb::dict& d) { call<&Simulation::set_phase>(s.core, which, phase(d)); })
        .def("add",
            [](PySimulation& s, std::size_t n, Address positions, Address velocities, std::vector<float> velocity,
                int phase) {
                return call<&Simulation::add>(
                    s.core, n, at<float>(positions), at<float>(velocities), vec(velocity), phase);
            })
        .def("remove", [](PySimulation& s, std::size_t n,
                           Address ids) { call<&Simulation::remove>(s.core, n, at<std::uint32_t>(ids)); })
        .def("emit",
            [](PySimulation& s, std::size_t n, Address positions, Address velocities, int phase) {
                return call<&Simulation::emit>(s.core, n, at<float>(positions), at<float>(velocities), phase);
            })
        .def("set_inlets",
            [](PySimulation& s, const nb::list& inlets) {
                std::vector<sim::Inlet> all;
                for (nb::handle h : inlets) {
                    const auto v = nb::cast<std::vector<float>>(h);  // center, direction, radius, length
                    all.push_back({{v.at(0), v.at(1), v.at(2)}, {v.at(3), v.at(4), v.at(5)}, v.at(6), v.at(7)});
                }
                call<&Simulation::set_inlets>(s.core, all);
            })
        .def("set_sinks",
            [](PySimulation& s, const nb::list& sinks) {
                std::vector<sim::Sink> all;
                for (nb::handle h : sinks) {
                    const auto v = nb::cast<std::vector<float>>(h);  // lo, hi, center, radius
                    all.push_back({{v.at(0), v.at(1), v.at(2)}, {v.at(3), v.at(4), v.at(5)},
                        {v.at(6), v.at(7), v.at(8)}, v.at(9)});
                }
                call<&Simulation::set_sinks>(s.core, all);
            })
        .def("capture", [](PySimulation& s, int phase,
                            std::vector<float> m) { call<&Simulation::capture>(s.core, phase, pose(m)); })
        .def("move_to", [](PySimulation& s, int phase,
                            std::vector<float> m) { call<&Simulation::move_to>(s.core, phase, pose(m)); })
        .def("make_body",
            [](PySimulation& s, int phase, double mass, std::vector<double> v) {
                if (v.size() != 18) throw nb::value_error("make_body: expected center, inertia, velocity and spin");
                const double* p = v.data();
                call<&Simulation::make_body>(s.core, phase, mass, p, p + 3, p + 12, p + 15);
            })
        .def("body", [](PySimulation& s, int phase) { return call<&Simulation::body>(s.core, phase); })
        .def("motion",
            [](PySimulation& s) {
                const std::vector<char> bytes = call<&Simulation::motion>(s.core);
                return nb::bytes(bytes.data(), bytes.size());
            })
        .def("set_motion",
            [](PySimulation& s, nb::bytes b) {
                const std::vector<char> bytes(b.c_str(), b.c_str() + b.size());
                call<&Simulation::set_motion>(s.core, bytes);
            })
        .def("totals",
            [](PySimulation& s) {
                const sim::Totals t = call<&Simulation::totals>(s.core);
                nb::dict d;
                d["mass"] = t.mass;
                d["kinetic"] = t.kinetic;
                d["potential"] = t.potential;
                d["momentum"] = nb::make_tuple(t.momentum[0], t.momentum[1], t.momentum[2]);
                d["angular_momentum"] = nb::make_tuple(t.angular[0], t.angular[1], t.angular[2]);
                d["center"] = nb::make_tuple(t.center[0], t.center[1], t.center[2]);
                return d;
            })
        .def("step", &step)
        .def("next_dt", &plain<&Simulation::next_dt>)
        .def("draw", [](PySimulation& s, int what) { call<&Simulation::draw>(s.core, sim::Drawn(what)); })
        .def("size", &plain<&Simulation::size>)
        .def("time", &plain<&Simulation::time>)
        .def("n_steps", &plain<&Simulation::n_steps>)
        .def("next_id", &plain<&Simulation::next_id>)
        .def("read", [](PySimulation& s, const std::string& name,
                         Address out) { call<&Simulation::read>(s.core, name, at<void>(out)); })
        .def("write", [](PySimulation& s, const std::string& name,
                          Address in) { call<&Simulation::write>(s.core, name, at<const void>(in)); })
        .def("resize", [](PySimulation& s, std::size_t n, std::uint32_t next_id, double time,
                           std::uint64_t n_steps) { call<&Simulation::resize>(s.core, n, next_id, time, n_steps); })
        .def("settle", [](PySimulation& s) { call<&Simulation::settle>(s.core); })
        .def("set_forces",
            [](PySimulation& s, Address forces) { call<&Simulation::set_forces>(s.core, at<const float>(forces)); })
        .def("neighbors",
            [](PySimulation& s) {
                auto* rows = new std::vector<std::uint32_t>();
                nb::capsule row_owner(
                    rows, [](void* p) noexcept { delete static_cast<std::vector<std::uint32_t>*>(p); });
                auto* found = new Neighbors();
                nb::capsule owner(found, [](void* p) noexcept { delete static_cast<Neighbors*>(p); });
                work([&] { s.core.call<&Simulation::neighbors>(*rows, *found); });
                return nb::make_tuple(nb::ndarray<nb::numpy, std::uint32_t>(rows->data(), {rows->size()}, row_owner),
                    nb::ndarray<nb::numpy, std::uint64_t>(found->offsets.data(), {found->offsets.size()}, owner),
                    nb::ndarray<nb::numpy, std::uint32_t>(found->indices.data(), {found->indices.size()}, owner));
            })
        .def("flow",
            [](PySimulation& s, Address density, Address vorticity) {
                call<&Simulation::flow>(s.core, at<float>(density), at<float>(vorticity));
            })
        .def("tissue", [](PySimulation& s) {
            Tissue* tissue = call<&Simulation::tissue>(s.core);
            // Alive as long as its simulation.
            return PyTissue{{s.core.backend(), std::shared_ptr<Tissue>(s.core.object(), tissue), s.core.gate()}};
        });
}
