// globule._core: scenes, frames and the reference implementations.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "arguments.hpp"
#include "backends/open.hpp"
#include "oracle/field.hpp"
#include "picture.hpp"

using namespace globule::core;

namespace {

struct PyFrame {
    Handle<Frame> core;
};
struct PyScene {
    Handle<Scene> core;
};

/// Reads an image of (pixels, channels) items.
template <Image image, class T>
auto read_image() {
    return [](PyFrame& f, Address out) { work([&] { f.core.read<&Frame::read>(image, ArrayAt<void>{at<void>(out)}); }); };
}

/// What a question takes of the field.
FieldRequest field_of(int kernel, float threshold = 0.0f) { return {KernelName(kernel), threshold, {}}; }

ThesisRequest thesis(const nb::tuple& t) {
    const auto [root, step, n_thresholds, ghosts, face_rule, exterior, refine, averaged_normals, count] =
        nb::cast<std::tuple<int, float, int, bool, bool, bool, bool, bool, bool>>(t);
    return {ThesisRoot(root), step, n_thresholds, ghosts, face_rule, exterior, refine, averaged_normals, count};
}
FieldRequest field_of(int kernel, float threshold, const nb::object& traced_like) {
    FieldRequest field = field_of(kernel, threshold);
    if (!traced_like.is_none()) field.thesis = thesis(nb::cast<nb::tuple>(traced_like));
    return field;
}

/// Address, shape, bytes an item and type code of any DLPack array, and the object that keeps it alive.
nb::tuple dlpack_view(nb::ndarray<nb::ro> a) {
    nb::list shape, strides;
    for (std::size_t i = 0; i < a.ndim(); ++i) {
        shape.append(a.shape(i));
        strides.append(a.stride(i));
    }
    return nb::make_tuple(Address(a.data()), nb::tuple(shape), nb::tuple(strides), int(a.dtype().code),
                          int(a.dtype().bits), a.device_type(), a.device_id(), nb::cast(a));
}

}  // namespace

void bind_sweep(nb::module_& m);       // sweep.cpp
void bind_simulation(nb::module_& m);  // simulation.cpp
void bind_tissue(nb::module_& m);      // tissue.cpp

