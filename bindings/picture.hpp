// What a picture is asked for with, from Python's dictionaries.  Python has checked every value.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "backends/backend.hpp"

namespace globule::core {

namespace nb = nanobind;

inline float3 vec(const std::vector<float>& v) { return {v.at(0), v.at(1), v.at(2)}; }
template <class T>
T value(const nb::dict& d, const char* key) { return nb::cast<T>(d[key]); }
inline float3 vec(const nb::dict& d, const char* key) { return vec(value<std::vector<float>>(d, key)); }

inline Material material(const nb::dict& d) {
    return {value<float>(d, "reflection"), value<float>(d, "transmission"), value<float>(d, "index"), value<float>(d, "roughness"),
            vec(d, "color"), vec(d, "absorption"), value<float>(d, "specular"), value<float>(d, "shininess")};
}

inline Clip clip(const nb::dict& d) { return {ClipKind(value<int>(d, "kind")), value<bool>(d, "keep"), vec(d, "a"), vec(d, "b")}; }

inline Sky sky(const nb::dict& d, const float*& image, std::uint64_t& id) {
    Sky s;
    s.zenith = vec(d, "zenith");
    s.horizon = vec(d, "horizon");
    s.ground = vec(d, "ground");
    s.up = vec(d, "up");
    s.east = vec(d, "east");
    image = reinterpret_cast<const float*>(value<std::uintptr_t>(d, "image"));
    s.width = value<int>(d, "width");
    s.height = value<int>(d, "height");
    s.strength = value<float>(d, "strength");
    id = value<std::uint64_t>(d, "id");
    return s;
}

inline Lighting lighting(const nb::dict& d) {
    Lighting s{};
    for (nb::handle h : nb::cast<nb::list>(d["lights"])) {
        const auto [kind, place, radiance, size] = nb::cast<std::tuple<int, std::vector<float>, std::vector<float>, float>>(h);
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
    s.cutoff = value<float>(d, "cutoff");
    s.exposure = value<float>(d, "exposure");
    if (!d["ground"].is_none()) {
        const nb::dict g = nb::cast<nb::dict>(d["ground"]);
        s.ground = {true, vec(g, "normal"), value<float>(g, "offset"), vec(g, "color"), vec(g, "other"), value<float>(g, "field"),
                    value<float>(g, "reflection")};
    }
    return s;
}

}  // namespace globule::core
