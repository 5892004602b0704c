// A rigid body's turns against formulas and a fine integration of Euler's equations.
#include "sim/rigid_body.hpp"

#include <vector>

#include "random.hpp"

namespace {

namespace sim = core::sim;
using core::RigidBody;
using V = RigidBody::V;
using M = RigidBody::M;

M diagonal(double a, double b, double c) { return {a, 0, 0, 0, b, 0, 0, 0, c}; }
V times(const M& m, const V& v) {
    V out{};
    for (int k = 0; k < 3; ++k) out[k] = m[3 * k] * v[0] + m[3 * k + 1] * v[1] + m[3 * k + 2] * v[2];
    return out;
}
double dot(const V& a, const V& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
double apart(const V& a, const V& b) { return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]); }
V momentum(const RigidBody& b) { return times(b.inertia_now(), b.spin); }
double energy(const RigidBody& b) { return 0.5 * dot(momentum(b), b.spin); }
RigidBody body(const M& inertia, const V& spin, double mass = 2) {
    RigidBody b(mass, {0, 0, 0}, inertia);
    b.spin = spin;
    return b;
}
/// The spin about the body's own axes after t, by Runge and Kutta's steps of 0.1 ms.
V euler(const M& i, V w, double t) {
    const auto rate = [&](const V& w) {
        return V{
            (i[4] - i[8]) * w[1] * w[2] / i[0], (i[8] - i[0]) * w[2] * w[0] / i[4], (i[0] - i[4]) * w[0] * w[1] / i[8]};
    };
    const auto moved = [](const V& w, const V& by, double dt) {
        return V{w[0] + dt * by[0], w[1] + dt * by[1], w[2] + dt * by[2]};
    };
    const int n = int(std::round(t / 1e-4));
    for (int s = 0; s < n; ++s) {
        const double dt = t / n;
        const V a = rate(w), b = rate(moved(w, a, dt / 2)), c = rate(moved(w, b, dt / 2)), d = rate(moved(w, c, dt));
        for (int k = 0; k < 3; ++k) w[k] += dt / 6 * (a[k] + 2 * b[k] + 2 * c[k] + d[k]);
    }
    return w;
}
V in_body(const RigidBody& b, const V& v) {
    const sim::Pose p = b.pose();
    return {p.x.x * v[0] + p.x.y * v[1] + p.x.z * v[2], p.y.x * v[0] + p.y.y * v[1] + p.y.z * v[2],
        p.z.x * v[0] + p.z.y * v[1] + p.z.z * v[2]};
}
const M kUneven = diagonal(1, 2, 3);

}  // namespace

TEST_CASE("about a main axis a body turns evenly") {
    for (int axis = 0; axis < 3; ++axis) {
        V spin{};
        spin[axis] = 3;
        RigidBody b = body(kUneven, spin);
        for (int s = 0; s < 100; ++s) b.advance(0.01);
        CHECK(apart(b.spin, spin) < 1e-12);
        const sim::Pose p = b.pose();
        const float3 e[3] = {p.x, p.y, p.z};
        const int next = (axis + 1) % 3;
        const float part[3] = {e[next].x, e[next].y, e[next].z};
        CHECK(part[next] == doctest::Approx(std::cos(3.0)));
        CHECK(part[(axis + 2) % 3] == doctest::Approx(std::sin(3.0)));
    }
}

TEST_CASE("a push changes momenta, whatever way the body is turned") {
    RigidBody b = body(kUneven, {1, 2, 3});
    for (int s = 0; s < 10; ++s) b.advance(0.03);
    const V before = momentum(b);
    const double p[3] = {4, -6, 8}, l[3] = {0.5, 1, -2};
    b.push(p, l);
    CHECK(apart(b.velocity, {2, -3, 4}) < 1e-14);
    CHECK(apart(momentum(b), {before[0] + 0.5, before[1] + 1, before[2] - 2}) < 1e-12);
}

TEST_CASE("a body that tumbles keeps its angular momentum and its energy") {
    for (const double dt : {0.1, 5e-3, 1e-3}) {
        RigidBody b = body(kUneven, {1, 8, 0.1});
        const V before = momentum(b);
        const double e = energy(b);
        for (int s = 0; s < int(10 / dt); ++s) b.advance(dt);
        CHECK(apart(momentum(b), before) < 1e-9);
        CHECK(energy(b) == doctest::Approx(e).epsilon(1e-4));
    }
}

TEST_CASE("Dzhanibekov's flips come when Euler's equations say") {
    for (const double dt : {0.02, 5e-3}) {
        RigidBody b = body(kUneven, {0, 10, 0.01});
        V right = b.spin;
        std::vector<double> found, expected;
        for (int s = 0; s < int(8 / dt); ++s) {
            const double was = in_body(b, b.spin)[1], should = right[1];
            b.advance(dt);
            right = euler(kUneven, right, dt);
            if (was * in_body(b, b.spin)[1] < 0) found.push_back(s * dt);
            if (should * right[1] < 0) expected.push_back(s * dt);
        }
        REQUIRE(expected.size() >= 3);
        REQUIRE(found.size() == expected.size());
        for (std::size_t k = 0; k < found.size(); ++k)
            CHECK(std::abs(found[k] - expected[k]) < 0.02 * expected[k] + dt);
    }
}

