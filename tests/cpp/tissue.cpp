// Bonds between particles of tissue, and what tissue cannot enter.
#include "bonds.hpp"

#include "sim/friction.hpp"

namespace {

double total(const Tissue& t, float core::Quad::* part) {
    double sum = 0;
    for (const core::Quad& v : t.velocity) sum += v.*part / v.w;
    return sum;
}
double energy(Tissue& t) {
    const tissue::EnergyOf of{t.bonds(), t.at.data()};
    double sum = 0;
    for (std::uint32_t i = 0; i < t.n; ++i) sum += of(i);
    return sum;
}
std::uint32_t tear(Tissue& t, const tissue::Materials& materials, float dt) {
    std::uint32_t n = 0;
    const tissue::TearAndCreep step{t.bonds(), t.at.data(), t.phase.data(), materials, dt, &n};
    for (std::uint32_t i = 0; i < t.n; ++i) step(i);
    return n;
}
std::vector<std::pair<std::uint32_t, std::uint32_t>> all_pairs(std::uint32_t n) {
    std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs;
    for (std::uint32_t a = 0; a < n; ++a)
        for (std::uint32_t b = a + 1; b < n; ++b) pairs.push_back({a, b});
    return pairs;
}
std::vector<float3> some_points(int n) {
    Random random(1);
    std::vector<float3> points(n);
    for (float3& p : points) p = random.point();
    return points;
}

}  // namespace

TEST_CASE("bonds change neither momentum nor angular momentum") {
    for (const int n : {2, 5, 33, 70}) {
        Tissue t(some_points(n), all_pairs(n), 1.0f, 2.0f);
        for (core::Quad& p : t.at) p = {1.2f * p.x, 0.9f * p.y, p.z, p.w};
        t.run(1, 0.05f);
        double spin[3] = {}, speed = 0;
        for (int i = 0; i < n; ++i) {
            const float3 l = core::cross(t.at[i].xyz(), t.velocity[i].xyz());
            spin[0] += l.x, spin[1] += l.y, spin[2] += l.z;
            speed += core::length(t.velocity[i].xyz());
        }
        CHECK(speed > 1e-4);
        for (const auto part : {&core::Quad::x, &core::Quad::y, &core::Quad::z})
            CHECK(std::abs(total(t, part)) < 1e-5 * speed);
        for (const double l : spin) CHECK(std::abs(l) < 1e-5 * speed);
    }
}

TEST_CASE("a weight on a spring comes to rest where its weight is the spring's force") {
    const float k = 50, mass = 0.5f, g = 9.81f;
    Tissue t({{0, 0, 0}, {0, -1, 0}}, {{0, 1}}, k, mass);
    t.hold[0] = tissue::kFixed;
    tissue::Materials materials;
    materials.damping[0] = 5;
    t.run(5000, 0.002f, {0, -g, 0}, materials);
    CHECK(t.at[0].y == 0.0f);
    CHECK(-t.at[1].y == doctest::Approx(1 + mass * g / k).epsilon(1e-4));
}

TEST_CASE("the energy of bonds is half the stiffness times the square of what they are stretched by") {
    Tissue t({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 1}, {0, 2}}, 3.0f);
    CHECK(energy(t) == 0.0);
    t.at[1].x = 1.5f;
    t.at[2].y = 0.5f;
    CHECK(energy(t) == doctest::Approx(2 * 0.5 * 3 * 0.25));
    t.bonds().set_length(0, t.bonds().begin(0), -1.0f);  // cut
    CHECK(energy(t) == doctest::Approx(0.5 * 3 * 0.25));
}

TEST_CASE("bonds break beyond the strain of the weaker of their ends, at once at both") {
    tissue::Materials materials;
    materials.tear_strain[0] = 0.5f;
    materials.tear_strain[1] = 0.2f;
    for (const auto& [stretch, phase, torn] :
        {std::tuple{1.4f, 0, false}, {1.6f, 0, true}, {1.4f, 1, true}, {1.1f, 1, false}, {100.0f, 2, true}}) {
        Tissue t({{0, 0, 0}, {1, 0, 0}}, {{0, 1}});
        t.at[1].x = stretch;
        t.phase[1] = std::uint8_t(phase);  // 2: never by itself, so that the other end decides
        CHECK(tear(t, materials, 0.1f) == std::uint32_t(torn));
        for (const std::uint32_t i : {0u, 1u}) CHECK((t.length[t.bonds().begin(i)] < 0) == torn);
    }
}

TEST_CASE("beyond the yield strain a bond creeps as exp(-rate t), either way") {
    for (const float strain : {0.3f, -0.3f, 0.05f}) {
        tissue::Materials materials;
        materials.yield_strain[0] = 0.1f;
        materials.creep_rate[0] = 2.0f;
        Tissue t({{0, 0, 0}, {1, 0, 0}}, {{0, 1}});
        t.at[1].x = 1 + strain;
        CHECK(tear(t, materials, 0.25f) == 0);
        const double beyond = std::max(std::abs(strain) - 0.1, 0.0), creep = beyond * (1 - std::exp(-0.5));
        CHECK(t.length[t.bonds().begin(1)] == doctest::Approx(1 + (strain > 0 ? creep : -creep)).epsilon(1e-6));
    }
}

