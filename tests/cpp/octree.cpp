// The octree and what it answers, against brute force in float64.
#include <limits>
#include <memory>
#include <numeric>
#include <set>

#include "particles.hpp"

namespace {

#define KEYS std::uint32_t, std::uint64_t
using core::Node;

template <class Key> core::TreeParams params() {
    return {.key_bits = int(8 * sizeof(Key)), .depth = core::morton::Traits<Key>::levels};
}
/// Points that are hard: none, one, many in one place, a lattice, clusters of very different size.
std::vector<std::vector<float3>> scenes() {
    std::vector<float3> clusters = cloud(400);
    for (std::size_t i = 0; i < clusters.size(); ++i)
        clusters[i] = clusters[i] * std::pow(0.01f, float(i % 4)) + float3{float(i % 3), 0, 1};
    return {{}, cloud(1), cloud(7), std::vector<float3>(100, {1, 2, 3}), lattice(9, 0.125f), cloud(1000), clusters};
}
/// Number of the particle, and whether it is near.
template <class Near> std::vector<std::uint32_t> all_where(std::size_t n, const Near& near) {
    std::vector<std::uint32_t> found;
    for (std::uint32_t j = 0; j < n; ++j)
        if (near(j)) found.push_back(j);
    return found;
}
std::vector<std::uint32_t> neighbors(Built& b, const float3& at, float radius) {
    std::uint64_t offsets[2] = {0, 0};
    core::FindNeighbors find{b.tree(), b.sorted(), &at.x, radius, offsets, nullptr};
    find(0);
    std::vector<std::uint32_t> found(offsets[0]);
    offsets[0] = 0;
    find.indices = found.data();
    if (!found.empty()) find(0);
    std::sort(found.begin(), found.end());
    return found;
}
const core::AnyKernel kMurakami{core::KernelName::murakami};
/// As the kernels are written down, in float64.
double murakami(double distance, double support) {
    const double x = distance * distance / (support * support);
    return x < 1 ? (1 - x) * (1 - x) : 0;
}

}  // namespace

TEST_CASE_TEMPLATE("sorting keeps all particles, in the order of their keys", Key, KEYS) {
    for (const auto& points : scenes()) {
        Built b(points, params<Key>());
        const auto* keys = static_cast<const Key*>(b.octree.keys());
        CHECK(std::is_sorted(keys, keys + points.size()));
        std::set<std::uint32_t> seen;
        for (std::size_t i = 0; i < points.size(); ++i) {
            const std::uint32_t from = b.sorted().index[i];
            seen.insert(from);
            CHECK(distance(b.sorted().position(i), points[from]) == 0.0);
            CHECK(keys[i] == core::morton::key_of<Key>(points[from], b.tree().header->space));
        }
        CHECK(seen.size() == points.size());
    }
}

TEST_CASE_TEMPLATE("leaves hold each particle once, in order, and few, unless they cannot be split", Key, KEYS) {
    for (const auto& points : scenes()) {
        Built b(points, params<Key>());
        const auto nodes = b.nodes();
        const auto* keys = static_cast<const Key*>(b.octree.keys());
        std::vector<int> held(points.size());
        for (const Node& node : nodes) {
            const std::uint32_t n = Node::count(node.meta);
            if (!Node::is_leaf(node.meta)) continue;
            for (std::uint32_t j = node.first; j < node.first + n; ++j) ++held[j];
            if (n > core::kLeafSize) CHECK(keys[node.first] == keys[node.first + n - 1]);
        }
        CHECK(std::count(held.begin(), held.end(), 1) == std::ptrdiff_t(points.size()));
    }
}

TEST_CASE_TEMPLATE("children lie side by side, and each node but the first has one parent", Key, KEYS) {
    for (const auto& points : scenes()) {
        Built b(points, params<Key>());
        const auto nodes = b.nodes();
        std::size_t next = 1;  // level by level, so that children come in the order of their parents
        for (const Node& node : nodes) {
            if (Node::is_leaf(node.meta)) continue;
            CHECK(node.first == next);
            CHECK((node.meta >= 1 && node.meta <= 8));
            next += node.meta;
        }
        CHECK(next == std::max<std::size_t>(nodes.size(), 1));
        CHECK(nodes.empty() == points.empty());
    }
}

TEST_CASE_TEMPLATE("a node's box is the smallest around the supports below it", Key, KEYS) {
    const auto points = cloud(1000);
    Random random(3);
    std::vector<float> support(points.size());
    for (float& a : support) a = float(random(0.01, 0.2));
    Built b(points, params<Key>(), support);
    const auto nodes = b.nodes();
    std::vector<Node> boxes(nodes.size(), Node::nothing());
    for (std::size_t i = nodes.size(); i-- > 0;) {
        const std::uint32_t n = Node::count(nodes[i].meta);
        for (std::uint32_t j = nodes[i].first; j < nodes[i].first + n; ++j) {
            const float a = Node::is_leaf(nodes[i].meta) ? b.sorted().support[j] : 0;
            const float3 r{a, a, a}, p = b.sorted().position(j);
            if (Node::is_leaf(nodes[i].meta)) boxes[i].unite(p - r, p + r);
            else boxes[i].unite(boxes[j].lo, boxes[j].hi);
        }
        CHECK(distance(boxes[i].lo, nodes[i].lo) == 0.0);
        CHECK(distance(boxes[i].hi, nodes[i].hi) == 0.0);
    }
}

