// Arrays in and out: shapes, types, layouts, devices.
#include <algorithm>
#include <cmath>

#include "helpers.hpp"

using namespace globule;

TEST_CASE("shapes and types of a view") {
    const std::vector<float> flat(6);
    CHECK(ArrayView(flat).shape() == Shape(6));
    CHECK(ArrayView(std::vector<std::array<double, 3>>(2)).shape() == Shape(2, 3));
    int n = 2;
    CHECK(ArrayView(flat.data(), {n, 3}).shape() == Shape(2, 3));
    CHECK(ArrayView(flat.data(), {n, 3}).dtype() == DType::float32);
    CHECK(Shape(2, 3, 4).size() == 24);
    CHECK(!ArrayView().given());
    CHECK(ArrayView(std::vector<float>()).given());
    CHECK(size_of(DType::uint16) == 2);
    CHECK(on_gpu().stream == 1);
    CHECK(Location().device == Location::host);
}

TEST_CASE("positions may be flat, rows, or float64") {
    const std::vector<float> flat = cube(6);
    std::vector<std::array<double, 3>> rows;
    for (std::size_t i = 0; i < flat.size(); i += 3) rows.push_back({flat[i], flat[i + 1], flat[i + 2]});
    const Camera camera = Camera::fit(flat);
    const auto a = Scene({.positions = flat}, on_cpu).render(camera, 64, 48).image();
    CHECK(
        a == Scene({.positions = ArrayView(flat.data(), {flat.size() / 3, 3})}, on_cpu).render(camera, 64, 48).image());
    CHECK(a == Scene({.positions = rows}, on_cpu).render(Camera::fit(rows), 64, 48).image());
}

TEST_CASE("converted colors outlive the caller's") {
    const std::vector<float> p = cube(6);
    const Camera camera = Camera::fit(p);
    std::vector<float> red;
    for (std::size_t i = 0; i < p.size() / 3; ++i) red.insert(red.end(), {1, 0, 0});
    const auto expected = Scene({.positions = p, .color = red}, on_cpu).render(camera, 64, 48).image();
    Scene bytes, doubles;
    {
        std::vector<std::uint8_t> of_bytes;
        for (const float v : red) of_bytes.push_back(std::uint8_t(255 * v));
        bytes = Scene({.positions = p, .color = of_bytes}, on_cpu);
        std::vector<double> of_doubles(red.begin(), red.end());
        doubles = Scene({.positions = p, .color = of_doubles}, on_cpu);
        for (double& v : of_doubles) v = 0.5;
    }
    CHECK(bytes.render(camera, 64, 48).image() == expected);
    CHECK(doubles.render(camera, 64, 48).image() == expected);
    CHECK(Scene({.positions = p, .color = {1, 0, 0}}, on_cpu).render(camera, 64, 48).image() == expected);
}

TEST_CASE("what is wrong with an array is named") {
    const std::vector<float> p = cube(3);
    const std::size_t n = p.size() / 3;
    Scene s({.positions = p}, on_cpu);
    CHECK_SAYS(s.update({}), "positions: expected an array, got none");
    CHECK_SAYS(s.update({.positions = std::vector<float>(4)}), "positions: expected shape (N, 3) or (3 N,), got (4,)");
    CHECK_SAYS(s.update({.positions = std::vector<int>(3)}), "positions: expected float32 or float64, got int32");
    CHECK_SAYS(s.update({.positions = ArrayView(static_cast<const float*>(nullptr), {2, 3})}),
        "positions: expected an address, got null");
    CHECK_SAYS(s.update({.positions = p, .color = std::vector<float>(3 * n, 2.0f)}),
        "color: expected 0 to 1, got 2 (particle 0)");
    CHECK_SAYS(s.update({.positions = p, .support = std::vector<float>(n, -1.0f)}),
        "support: expected a number >= 0, got -1 (particle 0)");
    CHECK_SAYS(s.update({.positions = p, .support = 0}), "support: expected a positive number, got 0");
    CHECK_SAYS(s.update({.positions = p, .anisotropy = std::vector<float>(9 * n)}),
        "anisotropy: expected symmetric positive definite");
    std::vector<float> far(n, 1.0f);
    far[1] = 1e9f;
    CHECK_SAYS(s.update({.positions = p, .support = far}), "support: expected all within a factor of 1e+06");
    CHECK_SAYS(s.blend(p, std::vector<float>(5)), "values: expected 27 rows, got 5");
    CHECK_SAYS(s.neighbors(p, 0), "radius: expected a positive number");
    CHECK(s.size() == n);  // all of this changed nothing
    CHECK(s.field(p).size() == n);
}

