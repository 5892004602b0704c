#include "globule/render_settings.hpp"

#include <atomic>
#include <numbers>

#include "api/impl.hpp"

namespace globule {

struct Environment::Image {
    std::vector<float> pixels;  ///< (height, width, 3)
    int width = 0, height = 0;
    std::uint64_t id = 0;
};

namespace {

constexpr double kRadians = std::numbers::pi / 180;

/// A unit vector across up: x, or z where up is along x.
Vec3 across(const Vec3& up) {
    const Vec3 axis = std::abs(up[0]) > 0.9 ? Vec3{0, 0, 1} : Vec3{1, 0, 0};
    const Vec3 a = axis - up * dot(axis, up);
    const double length = norm(a);
    return {a[0] / length, a[1] / length, a[2] / length};
}

core::Light packed(const Headlight& l) {
    return {core::LightKind::head, {0, 0, 1}, three("radiance", l.radiance, 0), 0};
}
core::Light packed(const DirectionalLight& l) {
    const double half = double(number("angle", l.angle, 0, 170)) / 2;
    return {core::LightKind::directional, single(unit("direction", l.direction)), three("radiance", l.radiance, 0),
        float(std::tan(half * kRadians))};
}
core::Light packed(const PointLight& l) {
    return {core::LightKind::point, three("position", l.position), three("radiance", l.radiance, 0),
        number("radius", l.radius, 0)};
}

core::Sky packed(const Sky& sky) {
    const Vec3 up = unit("up", sky.up);
    core::Sky s;
    s.zenith = three("zenith", sky.zenith, 0);
    s.horizon = three("horizon", sky.horizon, 0);
    s.ground = three("ground", sky.ground, 0);
    s.up = single(up);
    s.east = single(across(up));
    return s;
}
core::Sky packed(const Environment& e) {
    const Vec3 mean = e.mean(), up = unit("up", e.up), from = across(up);
    const double angle = double(number("turn", e.turn)) * kRadians;
    core::Sky s = packed(Sky{mean, mean, mean, {0, 1, 0}});  // seen all at once, by a matte surface
    s.up = single(up);
    s.east = single(from * std::cos(angle) + cross(up, from) * std::sin(angle));
    s.width = e.image().width;
    s.height = e.image().height;
    s.strength = number("strength", e.strength, 0);
    return s;
}

core::Ground packed(const Ground& g) {
    return {true, single(unit("normal", g.normal)), number("height", g.height), three("color", g.color, 0),
        three("other", g.other, 0), number("check", g.check, 0), number("reflection", g.reflection, 0, 1)};
}

}  // namespace

Environment::Environment(const ArrayView& image) {
    static std::atomic<std::uint64_t> ids{1};
    const Shape& s = image.shape();
    if (s.rank() != 3 || s[2] != 3 || s.size() == 0 || s[0] > 32768 || s[1] > 32768)
        refuse("image", "shape (H, W, 3)", text(s));
    Inputs inputs(core::kHost);
    const core::FloatArray pixels = inputs.floats("image", ArrayView(image), 3 * s[1], s[0]);
    check_range("image", pixels, s.size(), 1, 0, kInfinity);
    auto made = std::make_shared<Image>();
    made->pixels.assign(pixels.data, pixels.data + s.size());
    made->height = int(s[0]);
    made->width = int(s[1]);
    made->id = ids++;
    image_ = std::move(made);
}

Vec3 Environment::mean() const {
    const Image& i = *image_;
    Vec3 sum{0, 0, 0};
    double total = 0;
    for (int y = 0; y < i.height; ++y) {
        const double weight = std::sin((y + 0.5) / i.height * std::numbers::pi);
        double row[3] = {};
        for (int x = 0; x < i.width; ++x)
            for (int k = 0; k < 3; ++k) row[k] += i.pixels[(std::size_t(y) * i.width + x) * 3 + k];
        for (int k = 0; k < 3; ++k) sum[k] += weight * (row[k] / i.width);
        total += weight;
    }
    return {strength * sum[0] / total, strength * sum[1] / total, strength * sum[2] / total};
}

Look look(const RenderSettings& s) {
    Look out;
    core::Lighting& l = out.lighting;
    if (s.lights.size() > core::kMaxLights)
        refuse("lights", "at most " + std::to_string(core::kMaxLights), std::to_string(s.lights.size()));
    for (const Light& light : s.lights)
        l.lights[l.n_lights++] = std::visit([](const auto& one) { return packed(one); }, light);
    l.shadows = s.shadows;
    l.ambient_rays = whole("ambient_rays", s.ambient_rays, 0, 256);
    l.ambient_distance = number("ambient_distance", s.ambient_distance.value_or(0), 0);
    l.sky_light = !s.ambient;
    l.ambient = s.ambient ? three("ambient", *s.ambient, 0) : core::float3{0, 0, 0};
    l.background = three("background", s.background, 0);
    l.show_sky = s.sky.index() != 0;
    if (const auto* sky = std::get_if<Sky>(&s.sky)) l.sky = packed(*sky);
    else if (const auto* environment = std::get_if<Environment>(&s.sky)) {
        l.sky = packed(*environment);
        out.sky_image = environment->image().pixels.data();
        out.sky_id = environment->image().id;
    } else l.sky = packed(Sky{s.background, s.background, s.background});
    if (s.ground) l.ground = packed(*s.ground);
    l.bounces = whole("bounces", s.bounces, 0, 32);
    l.edge_samples = whole("edge_samples", s.edge_samples.value_or(0), 0, 64);
    l.cutoff = number("cutoff", s.cutoff, 0, 1);
    l.exposure = number("exposure", s.exposure, 0);
    out.specular = number("specular", s.specular, 0);
    out.shininess = number("shininess", s.shininess, 0);
    return out;
}

core::Material material(const Material& m, const Look& look) {
    const auto given = [](const char* name, const std::optional<double>& v, double most) {
        return v ? number(name, *v, 0, most) : -1.0f;
    };
    const auto color = [](const char* name, const std::optional<Vec3>& v) {
        return v ? three(name, *v, 0) : core::float3{-1, -1, -1};
    };
    return {given("reflection", m.reflection, 1), given("transmission", m.transmission, 1),
        m.index ? number("index", *m.index, 1, 4) : 0.0f, number("roughness", m.roughness, 0, 1),
        color("color", m.color), color("absorption", m.absorption),
        m.specular ? number("specular", *m.specular, 0) : look.specular,
        m.shininess ? number("shininess", *m.shininess, 0) : look.shininess};
}

namespace {
core::Clip packed(const ClipPlane& c) {
    const core::float3 n = three("normal", c.normal);
    const Vec3 normal{n.x, n.y, n.z};
    const double length = norm(normal);
    if (length == 0) refuse("normal", "a direction", text(c.normal));
    if (!std::isfinite(c.offset)) refuse("offset", "a finite number", text(c.offset));
    return {core::ClipKind::plane, false, single({normal[0] / length, normal[1] / length, normal[2] / length}),
        {float(c.offset / length), 0, 0}};
}
core::Clip packed(const ClipBox& c) {
    const core::float3 lo = three("low", c.low), hi = three("high", c.high);
    if (!(lo.x < hi.x && lo.y < hi.y && lo.z < hi.z)) refuse("high", "above low in each axis", text(c.high));
    return {core::ClipKind::box, c.keep, lo, hi};
}
core::Clip packed(const ClipSphere& c) {
    return {core::ClipKind::sphere, c.keep, three("center", c.center), {float(positive("radius", c.radius)), 0, 0}};
}
}  // namespace

core::Clip clip(const Clip& c) {
    return std::visit([](const auto& one) { return packed(one); }, c);
}

}  // namespace globule