TEST_CASE_TEMPLATE("neighbors are those of brute force", Key, KEYS) {
    for (const std::size_t n : {1, 7, 64, 1000}) {
        const auto points = cloud(n, n);
        Built b(points, params<Key>(), std::vector<float>(n, 1e-6f));
        for (const float radius : {0.0f, 0.1f, 0.5f, 3.0f})
            for (std::size_t i = 0; i < n; i += 1 + n / 20)
                CHECK(neighbors(b, points[i], radius) ==
                      all_where(n, [&](std::uint32_t j) { return distance(points[i], points[j]) <= radius; }));
    }
}

TEST_CASE_TEMPLATE("who is exactly as far away as the radius is a neighbor", Key, KEYS) {
    Built b(lattice(5, 0.25f), params<Key>(), std::vector<float>(125, 0.25f));
    CHECK(neighbors(b, {0.5f, 0.5f, 0.5f}, 0.25f).size() == 7);
    CHECK(neighbors(b, {0.5f, 0.5f, 0.5f}, std::nextafter(0.25f, 0.0f)).size() == 1);
    CHECK(neighbors(b, {0, 0, 0}, 0.25f).size() == 4);
}

TEST_CASE_TEMPLATE("particles in one place are one leaf, which every one of them finds", Key, KEYS) {
    Built b(std::vector<float3>(100, {1, 2, 3}), params<Key>());
    CHECK(b.nodes().size() == std::size_t(core::morton::Traits<Key>::levels) + 1);
    CHECK(Node::count(b.nodes().back().meta) == 100);
    CHECK(neighbors(b, {1, 2, 3}, 0.0f).size() == 100);
}

TEST_CASE_TEMPLATE("what is outside of a fixed space comes first and has no node", Key, KEYS) {
    auto points = cloud(300, 5, -0.5, 1.5);
    points[17].y = std::numeric_limits<float>::quiet_NaN();
    points[40].x = std::numeric_limits<float>::infinity();
    auto p = params<Key>();
    p.fixed_space = true;
    p.hi = {1, 1, 1};
    Built b(points, p);
    const auto inside = [&](std::uint32_t j) { return core::morton::is_inside(points[j], p.lo, p.hi); };
    const std::uint32_t n = b.tree().header->n_outside;
    CHECK(n == 300 - all_where(300, inside).size());
    for (std::uint32_t i = 0; i < 300; ++i) CHECK(inside(b.sorted().index[i]) == (i >= n));
    std::uint32_t held = 0;
    for (const Node& node : b.nodes()) held += Node::is_leaf(node.meta) ? Node::count(node.meta) : 0;
    CHECK(held == 300 - n);
}

TEST_CASE_TEMPLATE("any number of threads makes the same nodes", Key, KEYS) {
    const auto points = cloud(20000);
    Built one(points, params<Key>(), {}, {}, {}, 1);
    for (const int threads : {2, 3, 5}) {
        Built many(points, params<Key>(), {}, {}, {}, threads);
        const auto a = one.nodes(), b = many.nodes();
        REQUIRE(a.size() == b.size());
        CHECK(std::memcmp(a.data(), b.data(), a.size() * sizeof(Node)) == 0);
    }
}

TEST_CASE("a lane alone and a group of lanes come through the same leaves in the same order") {
    Built b(cloud(1000));
    Random random(2);
    core::CpuGroup group;
    for (int i = 0; i < 50; ++i) {
        const float3 lo = random.point(), hi = lo + random.point(0, 0.3);
        std::vector<std::uint32_t> alone, together;
        core::for_each_leaf(b.tree(), lo, hi, [&](std::uint32_t first, std::uint32_t) { alone.push_back(first); });
        core::for_each_leaf(
            group, b.tree(), lo, hi, [&](std::uint32_t first, std::uint32_t) { together.push_back(first); });
        CHECK(alone == together);
        CHECK(std::is_sorted(alone.begin(), alone.end()));
    }
}

TEST_CASE("the field is the sum of its particles, its gradient the field's slope") {
    const auto points = cloud(300);
    Random random(4);
    std::vector<float> support(300), weight(300);
    for (int i = 0; i < 300; ++i) support[i] = float(random(0.1, 0.4)), weight[i] = float(random(-1, 2));
    Built b(points, {}, support, weight);
    const auto field = [&](const float3& p, int axis, double step) {
        double sum = 0, at[3] = {p.x, p.y, p.z};
        at[axis] += step;
        for (int j = 0; j < 300; ++j)
            sum += weight[j] *
                   murakami(std::hypot(at[0] - points[j].x, at[1] - points[j].y, at[2] - points[j].z), support[j]);
        return sum;
    };
    for (int i = 0; i < 100; ++i) {
        const float3 p = random.point(-0.2, 1.2);
        float value, slope[3];
        core::EvaluateField{b.tree(), b.sorted(), kMurakami, 1, 0.5f, &p.x, &value, slope}.run<core::CpuPacket>(0);
        CHECK(value == doctest::Approx(field(p, 0, 0.0)).epsilon(1e-6));
        for (int k = 0; k < 3; ++k) CHECK(std::abs(slope[k] - (field(p, k, 1e-6) - field(p, k, -1e-6)) / 2e-6) < 1e-4);
    }
}

