// Meshes as layers: depth, colors, poses, mistakes.
#include <cmath>

#include "helpers.hpp"

using namespace globule;

namespace {

const std::vector<float> kCorners{-1, -1, 0, 1, -1, 0, 0, 2, 0};
const std::vector<std::uint32_t> kFace{0, 1, 2};
const Camera kCamera{.eye = {0, 0, 5}, .look_at = {0, 0, 0}};

}  // namespace

TEST_CASE("a mesh is a layer beside a scene") {
    const Mesh mesh({.vertices = kCorners, .faces = kFace, .color = Vec3{1, 0.5, 0.25}}, {.device = "cpu"});
    CHECK(mesh.size() == 1);
    CHECK(mesh.device() == "cpu");
    RenderSettings settings;
    settings.lights.clear();
    settings.ambient = Vec3{1, 1, 1};
    const Frame alone = render({Layer{.mesh = mesh}}, kCamera, 9, 9, settings);
    CHECK(alone.distance()[40] == 5.0f);
    CHECK(alone.color()[3 * 40 + 1] == doctest::Approx(0.5));
    const std::vector<float> p{0, 0, 2, 0.1f, 0, 2};
    const Scene scene({.positions = p, .support = 1.0}, on_cpu);
    const Frame both = render({Layer{.scene = scene}, Layer{.mesh = mesh}}, kCamera, 9, 9, settings);
    CHECK(both.layer()[40] == 0);
    CHECK(both.distance()[40] < 3.0f);
    CHECK(both.layer()[9 * 5 + 4] <= 1);
    settings.ambient_rays = 1;
    CHECK(render({Layer{.mesh = mesh}}, kCamera, 9, 9, settings).mask()[40]);
}

TEST_CASE("capsules are balls along their axes") {
    const std::vector<float> ends{-1, 0, 0, 1, 0, 0};
    const std::vector<std::uint32_t> one{0, 1};
    const Mesh tube(Capsules{.vertices = ends, .ends = one, .radius = 0.5}, {.device = "cpu"});
    CHECK(tube.size() == 1);
    CHECK(render({Layer{.mesh = tube}}, kCamera, 9, 9).distance()[40] == doctest::Approx(4.5));
    const Mesh thick(Capsules{.vertices = ends, .ends = one, .radius = std::vector<float>{1}}, {.device = "cpu"});
    CHECK(render({Layer{.mesh = thick}}, kCamera, 9, 9).distance()[40] == doctest::Approx(4.0));
    const auto make = [&](const Scalars& radius) { Mesh(Capsules{.vertices = ends, .ends = one, .radius = radius}); };
    CHECK_SAYS(make({}), "radius: expected one for all, or one each, got none");
    CHECK_SAYS(make(-1.0), "radius: ");
    CHECK_SAYS(Mesh(Capsules{.vertices = ends, .ends = std::vector<std::uint32_t>{0, 2}, .radius = 1.0}), "ends: ");
}

TEST_CASE("poses and new vertices move a mesh") {
    Mesh mesh({.vertices = kCorners, .faces = kFace}, {.device = "cpu"});
    Matrix4 pose{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1};
    mesh.place(pose);
    CHECK(render({Layer{.mesh = mesh}}, kCamera, 9, 9).distance()[40] == 3.0f);
    std::vector<float> nearer = kCorners;
    for (int k = 0; k < 3; ++k) nearer[3 * k + 2] = 1;
    mesh.update(nearer);
    const Frame frame = render({Layer{.mesh = mesh}}, kCamera, 9, 9);
    CHECK(frame.distance()[40] == 2.0f);
    mesh.update(kCorners);
    CHECK_SAYS(frame.refine(), "refine: expected the scene as it was rendered");
    pose[0] = 2;
    CHECK_SAYS(mesh.place(pose), "world_from_mesh: expected a rotation and a translation");
}

TEST_CASE("a frame is refined from what it keeps of a mesh that has gone") {
    constexpr int n = 150;  // so large that the memory of faces and colors would go back to the system
    std::vector<float> vertices, color;
    std::vector<std::uint32_t> faces;
    for (std::uint32_t y = 0; y < n; ++y)
        for (std::uint32_t x = 0; x < n; ++x) {
            vertices.insert(vertices.end(), {2.0f * x / n - 1, 2.0f * y / n - 1, 0});
            color.insert(color.end(), {float(x) / n, float(y) / n, 0.5f});
            const std::uint32_t a = y * n + x;
            if (x + 1 < n && y + 1 < n) faces.insert(faces.end(), {a, a + 1, a + n, a + 1, a + n + 1, a + n});
        }
    Frame frame;
    std::vector<std::uint8_t> right;
    {
        const Mesh mesh({.vertices = vertices, .faces = faces, .color = color}, {.smooth = 30, .device = "cpu"});
        frame = render({Layer{.mesh = mesh}}, kCamera, 32, 24);
        right = frame.refine(2).image();
    }
    CHECK(frame.refine(2).image() == right);
}

TEST_CASE("new vertices that are refused change nothing") {
    Mesh mesh({.vertices = kCorners, .faces = kFace}, {.device = "cpu"});
    const Frame before = render({Layer{.mesh = mesh}}, kCamera, 9, 9);
    {
        std::vector<float> bad = kCorners;
        bad[4] = std::nanf("");
        CHECK_SAYS(mesh.update(bad), "vertices: expected");
    }
    CHECK(render({Layer{.mesh = mesh}}, kCamera, 9, 9).image() == before.image());
    CHECK_NOTHROW(before.refine());
}

TEST_CASE("mistakes of meshes are named") {
    const std::vector<std::uint32_t> far{0, 1, 3};
    const std::vector<float> one{0, 0, 0};
    CHECK_SAYS(Mesh({.vertices = kCorners, .faces = far}, {.device = "cpu"}),
        "faces: expected numbers of vertices below 3, got 3");
    CHECK_SAYS(Mesh({.vertices = kCorners, .faces = kCorners}, {.device = "cpu"}),
        "faces: expected uint32 or int32, got float32");
    CHECK_SAYS(Mesh({.vertices = kCorners, .faces = kFace}, {.smooth = 200, .device = "cpu"}), "smooth: expected");
    Mesh mesh({.vertices = kCorners, .faces = kFace}, {.device = "cpu"});
    CHECK_SAYS(mesh.update(one), "vertices: expected 3 rows, got 1");
    CHECK_SAYS(Mesh().size(), "mesh: expected a mesh, got an empty handle");
    const Scene scene({.positions = one, .support = 1.0}, on_cpu);
    CHECK_SAYS(render({Layer{.scene = scene, .mesh = mesh}}, kCamera, 9, 9),
        "layers: expected a scene or a mesh in each, got both");
}
