// Volumes from tracked sweeps: addresses in, addresses out, as in core.cpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "dispatch.hpp"

namespace nb = nanobind;
using namespace globule;

namespace {

using Address = std::uintptr_t;
template <class T>
T* at(Address a) { return reinterpret_cast<T*>(a); }
using Array = std::tuple<Address, bool>;

bool poll_signals() {
    nb::gil_scoped_acquire gil;
    return PyErr_CheckSignals() != 0;
}

template <class Fn>
auto work(const Fn& fn) {
    try {
        nb::gil_scoped_release release;
        return fn();
    } catch (const Cancelled&) {
        throw nb::python_error();
    }
}

struct PyReconstructor {
    std::unique_ptr<Reconstructor> core;
};

template <class T>
T item(const nb::dict& d, const char* name) { return nb::cast<T>(d[name]); }

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
    for (nb::handle h : fillers) {
        auto [type, length, n_sticks, ratio, weights] = nb::cast<std::tuple<int, int, int, float, std::vector<float>>>(h);
        r.fillers.push_back({type, length, n_sticks, ratio, std::move(weights)});
    }
    work([&] { self.core->plus(r); });
    return nb::make_tuple(r.insert_seconds, r.fill_seconds);
}

}  // namespace

void bind_sweep(nb::module_& m) {
    nb::class_<PyReconstructor>(m, "Reconstructor")
        .def("__init__", [](PyReconstructor* self, const std::string& backend, int index, int threads) {
            new (self) PyReconstructor{open_backend(backend).make_reconstructor(index, threads, poll_signals)};
        })
        .def("plus", &plus);
}
