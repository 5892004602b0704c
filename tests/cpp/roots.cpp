// First roots along rays: of functions that are known, of balls, and of clouds of particles.
#include <functional>
#include <numbers>

#include "particles.hpp"
#include "trace/exact.hpp"
#include "trace/resolve.hpp"

namespace {

using Function = std::function<double(double)>;

/// A function of the distance, its derivative, and the most that it bends anywhere.
struct Curve {
    Function f, slope;
    double bend;

    /// A polynomial that is 0 at these places, and negative before the first of them.
    static Curve with_roots(const std::vector<double>& roots, double from, double to) {
        std::vector<double> c{roots.size() % 2 ? 1.0 : -1.0};
        for (const double r : roots) {
            c.insert(c.begin(), 0.0);
            for (std::size_t i = 0; i + 1 < c.size(); ++i) c[i] -= r * c[i + 1];
        }
        const auto value = [](const std::vector<double>& c, double t) {
            double sum = 0;
            for (std::size_t i = c.size(); i-- > 0;) sum = sum * t + c[i];
            return sum;
        };
        const auto derivative = [](const std::vector<double>& c) {
            std::vector<double> d;
            for (std::size_t i = 1; i < c.size(); ++i) d.push_back(double(i) * c[i]);
            return d;
        };
        const auto first = derivative(c), second = derivative(first);
        double bend = 0;
        for (int i = 0; i <= 1000; ++i) bend = std::max(bend, std::abs(value(second, from + (to - from) * i / 1000)));
        return {[=](double t) { return value(c, t); }, [=](double t) { return value(first, t); }, 1.01 * bend};
    }
    static Curve sine() {
        return {[](double t) { return std::sin(t); }, [](double t) { return std::cos(t); }, 1.0};
    }

    // As march() asks for it.
    bool any(bool active) const { return active; }
    template <bool, class F> core::Along<F> at(F t, const core::Limits<F>&, bool = true) const {
        return {F(f(t)), F(slope(t)), F(bend), F(bend)};
    }
};
struct Found {
    double t;
    bool hit, doubtful;
};
template <class F = double, bool leaving = false>
Found first_root(const Curve& curve, double tau, double from, double end, double side = 1) {
    const bool exact = sizeof(F) == 8;
    const core::Limits<F> lim{F(tau), F(0.23), F(exact ? 1e-13 : 1e-6), F(exact ? 1e-12 : 1e-6), F(side)};
    F t = F(from);
    bool hit = false, doubtful = false;
    core::march<leaving>(curve, lim, F(end), true, t, hit, doubtful);
    return {double(t), hit, doubtful};
}
constexpr double kPi = std::numbers::pi;

/// Where rays meet the surface, as the last word has it.
struct Rays {
    std::vector<float3> origin, direction, normal, albedo;
    std::vector<float> t;

    void add(const float3& o, const float3& d) { origin.push_back(o), direction.push_back(d); }
    void solve(Built& b, core::AnyKernel kernel, float tau) {
        const std::size_t n = origin.size();
        t.assign(n, 0.0f);
        normal.resize(n), albedo.resize(n);
        std::vector<std::uint32_t> all(n);
        for (std::size_t i = 0; i < n; ++i) all[i] = std::uint32_t(i);
        core::RaySource source{};
        source.origins = &origin.data()->x;
        source.directions = &direction.data()->x;
        source.n = n;
        core::Hits hits{t.data(), &normal.data()->x, &albedo.data()->x, {nullptr, all.data()}};
        core::ResolveRays<true> resolve{b.tree(), b.sorted(), kernel, tau, nullptr, {0.1f, 0.2f, 0.3f}, source, hits};
        b.cpu.for_each_tile(n, resolve);
    }
};
double kernel_at(core::AnyKernel kernel, double x) {
    double b, slope;
    kernel(std::min(x, 1.0), b, slope);
    return b;
}
/// The first place where f crosses tau, by steps and halving.
double by_steps(const Function& f, double tau, double end, double step) {
    const bool inside = f(0) > tau;
    for (double t = 0; t < end; t += step) {
        if ((f(t + step) > tau) == inside) continue;
        double lo = t, hi = t + step;
        for (int i = 0; i < 60; ++i) {
            const double mid = 0.5 * (lo + hi);
            ((f(mid) > tau) == inside ? lo : hi) = mid;
        }
        return lo;
    }
    return core::infinity();
}

}  // namespace