TEST_CASE("an array on a GPU that cannot be reached is refused, never read") {
    if (devices().size() > 1) return;
    const std::vector<float> p = cube(3);
    Scene s({.positions = p}, on_cpu);
    const auto* address = reinterpret_cast<const float*>(0x1000);
    CHECK_SAYS(s.update({.positions = ArrayView(address, {27, 3}, on_gpu())}),
        "positions: expected memory that can be reached, got an a");
    CHECK_SAYS(s.update({.positions = p, .color = ArrayView(address, {27, 3}, on_gpu())}),
        "color: expected memory that can be reached");
    const Frame f = s.render(Camera::fit(p), 8, 8);
    CHECK_SAYS(f.color(MutableArrayView(const_cast<float*>(address), {8, 8, 3}, on_gpu())),
        "color: expected host memory, where this frame is, got memory of a GPU");
}

TEST_CASE("rows of an image go from top to bottom, and positions lie on the rays") {
    const std::vector<float> p{0, 1, 0};
    const Scene s({.positions = p, .support = 1}, on_cpu);
    const Camera camera{.eye = {0, 0, 5}, .look_at = {0, 0, 0}, .fov = 60};
    const int w = 40, h = 30;
    const Frame f = s.render(camera, w, h);
    const auto mask = f.mask();
    const auto depth = f.distance(), position = f.position(), normal = f.normal();
    int top = 0, bottom = 0;
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) {
            const std::size_t i = std::size_t(y) * w + x;
            (y < h / 2 ? top : bottom) += mask[i];
            CHECK(bool(mask[i]) == std::isfinite(depth[i]));
            CHECK(bool(mask[i]) == std::isfinite(position[3 * i]));
            if (!mask[i]) continue;
            const float dx = position[3 * i], dy = position[3 * i + 1], dz = position[3 * i + 2] - 5;
            CHECK(std::sqrt(dx * dx + dy * dy + dz * dz) == doctest::Approx(depth[i]).epsilon(1e-5));
            CHECK(normal[3 * i + 2] > 0);
        }
    CHECK(top > 10);
    CHECK(bottom == 0);

    std::vector<float> into(std::size_t(w) * h);
    f.distance(MutableArrayView(into.data(), {h, w}));
    CHECK(into == depth);
    CHECK_SAYS(f.distance(MutableArrayView(into.data(), {w, h})), "distance: expected shape (30, 40), got (40, 30)");
    CHECK_SAYS(f.image(MutableArrayView(into.data(), {h, w, 3})), "image: expected an array of uint8, got float32");
}

TEST_CASE("neighbors are rows, and the field is the sum of kernels") {
    const std::vector<float> p = cube(4), points{0.15f, 0.15f, 0.15f, 9, 9, 9};
    const Scene s({.positions = p}, {.support = 0.2, .device = "cpu"});
    const Neighbors found = s.neighbors(points, 0.12);
    CHECK(found.offsets == std::vector<std::uint64_t>{0, 8, 8});
    const auto value = s.field(points), gradient = s.gradient(points);
    CHECK(value[1] == 0);
    double sum = 0;
    for (std::size_t j = 0; j < p.size(); j += 3) {
        double square = 0;
        for (int k = 0; k < 3; ++k) square += std::pow(points[k] - p[j + k], 2);
        const double x = square / 0.04;
        if (x < 1) sum += (1 - x) * (1 - x);
    }
    CHECK(value[0] == doctest::Approx(sum));
    CHECK(gradient.size() == 6);
    std::vector<float> speed(p.size() / 3, 3.0f);
    CHECK(s.blend(points, speed)[0] == doctest::Approx(3));
    // Through all balls' influence: the sum of lines of (1 - r^2 / h^2)^2, 16/15 h (1 - b^2 / h^2)^{5/2} at distance b.
    double line = 0;
    for (std::size_t j = 0; j < p.size(); j += 3) {
        const double b2 = std::pow(p[j] - 0.15, 2) + std::pow(p[j + 1] - 0.15, 2);
        if (b2 < 0.04) line += 16.0 / 15 * 0.2 * std::pow(1 - b2 / 0.04, 2.5);
    }
    const std::vector<float> origin{0.15f, 0.15f, 3}, down{0, 0, -1};
    CHECK(s.integrate(origin, down, std::vector<float>(p.size() / 3, 2.0f))[0] ==
          doctest::Approx(2 * line).epsilon(1e-4));
    const Intersections hits = s.intersect(std::vector<float>{0.15f, 0.15f, 3}, std::vector<float>{0, 0, -1});
    CHECK(hits.distance[0] == doctest::Approx(2.6).epsilon(0.05));
    std::vector<std::uint64_t> keys;
    std::vector<std::uint32_t> index;
    s.sorted_keys(keys, index);
    CHECK(std::is_sorted(keys.begin(), keys.end()));
    CHECK(index.size() == 64);
    CHECK(s.octree().n_inside == 64);
    CHECK(s.octree(true).key_hash != 0);
}

