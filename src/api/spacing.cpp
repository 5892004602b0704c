// Few particles are mostly surface, and in a plane or a line a ball of neighbors is mostly empty: there the spacing
// comes from the Delaunay tessellation. Simplices whose empty balls are larger than some spacings are left out (an
// alpha complex, Edelsbrunner and Muecke 1994), so that what lies apart stays apart. Inside of it a particle has the
// volume that it shares with others: sum of volumes / sum of the corners' parts of a full angle. Rows and layers, which
// have no volume, follow from the complex's intrinsic volumes: N = V3 / s^3 + V2 / s^2 + V1 / s + V0 for a lattice of
// spacing s (docs/design/surface.md).
//
// Each particle's simplices are found by themselves, from its Voronoi cell: faces, edges and corners of the cell are
// edges, triangles and tetrahedra at the particle, and their distance from it is the radius of the simplex's smallest
// empty ball. Each simplex is divided among its corners, so that some of many particles stand for all.
#include "api/spacing.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>

#include "base/vec.hpp"
#include "field/eigen.hpp"

namespace globule::core {
namespace {

using Vec = Vec3<double>;

constexpr double kFarthest = 1e18;  ///< coordinates of an octree
constexpr double kThin = 1e-6,
                 kFarThin =
                     1e-3;  ///< extent across a plane or line over that along it; most that rounding may make of it
constexpr double kRounding = 4.0 / (1 << 24);      ///< of coordinates
constexpr double kLargest[] = {0, 3.0, 2.0, 1.5};  ///< radius of a simplex's ball, spacings, by the dimension
constexpr double kJitter = 1e-5;  ///< spacings, against points of lattices, whose tessellation is not unique
constexpr double kBody = 0.12,
                 kClearlyBody =
                     0.4;        ///< least share of the particles' volume between them; eight corners of a cube: 1/8
constexpr double kAlike = 0.12;  ///< how far the two ways may differ
constexpr double kMostOverNeighbors = 1.3;  ///< of the spacing by volume; a close packing has 1.28
constexpr double kTurn = 2 * std::numbers::pi;

std::uint64_t hashed(std::uint64_t x) {  // splitmix64
    x += 0x9E3779B97F4A7C15ull;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ull;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBull;
    return x ^ (x >> 31);
}

/// What the simplices of one ball's size add to V0 to V3 of the complex, as far as one of their corners answers for
/// them, and to the sum of angles of those of the highest dimension, parts of a full angle.
struct Part { double radius, volume[4], angle; };

/// The cell of the point at 0: all that is nearer to it than to the others.
class Cell {
public:
    /// A cube of half an edge, which neighbors cut.
    explicit Cell(double half) {
        for (int k = 0; k < 6; ++k) {
            const double at = k % 2 ? 2 * half : -2 * half;
            others_.push_back({k / 2 == 0 ? at : 0, k / 2 == 1 ? at : 0, k / 2 == 2 ? at : 0});
        }
        for (int x = 0; x < 2; ++x)
            for (int y = 2; y < 4; ++y)
                for (int z = 4; z < 6; ++z) (x + y + z) % 2 ? add(x, y, z) : add(y, x, z);
    }
    /// Cuts off what is nearer to another point. As of the Delaunay tessellation by Bowyer and Watson: corners that go
    /// leave a ring of edges, each of which is a corner with the new plane.
    void cut(const Vec& other) {
        const double far = 0.5 * dot(other, other);
        const auto gone = std::stable_partition(
            corners_.begin(), corners_.end(), [&](const Corner& c) { return dot(c.at, other) <= far; });
        if (gone == corners_.end()) return;
        sides_.clear();
        for (auto c = gone; c != corners_.end(); ++c)
            for (int k = 0; k < 3; ++k) sides_.push_back({c->of[k], c->of[(k + 1) % 3]});
        corners_.erase(gone, corners_.end());
        const int next = int(others_.size());
        others_.push_back(other);
        for (const auto& [a, b] : sides_)
            if (std::find(sides_.begin(), sides_.end(), std::pair{b, a}) == sides_.end()) add(a, b, next);
    }
    /// Squared distance of the farthest corner.
    double reach() const {
        double most = 0;
        for (const Corner& c : corners_) most = std::max(most, dot(c.at, c.at));
        return most;
    }
    /// The simplices at the point. dimension: the highest.
    void describe(int dimension, std::vector<Part>& out) const {
        std::vector<Edge> edges;
        for (const Corner& c : corners_) {
            for (int k = 0; k < 3; ++k) edges.push_back({std::minmax(c.of[k], c.of[(k + 1) % 3]), c.at});
            if (std::min({c.of[0], c.of[1], c.of[2]}) >= kSides) out.push_back(tetrahedron(c, dimension));
        }
        std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) { return a.of < b.of; });
        std::vector<double> nearest(others_.size(), std::numeric_limits<double>::infinity());
        for (std::size_t i = 0; i + 1 < edges.size(); i += 2) {
            const auto [a, b] = edges[i].of;
            const double away = distance(edges[i].at, edges[i + 1].at);
            nearest[a] = std::min(nearest[a], away);
            nearest[b] = std::min(nearest[b], away);
            if (a < kSides) continue;
            const Vec &p = others_[a], &q = others_[b];
            const double area = 0.5 * length(cross(p, q)), around = 0.25 * (length(p) + length(q));
            // In a plane by their angles: then any particle of a lattice stands for all.
            const double angle = dimension == 2 ? std::atan2(2 * area, dot(p, q)) / kTurn : 0;
            out.push_back({away, {1.0 / 3, -around, area * (dimension == 2 ? 2 * angle : 1.0 / 3), 0}, angle});
        }
        for (std::size_t a = kSides; a < others_.size(); ++a) {
            if (nearest[a] == std::numeric_limits<double>::infinity()) continue;  // later ones cut its face off
            const Vec middle = others_[a] * 0.5;
            const double half = length(middle);
            const bool inside = std::all_of(others_.begin(), others_.end(),
                [&](const Vec& q) { return dot(middle, q) <= (0.5 + 1e-12) * dot(q, q); });
            out.push_back({inside ? half : nearest[a], {-0.5, half, 0, 0}, dimension == 1 ? 0.5 : 0});
        }
        out.push_back({0, {1, 0, 0, 0}, 0});
    }

private:
    static constexpr int kSides = 6;  ///< of the cube
    struct Corner {
        std::array<int, 3> of;  ///< planes, counterclockwise from outside
        Vec at;
    };
    struct Edge {
        std::pair<int, int> of;
        Vec at;  ///< one of its ends
    };

