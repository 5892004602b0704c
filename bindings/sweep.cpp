// Volumes from tracked sweeps: addresses in, addresses out, as in arguments.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "arguments.hpp"
#include "backends/open.hpp"

using namespace globule::core;

namespace {

struct PyReconstructor {
    Handle<Reconstructor> core;
    ScalarType type = ScalarType::u8;

    /// Calls a method of the grid for frames of the present type.
    template <auto Method, class... A> auto grid(const A&... arguments) const {
        return work([&] {
            const Gates inside({core.gate().get()});
            SweepGrid* grid = core.call_inside<&Reconstructor::grid>(inside, type);
            const Handle<SweepGrid> handle(core.backend(), std::shared_ptr<SweepGrid>(core.object(), grid), nullptr);
            return handle.call_inside<Method>(inside, arguments...);
        });
    }
};

/// Frames where the reconstructor can use them.
struct Frames {
    Arrays arrays;
    FramesView view;

    Frames(const PyReconstructor& s, const Array& values, Address poses, Address mask, int n, int height, int width,
        std::uint32_t first_order)
        : arrays(s.core.device()) {
        const std::size_t item = s.type == ScalarType::u8 ? 1 : s.type == ScalarType::u16 ? 2 : 4;
        const AnyArray reached =
            work([&] { return arrays.reach_bytes("frames", array<const void>(values), item * n * height * width); });
        view = {reached, at<const std::int64_t>(poses), at<const std::uint8_t>(mask), n, height, width, first_order};
    }
};

nb::tuple plus(PyReconstructor& self, const nb::dict& d, const nb::list& fillers) {
    PlusRequest r{};
    const AnyArray frames = array<const void>(item<Array>(d, "frames"));
    r.type = ScalarType(item<int>(d, "type"));
    r.n_frames = item<int>(d, "n_frames");
    r.height = item<int>(d, "height");
    r.width = item<int>(d, "width");
    r.voxel_from_image = at<const double>(item<Address>(d, "voxel_from_image"));
    r.sources = at<const std::int32_t>(item<Address>(d, "sources"));
    r.n_masks = item<int>(d, "n_masks");
    r.mask_of_frame = at<const std::uint32_t>(item<Address>(d, "mask_of_frame"));
    r.importance = at<const std::uint8_t>(item<Address>(d, "importance"));
    const auto size = item<std::vector<int>>(d, "size");
    for (int k = 0; k < 3; ++k) r.size[k] = size.at(k);
    r.interpolation = item<int>(d, "interpolation");
    r.optimization = item<int>(d, "optimization");
    r.compounding = item<int>(d, "compounding");
    r.rejects = item<bool>(d, "rejects");
    r.rejection = item<double>(d, "rejection");
    r.fill_holes = item<bool>(d, "fill_holes");
    r.values = at<void>(item<Address>(d, "values"));
    r.accumulator = at<std::uint16_t>(item<Address>(d, "accumulator"));
    r.origin = at<std::uint8_t>(item<Address>(d, "origin"));
    for (nb::handle h : fillers) {
        auto [type, length, n_sticks, ratio, weights] =
            nb::cast<std::tuple<int, int, int, float, std::vector<float>>>(h);
        r.fillers.push_back({type, length, n_sticks, ratio, std::move(weights)});
    }
    work([&] {
        Arrays arrays(self.core.device());
        const std::size_t item_bytes = r.type == ScalarType::u8 ? 1 : r.type == ScalarType::u16 ? 2 : 4;
        r.frames = arrays.reach_bytes("frames", frames, item_bytes * r.n_frames * r.height * r.width);
        self.core.call<&Reconstructor::plus>(r);
    });
    return nb::make_tuple(r.insert_seconds, r.fill_seconds);
}

using Three = std::array<int, 3>;  ///< along x, y, z

}  // namespace

void bind_sweep(nb::module_& m) {
    nb::class_<PyReconstructor>(m, "Reconstructor")
        .def("__init__",
            [](PyReconstructor* self, const std::string& backend, int index, int threads) {
                new (self) PyReconstructor{
                    work([&] { return make_reconstructor(open_backend(backend), index, threads, &poll_signals); })};
            })
        .def("start",
            [](PyReconstructor& s, int type, int compounding, bool wide, double scale, int nx, int ny, int nz) {
                s.type = ScalarType(type);
                s.grid<&SweepGrid::start>(GridRequest{s.type, compounding, wide, scale, {nx, ny, nz}});
            })
        .def("grow",
            [](PyReconstructor& s, Three size, Three shift) { s.grid<&SweepGrid::grow>(size.data(), shift.data()); })
        .def("add",
            [](PyReconstructor& s, Array values, Address poses, Address mask, int n, int h, int w, std::uint32_t order,
                int sign) { s.grid<&SweepGrid::add>(Frames(s, values, poses, mask, n, h, w, order).view, sign); })
        .def("median", [](PyReconstructor& s, Array values, Address poses, Address mask, int n, int h,
                           int w) { s.grid<&SweepGrid::median>(Frames(s, values, poses, mask, n, h, w, 0).view); })
        .def("bezier", [](PyReconstructor& s, Array values, Address poses, Address mask, int n, int h,
                           int w) { s.grid<&SweepGrid::bezier>(Frames(s, values, poses, mask, n, h, w, 0).view); })
        .def("fill",
            [](PyReconstructor& s, int method, Array values, Address poses, Address mask, int n, int h, int w,
                int reach, Address weights, int kind, Address out, Address radius, bool extrapolate, double max_gap,
                Address spread, Address contrast) {
                s.grid<&SweepGrid::fill>(globule::FillMethod(method), Frames(s, values, poses, mask, n, h, w, 0).view,
                    FillRequest{reach, at<const std::uint32_t>(weights), kind, at<void>(out), at<std::uint8_t>(radius),
                        extrapolate, max_gap, at<float>(spread), at<float>(contrast)});
            })
        .def("filled",
            [](PyReconstructor& s) {
                const DenseArrays a = s.grid<&SweepGrid::filled>();
                return nb::make_tuple(reinterpret_cast<Address>(a.values), reinterpret_cast<Address>(a.radius));
            })
        .def("read_filled",
            [](PyReconstructor& s, Three first, Three size, Address values, Address radius) {
                s.grid<&SweepGrid::read_filled>(
                    first.data(), size.data(), DenseArrays{at<void>(values), at<std::uint8_t>(radius)});
            })
        .def(
            "count_map", [](PyReconstructor& s, Address out) { s.grid<&SweepGrid::count_map>(at<std::uint32_t>(out)); })
        .def("variance_map",
            [](PyReconstructor& s, Array values, Address poses, Address mask, int n, int h, int w, Address out) {
                s.grid<&SweepGrid::variance_map>(Frames(s, values, poses, mask, n, h, w, 0).view, at<float>(out));
            })
        .def("source_map", [](PyReconstructor& s, std::uint32_t pixels,
                               Address out) { s.grid<&SweepGrid::source_map>(pixels, at<std::int32_t>(out)); })
        .def("facts",
            [](PyReconstructor& s) {
                const globule::VolumeFacts f = s.grid<&SweepGrid::facts>();
                nb::dict d;
                d["n_blocks"] = f.n_blocks;
                d["bytes"] = f.bytes;
                d["bin_seconds"] = f.bin_seconds;
                d["fill_seconds"] = f.fill_seconds;
                return d;
            })
        .def("free_bytes", [](PyReconstructor& s) { return call<&Reconstructor::free_bytes>(s.core); })
        .def("plus", &plus);
}