NB_MODULE(_core, m) {
    nb::set_leak_warnings(false);  // an exception that ends the program may still hold frames
    bind_sweep(m);
    bind_tissue(m);
    bind_picture(m);
    m.def("cpu_backends", &cpu_backends);
    m.def("dlpack_view", &dlpack_view);
    m.def("describe", [](const std::string& backend, int index) {
        bool ok = false;
        const std::string text = open_backend(backend).describe(index, ok);
        return nb::make_tuple(ok, text);
    });
    m.def("oracle_field", [](std::size_t n, Address positions, Address matrices, Address weight, int kernel,
                             std::size_t m, Address points, Address value, Address gradient) {
        work([&] { oracle::field({n, at<float>(positions), at<double>(matrices), at<double>(weight), {KernelName(kernel)}},
                                 m, at<double>(points), at<double>(value), at<double>(gradient)); });
    });
    m.def("oracle_first_hit", [](std::size_t n, Address positions, Address matrices, Address weight, int kernel,
                                 double tau, std::size_t m, Address origins, Address directions, Address t) {
        work([&] { oracle::first_hit({n, at<float>(positions), at<double>(matrices), at<double>(weight), {KernelName(kernel)}},
                                     tau, m, at<float>(origins), at<float>(directions), at<double>(t)); });
    });
    m.def("morton", [](int bits, const std::string& what, std::vector<std::uint64_t> args) -> nb::object {
        auto run = [&]<class Key>(Key) -> nb::object {
            using namespace morton;
            if (what == "encode") return nb::int_(encode(Key(args[0]), Key(args[1]), Key(args[2])));
            if (what == "decode") {
                const auto c = decode(Key(args[0]));
                return nb::make_tuple(c.x, c.y, c.z);
            }
            if (what == "ancestor") return nb::int_(ancestor(Key(args[0]), int(args[1])));
            if (what == "parent") return nb::int_(parent(Key(args[0]), int(args[1])));
            if (what == "child") return nb::int_(child(Key(args[0]), int(args[1]), int(args[2])));
            if (what == "neighbor") {
                Key out;
                if (!neighbor(Key(args[0]), int(args[1]), int(args[2]) - 1, int(args[3]) - 1, int(args[4]) - 1, out))
                    return nb::none();
                return nb::int_(out);
            }
            if (what == "dense_index") return nb::int_(dense_index(Key(args[0]), int(args[1])));
            if (what == "dense_key") return nb::int_(dense_key<Key>(args[0]));
            throw nb::value_error("unknown Morton operation");
        };
        return bits == 64 ? run(std::uint64_t()) : run(std::uint32_t());
    });

    nb::class_<Frame>(m, "Frame")
        .def("depth", [](Frame& f, Address out) { work([&] { f.depth(at<float>(out)); }); })
        .def("normal", [](Frame& f, Address out) { work([&] { f.normal(at<float>(out)); }); })
        .def("albedo", [](Frame& f, Address out) { work([&] { f.albedo(at<float>(out)); }); })
        .def("color", [](Frame& f, Address out) { work([&] { f.color(at<float>(out)); }); })
        .def("position", [](Frame& f, Address out) { work([&] { f.position(at<float>(out)); }); })
        .def("picture", [](Frame& f, Address out) { work([&] { f.picture(at<std::uint8_t>(out)); }); })
        .def("layer", [](Frame& f, Address out) { work([&] { f.layer(at<std::uint8_t>(out)); }); })
        .def("passes", [](Frame& f) { return f.passes(); })
        .def("trace_seconds", [](Frame& f) { return work([&] { return f.trace_seconds(); }); });

    nb::class_<PyScene>(m, "Scene")
        .def("__init__", [](PyScene* self, const std::string& backend, int index, int threads) {
            new (self) PyScene{open_backend(backend).make_scene(index, threads, poll_signals)};
        })
        .def("build", [](PyScene& s, std::size_t n, Array positions, Array support, float one_support, Array weight,
                         float one_weight, Array color, std::vector<float> one_color, Array reflection, float one_reflection,
                         Array refraction, float one_refraction, Array stretch, float most_stretch, int key_bits, int depth, bool dense, std::vector<float> space) {
            SceneArrays arrays{n, floats(positions), floats(support), floats(weight), floats(color), floats(reflection),
                               floats(refraction), floats(stretch), most_stretch, one_support, one_weight, vec(one_color), one_reflection, one_refraction};
            TreeRequest request{key_bits, depth, dense, !space.empty(), {}, {}};
            if (!space.empty()) {
                request.lo = {space.at(0), space.at(1), space.at(2)};
                request.hi = {space.at(3), space.at(4), space.at(5)};
            }
            work([&] { s.scene->build(arrays, request); });
        })
        .def("facts", [](PyScene& s, bool with_hashes) {
            const TreeFacts f = work([&] { return s.scene->facts(with_hashes); });
            nb::dict d;
            d["n_nodes"] = f.n_nodes;
            d["n_leaves"] = f.n_leaves;
            d["n_inside"] = f.n_inside;
            d["depth"] = f.header.depth;
            d["deepest"] = f.header.deepest;
            d["bytes"] = f.bytes;
            d["key_hash"] = f.key_hash;
            d["node_hash"] = f.node_hash;
            d["build_seconds"] = f.build_seconds;
            d["lo"] = nb::make_tuple(f.header.space.lo.x, f.header.space.lo.y, f.header.space.lo.z);
            d["extent"] = f.header.space.extent;
            return d;
        })
        .def("spacing", [](PyScene& s) { return work([&] { return s.scene->spacing(); }); })
        .def("sorted", [](PyScene& s, Address keys, Address index) {
            work([&] { s.scene->sorted(at<std::uint64_t>(keys), at<std::uint32_t>(index)); });
        })
        .def("render", [](PyScene& s, const std::vector<Layer>& layers, const CameraRays& view, const Look& look,
                          const ThesisRequest* thesis, int passes, std::shared_ptr<Frame> before) {
            const PictureRequest request = picture(layers, view, look, passes);
            const std::optional<ThesisRequest> way = thesis ? std::optional(*thesis) : std::nullopt;
            return work([&] {
                for (const LayerRequest& layer : request.layers) layer.scene->trace_like(way);
                return s.scene->render(request, before);
            });
        }, nb::arg("layers"), nb::arg("view"), nb::arg("look"), nb::arg("thesis").none(), nb::arg("passes"), nb::arg("before").none())
        .def("intersect", [](PyScene& s, int kernel, float threshold, std::size_t n, Array origins, Array directions,
                             Address t, Address normal, Address albedo) {
            work([&] { s.scene->intersect({KernelName(kernel), threshold}, n, floats(origins), floats(directions),
                                          at<float>(t), at<float>(normal), at<float>(albedo)); });
        })
        .def("evaluate", [](PyScene& s, int kernel, std::size_t n, Array points, Address value, Address gradient) {
            work([&] { s.scene->evaluate({KernelName(kernel), 0.0f}, n, floats(points), at<float>(value), at<float>(gradient)); });
        })
        .def("blend", [](PyScene& s, int kernel, std::size_t n, Array points, Array values, int channels, Address out) {
            work([&] { s.scene->blend({KernelName(kernel), 0.0f}, n, floats(points), floats(values), channels, at<float>(out)); });
        })
        .def("neighbors", [](PyScene& s, std::size_t n, Array points, float radius) {
            auto* found = new Neighbors(work([&] { return s.scene->neighbors(n, floats(points), radius); }));
            nb::capsule owner(found, [](void* p) noexcept { delete static_cast<Neighbors*>(p); });
            return nb::make_tuple(
                nb::ndarray<nb::numpy, std::uint64_t>(found->offsets.data(), {found->offsets.size()}, owner),
                nb::ndarray<nb::numpy, std::uint32_t>(found->indices.data(), {found->indices.size()}, owner));
        })
        .def("synchronize", [](PyScene& s) { work([&] { s.scene->synchronize(); }); })
        .def("trace_like_thesis", [](PyScene& s, int root, float step, int n_thresholds, bool ghosts, bool face_rule,
                                     bool exterior, bool refine, bool averaged_normals, bool count) {
            s.scene->trace_like(ThesisRequest{ThesisRoot(root), step, n_thresholds, ghosts, face_rule, exterior, refine,
                                              averaged_normals, count});
        })
        .def("thesis_work", [](PyScene& s, std::size_t n, Address out) {
            work([&] { s.scene->thesis_work(n, at<ThesisWork>(out)); });
        })
        .def("trace_exactly", [](PyScene& s) { s.scene->trace_like({}); });
    bind_simulation(m);
}
