// What a picture is asked for with: made of Python's dictionaries once, and kept on the object that they describe.
// Python has checked every value.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "arguments.hpp"
#include "handles.hpp"

namespace globule::core {

inline float3 vec(const std::vector<float>& v) { return {v.at(0), v.at(1), v.at(2)}; }
template <class T> T value(const nb::dict& d, const char* key) { return nb::cast<T>(d[key]); }
inline float3 vec(const nb::dict& d, const char* key) { return vec(value<std::vector<float>>(d, key)); }

inline Material material(const nb::dict& d) {
    return {value<float>(d, "reflection"), value<float>(d, "transmission"), value<float>(d, "index"),
        value<float>(d, "roughness"), vec(d, "color"), vec(d, "absorption"), value<float>(d, "specular"),
        value<float>(d, "shininess")};
}

/// How hits are turned into light.
struct Look {
    Lighting lighting;
    const float* sky_image = nullptr;
    std::uint64_t sky_id = 0;
    nb::object sky_owner;       ///< of the image
    float specular, shininess;  ///< of layers whose material has none of its own
};

inline Sky sky(const nb::dict& d) {
    Sky s;
    s.zenith = vec(d, "zenith");
    s.horizon = vec(d, "horizon");
    s.ground = vec(d, "ground");
    s.up = vec(d, "up");
    s.east = vec(d, "east");
    s.width = value<int>(d, "width");
    s.height = value<int>(d, "height");
    s.strength = value<float>(d, "strength");
    return s;
}

inline Lighting lighting(const nb::dict& d) {
    Lighting s{};
    for (nb::handle h : nb::cast<nb::list>(d["lights"])) {
        const auto [kind, place, radiance, size] =
            nb::cast<std::tuple<int, std::vector<float>, std::vector<float>, float>>(h);
        s.lights[s.n_lights++] = {LightKind(kind), vec(place), vec(radiance), size};
    }
    s.shadows = value<bool>(d, "shadows");
    s.ambient_rays = value<int>(d, "ambient_rays");
    s.ambient_distance = value<float>(d, "ambient_distance");
    s.sky_light = value<bool>(d, "sky_light");
    s.ambient = vec(d, "ambient");
    s.background = vec(d, "background");
    s.show_sky = value<bool>(d, "show_sky");
    s.bounces = value<int>(d, "depth");
    s.edge_samples = value<int>(d, "edge_samples");
    s.edge_contrast = value<bool>(d, "edge_contrast");
    s.cutoff = value<float>(d, "cutoff");
    s.exposure = value<float>(d, "exposure");
    if (!d["ground"].is_none()) {
        const nb::dict g = nb::cast<nb::dict>(d["ground"]);
        s.ground = {true, vec(g, "normal"), value<float>(g, "offset"), vec(g, "color"), vec(g, "other"),
            value<float>(g, "field"), value<float>(g, "reflection")};
    }
    s.sky = sky(nb::cast<nb::dict>(d["sky"]));
    return s;
}

inline Look look(const nb::dict& d) {
    const nb::dict s = nb::cast<nb::dict>(d["sky"]);
    return {lighting(d), reinterpret_cast<const float*>(value<std::uintptr_t>(s, "image")),
        value<std::uint64_t>(s, "id"), s["owner"], value<float>(d, "specular"), value<float>(d, "shininess")};
}

inline CameraRays view(const std::vector<float>& v, int width, int height, bool orthographic) {
    auto part = [&](int i) { return float3{v.at(3 * i), v.at(3 * i + 1), v.at(3 * i + 2)}; };
    return {part(0), part(1), part(2), part(3), width, height, orthographic};
}

/// What Python passes for one scene of a picture: the scene, its kernel and threshold, material, cuts, and who answers
/// for it where its particles lie elsewhere (None: itself).
using Layer = std::tuple<PyScene*, int, float, Material*, std::vector<Clip*>, nb::object>;

/// A call of Python within the core's work; false: Python's error is set, and `raise` finds it.
template <class Fn> bool asked(const Fn& fn) {
    nb::gil_scoped_acquire gil;
    try {
        fn();
        return true;
    } catch (nb::python_error& e) {
        e.restore();
        return false;
    }
}
/// The core's own memory as an array, for as long as the call takes.
template <class T> nb::object borrowed(T* data, std::size_t rows, std::size_t columns = 0) {
    const std::size_t shape[] = {rows, columns};
    return nb::cast(
        nb::ndarray<nb::numpy, T>(data, std::size_t(columns ? 2 : 1), shape, nb::handle()), nb::rv_policy::reference);
}

inline Remote remote(const nb::object& who) {
    if (who.is_none()) return {};
    return {who.ptr(),
        [](void* who, const RemoteRays& in, const RemoteHits& out) {
            return asked([&] {
                nb::handle(static_cast<PyObject*>(who))
                    .attr("march")(borrowed(in.ray, in.n, 6), borrowed(out.side, in.n), borrowed(out.t, in.n),
                        borrowed(out.cap, in.n), borrowed(out.looks, in.n, 8));
            });
        },
        [](void* who, const RemoteRays& in, float* left) {
            return asked([&] {
                nb::handle(static_cast<PyObject*>(who))
                    .attr("occlude")(borrowed(in.ray, in.n, 6), borrowed(in.distance, in.n), borrowed(in.side, in.n),
                        borrowed(left, in.n));
            });
        }};
}

inline PictureRequest picture(const std::vector<Layer>& layers, const CameraRays& view, const Look& look,
    const ThesisRequest* thesis, int passes) {
    PictureRequest request{{}, view, look.lighting, look.sky_image, look.sky_id, passes};
    for (const auto& [scene, kernel, threshold, of_layer, clips, answers] : layers) {
        Material& material = request.lighting.materials[request.layers.size()] = *of_layer;
        if (material.specular < 0.0f) material.specular = look.specular;
        if (material.shininess < 0.0f) material.shininess = look.shininess;
        LayerRequest layer{scene->core.object().get(),
            {KernelName(kernel), threshold, thesis ? std::optional(*thesis) : std::nullopt}, {}, remote(answers)};
        for (const Clip* clip : clips) layer.clips.push_back(*clip);
        request.layers.push_back(std::move(layer));
    }
    return request;
}

inline void bind_picture(nb::module_& m) {
    nb::class_<Look>(m, "Look")
        .def("__init__", [](Look* self, const nb::dict& d) { new (self) Look(look(d)); })
        .def("with_edges",
            [](Look look, int samples) {
                look.lighting.edge_samples = samples;
                return look;
            })
        .def("reaching", [](Look look, float distance) {  // whose ambient rays end there
            look.lighting.ambient_distance = distance;
            return look;
        });
    nb::class_<Material>(m, "Material").def("__init__", [](Material* self, const nb::dict& d) {
        new (self) Material(material(d));
    });
    nb::class_<CameraRays>(m, "View").def(
        "__init__",
        [](CameraRays* self, const std::vector<float>& frame, int width, int height, bool orthographic,
            const std::tuple<int, int, int, int, bool>& share) {
            const auto [device, n, square, step, apron] = share;
            new (self) CameraRays(view(frame, width, height, orthographic));
            self->share = {device, n, square, step, apron};
        },
        nb::arg("frame"), nb::arg("width"), nb::arg("height"), nb::arg("orthographic"),
        nb::arg("share") = std::tuple(0, 1, 64, 1, false));
    nb::class_<Clip>(m, "Clip").def(
        "__init__", [](Clip* self, int kind, bool keep, const std::vector<float>& a, const std::vector<float>& b) {
            new (self) Clip{ClipKind(kind), keep, vec(a), vec(b)};
        });
    nb::class_<ThesisRequest>(m, "Thesis")
        .def("__init__", [](ThesisRequest* self, int root, float step, int n_thresholds, bool ghosts, bool face_rule,
                             bool exterior, bool refine, bool averaged_normals, bool count) {
            new (self) ThesisRequest{
                ThesisRoot(root), step, n_thresholds, ghosts, face_rule, exterior, refine, averaged_normals, count};
        });
}

}  // namespace globule::core