    void add(int a, int b, int c) {
        const Vec &p = others_[a], &q = others_[b], &r = others_[c];
        const Vec qr = cross(q, r);
        const Vec sum = qr * dot(p, p) + cross(r, p) * dot(q, q) + cross(p, q) * dot(r, r);
        corners_.push_back({{a, b, c}, sum * (0.5 / dot(p, qr))});
    }
    static double distance(const Vec& from, const Vec& to) {
        const Vec along = to - from;
        const double square = dot(along, along);
        return length(from + along * (square > 0 ? std::clamp(-dot(from, along) / square, 0.0, 1.0) : 0));
    }
    Part tetrahedron(const Corner& c, int dimension) const {
        const Vec p[3] = {others_[c.of[0]], others_[c.of[1]], others_[c.of[2]]};
        const double l[3] = {length(p[0]), length(p[1]), length(p[2])}, six = abs(dot(p[0], cross(p[1], p[2])));
        double faces = 0, turns = 0;
        for (int k = 0; k < 3; ++k) {
            const Vec &a = p[k], one = cross(a, p[(k + 1) % 3]), other = cross(a, p[(k + 2) % 3]);
            faces += 0.5 * length(one);
            const double dihedral = std::atan2(length(cross(one, other)), dot(one, other));
            turns += l[k] * (0.5 - dihedral / kTurn);
        }
        const double solid = 2 * std::atan2(six, l[0] * l[1] * l[2] + dot(p[0], p[1]) * l[2] + dot(p[1], p[2]) * l[0] +
                                                     dot(p[2], p[0]) * l[1]);
        return {length(c.at), {-0.25, 0.5 * turns, -faces / 6, six / 24}, dimension == 3 ? solid / (2 * kTurn) : 0};
    }

    std::vector<Vec> others_;
    std::vector<Corner> corners_;
    std::vector<std::pair<int, int>> sides_;
};

/// Where V3 / s^3 + V2 / s^2 + V1 / s + V0 = n.
double root(const double* volume, double n) {
    double low = 1e-3, high = 1e3;
    for (int i = 0; i < 60; ++i) {
        const double s = sqrt(low * high), t = 1 / s;
        (((volume[3] * t + volume[2]) * t + volume[1]) * t + volume[0] < n ? high : low) = s;
    }
    return low;
}

