// The knife cuts the bonds that its swept surface crosses: each once, however ties fall.
#include "bonds.hpp"

#include <set>

namespace {

using tissue::GridPoint;

/// n x n x 2 n particles a unit apart, with bonds to those along axes and diagonals of faces.
Tissue block(int n) {
    std::vector<float3> points;
    std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs;
    const auto number = [&](int x, int y, int z) { return std::uint32_t((z * n + y) * n + x); };
    for (int z = 0; z < 2 * n; ++z)
        for (int y = 0; y < n; ++y)
            for (int x = 0; x < n; ++x) {
                points.push_back({float(x), float(y), float(z)});
                for (int k = 14; k < 27; ++k) {
                    const int dx = k % 3 - 1, dy = k / 3 % 3 - 1, dz = k / 9 - 1, X = x + dx, Y = y + dy, Z = z + dz;
                    if (std::abs(dx) + std::abs(dy) + std::abs(dz) < 3 && X >= 0 && X < n && Y >= 0 && Y < n &&
                        Z < 2 * n)
                        pairs.push_back({number(x, y, z), number(X, Y, Z)});
                }
            }
    return Tissue(points, pairs);
}
struct Blade {
    tissue::Grid grid{{0, 0, 0}, 1 << 20};
    std::vector<GridPoint> vertices;
    std::vector<std::uint32_t> triangles;
    std::uint32_t n_moving = 0;
    float3 lo{1e9f, 1e9f, 1e9f}, hi{-1e9f, -1e9f, -1e9f};

    std::uint32_t add(const float3& p) {
        vertices.push_back(grid.snap(p));
        lo = {std::min(lo.x, p.x - 0.01f), std::min(lo.y, p.y - 0.01f), std::min(lo.z, p.z - 0.01f)};
        hi = {std::max(hi.x, p.x + 0.01f), std::max(hi.y, p.y + 0.01f), std::max(hi.z, p.z + 0.01f)};
        return std::uint32_t(vertices.size()) - 1;
    }
    /// A sheet at z of n x n squares, each of two triangles, from -1 to `to`.
    static Blade sheet(float z, float to, int n = 1) {
        Blade b;
        const auto at = [&](int i) { return -1.0f + (to + 1.0f) * float(i) / float(n); };
        for (int y = 0; y <= n; ++y)
            for (int x = 0; x <= n; ++x) b.add({at(x), at(y), z});
        for (int y = 0; y < n; ++y)
            for (int x = 0; x < n; ++x) {
                const std::uint32_t m = std::uint32_t(n + 1), a = y * m + x;
                for (const std::uint32_t v : {a, a + 1, a + m + 1, a, a + m + 1, a + m}) b.triangles.push_back(v);
            }
        return b;
    }
    tissue::SweptSurface surface() const {
        return {grid, vertices.data(), triangles.data(), std::uint32_t(triangles.size() / 3), n_moving, lo, hi};
    }
    std::uint32_t cut(Tissue& t, const float3* before = nullptr) const {
        std::uint32_t n_cut = 0;
        const tissue::Cut cut{t.bonds(), t.at.data(), before, surface(), &n_cut};
        for (std::uint32_t i = 0; i < t.n; ++i) cut(i);
        return n_cut;
    }
};
GridPoint grid_point(Random& random, int most) {
    const auto one = [&] { return std::int64_t(random.below(2 * most + 1)) - most; };
    const std::int64_t x = one(), y = one();
    return {x, y, one()};
}
GridPoint operator*(int s, const GridPoint& p) { return {s * p.x, s * p.y, s * p.z}; }

}  // namespace

TEST_CASE("a sheet through n x n particles cuts 5 n^2 - 4 n bonds, and none the second time") {
    for (const int n : {1, 2, 5, 8}) {
        Tissue t = block(n);
        const Blade blade = Blade::sheet(float(n) - 0.5f, float(n));
        CHECK(blade.cut(t) == std::uint32_t(5 * n * n - 4 * n));
        CHECK(blade.cut(t) == 0);
    }
}

TEST_CASE("so does a sheet in which particles lie, and one whose edges meet bonds") {
    for (const float z : {4.0f, 3.5f, 3.999999f})
        for (const int parts : {1, 2, 3, 6, 12}) {
            Tissue t = block(5);
            CHECK(Blade::sheet(z, 5, parts).cut(t) == 5 * 25 - 4 * 5);
        }
}

TEST_CASE("every bond through a sheet crosses exactly one of its triangles") {
    Random random(1);
    for (int i = 0; i < 500; ++i) {
        GridPoint grid[3][3];  // a sheet with bumps, over the squares from -4 to 4
        for (int y = 0; y < 3; ++y)
            for (int x = 0; x < 3; ++x) grid[y][x] = {4 * (x - 1), 4 * (y - 1), std::int64_t(random.below(5)) - 2};
        const GridPoint p{std::int64_t(random.below(7)) - 3, std::int64_t(random.below(7)) - 3, 9},
            q{std::int64_t(random.below(7)) - 3, std::int64_t(random.below(7)) - 3, -9};
        int n = 0;
        for (int y = 0; y < 2; ++y)
            for (int x = 0; x < 2; ++x)
                n += tissue::crosses({grid[y][x], grid[y][x + 1], grid[y + 1][x + 1]}, p, q) +
                     tissue::crosses({grid[y][x], grid[y + 1][x + 1], grid[y + 1][x]}, p, q);
        CHECK(n % 2 == 1);  // a steep bond may pass a bump three times
    }
}