TEST_CASE("answers go into arrays of the caller's") {
    const std::vector<float> p = cube(4), points{0.15f, 0.15f, 0.15f, 0.05f, 0.1f, 0.2f}, two(128, 2.0f);
    const Scene s({.positions = p}, {.support = 0.2, .device = "cpu"});
    const ArrayView values(two.data(), {64, 2});
    std::vector<float> field(2), gradient(6), blended(4), lines(4), t(2), normal(6);
    s.field(points, field);
    s.gradient(points, MutableArrayView(gradient.data(), {2, 3}));
    s.blend(points, values, blended);
    const std::vector<float> down{0, 0, -1, 0, 0, -1}, above{0.15f, 0.15f, 3, 0.05f, 0.1f, 3};
    s.integrate(above, down, values, lines);
    s.intersect(above, down, t, normal);
    CHECK(field == s.field(points));
    CHECK(gradient == s.gradient(points));
    CHECK(blended == s.blend(points, values));
    CHECK(lines == s.integrate(above, down, values));
    CHECK(t == s.intersect(above, down).distance);
    CHECK(normal == s.intersect(above, down).normal);
    const Neighbors expected = s.neighbors(points, 0.12);
    std::vector<std::uint64_t> offsets(3);
    std::vector<std::uint32_t> few(1, 77), enough(100, 77);
    CHECK(s.neighbors(points, 0.12, offsets, few) == expected.indices.size());
    CHECK(few[0] == 77);
    CHECK(s.neighbors(points, 0.12, offsets, enough) == expected.indices.size());
    CHECK(offsets == expected.offsets);
    CHECK(std::equal(expected.indices.begin(), expected.indices.end(), enough.begin()));
    CHECK(enough[expected.indices.size()] == 77);
    CHECK_SAYS(s.field(points, gradient), "out: expected 2 numbers, got (6,)");
    CHECK_SAYS(s.gradient(points, offsets), "out: expected an array of float32, got uint64");
    if (devices().size() == 1)
        CHECK_SAYS(s.field(points, MutableArrayView(field.data(), {2}, on_gpu())), "out: expected memory that can be");
}

TEST_CASE("pieces of a scene share their space") {
    const std::vector<float> p = cube(4), half(p.begin(), p.begin() + 96);
    const Scene all({.positions = p}, {.support = 0.2, .device = "cpu"});
    const OctreeFacts facts = all.octree();
    const Box cubical{
        facts.low, {facts.low[0] + facts.extent, facts.low[1] + facts.extent, facts.low[2] + facts.extent}};
    const Scene piece({.positions = half},
        {.support = 0.2, .device = "cpu", .bounds = cubical, .typical_support = 0.3, .most_weight = 2});
    const OctreeFacts of_piece = piece.octree();
    CHECK(of_piece.low == facts.low);
    CHECK(of_piece.extent == facts.extent);
    CHECK(of_piece.typical_support == doctest::Approx(0.3));
    CHECK(of_piece.most_weight == 2);
    std::vector<std::uint64_t> keys, of_half;
    std::vector<std::uint32_t> index;
    all.sorted_keys(keys, index);
    piece.sorted_keys(of_half, index);
    CHECK(std::includes(keys.begin(), keys.end(), of_half.begin(), of_half.end()));
}
