// Volumes from tracked sweeps.
#include "arguments.hpp"
#include "globule/volume.hpp"

using namespace globule;
namespace nb = nanobind;
using core::item, core::plain, core::work;

namespace {

DType dtype(int type) { return std::array{DType::uint8, DType::uint16, DType::float32}.at(std::size_t(type)); }

/// Frames of host or device memory; Python keeps them, this keeps what belongs to them.
struct PyFrames {
    GridFrames view;
    nb::object poses, mask;
};
ArrayView frames(const core::Array& a, int type, const std::array<std::size_t, 3>& shape) {
    const auto [address, device, stream] = a;
    return {core::at<const void>(address), dtype(type), Shape(shape[0], shape[1], shape[2]), {device, stream}};
}
ArrayView given(nb::handle array) { return array.is_none() ? ArrayView() : nb::cast<ArrayView>(array); }

using Three = std::array<int, 3>;  ///< along x, y, z

}  // namespace

void bind_sweep(nb::module_& m) {
    nb::class_<PyFrames>(m, "SweepFrames")
        .def(
            "__init__",
            [](PyFrames* self, const core::Array& values, int type, const std::array<std::size_t, 3>& shape,
                nb::object poses, nb::object mask, std::uint32_t first_order) {
                new (self) PyFrames{{frames(values, type, shape), given(poses), given(mask), first_order}, poses, mask};
            },
            nb::arg("values"), nb::arg("type"), nb::arg("shape"), nb::arg("poses"), nb::arg("mask").none(),
            nb::arg("first_order"));
    nb::class_<SweepGrid>(m, "SweepGrid")
        .def("__init__",
            [](SweepGrid* self, const std::string& device, int threads) {
                new (self) SweepGrid(work([&] { return SweepGrid({device, threads, &core::poll_signals}); }));
            })
        .def("start",
            [](SweepGrid& s, int type, int compounding, bool wide, double scale, const Three& size) {
                work([&] { s.start({dtype(type), Compounding(compounding), wide, scale, size}); });
            })
        .def("grow", plain<&SweepGrid::grow>)
        .def("add", [](SweepGrid& s, const PyFrames& f, int sign) { work([&] { s.add(f.view, sign); }); })
        .def("median", [](SweepGrid& s, const PyFrames& f) { work([&] { s.median(f.view); }); })
        .def("bezier", [](SweepGrid& s, const PyFrames& f) { work([&] { s.bezier(f.view); }); })
        .def(
            "fill",
            [](SweepGrid& s, int method, const PyFrames* f, int reach, const ArrayView& weights, int kind,
                bool extrapolate, double max_gap, const MutableArrayView& values, const MutableArrayView& radius,
                const MutableArrayView& spread, const MutableArrayView& contrast) {
                work([&] {
                    s.fill(f ? f->view : GridFrames(), {FillMethod(method), reach, weights, HoleWeights(kind),
                                                           extrapolate, max_gap, values, radius, spread, contrast});
                });
            },
            nb::arg("method"), nb::arg("frames").none(), nb::arg("reach"), nb::arg("weights").none(), nb::arg("kind"),
            nb::arg("extrapolate"), nb::arg("max_gap"), nb::arg("values").none() = nb::none(),
            nb::arg("radius").none() = nb::none(), nb::arg("spread").none() = nb::none(),
            nb::arg("contrast").none() = nb::none())
        .def("filled",
            [](SweepGrid& s) {
                const auto [values, radius] = work([&] { return s.filled(); });
                return nb::make_tuple(core::Address(values.data()), core::Address(radius.data()));
            })
        .def("read_filled", plain<&SweepGrid::read_filled>, nb::arg("first"), nb::arg("size"),
            nb::arg("values").none() = nb::none(), nb::arg("radius").none() = nb::none())
        .def("count_map", plain<&SweepGrid::count_map>)
        .def("variance_map", [](SweepGrid& s, const PyFrames& f,
                                 const MutableArrayView& out) { work([&] { s.variance_map(f.view, out); }); })
        .def("source_map", plain<&SweepGrid::source_map>)
        .def("facts",
            [](SweepGrid& s) {
                const VolumeFacts f = work([&] { return s.facts(); });
                nb::dict d;
                d["n_blocks"] = f.n_blocks;
                d["bytes"] = f.bytes;
                d["bin_seconds"] = f.bin_seconds;
                d["fill_seconds"] = f.fill_seconds;
                return d;
            })
        .def("free_bytes", plain<&SweepGrid::free_bytes>)
        .def("plus", [](SweepGrid& s, const nb::dict& d) {
            PlusSweep p;
            p.frames = frames(
                item<core::Array>(d, "frames"), item<int>(d, "type"), item<std::array<std::size_t, 3>>(d, "shape"));
            p.voxel_from_image = item<ArrayView>(d, "voxel_from_image");
            p.sources = item<ArrayView>(d, "sources");
            p.source_of_frame = item<ArrayView>(d, "source_of_frame");
            p.importance = given(d["importance"]);
            p.size = item<Three>(d, "size");
            p.interpolation = item<int>(d, "interpolation");
            p.optimization = item<int>(d, "optimization");
            p.compounding = item<int>(d, "compounding");
            p.rejection = item<std::optional<double>>(d, "rejection");
            p.fill_holes = item<bool>(d, "fill_holes");
            for (nb::handle h : nb::cast<nb::list>(d["fillers"]))
                p.fillers.push_back({nb::cast<int>(h[0]), nb::cast<int>(h[1]), nb::cast<int>(h[2]),
                    nb::cast<float>(h[3]), nb::cast<std::vector<float>>(h[4])});
            p.values = item<MutableArrayView>(d, "values");
            p.accumulator = item<MutableArrayView>(d, "accumulator");
            p.origin = item<MutableArrayView>(d, "origin");
            return work([&] { return s.plus(p); });
        });
}