TEST_CASE("the spacing around the particles of a lattice is the lattice's") {
    for (const float spacing : {0.01f, 1.0f, 300.0f}) {
        const auto points = lattice(7, spacing);
        Built b(points, {}, std::vector<float>(points.size(), spacing));
        for (std::uint32_t i = 0; i < points.size(); ++i) {
            if (b.sorted().index[i] != 3 * 49 + 3 * 7 + 3) continue;
            float out;
            core::LocalSpacing{b.tree(), b.sorted(), i, points.size(), 1, &out}(0);
            CHECK(out == doctest::Approx(spacing).epsilon(0.02));  // the 12th neighbor is a diagonal of a face away
        }
    }
}

TEST_CASE("boxes of ellipsoids hold them and no more") {
    Random random(8);
    for (int i = 0; i < 20; ++i) {
        const float3 e = random.direction();  // reaches a along e, a / 4 across: G = (4 - 3 e e^T) / a
        const float a = 0.5f, s = 3 / a, t = 4 / a;
        Built b({{1, 2, 3}}, {}, {a}, {},
            {t - s * e.x * e.x, t - s * e.y * e.y, t - s * e.z * e.z, -s * e.x * e.y, -s * e.x * e.z, -s * e.y * e.z});
        const Node node = b.nodes()[0];
        for (const auto& [lo, hi, center, c] : {std::tuple{node.lo.x, node.hi.x, 1.0f, e.x},
                 {node.lo.y, node.hi.y, 2.0f, e.y}, {node.lo.z, node.hi.z, 3.0f, e.z}}) {
            const double reach = a * std::sqrt(c * c + (1 - c * c) / 16.0);
            CHECK(hi - center == doctest::Approx(reach).epsilon(1e-4));
            CHECK(center - lo == doctest::Approx(reach).epsilon(1e-4));
            CHECK(hi - center >= reach * (1 - 1e-6));
        }
    }
}

TEST_CASE("other shapes make the boxes that a new octree has") {
    const auto points = cloud(500);
    Random random(9);
    std::vector<float> support(500), weight(500, 1.0f), stretch(3000, 0.0f);
    for (int i = 0; i < 500; ++i) {
        support[i] = float(random(0.05, 0.2));
        for (int k = 0; k < 3; ++k) stretch[6 * i + k] = float(random(1, 2)) / support[i];
    }
    Built fresh(points, {}, support, weight, stretch), changed(points);
    const auto shapes = changed.octree.shapes();
    for (int i = 0; i < 500; ++i) {
        const std::uint32_t from = changed.sorted().index[i];
        shapes.support[i] = support[from];
        shapes.weight[i] = 1.0f;
        std::copy_n(&stretch[6 * from], 6, shapes.stretch + 6 * i);
    }
    changed.octree.reshape(shapes, 0.0f, 2.0f, 1.0f);
    const auto a = fresh.nodes(), b = changed.nodes();
    REQUIRE(a.size() == b.size());
    CHECK(std::memcmp(a.data(), b.data(), a.size() * sizeof(Node)) == 0);
}

TEST_CASE("dense nodes tell of their particles, their children and how far they reach") {
    const auto points = cloud(300);
    Random random(10);
    std::vector<float> support(300);
    for (float& a : support) a = float(random(0.01, 0.2));
    Built b(points, {.depth = 3, .dense = true}, support);
    const core::DenseNode* nodes = b.octree.dense_nodes();
    const auto* keys = static_cast<const std::uint32_t*>(b.octree.keys());
    for (std::uint64_t i = 0; i < core::morton::dense_offset(4); ++i) {
        std::uint32_t n = 0, mask = 0;
        float reach = 0;
        for (std::uint32_t j = 0; j < 300; ++j) {
            if (core::morton::dense_index(keys[j], core::morton::dense_level(i)) != i) continue;
            ++n;
            reach = std::max(reach, b.sorted().support[j]);
            if (i < core::morton::dense_offset(3))
                mask |= 1u << (core::morton::dense_index(keys[j], core::morton::dense_level(i) + 1) - 8 * i - 1);
        }
        CHECK(nodes[i].last - nodes[i].first == n);
        CHECK(nodes[i].reach == reach);
        CHECK(nodes[i].child_mask == mask);
    }
}

TEST_CASE("a dense octree makes the sparse one's nodes when somebody asks for them") {
    const auto points = cloud(800);
    Built sparse(points, {.depth = 4}), dense(points, {.depth = 4, .dense = true});
    const auto a = sparse.nodes(), b = dense.nodes();
    REQUIRE(a.size() == b.size());
    CHECK(std::memcmp(a.data(), b.data(), a.size() * sizeof(Node)) == 0);
}
