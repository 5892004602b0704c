#include "globule/camera.hpp"

#include <algorithm>
#include <numbers>

#include "api/impl.hpp"

namespace globule {
namespace {

void check_fov(double degrees) {
    if (!(degrees >= 1e-9 && degrees < 180)) refuse("fov", "degrees between 1e-09 and 180", text(degrees));
}

constexpr std::size_t kMostPoints = 1'000'000;  ///< of more, the box's corners count
constexpr float kFarthest = 1e18f;              ///< past it a coordinate counts as infinite, as in the octree

Vec3 divided(const Vec3& v, double by) { return {v[0] / by, v[1] / by, v[2] / by}; }

/// Unit right and up vectors of an image seen along `forward`; an `up` along it is replaced.
void axes(const Vec3& forward, const Vec3& up, Vec3& right, Vec3& true_up) {
    right = cross(forward, up);
    if (norm(right) <= 1e-9 * std::max(norm(up), 1e-300)) {
        Vec3 other{0, 0, 0};
        int least = 0;
        for (int k = 1; k < 3; ++k)
            if (std::abs(forward[k]) < std::abs(forward[least])) least = k;
        other[least] = 1;
        right = cross(forward, other);
    }
    right = divided(right, norm(right));
    true_up = cross(right, forward);
}

void check_finite(const char* name, const Vec3& v) {
    for (const double x : v)
        if (!std::isfinite(x)) refuse(name, "three finite numbers", text(v));
}

/// Points that stand for all positions, relative to the middle of their box.
std::vector<Vec3> outline(const ArrayView& positions, Vec3& middle) {
    std::size_t n;
    Inputs inputs(core::kHost);
    const bool on_gpu = positions.where().device != Location::host;
    const core::FloatArray p = inputs.rows("positions", positions, 3, n);
    middle = {0, 0, 0};
    const float inf = std::numeric_limits<float>::infinity();
    float lo[3] = {inf, inf, inf}, hi[3] = {-inf, -inf, -inf};
    const auto inside = [&](std::size_t i) {
        for (int k = 0; k < 3; ++k)
            if (!(std::abs(p.data[3 * i + k]) <= kFarthest)) return false;
        return true;
    };
    std::size_t n_inside = 0;
    for (std::size_t i = 0; i < n; ++i) {
        if (!inside(i)) continue;
        ++n_inside;
        for (int k = 0; k < 3; ++k) {
            lo[k] = std::min(lo[k], p.data[3 * i + k]);
            hi[k] = std::max(hi[k], p.data[3 * i + k]);
        }
    }
    if (n_inside == 0) return {{0, 0, 0}};
    for (int k = 0; k < 3; ++k) middle[k] = (double(lo[k]) + double(hi[k])) / 2;
    std::vector<Vec3> points;
    if (on_gpu || n > kMostPoints) {
        for (int corner = 0; corner < 8; ++corner) {
            const Vec3 at{corner & 1 ? hi[0] : lo[0], corner & 2 ? hi[1] : lo[1], corner & 4 ? hi[2] : lo[2]};
            points.push_back(at - middle);
        }
        return points;
    }
    points.reserve(n_inside);
    for (std::size_t i = 0; i < n; ++i)
        if (inside(i)) points.push_back(Vec3{p.data[3 * i], p.data[3 * i + 1], p.data[3 * i + 2]} - middle);
    return points;
}

}  // namespace

Camera Camera::fit(const ArrayView& positions, const FitOptions& o) {
    check_finite("direction", o.direction);
    check_finite("up", o.up);
    if (!(norm(o.direction) > 0)) refuse("direction", "a direction", text(o.direction));
    check_fov(o.fov);
    if (o.width < 1 || o.height < 1)
        refuse("width, height", "at least 1 pixel", std::to_string(o.width) + " x " + std::to_string(o.height));
    if (!(std::isfinite(o.margin) && o.margin >= 0)) refuse("margin", "a number >= 0", text(o.margin));
    Vec3 middle;
    const std::vector<Vec3> points = outline(positions, middle);
    const Vec3 back = divided(o.direction, norm(o.direction));
    Vec3 right, up;
    axes(back * -1, o.up, right, up);
    const double aspect = double(o.width) / o.height;
    double grown = 1.15 * o.margin + 1e-6 * std::max({std::abs(middle[0]), std::abs(middle[1]), std::abs(middle[2])});

    // A view's axis: the largest of v + slope z and slope z - v, and of v and -v.
    struct Span {
        double plus = -kInfinity, minus = -kInfinity;
        void add(double p, double m) {
            plus = std::max(plus, p);
            minus = std::max(minus, m);
        }
    };
    const double slope = std::tan(o.fov * (std::numbers::pi / 180) / 2) / 1.05;
    Span across, upward, flat_x, flat_y;
    double nearest = -kInfinity, least = kInfinity, most = -kInfinity;
    for (const Vec3& p : points) {
        const double x = dot(p, right), y = dot(p, up), z = dot(p, back);
        across.add(x + slope * aspect * z, slope * aspect * z - x);
        upward.add(y + slope * z, slope * z - y);
        flat_x.add(x, -x);
        flat_y.add(y, -y);
        nearest = std::max(nearest, z);
        for (const double v : p) {
            least = std::min(least, v);
            most = std::max(most, v);
        }
    }
    if (!(grown > 0 || most - least > 0)) grown = 0.5;  // one point at the origin
    const double depth = nearest + 2 * grown;
    Camera camera;
    camera.up = o.up;
    camera.fov = o.fov;
    double distance;
    if (o.orthographic) {
        const double width = flat_x.plus + flat_x.minus, height = flat_y.plus + flat_y.minus;
        camera.look_at = middle + right * ((flat_x.plus - flat_x.minus) / 2) + up * ((flat_y.plus - flat_y.minus) / 2);
        camera.height = 1.05 * std::max(height + 2 * grown, (width + 2 * grown) / aspect);
        distance = depth + *camera.height;
    } else {
        camera.look_at = middle + right * ((across.plus - across.minus) / 2) + up * ((upward.plus - upward.minus) / 2);
        distance = std::max({(across.plus + across.minus + 2 * grown) / (2 * (slope * aspect)),
            (upward.plus + upward.minus + 2 * grown) / (2 * slope), depth});
    }
    camera.eye = camera.look_at + back * distance;
    return camera;
}

core::CameraRays rays(const Camera& c, int width, int height) {
    constexpr int kMaxPixels = 1 << 28;
    if (width < 1 || height < 1 || std::int64_t(width) * height > kMaxPixels)
        refuse("size", "1 to " + std::to_string(kMaxPixels) + " pixels",
            std::to_string(width) + " x " + std::to_string(height));
    check_finite("eye", c.eye);
    check_finite("look_at", c.look_at);
    check_finite("up", c.up);
    check_fov(c.fov);
    if (c.height) positive("height", *c.height);
    const Vec3 ahead = c.look_at - c.eye;
    if (norm(ahead) == 0) refuse("look_at", "a point other than eye", text(c.look_at));
    const Vec3 forward = divided(ahead, norm(ahead));
    Vec3 right, up;
    axes(forward, c.up, right, up);
    const double half = c.height ? *c.height / 2 : std::tan(c.fov * (std::numbers::pi / 180) / 2);
    Vec3 wide = right * half * width;
    wide = divided(wide, height);
    return {single(c.eye), single(forward), single(wide), single(up * half), width, height, c.height.has_value()};
}

}  // namespace globule