TEST_CASE_TEMPLATE("each root of a cubic is the first one behind the root before it", F, float, double) {
    const Curve cubic = Curve::with_roots({1, 2, 3}, 0, 5);
    for (const auto& [from, side, root] : {std::tuple{0.0, 1, 1.0}, {1.2, -1, 2.0}, {2.2, 1, 3.0}}) {
        const Found found = first_root<F>(cubic, 0, from, 5, side);
        CHECK(found.hit);
        CHECK(found.t == doctest::Approx(root).epsilon(sizeof(F) == 8 ? 1e-10 : 1e-5));
    }
    CHECK(!first_root<F>(cubic, 0, 3.5, 5, -1).hit);
}

TEST_CASE("roots of random polynomials come one after the other, and none is passed") {
    Random random(1);
    for (int i = 0; i < 300; ++i) {
        std::vector<double> roots;
        double at = 0;
        for (std::uint64_t n = 1 + random.below(5); n > 0; --n) roots.push_back(at += random(0.02, 0.3));
        const Curve curve = Curve::with_roots(roots, 0, at + 0.1);
        double from = 0, side = 1;
        for (std::size_t k = 0; k < roots.size(); ++k) {
            const Found found = first_root(curve, 0, from, at + 0.1, side);
            REQUIRE(found.hit);
            CHECK(found.t == doctest::Approx(roots[k]).epsilon(1e-8));
            from = k + 1 < roots.size() ? 0.5 * (roots[k] + roots[k + 1]) : at + 0.05;
            side = -side;
        }
        CHECK(!first_root(curve, 0, from, at + 0.1, side).hit);
    }
}

TEST_CASE("a wave crosses its threshold at the arc sine, from outside and from inside") {
    CHECK(first_root(Curve::sine(), 0.5, 0, 10).t == doctest::Approx(kPi / 6));
    CHECK(first_root(Curve::sine(), 0.5, kPi / 2, 10, -1).t == doctest::Approx(5 * kPi / 6));
    CHECK(!first_root(Curve::sine(), 1.01, 0, 100).hit);
}

TEST_CASE("a parabola that misses the threshold by little is passed, one that reaches it is met") {
    for (const double over : {-1e-2, -1e-6, -1e-9, 1e-2, 1e-6, 1e-9}) {
        const Curve parabola{[=](double t) { return over - (t - 2) * (t - 2); }, [](double t) { return 4 - 2 * t; }, 2};
        const Found found = first_root(parabola, 0, 0, 5);
        CHECK(found.hit == (over > 0));
        CHECK(!found.doubtful);
        if (over > 0) CHECK(found.t == doctest::Approx(2 - std::sqrt(over)).epsilon(1e-9));
    }
}

TEST_CASE("where a parabola touches the threshold nobody can tell: that is said, and where") {
    const Curve parabola{[](double t) { return -(t - 2) * (t - 2); }, [](double t) { return 4 - 2 * t; }, 2};
    const Found found = first_root(parabola, 0, 0, 5);
    CHECK(found.doubtful);
    CHECK(!found.hit);
    CHECK(found.t == doctest::Approx(2).epsilon(1e-5));
}

TEST_CASE("a peak is met however thin it is") {
    for (const double width : {1e-1, 1e-3, 1e-5}) {
        const auto f = [=](double t) { return std::exp(-(t - 2) * (t - 2) / (width * width)); };
        const Curve peak{f, [=](double t) { return -2 * (t - 2) / (width * width) * f(t); }, 2 / (width * width)};
        const Found found = first_root(peak, 0.5, 2 - 40 * width, 3);
        CHECK(found.hit);
        CHECK(std::abs(found.t - (2 - width * std::sqrt(std::log(2.0)))) < 1e-6 * width);
    }
}

TEST_CASE("what lies behind the end is not met") {
    const Found found = first_root(Curve::sine(), 0.5, 0, kPi / 6 - 1e-3);
    CHECK(!found.hit);
    CHECK(found.t >= kPi / 6 - 1e-3);
    CHECK(found.t < kPi / 6);
}

TEST_CASE("a ray that leaves the surface does not meet it where it begins") {
    for (const double off : {0.0, 1e-14, 1e-9, 1e-4}) {
        const Found found = first_root<double, true>(Curve::sine(), 0.5, 5 * kPi / 6 + off, 10);
        CHECK(found.hit);
        CHECK(found.t == doctest::Approx(2 * kPi + kPi / 6).epsilon(1e-9));
    }
}