TEST_CASE("cut faces push each other apart and never pull") {
    for (const float apart : {0.5f, 0.95f, 1.5f}) {
        Tissue t({{0, 0, 0}, {1, 0, 0}}, {{0, 1}});
        t.bonds().set_length(0, t.bonds().begin(0), -1.0f);
        t.at[1].x = apart;
        t.run(1, 0.01f, {}, {}, 0.9f);
        CHECK((t.velocity[1].x > 0) == (apart < 0.9f));
        CHECK(t.velocity[1].x >= 0);
        CHECK(t.velocity[0].x == doctest::Approx(-t.velocity[1].x));
    }
}

TEST_CASE("without bonds particles fly as they were thrown") {
    Tissue t(some_points(40), {});
    const core::Quad from = t.at[33];
    t.velocity[33].x = 2;
    const float dt = 1e-2f;
    t.run(100, dt, {0, -10, 0});
    CHECK(t.at[33].x == doctest::Approx(from.x + 2).epsilon(1e-4));
    CHECK(t.at[33].y == doctest::Approx(from.y - 5 * (1 + dt)).epsilon(1e-4));
    CHECK(t.velocity[33].y == doctest::Approx(-10).epsilon(1e-4));
}

TEST_CASE("distances from a ball, a capsule and a half-space") {
    using tissue::Shape;
    const Shape ball{Shape::ball, {1, 0, 0}, {}, 0.5f, {}}, capsule{Shape::capsule, {0, 0, 0}, {2, 0, 0}, 0.25f, {}},
        ground{Shape::half_space, {0, 1, 0}, {0, 1, 0}, 0.5f, {}};
    float3 out;
    CHECK(ball.distance({1, 2, 0}, out) == doctest::Approx(1.5));
    CHECK(out.y == doctest::Approx(1));
    CHECK(ball.distance({1, 0, 0}, out) == doctest::Approx(-0.5));
    CHECK(core::length(out) == 1.0f);
    CHECK(capsule.distance({1, 1, 0}, out) == doctest::Approx(0.75));
    CHECK(capsule.distance({5, 4, 0}, out) == doctest::Approx(4.75));
    CHECK(out.x == doctest::Approx(0.6));
    CHECK(capsule.distance({-3, 0, 0}, out) == doctest::Approx(2.75));
    CHECK(ground.distance({7, 3, 7}, out) == doctest::Approx(1.5));
}

TEST_CASE("what meets a shape leaves it, and loses of its speed what leads in and what friction takes") {
    constexpr float dt = 0.1f;
    tissue::Shapes shapes;
    shapes.n = 1;
    for (const float mu : {0.0f, 0.2f, 5.0f}) {
        shapes.shape[0] = {tissue::Shape::half_space, {0, 0, 0}, {0, 1, 0}, 0, {1, 0, 0}, mu};
        core::Quad load{0, 0, 0, 0};
        shapes.loads = {&load, 1 / dt, 0.05f};  // the mean of one substep
        float3 x{0, -0.1f, 0}, u{4, -2, 0}, felt{0, 0, 0};
        shapes.keep_out(0, x, u, 0.0f, dt, [&](int, const float3& change) { felt = felt + change; });
        CHECK(x.y == doctest::Approx(0));
        CHECK(u.y == doctest::Approx(0));
        CHECK(u.x == doctest::Approx(std::max(4 - mu * 2, 1.0f)));  // to the shape's own speed and no slower
        CHECK(felt.y == doctest::Approx(2));
        CHECK(felt.x == doctest::Approx(u.x - 4));
        CHECK(x.x == doctest::Approx((u.x - 4) * dt));
        load = {0, 0, 0, 0};
        float3 away{0, -0.1f, 0}, leaving{4, 2, 0};
        shapes.keep_out(0, away, leaving, 0.0f, dt, [](int, const float3& change) { CHECK(length(change) == 0.0f); });
        CHECK((leaving.x == 4 && leaving.y == 2));
        shapes.loads = {};
        float3 smooth{0, -0.1f, 0}, sliding{4, -2, 0};
        shapes.keep_out(0, smooth, sliding, 0.0f, dt, [](int, const float3&) {});
        CHECK(sliding.x == 4);  // nothing has friction
    }
}

TEST_CASE("friction between cut faces is opposite at both, and slows sliding without turning it round") {
    for (const float mu : {0.1f, 0.5f, 100.0f}) {
        Tissue t({{0, 0, 0}, {0.5f, 0, 0}}, {{0, 1}}, 2.0f);
        t.bonds().set_length(0, t.bonds().begin(0), -1.0f);
        t.velocity[0].y = 1;
        tissue::Materials materials;
        materials.friction[0] = mu;
        float3 impulse[2];
        const tissue::Rub rub{t.bonds(), t.at.data(), t.velocity.data(), t.hold.data(), t.phase.data(), materials, 0.1f,
            0.9f, true, impulse};
        rub(0), rub(1);
        CHECK(core::length(impulse[0] + impulse[1]) == 0.0f);
        const float press = 0.4f * 2 * 0.1f;
        CHECK(impulse[0].y == doctest::Approx(-std::min(mu * press, 0.5f)));  // half of what would stop both
    }
}
