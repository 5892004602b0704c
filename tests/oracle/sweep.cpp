// The reference for volumes from sweeps: float64, brute force, slow and obvious.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace {

/// Images as float64, with the poses that the fast paths use (32 fractional bits).
struct SweepInput {
    int n, height, width;
    const double* values;       ///< (n, height, width)
    const std::int64_t* poses;  ///< (n, 9): origin, column step, row step, voxels
    const std::uint8_t* mask;   ///< (height, width) or null
    int size[3];                ///< voxels x, y, z
    bool whole;                 ///< values are rounded to integers, halves up
};

struct Point { double x, y, z, value; };

std::size_t place(const int size[3], int x, int y, int z) { return (std::size_t(z) * size[1] + y) * size[0] + x; }
double rounded(double v, bool whole) { return whole ? std::floor(v + 0.5) : v; }

Point locate(const SweepInput& in, int f, int row, int column) {
    const std::int64_t* p = in.poses + 9 * f;
    auto at = [&](int k) { return double(p[k] + column * p[3 + k] + row * p[6 + k]) * 0x1p-32; };
    return {at(0), at(1), at(2), in.values[(std::size_t(f) * in.height + row) * in.width + column]};
}
bool inside(const SweepInput& in, const Point& p) {
    return p.x >= 0 && p.y >= 0 && p.z >= 0 && p.x < in.size[0] && p.y < in.size[1] && p.z < in.size[2];
}

/// Points of each voxel, in order of arrival.
std::vector<std::vector<Point>> lists(const SweepInput& in) {
    std::vector<std::vector<Point>> all(std::size_t(in.size[0]) * in.size[1] * in.size[2]);
    for (int f = 0; f < in.n; ++f)
        for (int row = 0; row < in.height; ++row)
            for (int column = 0; column < in.width; ++column) {
                if (in.mask && !in.mask[row * in.width + column]) continue;
                const Point p = locate(in, f, row, column);
                if (inside(in, p)) all[place(in.size, int(p.x), int(p.y), int(p.z))].push_back(p);
            }
    return all;
}

double compound(std::vector<Point> points, int mode) {
    if (mode == 2) return points.back().value;
    if (mode == 3) return points.front().value;
    std::sort(points.begin(), points.end(), [](const Point& a, const Point& b) { return a.value < b.value; });
    const std::size_t n = points.size();
    if (mode == 1) return points.back().value;
    if (mode == 4) return 0.5 * (points[(n - 1) / 2].value + points[n / 2].value);
    double sum = 0;
    for (const Point& p : points) sum += p.value;
    return sum / double(n);
}

/// Calls visit for the voxels of the cube that lie in the grid.
template <class Visit> void for_cube(const int size[3], int x, int y, int z, int r, const Visit& visit) {
    for (int k = std::max(z - r, 0); k <= std::min(z + r, size[2] - 1); ++k)
        for (int j = std::max(y - r, 0); j <= std::min(y + r, size[1] - 1); ++j)
            for (int i = std::max(x - r, 0); i <= std::min(x + r, size[0] - 1); ++i) visit(i, j, k);
}

/// Mean of (distance^2, value) weighted by exp(-d^2 / sigma^2), sigma the largest distance.
double weighted(const std::vector<std::pair<double, double>>& near, bool printed) {
    double sigma2 = 0, sum = 0, weights = 0;
    for (const auto& [d2, value] : near) sigma2 = std::max(sigma2, d2);
    for (const auto& [d2, value] : near) {
        const double w = sigma2 > 0 ? std::exp(-d2 / sigma2) : 1.0;
        sum += w * value;
        weights += w;
    }
    return sum / (printed ? double(near.size()) : weights);
}

template <class Visit> void for_voxels(const int size[3], const Visit& visit) {
    for (int z = 0; z < size[2]; ++z)
        for (int y = 0; y < size[1]; ++y)
            for (int x = 0; x < size[0]; ++x) visit(x, y, z, place(size, x, y, z));
}

/// One value a voxel, NaN where no pixel falls; compounding as sweep::Compounding.
void bin(const SweepInput& in, int compounding, double* out) {
    const auto all = lists(in);
    for (std::size_t i = 0; i < all.size(); ++i)
        out[i] = all[i].empty() ? std::numeric_limits<double>::quiet_NaN()
                                : rounded(compound(all[i], compounding), in.whole);
}

