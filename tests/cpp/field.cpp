// The basis functions against what their bounds and integrals promise.
#include "field/column.hpp"

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

TEST_CASE_TEMPLATE("every kind of lanes computes the same kernels", F, float, double, core::WideF, core::WideD) {
    each_kernel([](const AnyKernel& kernel, const auto& exact) {
        for (float x = 0.0f; x <= 1.0f; x += 0.0625f) {
            F b, slope;
            kernel(F(x), b, slope);
            CHECK(std::abs(first(b) - exact(x)) < 2e-6);
        }
    });
}
