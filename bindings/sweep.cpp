// Volumes from tracked sweeps: addresses in, addresses out, as in arguments.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "arguments.hpp"
#include "backends/open.hpp"
#include "oracle/sweep.hpp"

namespace nb = nanobind;
using namespace globule::core;

namespace {

struct PyReconstructor {
    std::unique_ptr<Reconstructor> core;
    ScalarType type = ScalarType::u8;
    SweepGrid& grid() { return core->grid(type); }
};

nb::tuple plus(PyReconstructor& self, const nb::dict& d, const nb::list& fillers) {
    PlusRequest r{};
    const Array frames = item<Array>(d, "frames");
    r.frames = {at<const void>(std::get<0>(frames)), std::get<1>(frames)};
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
        auto [type, length, n_sticks, ratio, weights] = nb::cast<std::tuple<int, int, int, float, std::vector<float>>>(h);
        r.fillers.push_back({type, length, n_sticks, ratio, std::move(weights)});
    }
    work([&] { self.core->plus(r); });
    return nb::make_tuple(r.insert_seconds, r.fill_seconds);
}

FramesView view(Array values, Address poses, Address mask, int n, int height, int width, std::uint32_t first_order) {
    return {{at<const void>(std::get<0>(values)), std::get<1>(values)}, at<const std::int64_t>(poses), at<const std::uint8_t>(mask),
            n, height, width, first_order};
}

using Three = std::array<int, 3>;  ///< along x, y, z

void oracle_sweep(const std::string& method, Address values, Address poses, Address mask, const std::vector<int>& frames,
                  const std::vector<int>& size, bool whole, int compounding, int reach, bool printed, Address out, Address radius) {
    const oracle::SweepInput in{frames.at(0), frames.at(1), frames.at(2), at<const double>(values), at<const std::int64_t>(poses),
                                at<const std::uint8_t>(mask), {size.at(0), size.at(1), size.at(2)}, whole};
    work([&] {
        if (method == "vvn" || method == "vvn-om") {
            oracle::gather(in, reach, printed, at<double>(out), at<std::uint8_t>(radius));
            return;
        }
        std::vector<double> bins(std::size_t(in.size[0]) * in.size[1] * in.size[2]);
        if (method == "bezier") oracle::bezier(in, bins.data());
        else oracle::bin(in, compounding, bins.data());
        oracle::fill(in.size, whole, bins.data(), reach, printed, at<double>(out), at<std::uint8_t>(radius));
    });
}

}  // namespace

void bind_sweep(nb::module_& m) {
    m.def("oracle_sweep", &oracle_sweep);
    nb::class_<PyReconstructor>(m, "Reconstructor")
        .def("__init__", [](PyReconstructor* self, const std::string& backend, int index, int threads) {
            new (self) PyReconstructor{open_backend(backend).make_reconstructor(index, threads, poll_signals)};
        })
        .def("start", [](PyReconstructor& s, int type, int compounding, bool wide, double scale, int nx, int ny, int nz) {
            s.type = ScalarType(type);
            work([&] { s.grid().start({s.type, compounding, wide, scale, {nx, ny, nz}}); });
        })
        .def("grow", [](PyReconstructor& s, Three size, Three shift) {
            work([&] { s.grid().grow(size.data(), shift.data()); });
        })
        .def("add", [](PyReconstructor& s, Array values, Address poses, Address mask, int n, int h, int w, std::uint32_t order, int sign) {
            work([&] { s.grid().add(view(values, poses, mask, n, h, w, order), sign); });
        })
        .def("median", [](PyReconstructor& s, Array values, Address poses, Address mask, int n, int h, int w) {
            work([&] { s.grid().median(view(values, poses, mask, n, h, w, 0)); });
        })
        .def("bezier", [](PyReconstructor& s, Array values, Address poses, Address mask, int n, int h, int w) {
            work([&] { s.grid().bezier(view(values, poses, mask, n, h, w, 0)); });
        })
        .def("fill", [](PyReconstructor& s, int method, Array frames, Address poses, Address mask, int n, int h, int w, int reach,
                        Address weights, int kind, Address values, Address radius) {
            work([&] {
                s.grid().fill(FillMethod(method), view(frames, poses, mask, n, h, w, 0),
                             {reach, at<const std::uint32_t>(weights), kind, at<void>(values), at<std::uint8_t>(radius)});
            });
        })
        .def("filled", [](PyReconstructor& s) {
            const DenseArrays a = s.grid().filled();
            return nb::make_tuple(reinterpret_cast<Address>(a.values), reinterpret_cast<Address>(a.radius));
        })
        .def("read_filled", [](PyReconstructor& s, Three first, Three size, Address values, Address radius) {
            work([&] { s.grid().read_filled(first.data(), size.data(), {at<void>(values), at<std::uint8_t>(radius)}); });
        })
        .def("count_map", [](PyReconstructor& s, Address out) { work([&] { s.grid().count_map(at<std::uint32_t>(out)); }); })
        .def("variance_map", [](PyReconstructor& s, Array values, Address poses, Address mask, int n, int h, int w, Address out) {
            work([&] { s.grid().variance_map(view(values, poses, mask, n, h, w, 0), at<float>(out)); });
        })
        .def("source_map", [](PyReconstructor& s, std::uint32_t pixels, Address out) {
            work([&] { s.grid().source_map(pixels, at<std::int32_t>(out)); });
        })
        .def("facts", [](PyReconstructor& s) {
            const VolumeFacts f = work([&] { return s.grid().facts(); });
            nb::dict d;
            d["n_blocks"] = f.n_blocks;
            d["bytes"] = f.bytes;
            d["bin_seconds"] = f.bin_seconds;
            d["fill_seconds"] = f.fill_seconds;
            return d;
        })
        .def("free_bytes", [](PyReconstructor& s) { return s.core->free_bytes(); })
        .def("plus", &plus);
}
