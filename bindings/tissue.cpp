// Tissue, by itself or of a simulation.
#include "arguments.hpp"
#include "globule/tissue.hpp"

using namespace globule;
namespace nb = nanobind;
using core::item, core::owned, core::plain, core::work;

namespace {

/// (kind, a, b, radius, velocity), or with the friction behind
TissueShape shape(nb::handle h) {
    return {TissueShape::Kind(nb::cast<int>(h[0])), nb::cast<Vec3>(h[1]), nb::cast<Vec3>(h[2]), nb::cast<double>(h[3]),
        nb::cast<Vec3>(h[4]), nb::len(h) > 5 ? nb::cast<double>(h[5]) : 0.0};
}

}  // namespace

void bind_tissue(nb::module_& m) {
    nb::class_<Tissue>(m, "Tissue")
        .def("__init__",
            [](Tissue* self, const std::string& device, int threads) {
                new (self) Tissue(work([&] { return Tissue({device, threads, &core::poll_signals}); }));
            })
        .def(
            "add",
            [](Tissue& s, const ArrayView& positions, const ArrayView& ids, const ArrayView& inverse_mass,
                const ArrayView& hold, const ArrayView& phase, const ArrayView& offsets, const ArrayView& other,
                const ArrayView& length, const ArrayView& stiffness, const ArrayView& bound, double contact,
                const ArrayView& lame, double frequency, const ArrayView& relaxation) {
                work([&] {
                    s.add({positions, ids, inverse_mass, hold, phase, offsets, other, length, stiffness, bound, contact,
                        lame, frequency, relaxation});
                });
            },
            nb::arg("positions"), nb::arg("ids"), nb::arg("inverse_mass"), nb::arg("hold"), nb::arg("phase"),
            nb::arg("offsets"), nb::arg("other"), nb::arg("length"), nb::arg("stiffness"), nb::arg("bound"),
            nb::arg("contact"), nb::arg("lame").none() = nb::none(), nb::arg("frequency") = 0.0,
            nb::arg("relaxation").none() = nb::none())
        .def("materials",
            [](Tissue& s, const std::vector<std::array<double, 5>>& rows) {
                std::vector<TissueMaterial> all;  // damping, tear, plastic, creep, friction
                for (const auto& r : rows) all.push_back({r[0], r[1], r[2], r[3], r[4]});
                work([&] { s.set_materials(all); });
            })
        .def("instruments",
            [](Tissue& s, const std::vector<std::array<Vec3, 3>>& motions, const nb::list& shapes) {
                std::vector<GraspMotion> grasps;
                for (const auto& [velocity, spin, center] : motions) grasps.push_back({velocity, spin, center});
                std::vector<TissueShape> all;
                for (nb::handle h : shapes) all.push_back(shape(h));
                work([&] { s.set_instruments(grasps, all); });
            })
        .def("advance", plain<&Tissue::advance>)
        .def("tear", plain<&Tissue::tear>)
        .def("follow", plain<&Tissue::follow>)
        .def(
            "cut", [](Tissue& s, const ArrayView& vertices, const ArrayView& triangles,
                       std::uint32_t n_moving) { return work([&] { return s.cut({vertices, triangles, n_moving}); }); })
        .def("pieces", plain<&Tissue::n_pieces>)
        .def("grasp", plain<&Tissue::grasp>)
        .def(
            "remove", [](Tissue& s, nb::handle region) { return work([&, r = shape(region)] { return s.remove(r); }); })
        .def("felt", plain<&Tissue::felt>)
        .def("n", plain<&Tissue::size>)
        .def("n_bonds", plain<&Tissue::n_bonds>)
        .def("elastic_energy", plain<&Tissue::elastic_energy>)
        .def("substeps", plain<&Tissue::substeps>)
        .def("get", plain<&Tissue::get>, nb::arg("positions").none() = nb::none(),
            nb::arg("velocities").none() = nb::none(), nb::arg("piece").none() = nb::none(),
            nb::arg("hold").none() = nb::none(), nb::arg("ids").none() = nb::none())
        .def("accelerate", plain<&Tissue::accelerate>)
        .def("set", plain<&Tissue::set>, nb::arg("positions").none() = nb::none(),
            nb::arg("velocities").none() = nb::none())
        .def("set_vessel", [](Tissue& s, std::size_t number, float speed, double pool,
                               int phase) { work([&] { s.set_vessel(number, {speed, pool, phase}); }); })
        .def("pools",
            [](Tissue& s) {
                std::vector<double> all;
                for (const BloodVessel& v : work([&] { return s.vessels(); })) all.push_back(v.pool);
                return all;
            })
        .def("arrays",
            [](Tissue& s) {  // all that a checkpoint needs
                nb::dict all;
                for (const auto& [name, bytes] : work([&] { return s.arrays(); }))
                    all[name.c_str()] = owned(work([&] { return s.read(name); }));
                return all;
            })
        .def("write", plain<&Tissue::write>);
}