/// The spacing of n particles of which the parts are, ascending by radius.
double solve(const std::vector<Part>& parts, double n, int dimension) {
    const auto sums = [&](double spacing) {
        Part sum{};
        for (const Part& p : parts) {
            if (p.radius > kLargest[dimension] * spacing) break;
            for (int k = 0; k < 4; ++k) sum.volume[k] += p.volume[k];
            sum.angle += p.angle;
        }
        return sum;
    };
    const auto settle = [&](const auto& better) {
        double spacing = 1.3;
        for (int i = 0; i < 50; ++i) {
            const double last = spacing;
            spacing = better(sums(last));
            if (abs(spacing - last) <= 1e-6 * spacing) break;
        }
        return spacing;
    };
    Part found{};
    const auto inside = [&](const Part& sum) {
        found = sum;
        return std::pow(sum.volume[dimension] / std::max(sum.angle, 1e-9), 1.0 / dimension);
    };
    if (n > 100) {  // mostly a body, for which simplices of the highest dimension suffice
        const double spacing = settle(inside);
        // In a close packing the nearest is 1.12 spacings away: of thin things this is far less.
        if (spacing >= 0.85 && found.angle >= kClearlyBody * n) return spacing;
    }
    const double spacing = settle([&](const Part& sum) {
        found = sum;
        return root(sum.volume, n);
    });
    if (found.angle > 0 && found.volume[dimension] >= kBody * n * std::pow(spacing, dimension)) {
        const double other = inside(found);
        if (abs(other - spacing) <= kAlike * spacing) return other;
    }
    return spacing;
}

bool less(const Vec& a, const Vec& b) { return a.x != b.x ? a.x < b.x : a.y != b.y ? a.y < b.y : a.z < b.z; }
bool same(const Vec& a, const Vec& b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

/// Median distance to the nearest other one, of the points that are picked. points: ascending by x.
double nearest_distance(const std::vector<Vec>& points, const std::vector<std::size_t>& picked) {
    std::vector<double> all;
    for (const std::size_t i : picked) {
        double best = std::numeric_limits<double>::infinity();
        const auto nearer = [&](std::size_t j) {
            const Vec d = points[j] - points[i];
            best = std::min(best, dot(d, d));
            return d.x * d.x < best;
        };
        for (std::size_t j = i; j-- > 0 && nearer(j);) {}
        for (std::size_t j = i + 1; j < points.size() && nearer(j); ++j) {}
        all.push_back(sqrt(best));
    }
    std::nth_element(all.begin(), all.begin() + all.size() / 2, all.end());
    return all[all.size() / 2];
}

/// Spacing of points, each once, ascending by x; y and z are 0 where the dimension is less.
double tessellated_spacing(std::vector<Vec> points, int dimension) {
    std::vector<std::size_t> picked;
    for (std::size_t i = 0; i < std::min(points.size(), kFewParticles); ++i)
        picked.push_back(points.size() <= kFewParticles ? i : hashed(i) % points.size());
    const double unit = nearest_distance(points, picked);
    for (std::size_t i = 0; i < points.size(); ++i) {
        const auto off = [&](int k) {
            return k < dimension ? kJitter * (double(hashed(3 * i + k) >> 11) / double(1ull << 52) - 1) : 0;
        };
        points[i] = points[i] * (1 / unit) + Vec{off(0), off(1), off(2)};
    }
    const double extent = points.back().x - points.front().x;
    for (double most = 2;; most *= 2) {  // spacing
        const double half = kLargest[dimension] * most;
        std::vector<Part> parts;
        std::vector<std::pair<double, Vec>> near;
        for (const std::size_t i : picked) {
            near.clear();
            const auto look = [&](std::size_t j) {
                const Vec d = points[j] - points[i];
                if (const double square = dot(d, d); square <= 4 * half * half) near.push_back({square, d});
                return abs(d.x) <= 2 * half;
            };
            for (std::size_t j = i; j-- > 0 && look(j);) {}
            for (std::size_t j = i + 1; j < points.size() && look(j); ++j) {}
            std::sort(near.begin(), near.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
            Cell cell(half);
            double reach = cell.reach();
            for (const auto& [square, d] : near) {
                if (square > 4 * reach) break;
                cell.cut(d);
                reach = cell.reach();
            }
            cell.describe(dimension, parts);
        }
        std::sort(parts.begin(), parts.end(), [](const Part& a, const Part& b) { return a.radius < b.radius; });
        const double spacing = solve(parts, double(picked.size()), dimension);
        if (spacing <= most || most > 4 * extent) return spacing * unit;
    }
}

}  // namespace

std::vector<Vec> axes_of(const float* positions, std::size_t n) {
    std::vector<Vec> all;
    const auto chosen = [&](std::size_t stride) {
        all.clear();
        for (std::size_t i = 0; i < n; i += stride) {
            const float* p = positions + 3 * i;
            if (abs(p[0]) <= kFarthest && abs(p[1]) <= kFarthest && abs(p[2]) <= kFarthest)
                all.push_back({p[0], p[1], p[2]});
        }
    };
    chosen(std::max<std::size_t>(1, n / kFewParticles));
    if (all.empty()) return {};
    double scale = 0;
    Vec middle{};
    for (const Vec& p : all) {
        middle = middle + p * (1.0 / double(all.size()));  // of a plane's points it lies in the plane
        scale = std::max({scale, abs(p.x), abs(p.y), abs(p.z)});
    }
    double size = 0;  // keeps squares in range
    for (const Vec& p : all) size = std::max({size, abs(p.x - middle.x), abs(p.y - middle.y), abs(p.z - middle.z)});
    Sym3<double> spread{};
    for (const Vec& p : all) {
        const Vec d = (p - middle) * (size > 0 ? 1 / size : 1);
        spread = {spread.xx + d.x * d.x, spread.yy + d.y * d.y, spread.zz + d.z * d.z, spread.xy + d.x * d.y,
            spread.xz + d.x * d.z, spread.yz + d.y * d.z};
    }
    const Eigen3<double> e = eigen(spread);
    std::array<int, 3> order{0, 1, 2};
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return e.value[a] > e.value[b]; });
    std::vector<Vec> axes;
    for (const std::size_t stride :
        {std::max<std::size_t>(1, n / kFewParticles), std::size_t(1)}) {  // some tell mostly
        chosen(stride);
        double extent = 0, across[3];
        for (int k = 0; k < 3; ++k) {
            std::vector<double> away;
            for (const Vec& p : all) away.push_back(dot(p - middle, e.axis[order[k]]));
            const auto [least, most] = std::minmax_element(away.begin(), away.end());
            across[k] = *most - *least;
            const auto median = [&] {
                std::nth_element(away.begin(), away.begin() + away.size() / 2, away.end());
                return away[away.size() / 2];
            };
            const double center = median();
            for (double& a : away) a = abs(a - center);
            extent = std::max(extent, 4 * median());
        }
        axes.clear();
        for (int k = 0; k < 3; ++k)
            if (across[k] > std::max(kThin * extent, std::min(kRounding * scale, kFarThin * extent)))
                axes.push_back(e.axis[order[k]]);
        if (axes.size() == 3) break;
    }
    return axes;
}

