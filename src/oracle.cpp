#include "oracle.hpp"

#include <algorithm>
#include <vector>

namespace globule::oracle {
namespace {

struct Sphere {
    Vec3<double> q;
    double a2, weight;
};

/// Range of f over [t0, t1]: each term lies in b's range between the smallest and the largest distance.
void range(const std::vector<Sphere>& spheres, const AnyKernel& kernel, const Vec3<double>& o, const Vec3<double>& d,
           double dd, double t0, double t1, double& lo, double& hi) {
    lo = hi = 0;
    for (const Sphere& s : spheres) {
        const Vec3<double> v = o - s.q;
        const double closest = std::clamp(-dot(v, d) / dd, t0, t1);
        auto x = [&](double t) {
            const Vec3<double> r = v + d * t;
            return std::min(dot(r, r) / s.a2, 1.0);
        };
        double least, most;
        kernel.range(x(closest), std::max(x(t0), x(t1)), least, most);
        lo += s.weight * (s.weight > 0 ? least : most);
        hi += s.weight * (s.weight > 0 ? most : least);
    }
}

/// First point of [t0, t1] where sign (tau - f) is no longer positive, by exclusion and bisection.
double search(const std::vector<Sphere>& all, const AnyKernel& kernel, double tau, double sign, const Vec3<double>& o,
              const Vec3<double>& d, double dd, double t0, double t1, double least_width, double slack) {
    std::vector<Sphere> here;
    const double pad = least_width;
    for (const Sphere& s : all) {
        const Vec3<double> v = o - s.q;
        const Vec3<double> r = v + d * std::clamp(-dot(v, d) / dd, t0 - pad, t1 + pad);
        if (dot(r, r) < s.a2) here.push_back(s);
    }
    double lo, hi;
    range(here, kernel, o, d, dd, t0, t1, lo, hi);
    if (sign > 0 ? hi < tau : lo > tau) return infinity();
    if (t1 - t0 <= least_width) {
        double at, same;
        range(here, kernel, o, d, dd, t0, t0, at, same);
        // Within a least_width of a root f is as close to tau as rounding lets it be.
        return sign * (tau - at) < slack ? t0 : infinity();
    }
    const double mid = 0.5 * (t0 + t1);
    const double first = search(here, kernel, tau, sign, o, d, dd, t0, mid, least_width, slack);
    return first < infinity() ? first : search(here, kernel, tau, sign, o, d, dd, mid, t1, least_width, slack);
}

}  // namespace

void field(const Particles& p, std::size_t m, const double* points, double* value, double* gradient) {
#pragma omp parallel for schedule(dynamic, 64)
    for (std::size_t i = 0; i < m; ++i) {
        double f = 0;
        Vec3<double> g{0, 0, 0};
        for (std::size_t j = 0; j < p.n; ++j) {
            if (!(p.support[j] > 0)) continue;
            const Vec3<double> r{points[3 * i] - p.positions[3 * j], points[3 * i + 1] - p.positions[3 * j + 1],
                                 points[3 * i + 2] - p.positions[3 * j + 2]};
            const double a2 = p.support[j] * p.support[j], x = dot(r, r) / a2;
            if (!(x < 1)) continue;
            double b, slope;
            p.kernel(x, b, slope);
            f += p.weight[j] * b;
            g = g + r * (p.weight[j] * slope * 2.0 / a2);
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
        const double dd = dot(d, d);
        std::vector<Sphere> met;
        std::vector<double> events{0.0};
        double smallest = infinity(), f0 = 0, heaviness = 0;
        for (std::size_t j = 0; j < p.n; ++j) {
            const double a2 = p.support[j] * p.support[j];
            const Vec3<double> q{p.positions[3 * j], p.positions[3 * j + 1], p.positions[3 * j + 2]};
            const Vec3<double> v = o - q;
            const double s = -dot(v, d) / dd;
            const Vec3<double> nearest = v + d * s;
            const double h2 = dot(nearest, nearest);
            if (!(p.support[j] > 0) || !(h2 < a2)) continue;
            const double half = std::sqrt((a2 - h2) / dd);
            if (s + half <= 0) continue;
            met.push_back({q, a2, p.weight[j]});
            heaviness += std::abs(p.weight[j]);
            events.push_back(std::max(0.0, s - half));
            events.push_back(s + half);
            smallest = std::min(smallest, p.support[j]);
            const double x = dot(v, v) / a2;
            double b = 0, slope;
            if (x < 1) p.kernel(x, b, slope);
            f0 += p.weight[j] * b;
        }
        std::sort(events.begin(), events.end());
        t[i] = infinity();
        const double sign = f0 > tau ? -1 : 1, width = 1e-9 * smallest / std::sqrt(dd);
        for (std::size_t k = 0; k + 1 < events.size() && !(t[i] < infinity()); ++k)
            if (events[k + 1] > events[k])
                t[i] = search(met, p.kernel, tau, sign, o, d, dd, events[k], events[k + 1], width,
                              1e-13 * (tau + heaviness));
    }
}

}  // namespace globule::oracle
