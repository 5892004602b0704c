#include "oracle/field.hpp"

#include <algorithm>
#include <vector>

namespace globule::core::oracle {
namespace {

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

void field(const Particles& p, std::size_t m, const double* points, double* value, double* gradient) {
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
        if (gradient) {
            gradient[3 * i] = g.x;
            gradient[3 * i + 1] = g.y;
            gradient[3 * i + 2] = g.z;
        }
    }
}

void first_hit(const Particles& p, double tau, std::size_t m, const float* origins, const float* directions, double* t) {
#pragma omp parallel for schedule(dynamic, 16)
    for (std::size_t i = 0; i < m; ++i) {
        const Vec3<double> o{origins[3 * i], origins[3 * i + 1], origins[3 * i + 2]};
        const Vec3<double> d{directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]};
        std::vector<Ball> met;
        std::vector<double> events{0.0};
        double smallest = infinity(), f0 = 0, heaviness = 0;
        for (std::size_t j = 0; j < p.n; ++j) {
            const Sym3<double> m = matrix(p, j);
            if (!(m.xx > 0)) continue;
            const Vec3<double> q{p.positions[3 * j], p.positions[3 * j + 1], p.positions[3 * j + 2]};
            const Ball ball{m * (o - q), m * d, p.weight[j]};
            const double s = ball.nearest(-infinity(), infinity()), h2 = ball.x(s), speed2 = dot(ball.e, ball.e);
            if (!(h2 < 1)) continue;
            const double half = std::sqrt((1 - h2) / speed2);
            if (s + half <= 0) continue;
            met.push_back(ball);
            heaviness += std::abs(p.weight[j]);
            events.push_back(std::max(0.0, s - half));
            events.push_back(s + half);
            smallest = std::min(smallest, 1 / std::sqrt(speed2));
            double b, slope;
            p.kernel(ball.x(0), b, slope);
            f0 += p.weight[j] * b;
        }
        std::sort(events.begin(), events.end());
        t[i] = infinity();
        const double sign = f0 > tau ? -1 : 1, width = 1e-9 * smallest;
        for (std::size_t k = 0; k + 1 < events.size() && !(t[i] < infinity()); ++k)
            if (events[k + 1] > events[k])
                t[i] = search(met, p.kernel, tau, sign, events[k], events[k + 1], width,
                              1e-13 * (tau + heaviness));
    }
}

}  // namespace globule::core::oracle