double few_or_flat_spacing(const float* positions, std::size_t n) {
    const std::vector<Vec> axes = axes_of(positions, n);
    if (axes.empty() || (axes.size() == 3 && n >= kFewParticles)) return 0;
    std::vector<Vec> points;
    Vec first{};
    for (std::size_t i = 0; i < n; ++i) {
        const float* p = positions + 3 * i;
        if (!(abs(p[0]) <= kFarthest && abs(p[1]) <= kFarthest && abs(p[2]) <= kFarthest)) continue;
        if (points.empty()) first = {p[0], p[1], p[2]};
        const Vec d = Vec{p[0], p[1], p[2]} - first;
        points.push_back(
            {dot(d, axes[0]), axes.size() > 1 ? dot(d, axes[1]) : 0, axes.size() > 2 ? dot(d, axes[2]) : 0});
    }
    std::sort(points.begin(), points.end(), less);
    points.erase(std::unique(points.begin(), points.end(), same), points.end());
    if (points.size() < 2) return 0;
    return tessellated_spacing(std::move(points), int(axes.size()));
}

double measured_spacing(
    const Handle<Scene>& scene, const Gates& inside, const float* positions, std::size_t n, bool smooth) {
    if (positions) {
        const double found = few_or_flat_spacing(positions, n);
        if (found > 0 && found < 1 / kFarthest)
            return std::numeric_limits<double>::infinity();  // as by float32, which cannot square it
        if (found > 0 || n < kFewParticles) return found;
    }
    const double neighbors = scene.call_inside<&Scene::spacing>(inside);
    if (!smooth) return neighbors;
    const double volume = scene.call_inside<&Scene::fluid_spacing>(
        inside);  // in bodies of few layers that is far more than neighbors say
    return volume <= kMostOverNeighbors * neighbors ? volume : neighbors;
}

}  // namespace globule::core
