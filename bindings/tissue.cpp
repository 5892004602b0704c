// Tissue, by itself or of a simulation: addresses in, addresses out, as in arguments.hpp.
#include "tissue.hpp"

#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>

#include "arguments.hpp"
#include "backends/open.hpp"

using namespace globule::core;

namespace {

float3 vec(nb::handle h) {
    const auto v = nb::cast<std::vector<float>>(h);
    return {v.at(0), v.at(1), v.at(2)};
}
/// (kind, a, b, radius, velocity), or with the friction behind
tissue::Shape shape(nb::handle h) {
    const float friction = nb::len(h) > 5 ? nb::cast<float>(h[5]) : 0.0f;
    return {tissue::Shape::Kind(nb::cast<int>(h[0])), vec(h[1]), vec(h[2]), nb::cast<float>(h[3]), vec(h[4]), friction};
}

}  // namespace

void bind_tissue(nb::module_& m) {
    nb::class_<PyTissue>(m, "Tissue")
        .def("__init__",
            [](PyTissue* self, const std::string& backend, int index, int threads) {
                new (self)
                    PyTissue{work([&] { return make_tissue(open_backend(backend), index, threads, &poll_signals); })};
            })
        .def("add",
            [](PyTissue& s, const nb::dict& d) {
                TissueArrays a{};
                a.n = item<std::uint32_t>(d, "n");
                a.ids = at<const std::uint32_t>(item<Address>(d, "ids"));
                a.positions = at<const float>(item<Address>(d, "positions"));
                a.inverse_mass = at<const float>(item<Address>(d, "inverse_mass"));
                a.bound = at<const float>(item<Address>(d, "bound"));
                a.hold = at<const std::uint8_t>(item<Address>(d, "hold"));
                a.phase = at<const std::uint8_t>(item<Address>(d, "phase"));
                a.offsets = at<const std::uint64_t>(item<Address>(d, "offsets"));
                a.other = at<const std::uint32_t>(item<Address>(d, "other"));
                a.length = at<const float>(item<Address>(d, "length"));
                a.stiffness = at<const float>(item<Address>(d, "stiffness"));
                a.contact = item<float>(d, "contact");
                if (d.contains("lame")) {
                    a.lame = at<const float>(item<Address>(d, "lame"));
                    a.frequency = item<float>(d, "frequency");
                    a.relaxation = at<const float>(item<Address>(d, "relaxation"));
                    a.n_terms = item<std::uint32_t>(d, "n_terms");
                }
                call<&Tissue::add>(s.core, a);
            })
        .def("materials",
            [](PyTissue& s, std::vector<float> damping, std::vector<float> tear, std::vector<float> yield,
                std::vector<float> creep, std::vector<float> friction) {
                tissue::Materials m;
                const auto copy = [](const std::vector<float>& from, float* to) {
                    std::copy_n(from.begin(), std::min<std::size_t>(from.size(), tissue::kMaxPhases), to);
                };
                copy(damping, m.damping);
                copy(tear, m.tear_strain);
                copy(yield, m.yield_strain);
                copy(creep, m.creep_rate);
                copy(friction, m.friction);
                call<&Tissue::set_materials>(s.core, m);
            })
        .def("instruments",
            [](PyTissue& s, nb::list motions, nb::list shapes) {
                tissue::Motions all;
                for (std::size_t g = 0; g < std::min<std::size_t>(nb::len(motions), tissue::kMaxGrasps); ++g) {
                    all.velocity[g] = vec(motions[g][0]);
                    all.spin[g] = vec(motions[g][1]);
                    all.center[g] = vec(motions[g][2]);
                }
                tissue::Shapes solid;
                for (nb::handle h : shapes)
                    if (solid.n < tissue::kMaxShapes) solid.shape[solid.n++] = shape(h);
                call<&Tissue::set_instruments>(s.core, all, solid);
            })
        .def("advance",
            [](PyTissue& s, float dt, int substeps, int iterations, nb::handle gravity) {
                const TissueStep step{dt, substeps, iterations, vec(gravity)};
                return call<&Tissue::advance>(s.core, step);
            })
        .def("tear", [](PyTissue& s, float dt) { return call<&Tissue::tear>(s.core, dt); })
        .def("follow", [](PyTissue& s) { call<&Tissue::follow>(s.core); })
        .def("cut",
            [](PyTissue& s, Address vertices, std::uint32_t n_vertices, std::uint32_t n_moving, Address triangles,
                std::uint32_t n) {
                return call<&Tissue::cut>(s.core, BladeSweep{at<const double>(vertices), n_vertices, n_moving,
                                                      at<const std::uint32_t>(triangles), n});
            })
        .def("pieces", [](PyTissue& s) { return call<&Tissue::pieces>(s.core); })
        .def("grasp",
            [](PyTissue& s, nb::handle center, float radius, int number) {
                const float3 c = vec(center);
                call<&Tissue::grasp>(s.core, c, radius, number);
            })
        .def("remove",
            [](PyTissue& s, nb::handle region) {
                const tissue::Shape r = shape(region);
                return call<&Tissue::remove>(s.core, r);
            })
        .def("felt", [](PyTissue& s) { return call<&Tissue::felt>(s.core); })
        .def("n", [](PyTissue& s) { return call<&Tissue::n>(s.core); })
        .def("n_bonds", [](PyTissue& s) { return call<&Tissue::n_bonds>(s.core); })
        .def("elastic_energy", [](PyTissue& s) { return call<&Tissue::elastic_energy>(s.core); })
        .def("substeps", [](PyTissue& s, float dt) { return call<&Tissue::substeps>(s.core, dt); })
        .def("get",
            [](PyTissue& s, Address positions, Address velocities, Address piece, Address hold, Address ids) {
                call<&Tissue::get>(s.core, at<float>(positions), at<float>(velocities), at<std::uint32_t>(piece),
                    at<std::uint8_t>(hold), at<std::uint32_t>(ids));
            })
        .def("accelerate", [](PyTissue& s, Address a) { call<&Tissue::accelerate>(s.core, at<const float>(a)); })
        .def("set",
            [](PyTissue& s, Address positions, Address velocities) {
                call<&Tissue::set>(s.core, at<const float>(positions), at<const float>(velocities));
            })
        .def("set_vessel",
            [](PyTissue& s, std::size_t number, float speed, double pool, int phase) {
                call<&Tissue::set_vessel>(s.core, number, BloodVessel{speed, pool, phase});
            })
        .def("pools",
            [](PyTissue& s) {
                std::vector<double> all;
                for (const BloodVessel& v : call<&Tissue::vessels>(s.core)) all.push_back(v.pool);
                return all;
            })
        .def("arrays",
            [](PyTissue& s) {
                nb::dict all;
                for (const auto& [name, bytes] : call<&Tissue::arrays>(s.core)) all[name.c_str()] = bytes;
                return all;
            })
        .def("read",
            [](PyTissue& s, const std::string& name, Address out) { call<&Tissue::read>(s.core, name, at<void>(out)); })
        .def("write", [](PyTissue& s, const std::string& name, Address in, std::size_t bytes) {
            call<&Tissue::write>(s.core, name, at<const void>(in), bytes);
        });
}
