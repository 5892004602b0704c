// The basis functions against what their bounds and integrals promise; sums of particles; slabs; axes of matrices.
#include "field/column.hpp"
#include "field/eigen.hpp"
#include "field/influence.hpp"
#include "field/spacing.hpp"

#include <functional>

#include "base/wide.hpp"
#include "random.hpp"

namespace {

using core::AnyKernel;

/// fn(kernel, b(x)) for each of the seven.
template <class Fn> void each_kernel(const Fn& fn) {
    for (int name = 0; name <= int(core::KernelName::solid); ++name) {
        CAPTURE(name);
        const AnyKernel kernel{core::KernelName(name)};
        fn(kernel, [&](double x) {
            double b, slope;
            kernel(std::min(x, 1.0), b, slope);
            return b;
        });
    }
}
double simpson(const std::function<double(double)>& f, double from, double to, int n = 2000) {
    const double h = (to - from) / n;
    double sum = f(from) + f(to);
    for (int i = 1; i < n; ++i) sum += (i % 2 ? 4 : 2) * f(from + i * h);
    return sum * h / 3;
}
/// A lane's value, of any kind of lanes.
double first(float v) { return v; }
double first(double v) { return v; }
double first(const core::WideF& v) { return v.v[0]; }
double first(const core::WideD& v) { return v.v[0]; }

core::Sym3<double> random_matrix(Random& random) {
    return {random(-1, 1), random(-1, 1), random(-1, 1), random(-1, 1), random(-1, 1), random(-1, 1)};
}

}  // namespace

TEST_CASE("kernels are 1 in the middle, and 0 with slope 0 at the edge") {
    each_kernel([](const AnyKernel& kernel, const auto& b) {
        double value, slope;
        kernel(1.0, value, slope);
        CHECK(b(0.0) == doctest::Approx(1.0).epsilon(2e-4));
        CHECK(std::abs(value) < 1e-12);
        CHECK(std::abs(slope) < 1e-12);
    });
}

TEST_CASE("a kernel's slope is its derivative") {
    each_kernel([](const AnyKernel& kernel, const auto& b) {
        for (double x = 0.0155; x < 0.98; x += 0.01) {
            double value, slope;
            kernel(x, value, slope);
            CHECK(slope == doctest::Approx((b(x + 1e-6) - b(x - 1e-6)) / 2e-6).epsilon(1e-4));
        }
    });
}

TEST_CASE("bounds on the second derivative along a ray hold, on a window and everywhere") {
    each_kernel([](const AnyKernel& kernel, const auto& b) {
        Random random(1);
        for (int i = 0; i < 300; ++i) {
            const double h2 = random(0, 0.98), A = 1 - h2, edge = std::sqrt(A), from = random(-edge, edge),
                         to = random(from, edge), near = std::max({from, -to, 0.0}), far = std::max(-from, to);
            const double rise = kernel.rise(far * far, A), dive = kernel.dive(near * near, A);
            for (int k = 1; k < 30; ++k) {
                const double u = from + (to - from) * k / 30, d = 1e-4;
                if (std::abs(u) + d > edge) continue;
                const double second =
                    (b(h2 + (u + d) * (u + d)) - 2 * b(h2 + u * u) + b(h2 + (u - d) * (u - d))) / (d * d);
                CHECK(second <= rise + 2e-3);
                CHECK(-second <= kernel.max_fall() + 2e-3);
                CHECK(-second <= dive + 2e-3);
            }
        }
    });
}

TEST_CASE("a kernel's range between two distances is the least and the greatest there") {
    each_kernel([](const AnyKernel& kernel, const auto& b) {
        Random random(2);
        for (int i = 0; i < 100; ++i) {
            const double near = random(), far = random(near, 1.0);
            double lo, hi, least = 1, most = -1;
            kernel.range(near, far, lo, hi);
            for (int k = 0; k <= 200; ++k) {
                const double v = b(near + (far - near) * k / 200);
                least = std::min(least, v);
                most = std::max(most, v);
            }
            CHECK((lo <= least + 1e-12 && lo >= least - 1e-3));
            CHECK((hi >= most - 1e-12 && hi <= most + 1e-3));
        }
    });
}

TEST_CASE("a kernel's column is the integral along the line") {
    each_kernel([](const AnyKernel& kernel, const auto& b) {
        Random random(3);
        for (int i = 0; i < 40; ++i) {
            const double h2 = i ? random(0, 0.99) : 0.0, edge = std::sqrt(1 - h2), u0 = random(-edge, edge),
                         u1 = random(u0, edge);
            CHECK(std::abs(core::column(kernel, h2, u0, u1) -
                           simpson([&](double u) { return b(h2 + u * u); }, u0, u1)) < 1e-6);
            CHECK(core::half_column(kernel, h2, edge) == doctest::Approx(0.5 * core::column(kernel, h2, -edge, edge)));
        }
    });
}

TEST_CASE("integrals of powers of the distance along a line") {
    for (const double h2 : {0.0, 1e-6, 0.3})
        for (const double u : {0.0, 0.2, 0.8}) {
            const core::PowersOnLine powers(h2, u);
            for (int n = 0; n < 7; ++n)
                CHECK(std::abs(powers.i[n] - simpson([&](double v) { return std::pow(h2 + v * v, 0.5 * n); }, 0, u)) <
                      1e-7);
        }
}