TEST_CASE("the field along a ray has the slope and the bounds that steps are taken by") {
    Random random(2);
    for (int i = 0; i < 500; ++i) {
        const core::AnyKernel kernel{core::KernelName(i % 7)};
        const double side = i % 2 ? 1 : -1, window = random(0.05, 0.5), d = 1e-4;
        core::Vec3<double> way{random(-1, 1), random(-1, 1), random(-1, 1)};
        way = core::normalize(way);
        struct {
            core::Vec3<double> v;
            double a, c;
        } ball[5];
        for (auto& b : ball) b = {{random(-1, 1), random(-1, 1), random(-1, 1)}, random(0.5, 2), random(-1, 1)};
        const auto along = [&](double t) {
            core::Along<double> sum{0, 0, 0, 0};
            for (const auto& b : ball)
                core::add<true, true, true>(sum, kernel, b.v + way * t, way, 1 / (b.a * b.a), b.c,
                    core::Limits<double>{0.3, window, 0, 0, side});
            sum.slope *= 2;
            return sum;
        };
        const auto here = along(0);
        CHECK(here.slope == doctest::Approx((along(1e-6).f - along(-1e-6).f) / 2e-6).epsilon(1e-4));
        for (int k = 1; k < 10; ++k) {
            const double t = window * k / 10,
                         second = side * (along(t + d).f - 2 * along(t).f + along(t - d).f) / (d * d);
            CHECK(second <= here.rise + 1e-2);
            CHECK(-second <= here.fall + 1e-2);
        }
    }
}

TEST_CASE("a ball is met where its kernel falls to the threshold, and its normal leads outward") {
    Random random(4);
    for (int name = 0; name < 7; ++name) {
        const core::AnyKernel kernel{core::KernelName(name)};
        const double tau = 0.3, a = 2,
                     r = a * by_steps([&](double q) { return kernel_at(kernel, q * q); }, tau, 1, 1e-2);
        Built b({{1, 2, 3}}, {}, {float(a)});
        Rays rays;
        for (int i = 0; i < 50; ++i) {
            const float3 from = float3{1, 2, 3} + random.direction() * 5.0f, to = float3{1, 2, 3} + random.direction();
            rays.add(from, core::normalize(to - from));
        }
        rays.solve(b, kernel, float(tau));
        for (int i = 0; i < 50; ++i) {
            const float3 v = rays.origin[i] - b.points[0], d = rays.direction[i];
            const double along = core::dot(v, d), half2 = along * along - core::dot(v, v) + r * r;
            CHECK((rays.t[i] < core::infinity()) == (half2 > 0));
            if (half2 < 1e-3) continue;
            CHECK(rays.t[i] == doctest::Approx(-along - std::sqrt(half2)).epsilon(1e-5));
            CHECK(core::length(rays.normal[i] - core::normalize(v + d * rays.t[i])) < 1e-4f);
        }
    }
}

TEST_CASE("first hits of a cloud are those of small steps, from outside and from inside") {
    const auto points = cloud(150, 3);
    Random random(5);
    std::vector<float> support(150), weight(150);
    for (int j = 0; j < 150; ++j) support[j] = float(random(0.1, 0.4)), weight[j] = float(random(-0.3, 1));
    Built b(points, {}, support, weight);
    const core::AnyKernel kernel{core::KernelName::wyvill};
    Rays rays;
    for (int i = 0; i < 60; ++i) rays.add(random.point(i % 2 ? 0.3 : -0.5, i % 2 ? 0.7 : 1.5), random.direction());
    rays.solve(b, kernel, 0.6f);
    int hits = 0;
    for (int i = 0; i < 60; ++i) {
        const auto f = [&](double t) {
            double sum = 0;
            for (int j = 0; j < 150; ++j) {
                const float3 o = rays.origin[i], d = rays.direction[i], p = points[j];
                const double x = o.x + t * d.x - p.x, y = o.y + t * d.y - p.y, z = o.z + t * d.z - p.z;
                sum += weight[j] * kernel_at(kernel, (x * x + y * y + z * z) / (double(support[j]) * support[j]));
            }
            return sum;
        };
        const double right = by_steps(f, 0.6f, 3, 2e-3);
        if (right < core::infinity()) CHECK(rays.t[i] == doctest::Approx(right).epsilon(1e-5));
        else CHECK(rays.t[i] == core::infinity());
        hits += right < core::infinity();
    }
    CHECK(hits > 20);
}

TEST_CASE("a root is settled to float64, and a tangent stays where it was found") {
    const core::Vec3<double> o{0, 0, 0}, d{1, 0, 0};
    const auto sine = [](const core::Vec3<double>& p, bool) {
        return core::Influence<double>{std::sin(p.x), {0.5 * std::cos(p.x), 0, 0}};
    };
    double t = kPi / 6 + 3e-4;
    core::settle(sine, 0.5, 1.0, o, d, t);
    CHECK(t == doctest::Approx(kPi / 6).epsilon(1e-15));
    double flat = kPi / 2 + 1e-3;
    core::settle(sine, 1.0 + 1e-3, 1.0, o, d, flat);
    CHECK(flat == kPi / 2 + 1e-3);
}
