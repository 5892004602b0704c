// globule._core: scenes and frames.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "api/limits.hpp"
#include "api/spacing.hpp"
#include "arguments.hpp"
#include "backends/open.hpp"
#include "base/crc64.hpp"
#include "picture.hpp"
#include "pixels.hpp"

using namespace globule::core;

namespace {

/// One image of a frame as a new NumPy array (height, width[, channels]).
template <Image image, class T, int channels>
nb::ndarray<nb::numpy, T> read_image(PyFrame& f, std::size_t height, std::size_t width) {
    struct Room {
        const BackendApi* backend;  ///< null: ordinary memory
        void* data;
        std::size_t bytes;
        ~Room() {
            if (backend) backend->give_pinned_back(data, bytes);
            else std::free(data);
        }
    };
    const std::size_t bytes = height * width * channels * sizeof(T);
    const BackendApi& backend = f.core.backend();
    void* pinned = backend.take_pinned(bytes);
    std::unique_ptr<Room> room(
        pinned ? new Room{&backend, pinned, bytes} : new Room{nullptr, std::malloc(bytes), bytes});
    if (!room->data) throw std::bad_alloc();
    work([&] { f.core.read<&Frame::read>(image, ArrayAt<void>{room->data, pinned ? kPinned : kHost}); });
    T* data = static_cast<T*>(room->data);
    nb::capsule owner(room.release(), [](void* p) noexcept { delete static_cast<Room*>(p); });
    const std::size_t shape[] = {height, width, std::size_t(channels)};
    return {data, std::size_t(channels > 1 ? 3 : 2), shape, owner};
}

/// 1 << Image for each name.
unsigned bits(const std::vector<std::string>& images) {
    constexpr const char* names[] = {"depth", "normal", "albedo", "color", "position", "picture", "layer"};
    unsigned all = 0;
    for (const std::string& name : images)
        for (unsigned k = 0; k < std::size(names); ++k)
            if (name == names[k]) all |= 1u << k;
    return all;
}

FieldRequest field_of(int kernel, float threshold = 0.0f, const ThesisRequest* thesis = nullptr) {
    return {KernelName(kernel), threshold, thesis ? std::optional(*thesis) : std::nullopt};
}

std::vector<Clip> copies(const std::vector<Clip*>& clips) {
    std::vector<Clip> out;
    for (const Clip* clip : clips) out.push_back(*clip);
    return out;
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
    bind_pixels(m);
    m.attr("version") = globule::version();
    nb::dict limits, kernels;  // support in spacings, threshold and reach in supports, by name
    limits["particles"] = globule::kMaxParticles;
    limits["support"] = globule::kMaxSupport;
    limits["ratio"] = globule::kMaxRatio;
    limits["samples"] = globule::kMaxSamples;
    limits["lights"] = kMaxLights;
    limits["layers"] = kMaxLayers;
    limits["iterations"] = SimulationSettings::kIterations;
    for (const auto& k : globule::kKernels) kernels[k.name] = nb::make_tuple(k.spacings, k.threshold, k.reach);
    m.attr("limits") = limits;
    m.attr("kernels") = kernels;
    m.def("cpu_backends", &cpu_backends);
    m.def("stop_at_poll", &stop_at_poll, nb::arg("poll").none());
    m.def("n_polls", [] { return counted.n.load(); });
    m.def("dlpack_view", &dlpack_view);
    m.def("crc64", [](Address data, std::size_t n, std::uint64_t start) {
        return work([&] { return crc64(at<const std::uint8_t>(data), n, start); });
    });
    m.def("axes_of", [](Address positions, std::size_t n) {
        const auto axes = work([&] { return axes_of(at<const float>(positions), n); });
        nb::list rows;
        for (const auto& a : axes) rows.append(nb::make_tuple(a.x, a.y, a.z));
        return rows;
    });
    m.def("describe", [](const std::string& backend, int index) {
        bool ok = false;
        const std::string text = work([&] { return describe(open_backend(backend), index, ok); });
        return nb::make_tuple(ok, text);
    });
    m.def("let_wait", [](int device, std::uintptr_t stream) {
        work([&] { check_status(open_backend("cuda").let_wait(device, stream)); });
    });
    m.def("gpu_array",
        [](Address data, const std::vector<std::size_t>& shape, int code, int bits, int device, nb::object owner) {
            const nb::dlpack::dtype dtype{std::uint8_t(code), std::uint8_t(bits), 1};
            return nb::ndarray<>(
                at<void>(data), shape.size(), shape.data(), owner, nullptr, dtype, nb::device::cuda::value, device);
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

    nb::class_<PyFrame>(m, "Frame")
        .def("depth", &read_image<Image::depth, float, 1>)
        .def("normal", &read_image<Image::normal, float, 3>)
        .def("albedo", &read_image<Image::albedo, float, 3>)
        .def("color", &read_image<Image::color, float, 3>)
        .def("position", &read_image<Image::position, float, 3>)
        .def("picture", &read_image<Image::picture, std::uint8_t, 3>)
        .def("layer", &read_image<Image::layer, std::uint8_t, 1>)
        .def("lend",
            [](PyFrame& f, const std::vector<std::string>& images) {
                const LentPlace place = work([&] { return f.core.read<&Frame::lend>(bits(images)); });
                return nb::bytes(&place, sizeof place);
            })
        .def(
            "take",
            [](PyFrame& f, const std::vector<std::string>& images, const std::vector<nb::bytes>& lent,
                const CameraRays* dealt) {
                std::vector<LentPlace> places(lent.size());
                for (std::size_t k = 0; k < lent.size(); ++k)
                    std::memcpy(&places[k], lent[k].c_str(), sizeof places[k]);
                return work(
                    [&] { return f.core.read<&Frame::take>(bits(images), places, dealt ? &dealt->share : nullptr); });
            },
            nb::arg("images"), nb::arg("lent"), nb::arg("dealt").none())
        .def("passes", [](PyFrame& f) { return work([&] { return f.core.read<&Frame::passes>(); }); })
        .def("trace_seconds", [](PyFrame& f) { return work([&] { return f.core.read<&Frame::trace_seconds>(); }); });

    nb::class_<PyScene>(m, "Scene")
        .def("__init__",
            [](PyScene* self, const std::string& backend, int index, int threads) {
                new (self)
                    PyScene{work([&] { return make_scene(open_backend(backend), index, threads, &poll_signals); })};
            })
        .def("build",
            [](PyScene& s, std::size_t n, Array positions, Array support, float one_support, Array weight,
                float one_weight, Array color, std::vector<float> one_color, Array reflection, float one_reflection,
                Array refraction, float one_refraction, Array stretch, float most_stretch, float spacing, int key_bits,
                int depth, bool dense, std::vector<float> space, bool given_up) {
                TreeRequest request{key_bits, depth, dense, !space.empty(), {}, {}};
                if (!space.empty()) {
                    request.lo = {space.at(0), space.at(1), space.at(2)};
                    request.hi = {space.at(3), space.at(4), space.at(5)};
                }
                work([&] {
                    Arrays all(s.core.device());
                    auto held = std::make_shared<Arrays>(s.core.device());
                    const SceneArrays arrays{n, all.reach("positions", array(positions), 3 * n),
                        all.reach("support", array(support), n), all.reach("weight", array(weight), n),
                        held->reach("color", array(color), 3 * n), held->reach("reflection", array(reflection), n),
                        held->reach("refraction", array(refraction), n), all.reach("anisotropy", array(stretch), 6 * n),
                        most_stretch, one_support, one_weight, spacing, vec(one_color), one_reflection, one_refraction,
                        given_up};
                    s.core.call<&Scene::build>(arrays, request);
                    s.held = std::move(held);
                });
            })
        .def("build_mesh",
            [](PyScene& s, std::size_t n_vertices, Array vertices, std::size_t n_faces, Array faces, Array places,
                Array corners, Array begins, std::size_t n_places, float smooth_cosine, Array color,
                bool color_of_faces, std::vector<float> one_color, bool closed, bool capsules, Array radius,
                float one_radius) {
                work([&] {
                    Arrays all(s.core.device());
                    auto held = std::make_shared<Arrays>(s.core.device());
                    const MeshArrays arrays{n_vertices, n_faces, all.reach("vertices", array(vertices), 3 * n_vertices),
                        held->reach("faces", array<const std::uint32_t>(faces), (capsules ? 2 : 3) * n_faces),
                        array<const std::uint32_t>(places), array<const std::uint32_t>(corners),
                        array<const std::uint32_t>(begins), n_places, smooth_cosine,
                        held->reach("color", array(color), 3 * (color_of_faces ? n_faces : n_vertices)), color_of_faces,
                        vec(one_color), closed, capsules, all.reach("radius", array(radius), n_faces), one_radius};
                    s.core.call<&Scene::build_mesh>(arrays);
                    s.held = std::move(held);
                });
            })
        .def("place_mesh",
            [](PyScene& s, const std::vector<float>& rows) {
                call<&Scene::place_mesh>(
                    s.core, Pose{{rows.at(0), rows.at(1), rows.at(2)}, {rows.at(4), rows.at(5), rows.at(6)},
                                {rows.at(8), rows.at(9), rows.at(10)}, {rows.at(3), rows.at(7), rows.at(11)}});
            })
        .def("intersect_mesh",
            [](PyScene& s, std::size_t n, Array origins, Array directions, Address t, Address normal, Address face) {
                work([&] {
                    Arrays all(s.core.device());
                    s.core.call<&Scene::intersect_mesh>(n, all.reach("origins", array(origins), 3 * n),
                        all.reach("directions", array(directions), 3 * n), at<float>(t), at<float>(normal),
                        at<std::uint32_t>(face));
                });
            })
        .def("facts",
            [](PyScene& s, bool with_hashes) {
                const TreeFacts f = call<&Scene::facts>(s.core, with_hashes);
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
        .def("spacing",
            [](PyScene& s, Address positions, std::size_t n, bool smooth) {
                return work([&] {
                    return measured_spacing(
                        s.core, Gates({s.core.gate().get()}), at<const float>(positions), n, smooth);
                });
            })
        .def("beside",
            [](PyScene& s, int which) {
                return PyScene{Handle<Scene>(
                    s.core.backend(), {s.core.object(), call<&Scene::beside>(s.core, which)}, s.core.gate())};
            })
        .def("sorted",
            [](PyScene& s, Address keys, Address index) {
                call<&Scene::sorted>(s.core, at<std::uint64_t>(keys), at<std::uint32_t>(index));
            })
        .def("surface_kernels",
            [](PyScene& s, Address stretch, Address weight) {
                call<&Scene::surface_kernels>(s.core, at<float>(stretch), at<float>(weight));
            })
        .def(
            "render",
            [](PyScene&, const std::vector<Layer>& layers, const CameraRays& view, const Look& look,
                const ThesisRequest* thesis, int passes, const PyFrame* before) {
                const PictureRequest request = picture(layers, view, look, thesis, passes);
                std::vector<Handle<Scene>> scenes;
                for (const Layer& layer : layers) scenes.push_back(std::get<0>(layer)->core);
                return PyFrame{work([&] { return render(scenes, request, before ? before->core : Handle<Frame>()); })};
            },
            nb::arg("layers"), nb::arg("view"), nb::arg("look"), nb::arg("thesis").none(), nb::arg("passes"),
            nb::arg("before").none())
        .def(
            "intersect",
            [](PyScene& s, int kernel, float threshold, const ThesisRequest* thesis, std::size_t n, Array origins,
                Array directions, Address t, Address normal, Address albedo) {
                work([&] {
                    Arrays all(s.core.device());
                    s.core.call<&Scene::intersect>(field_of(kernel, threshold, thesis), n,
                        all.reach("origins", array(origins), 3 * n), all.reach("directions", array(directions), 3 * n),
                        at<float>(t), at<float>(normal), at<float>(albedo));
                });
            },
            nb::arg("kernel"), nb::arg("threshold"), nb::arg("thesis").none(), nb::arg("n"), nb::arg("origins"),
            nb::arg("directions"), nb::arg("t"), nb::arg("normal"), nb::arg("albedo"))
        .def("march_parts",
            [](PyScene& s, int kernel, float threshold, const std::vector<Clip*>& clips, std::size_t n, Address ray,
                Address from, Address to, Address side, Address t, Address cap, Address looks) {
                work([&] {
                    s.core.call<&Scene::march_parts>(field_of(kernel, threshold), copies(clips),
                        RayParts{n, at<float>(ray), at<float>(from), at<float>(to), at<std::int8_t>(side)},
                        at<float>(t), at<std::int32_t>(cap), at<float>(looks));
                });
            })
        .def("occlude_parts",
            [](PyScene& s, int kernel, float threshold, const std::vector<Clip*>& clips, const Material& material,
                std::size_t n, Address ray, Address from, Address to, Address side, Address distance, Address left,
                Address on, Address crossings, Address test) {
                work([&] {
                    s.core.call<&Scene::occlude_parts>(field_of(kernel, threshold), copies(clips), material,
                        RayParts{n, at<float>(ray), at<float>(from), at<float>(to), at<std::int8_t>(side)},
                        ShadowParts{at<float>(distance), at<float>(left), at<float>(on), at<std::int32_t>(crossings),
                            at<std::int8_t>(test)});
                });
            })
        .def("evaluate",
            [](PyScene& s, int kernel, std::size_t n, Array points, Address value, Address gradient) {
                work([&] {
                    Arrays all(s.core.device());
                    s.core.call<&Scene::evaluate>(field_of(kernel), n, all.reach("points", array(points), 3 * n),
                        at<float>(value), at<float>(gradient));
                });
            })
        .def("blend",
            [](PyScene& s, int kernel, std::size_t n, Array points, Array values, std::size_t n_rows, int channels,
                Address out) {
                work([&] {
                    Arrays all(s.core.device());
                    s.core.call<&Scene::blend>(field_of(kernel), n, all.reach("points", array(points), 3 * n),
                        all.reach("values", array(values), n_rows * channels), n_rows, channels, at<float>(out));
                });
            })
        .def("integrate",
            [](PyScene& s, int kernel, std::size_t n, Array origins, Array directions, Array values, std::size_t n_rows,
                int channels, Address out) {
                work([&] {
                    Arrays all(s.core.device());
                    s.core.call<&Scene::integrate>(field_of(kernel), n, all.reach("origins", array(origins), 3 * n),
                        all.reach("directions", array(directions), 3 * n),
                        all.reach("values", array(values), n_rows * channels), n_rows, channels, at<float>(out));
                });
            })
        .def("neighbors",
            [](PyScene& s, std::size_t n, Array points, float radius) {
                globule::Neighbors found = work([&] {
                    Arrays all(s.core.device());
                    return s.core.call<&Scene::neighbors>(n, all.reach("points", array(points), 3 * n), radius);
                });
                return nb::make_tuple(owned(std::move(found.offsets)), owned(std::move(found.indices)));
            })
        .def("synchronize", [](PyScene& s) { call<&Scene::synchronize>(s.core); })
        .def("cancel", [](PyScene& s) { s.core.object()->cancel(); })
        .def("thesis_work",
            [](PyScene& s, std::size_t n, Address out) { call<&Scene::thesis_work>(s.core, n, at<ThesisWork>(out)); });
    bind_simulation(m);
}
