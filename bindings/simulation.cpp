// Particle simulations: addresses in, addresses out, as in arguments.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "arguments.hpp"
#include "backends/open.hpp"
#include "picture.hpp"
#include "scene_handle.hpp"
#include "backends/simulation.hpp"
#include "tissue_handle.hpp"

using namespace globule::core;

namespace {

struct PySimulation {
    std::unique_ptr<Simulation> core;
};

SimulationSettings settings(const nb::dict& d) {
    SimulationSettings s;
    s.spacing = item<float>(d, "spacing");
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
    return {{m.at(0), m.at(4), m.at(8)}, {m.at(1), m.at(5), m.at(9)}, {m.at(2), m.at(6), m.at(10)}, {m.at(3), m.at(7), m.at(11)}};
}

sim::Phase phase(const nb::dict& d) {
    sim::Phase p;
    p.kind = sim::Kind(item<int>(d, "kind"));
    p.density = item<float>(d, "density");
    p.viscosity = item<float>(d, "viscosity");
    p.tension = item<float>(d, "tension");
    p.adhesion = item<float>(d, "adhesion");
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
    d["n"] = r.n;
    d["n_solved"] = r.n_solved;
    d["n_escaped"] = r.n_escaped;
    d["most_speed"] = r.most_speed;
    d["seconds"] = seconds;
    return d;
}

nb::dict step(PySimulation& s, double dt) {
    try {
        return report(work([&] { return s.core->step(dt); }));
    } catch (const SimulationError& e) {
        nb::dict d;
        d["lost"] = nb::make_tuple(e.id, e.phase, nb::make_tuple(e.position.x, e.position.y, e.position.z), e.time, e.step);
        return d;
    }
}

}  // namespace

void bind_simulation(nb::module_& m) {
    nb::class_<PySimulation>(m, "Simulation")
        .def("__init__", [](PySimulation* self, const std::string& backend, PyScene& scene) {
            new (self) PySimulation{open_backend(backend).make_simulation(scene.scene)};
        })
        .def("configure", [](PySimulation& s, const nb::dict& d) { s.core->configure(settings(d)); })
        .def("set_phase", [](PySimulation& s, int which, const nb::dict& d) { s.core->set_phase(which, phase(d)); })
        .def("add", [](PySimulation& s, std::size_t n, Address positions, Address velocities, std::vector<float> velocity, int phase) {
            return work([&] { return s.core->add(n, at<float>(positions), at<float>(velocities), vec(velocity), phase); });
        })
        .def("remove", [](PySimulation& s, std::size_t n, Address ids) { work([&] { s.core->remove(n, at<std::uint32_t>(ids)); }); })
        .def("emit", [](PySimulation& s, std::size_t n, Address positions, Address velocities, int phase) {
            return s.core->emit(n, at<float>(positions), at<float>(velocities), phase);
        })
        .def("set_sinks", [](PySimulation& s, const nb::list& sinks) {
            std::vector<sim::Sink> all;
            for (nb::handle h : sinks) {
                const auto v = nb::cast<std::vector<float>>(h);  // lo, hi, center, radius
                all.push_back({{v.at(0), v.at(1), v.at(2)}, {v.at(3), v.at(4), v.at(5)}, {v.at(6), v.at(7), v.at(8)}, v.at(9)});
            }
            s.core->set_sinks(all);
        })
        .def("capture", [](PySimulation& s, int phase, std::vector<float> m) { s.core->capture(phase, pose(m)); })
        .def("move_to", [](PySimulation& s, int phase, std::vector<float> m) { s.core->move_to(phase, pose(m)); })
        .def("make_body", [](PySimulation& s, int phase, double mass, std::vector<double> v) {
            if (v.size() != 18) throw nb::value_error("make_body: expected center, inertia, velocity and spin");
            s.core->make_body(phase, mass, v.data(), v.data() + 3, v.data() + 12, v.data() + 15);
        })
        .def("body", [](PySimulation& s, int phase) { return s.core->body(phase); })
        .def("motion", [](PySimulation& s) {
            const std::vector<char> bytes = s.core->motion();
            return nb::bytes(bytes.data(), bytes.size());
        })
        .def("set_motion", [](PySimulation& s, nb::bytes b) { s.core->set_motion({b.c_str(), b.c_str() + b.size()}); })
        .def("totals", [](PySimulation& s) {
            const sim::Totals t = work([&] { return s.core->totals(); });
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
        .def("next_dt", [](PySimulation& s) { return s.core->next_dt(); })
        .def("size", [](PySimulation& s) { return s.core->size(); })
        .def("time", [](PySimulation& s) { return s.core->time(); })
        .def("n_steps", [](PySimulation& s) { return s.core->n_steps(); })
        .def("next_id", [](PySimulation& s) { return s.core->next_id(); })
        .def("read", [](PySimulation& s, const std::string& name, Address out) { work([&] { s.core->read(name, at<void>(out)); }); })
        .def("write", [](PySimulation& s, const std::string& name, Address in) { work([&] { s.core->write(name, at<void>(in)); }); })
        .def("resize", [](PySimulation& s, std::size_t n, std::uint32_t next_id, double time, std::uint64_t n_steps) {
            s.core->resize(n, next_id, time, n_steps);
        })
        .def("settle", [](PySimulation& s) { work([&] { s.core->settle(); }); })
        .def("set_forces", [](PySimulation& s, Address forces) { s.core->set_forces(at<float>(forces)); })
        .def("neighbors", [](PySimulation& s) {
            auto* rows = new std::vector<std::uint32_t>();
            nb::capsule row_owner(rows, [](void* p) noexcept { delete static_cast<std::vector<std::uint32_t>*>(p); });
            auto* found = new Neighbors();
            nb::capsule owner(found, [](void* p) noexcept { delete static_cast<Neighbors*>(p); });
            work([&] { s.core->neighbors(*rows, *found); });
            return nb::make_tuple(
                nb::ndarray<nb::numpy, std::uint32_t>(rows->data(), {rows->size()}, row_owner),
                nb::ndarray<nb::numpy, std::uint64_t>(found->offsets.data(), {found->offsets.size()}, owner),
                nb::ndarray<nb::numpy, std::uint32_t>(found->indices.data(), {found->indices.size()}, owner));
        })
        .def("tissue", [](PySimulation& s) { return PyTissue{nullptr, &work([&]() -> Tissue& { return s.core->tissue(); })}; }, nb::keep_alive<0, 1>())
        .def("show", [](PySimulation& s) { work([&] { s.core->show(); }); });
}