/// Mean of samples along Bezier curves through pixels of four images, and each voxel's smallest distance of a sample
/// from a pixel along an axis, voxels; 0 where a pixel lies in the voxel.
void bezier(const SweepInput& in, double* out, double* distance) {
    const std::size_t n_voxels = std::size_t(in.size[0]) * in.size[1] * in.size[2];
    std::vector<double> sums(n_voxels), counts(n_voxels);
    std::fill_n(distance, n_voxels, std::numeric_limits<double>::infinity());
    const double binomial[4][4] = {{1}, {1, 1}, {1, 2, 1}, {1, 3, 3, 1}};
    for (int start = 0; start == 0 || start < in.n - 1; start += 3) {
        const int degree = std::min(3, in.n - 1 - start);
        for (int row = 0; row < in.height; ++row)
            for (int column = 0; column < in.width; ++column) {
                if (in.mask && !in.mask[row * in.width + column]) continue;
                std::vector<Point> control;
                double length = 0;
                for (int f = 0; f <= degree; ++f) {
                    const Point p = locate(in, start + f, row, column);
                    if (f) {
                        const Point& q = control.back();
                        length += std::max({std::abs(p.x - q.x), std::abs(p.y - q.y), std::abs(p.z - q.z)});
                    }
                    control.push_back(p);
                }
                const int n = int(length) + 1;
                for (int s = 0; s < n + (start + degree == in.n - 1); ++s) {
                    const double t = double(s) / n;
                    Point p{0, 0, 0, 0};
                    for (int f = 0; f <= degree; ++f) {
                        const double b = binomial[degree][f] * std::pow(t, f) * std::pow(1 - t, degree - f);
                        p.x += b * control[f].x;
                        p.y += b * control[f].y;
                        p.z += b * control[f].z;
                        p.value += b * control[f].value;
                    }
                    if (!inside(in, p)) continue;
                    for (const Point& c : control) {
                        double& least = distance[place(in.size, int(p.x), int(p.y), int(p.z))];
                        least =
                            std::min(least, std::max({std::abs(p.x - c.x), std::abs(p.y - c.y), std::abs(p.z - c.z)}));
                    }
                    sums[place(in.size, int(p.x), int(p.y), int(p.z))] += p.value;
                    counts[place(in.size, int(p.x), int(p.y), int(p.z))] += 1;
                }
            }
    }
    const auto pixels = lists(in);
    for (std::size_t i = 0; i < n_voxels; ++i)
        if (!pixels[i].empty()) {
            distance[i] = 0;
            if (counts[i] > 0) continue;
            for (const Point& p : pixels[i]) sums[i] += p.value;
            counts[i] = double(pixels[i].size());
        }
    for (std::size_t i = 0; i < n_voxels; ++i)
        out[i] = counts[i] > 0 ? rounded(sums[i] / counts[i], in.whole) : std::numeric_limits<double>::quiet_NaN();
}

/// Fills NaN voxels from the smallest cube with a value; radius 0 measured, 255 still empty (value 0).
void fill(
    const int size[3], bool whole, const double* bins, int reach, bool printed, double* out, std::uint8_t* radius) {
    for_voxels(size, [&](int x, int y, int z, std::size_t at) {
        out[at] = bins[at];
        radius[at] = 0;
        if (!std::isnan(bins[at])) return;
        out[at] = 0;
        radius[at] = 255;
        for (int r = 1; r <= reach && radius[at] == 255; ++r) {
            std::vector<std::pair<double, double>> near;
            for_cube(size, x, y, z, r, [&](int i, int j, int k) {
                const double v = bins[place(size, i, j, k)], dx = i - x, dy = j - y, dz = k - z;
                if (!std::isnan(v)) near.emplace_back(dx * dx + dy * dy + dz * dz, v);
            });
            if (near.empty()) continue;
            out[at] = rounded(weighted(near, printed), whole);
            radius[at] = std::uint8_t(r);
        }
    });
}

/// VVN: every voxel from the pixels in the smallest sphere (rho = radius + 1/2) that holds one.
void gather(const SweepInput& in, int reach, bool printed, double* out, std::uint8_t* radius) {
    const auto all = lists(in);
    for_voxels(in.size, [&](int x, int y, int z, std::size_t at) {
        out[at] = 0;
        radius[at] = 255;
        for (int r = 1; r <= reach && radius[at] == 255; ++r) {
            std::vector<std::pair<double, double>> near;
            for_cube(in.size, x, y, z, r, [&](int i, int j, int k) {
                for (const Point& p : all[place(in.size, i, j, k)]) {
                    const double dx = p.x - x - 0.5, dy = p.y - y - 0.5, dz = p.z - z - 0.5;
                    const double d2 = dx * dx + dy * dy + dz * dz;
                    if (d2 <= (r + 0.5) * (r + 0.5)) near.emplace_back(d2, p.value);
                }
            });
            if (near.empty()) continue;
            out[at] = rounded(weighted(near, printed), in.whole);
            radius[at] = std::uint8_t(all[at].empty() ? r : 0);
        }
    });
}

}  // namespace

/// method: 0 bins, 1 bezier, 2 voxel by voxel.
extern "C" void oracle_sweep(int method, const double* values, const std::int64_t* poses, const std::uint8_t* mask,
    const int frames[3], const int size[3], bool whole, int compounding, int reach, bool printed, double* out,
    std::uint8_t* radius, double* distance) {
    const SweepInput in{frames[0], frames[1], frames[2], values, poses, mask, {size[0], size[1], size[2]}, whole};
    if (method == 2) return gather(in, reach, printed, out, radius);
    std::vector<double> bins(std::size_t(size[0]) * size[1] * size[2]);
    if (method == 1) bezier(in, bins.data(), distance);
    else bin(in, compounding, bins.data());
    fill(in.size, whole, bins.data(), reach, printed, out, radius);
}