TEST_CASE_TEMPLATE("every kind of lanes computes the same kernels", F, float, double, core::WideF, core::WideD) {
    each_kernel([](const AnyKernel& kernel, const auto& exact) {
        for (float x = 0.0f; x <= 1.0f; x += 0.0625f) {
            F b, slope;
            kernel(F(x), b, slope);
            CHECK(std::abs(first(b) - exact(x)) < 2e-6);
        }
    });
}

TEST_CASE_TEMPLATE("axes of a symmetric matrix are orthonormal and compose it again", F, float, double, core::WideF) {
    Random random(4);
    for (int i = 0; i < 50; ++i) {
        const core::Sym3<double> m = random_matrix(random);
        const auto e = core::eigen(core::Sym3<F>{F(m.xx), F(m.yy), F(m.zz), F(m.xy), F(m.xz), F(m.yz)});
        for (int a = 0; a < 3; ++a)
            for (int b = 0; b < 3; ++b) CHECK(std::abs(first(core::dot(e.axis[a], e.axis[b])) - (a == b)) < 1e-5);
        const auto again = e.compose(e.value);
        CHECK(std::abs(first(again.xx) - m.xx) < 1e-5);
        CHECK(std::abs(first(again.yy) - m.yy) < 1e-5);
        CHECK(std::abs(first(again.zz) - m.zz) < 1e-5);
        CHECK(std::abs(first(again.xy) - m.xy) < 1e-5);
        CHECK(std::abs(first(again.xz) - m.xz) < 1e-5);
        CHECK(std::abs(first(again.yz) - m.yz) < 1e-5);
    }
}

TEST_CASE("the axes of a diagonal matrix are the coordinates', of a multiple of one any three") {
    const auto e = core::eigen(core::Sym3<double>{3, -1, 2, 0, 0, 0});
    CHECK((e.value[0] == 3 && e.value[1] == -1 && e.value[2] == 2));
    const auto ball = core::eigen(core::Sym3<double>{5, 5, 5, 0, 0, 0});
    CHECK((ball.value[0] == 5 && ball.value[1] == 5 && ball.value[2] == 5));
}

TEST_CASE("a square of a symmetric matrix is the matrix applied twice") {
    Random random(5);
    for (int i = 0; i < 50; ++i) {
        const core::Sym3<double> m = random_matrix(random);
        const core::Vec3<double> v{random(-1, 1), random(-1, 1), random(-1, 1)}, d = core::square(m) * v - m * (m * v);
        CHECK(core::length(d) < 1e-14);
    }
}

TEST_CASE("a ball, an ellipsoid and its form are one where all axes are as long") {
    Random random(6);
    for (int i = 0; i < 50; ++i) {
        const core::Vec3<double> v{random(-1, 1), random(-1, 1), random(-1, 1)};
        const double g = random(0.3, 0.6), c = random(-2, 2);
        const core::Murakami kernel;
        const auto ball = core::influence(kernel, core::Ball<double>{g * g}, v, c);
        for (const auto& other : {core::influence(kernel, core::Ellipsoid<double>{{g, g, g, 0, 0, 0}}, v, c),
                 core::influence(kernel, core::Form<double>{{g * g, g * g, g * g, 0, 0, 0}}, v, c)}) {
            CHECK(other.value == doctest::Approx(ball.value));
            CHECK(core::length(other.half_gradient - ball.half_gradient) < 1e-12);
        }
    }
}

TEST_CASE("one color blends to itself, whatever the weights") {
    const float colors[6] = {0.2f, 0.4f, 0.6f, 0.2f, 0.4f, 0.6f};
    core::BlendedColor<float> blended;
    blended.add(colors, 0, 0.3f);
    blended.add(colors, 1, 7.0f);
    CHECK(core::length(blended.mean() - float3{0.2f, 0.4f, 0.6f}) < 1e-6f);
}

TEST_CASE("what is dry keeps its color, and what is wet takes the film's") {
    const float3 own{0.2f, 0.4f, 0.6f}, film{1, 0, 0};
    for (const float inside : {0.0f, 0.2f, 0.5f, 1.0f}) {
        float3 color = film + (own - film) * (1 - core::kWetShare * inside);  // as the particles have it
        const float wetness = core::under_film(inside, film, color);
        CHECK(wetness == std::min(2 * inside, 1.0f));
        CHECK(core::length(color - (film + (own - film) * (1 - core::kWetShare * wetness))) < 1e-6f);
    }
}

TEST_CASE("a slab as thick as the ball is all of it, and its thickness follows from its variance") {
    CHECK(core::slab::filled(1.0f) == doctest::Approx(1.0));
    CHECK(core::slab::filled(-0.3f) == -core::slab::filled(0.3f));
    for (const float h : {0.1f, 0.4f, 0.8f}) {
        const auto weight = [](double z) { return std::pow(1 - z * z, 3.0); };  // of a plane of matter
        CHECK(core::slab::filled(h) == doctest::Approx(simpson(weight, 0, h) / simpson(weight, 0, 1)));
        CHECK(core::slab::variance(h) ==
              doctest::Approx(9 * simpson([&](double z) { return z * z * weight(z); }, 0, h) / simpson(weight, 0, h)));
        CHECK(core::slab::half_thickness(core::slab::variance(h)) == doctest::Approx(h).epsilon(1e-4));
    }
}