TEST_CASE("a top's axis goes around its angular momentum with L / I") {
    RigidBody b = body(diagonal(2, 2, 3), {1, 0, 4});
    const V l = momentum(b);
    const double rate = std::sqrt(dot(l, l)) / 2, period = 2 * 3.14159265358979 / rate;
    for (int s = 0; s < 100; ++s) b.advance(period / 100);
    CHECK(core::length(b.pose().z - float3{0, 0, 1}) < 1e-3f);
    for (int s = 0; s < 50; ++s) b.advance(period / 100);
    CHECK(core::length(b.pose().z - float3{0, 0, 1}) > 0.3f);
}

TEST_CASE("what has no inertia keeps its spin, and takes no moment") {
    RigidBody b = body(M{}, {1, 2, 3});
    const double p[3] = {0, 0, 0}, l[3] = {1, 1, 1};
    b.push(p, l);
    b.advance(0.5);
    CHECK(apart(b.spin, {1, 2, 3}) == 0);
    CHECK(b.inverse_inertia_now() == M{});
}

TEST_CASE("inertia and its inverse are turned with the body") {
    RigidBody b(1, {0, 0, 0}, {2, 0.3, 0.1, 0.3, 3, -0.2, 0.1, -0.2, 4});
    b.spin = {1, -2, 0.5};
    for (int s = 0; s < 30; ++s) {
        const M i = b.inertia_now(), inverse = b.inverse_inertia_now();
        for (const V& e : {V{1, 0, 0}, V{0, 1, 0}, V{0, 0, 1}}) CHECK(apart(times(inverse, times(i, e)), e) < 1e-12);
        CHECK(i[0] + i[4] + i[8] == doctest::Approx(9));
        CHECK((std::abs(i[1] - i[3]) < 1e-12 && std::abs(i[2] - i[6]) < 1e-12 && std::abs(i[5] - i[7]) < 1e-12));
        b.advance(0.1);
    }
}

TEST_CASE("axes stay orthonormal and right-handed over very many turns") {
    RigidBody b = body(kUneven, {20, 30, 40});
    for (int s = 0; s < 3000; ++s) b.advance(0.01);
    const sim::Pose p = b.pose();
    CHECK(std::abs(core::dot(p.x, p.y)) < 1e-6f);
    CHECK(core::length(core::cross(p.x, p.y) - p.z) < 1e-6f);
}

TEST_CASE("a center flies straight on, and comes in again where the domain repeats") {
    RigidBody b = body(kUneven, {0, 0, 0});
    b.velocity = {10, -3, 7};
    b.advance(1);
    b.wrap({-1, -1, -1}, {4, 0, 4});
    CHECK(apart(b.center(), {2, -3, -1}) < 1e-12);
}

TEST_CASE("a body made of another's numbers goes on as that") {
    RigidBody a = body(kUneven, {1, 2, 3});
    a.velocity = {1, 0, 2};
    for (int s = 0; s < 10; ++s) a.advance(0.05);
    RigidBody b(a.numbers());
    for (RigidBody* body : {&a, &b}) body->advance(0.05);
    CHECK(a.numbers() == b.numbers());
}

TEST_CASE("a pose leads to the world and back") {
    RigidBody b = body(kUneven, {3, 1, 2});
    b.velocity = {1, 2, 3};
    b.advance(1);
    Random random(1);
    for (int i = 0; i < 20; ++i) {
        const float3 p = random.point(-3, 3);
        CHECK(core::length(b.pose().to_body(b.pose().to_world(p)) - p) < 3e-6f);
        CHECK(core::length(b.pose().to_world(p) - b.center_float()) == doctest::Approx(core::length(p)).epsilon(1e-5));
    }
}

TEST_CASE("particles of a body are led to its next pose, the nearest way around a domain that repeats") {
    core::Quad place[2] = {{1, 0, 0, 0}, {9.5f, 0, 0, 0}}, velocity[2] = {{0, 0, 0, 7}, {}}, home[2] = {};
    std::uint32_t id[2] = {1, 0};
    std::uint8_t phase[2] = {3, 3};
    const sim::State state{2, place, velocity, id, phase, nullptr, nullptr, nullptr};
    sim::Pose pose;
    for (const std::size_t i : {0, 1}) sim::Capture{state, 3, pose, home}(i);
    CHECK(home[1].x == 1.0f);
    pose.origin = {1, 2, 0};
    for (const std::size_t i : {0, 1}) sim::Carry{state, 3, pose, home, {{10, 0, 0}}, 0.5f}(i);
    CHECK((velocity[0].x == 2 && velocity[0].y == 4 && velocity[0].w == 7));
    place[1].x = 0.5f;  // it came in again on the other side
    sim::Carry{state, 3, pose, home, {{10, 0, 0}}, 0.5f}(1);
    CHECK((velocity[1].x == 0 && velocity[1].y == 4));
}
