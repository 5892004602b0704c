// The reference for fields and their first hits: float64, brute force, slow and obvious.
#include <algorithm>
#include <vector>

#include "base/vec.hpp"
#include "field/kernels.hpp"

namespace globule::core {
namespace {

/// The particles as float64 views.  Particle j adds weight b(|G (x - q)|); G is 0 where it reaches nothing.
struct Particles {
    std::size_t n;
    const float* positions;
    const double* matrices;  ///< (n, 6) xx yy zz xy xz yz; 1 / support on the diagonal: a ball
    const double* weight;
    AnyKernel kernel;
};

/// A particle on a ray, where its support is the unit ball: at v + e t.
struct Ball {
    Vec3<double> v, e;
    double weight;
    double nearest(double t0, double t1) const { return std::clamp(-dot(v, e) / dot(e, e), t0, t1); }
    double x(double t) const {
        const Vec3<double> r = v + e * t;
        return std::min(dot(r, r), 1.0);
    }
};

Sym3<double> matrix(const Particles& p, std::size_t j) {
    const double* m = p.matrices + 6 * j;
    return {m[0], m[1], m[2], m[3], m[4], m[5]};
}

/// Range of f over [t0, t1]: each term lies in b's range between the smallest and the largest distance.
void range(const std::vector<Ball>& balls, const AnyKernel& kernel, double t0, double t1, double& lo, double& hi) {
    lo = hi = 0;
    for (const Ball& s : balls) {
        double least, most;
        kernel.range(s.x(s.nearest(t0, t1)), std::max(s.x(t0), s.x(t1)), least, most);
        lo += s.weight * (s.weight > 0 ? least : most);
        hi += s.weight * (s.weight > 0 ? most : least);
    }
}

/// First point of [t0, t1] where sign (tau - f) is no longer positive, by exclusion and bisection.
double search(const std::vector<Ball>& all, const AnyKernel& kernel, double tau, double sign, double t0, double t1,
    double least_width, double slack) {
    std::vector<Ball> here;
    const double pad = least_width;
    for (const Ball& s : all)
        if (s.x(s.nearest(t0 - pad, t1 + pad)) < 1) here.push_back(s);
    double lo, hi;
    range(here, kernel, t0, t1, lo, hi);
    if (sign > 0 ? hi < tau : lo > tau) return infinity();
    if (t1 - t0 <= least_width) {
        double at, same;
        range(here, kernel, t0, t0, at, same);
        // Within a least_width of a root f is as close to tau as rounding lets it be.
        return sign * (tau - at) < slack ? t0 : infinity();
    }
    const double mid = 0.5 * (t0 + t1);
    const double first = search(here, kernel, tau, sign, t0, mid, least_width, slack);
    return first < infinity() ? first : search(here, kernel, tau, sign, mid, t1, least_width, slack);
}

}  // namespace

}  // namespace globule::core

using namespace globule::core;

/// f and grad f at m points.
extern "C" void oracle_field(std::size_t n, const float* positions, const double* matrices, const double* weight,
    int kernel, std::size_t m, const double* points, double* value, double* gradient) {
    const Particles p{n, positions, matrices, weight, {KernelName(kernel)}};

#pragma omp parallel for schedule(dynamic, 64)
    for (std::size_t i = 0; i < m; ++i) {
        double f = 0;
        Vec3<double> g{0, 0, 0};
        for (std::size_t j = 0; j < p.n; ++j) {
            const Vec3<double> r{points[3 * i] - p.positions[3 * j], points[3 * i + 1] - p.positions[3 * j + 1],
                points[3 * i + 2] - p.positions[3 * j + 2]};
            const Sym3<double> m = matrix(p, j);
            const Vec3<double> w = m * r;
            const double x = dot(w, w);
            if (!(x < 1) || !(m.xx > 0)) continue;
            double b, slope;
            p.kernel(x, b, slope);
            f += p.weight[j] * b;
            g = g + (m * w) * (p.weight[j] * slope * 2.0);
        }
        value[i] = f;
        gradient[3 * i] = g.x;
        gradient[3 * i + 1] = g.y;
        gradient[3 * i + 2] = g.z;
    }
}

/// Smallest t >= 0 with f(o + t d) = tau (directions need not have unit length; t counts them); infinity where there is
/// none.
extern "C" void oracle_first_hit(std::size_t n, const float* positions, const double* matrices, const double* weight,
    int kernel, double tau, std::size_t m, const float* origins, const float* directions, double* t) {
    const Particles p{n, positions, matrices, weight, {KernelName(kernel)}};
#pragma omp parallel for schedule(dynamic, 16)
    for (std::size_t i = 0; i < m; ++i) {
        const Vec3<double> o{origins[3 * i], origins[3 * i + 1], origins[3 * i + 2]};
        const Vec3<double> d{directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]};
        // Each ball's part of the ray in 64 bits of mantissa, counted from where the first begins: then float64 is as
        // precise for an eye far away.
        using Long = long double;
        struct Met {
            Vec3<Long> v, e;
            double weight;
        };
        std::vector<Met> met;
        std::vector<Long> events{0};
        Long base = infinity();
        double smallest = infinity(), f0 = 0, heaviness = 0;
        for (std::size_t j = 0; j < p.n; ++j) {
            const Sym3<double> m64 = matrix(p, j);
            if (!(m64.xx > 0)) continue;
            const Sym3<Long> m{m64.xx, m64.yy, m64.zz, m64.xy, m64.xz, m64.yz};
            const Vec3<Long> away{
                Long(o.x) - p.positions[3 * j], Long(o.y) - p.positions[3 * j + 1], Long(o.z) - p.positions[3 * j + 2]};
            const Met ball{m * away, m * Vec3<Long>{d.x, d.y, d.z}, p.weight[j]};
            const Long speed2 = dot(ball.e, ball.e), s = -dot(ball.v, ball.e) / speed2;
            const Vec3<Long> nearest = ball.v + ball.e * s;
            const Long h2 = dot(nearest, nearest);
            if (!(h2 < 1)) continue;
            const Long half = std::sqrt((1 - h2) / speed2);
            if (s + half <= 0) continue;
            met.push_back(ball);
            heaviness += std::abs(p.weight[j]);
            events.push_back(std::max<Long>(0, s - half));
            events.push_back(s + half);
            base = std::min(base, events[events.size() - 2]);
            smallest = std::min(smallest, double(1 / std::sqrt(speed2)));
            double b, slope;
            p.kernel(std::min(1.0, double(dot(ball.v, ball.v))), b, slope);
            f0 += p.weight[j] * b;
        }
        t[i] = infinity();
        if (met.empty()) continue;
        std::vector<Ball> balls;
        for (const Met& m : met) {
            const Vec3<Long> v = m.v + m.e * base;
            balls.push_back(
                {{double(v.x), double(v.y), double(v.z)}, {double(m.e.x), double(m.e.y), double(m.e.z)}, m.weight});
        }
        std::vector<double> from_base;
        for (const Long e : events) from_base.push_back(std::max(0.0, double(e - base)));
        std::sort(from_base.begin(), from_base.end());
        const double sign = f0 > tau ? -1 : 1;
        for (std::size_t k = 0; k + 1 < from_base.size() && !(t[i] < infinity()); ++k) {
            // A support far behind the first may be so small that float64 does not count its parts.
            const double width = std::max(1e-9 * smallest, 4e-16 * from_base[k + 1]);
            if (from_base[k + 1] > from_base[k])
                t[i] = search(
                    balls, p.kernel, tau, sign, from_base[k], from_base[k + 1], width, 1e-13 * (tau + heaviness));
        }
        t[i] += double(base);
    }
}