TEST_CASE("neither the order of the corners nor that of a bond's ends matters, ties included") {
    Random random(2);
    int crossed = 0;
    for (int i = 0; i < 3000; ++i) {
        GridPoint c[3], p = grid_point(random, 2), q = grid_point(random, 2);
        for (GridPoint& v : c) v = grid_point(random, 2);
        const bool right = tissue::crosses({c[0], c[1], c[2]}, p, q);
        crossed += right;
        for (int k = 0; k < 3; ++k)
            CHECK((right == tissue::crosses({c[k], c[(k + 1) % 3], c[(k + 2) % 3]}, q, p) &&
                   right == tissue::crosses({c[k], c[(k + 2) % 3], c[(k + 1) % 3]}, p, q)));
    }
    CHECK(crossed > 100);
}

TEST_CASE("ties fall as if all tissue were moved by (e, e^2, e^3)") {
    Random random(3);
    for (int i = 0; i < 3000; ++i) {
        GridPoint c[3], p = grid_point(random, 2), q = grid_point(random, 2);
        for (GridPoint& v : c) v = grid_point(random, 2);
        const bool right = tissue::crosses({c[0], c[1], c[2]}, p, q);
        const GridPoint e{1'000'000, 1000, 1};  // of 10^9
        const int s = 1'000'000'000;
        CHECK(right == tissue::crosses({s * c[0], s * c[1], s * c[2]}, s * p + e, s * q + e));
    }
}

TEST_CASE("crossings are those of plain arithmetic where nothing is near a tie") {
    Random random(4);
    for (int i = 0; i < 3000; ++i) {
        GridPoint v[5];
        for (GridPoint& p : v) p = grid_point(random, 1 << 29);
        const auto volume = [&](int a, int b, int c, int d) {  // of a tetrahedron
            const GridPoint x = v[b] - v[a], y = v[c] - v[a], z = v[d] - v[a];
            return (long double)(x.x) * ((long double)(y.y) * z.z - (long double)(y.z) * z.y) -
                   (long double)(x.y) * ((long double)(y.x) * z.z - (long double)(y.z) * z.x) +
                   (long double)(x.z) * ((long double)(y.x) * z.y - (long double)(y.y) * z.x);
        };
        const bool apart = (volume(0, 1, 2, 3) > 0) != (volume(0, 1, 2, 4) > 0), a = volume(3, 4, 0, 1) > 0,
                   b = volume(3, 4, 1, 2) > 0, c = volume(3, 4, 2, 0) > 0;
        CHECK(tissue::crosses({v[0], v[1], v[2]}, v[3], v[4]) == (apart && a == b && b == c));
    }
}

TEST_CASE("a triangle without area cuts nothing") {
    Random random(5);
    for (int i = 0; i < 500; ++i) {
        const GridPoint a = grid_point(random, 3), d = grid_point(random, 3);
        CHECK(!tissue::crosses({a, a + d, a + 2 * d}, grid_point(random, 3), grid_point(random, 3)));
        CHECK(!tissue::crosses({a, a, a + d}, grid_point(random, 3), grid_point(random, 3)));
    }
}

TEST_CASE("places are snapped to even numbers, and what is far away to the end of the grid") {
    const tissue::Grid grid{{1, 0, 0}, 8.0};
    CHECK(grid.snap(1.0, 0) == 0);
    CHECK(grid.snap(1.26, 0) == 2);
    CHECK(grid.snap(-0.3, 1) == -2);
    CHECK(grid.snap(1e30, 2) == 1 << 30);
    CHECK(grid.snap(-1e30, 2) == -(1 << 30));
}

TEST_CASE("both ends know that a bond is cut, and are scarred") {
    Tissue t({{0, 0, 0}, {0, 0, 1}, {9, 0, 0}, {9, 0, 1}}, {{0, 1}, {2, 3}, {1, 3}});
    CHECK(Blade::sheet(0.5f, 5).cut(t) == 1);
    CHECK(t.length[t.bonds().begin(0)] == -1.0f);
    CHECK(t.length[t.bonds().twin(0, 1)] == -1.0f);
    CHECK(t.scarred == std::vector<std::uint8_t>{1, 1, 0, 0});
    t.each([&](std::uint32_t a, std::uint32_t e) { CHECK((t.length[e] < 0) == (a == 0)); });
}

TEST_CASE("an edge that moves cuts what it passes, and nothing where tissue moves along") {
    for (const bool along : {false, true}) {
        Tissue t = block(4);
        Blade blade;
        for (const float x : {-1.0f, 5.0f}) {  // before this step, after it: the edge runs along y at z = 3.5
            blade.add({x, -1, 3.5f});
            blade.add({x, 5, 3.5f});
        }
        blade.triangles = {0, 1, 3, 0, 3, 2};
        blade.n_moving = 2;
        std::vector<float3> before;
        for (const core::Quad& p : t.at) before.push_back({p.x - (along ? 6.0f : 0.0f), p.y, p.z});
        CHECK(blade.cut(t, before.data()) == (along ? 0u : 5u * 16 - 4 * 4));
    }
}

TEST_CASE("where a sheet ends the cut ends") {
    Tissue t = block(6);
    Blade::sheet(5.5f, 2.5f).cut(t);
    t.each([&](std::uint32_t a, std::uint32_t e) {
        const float3 p = t.at[a].xyz(), q = t.at[t.other[e]].xyz();
        const bool through = (p.z < 5.5f) != (q.z < 5.5f);
        if (through && std::max({p.x, p.y, q.x, q.y}) < 2.4f) CHECK(t.length[e] < 0);
        if (!through || std::max(std::min(p.x, q.x), std::min(p.y, q.y)) > 2.6f) CHECK(t.length[e] > 0);
    });
}
