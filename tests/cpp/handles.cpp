// Handles: empty, moved from, copied; typed errors; what an update keeps.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "helpers.hpp"

using namespace globule;

TEST_CASE("the library has the headers' version") {
    const std::string expected = std::to_string(GLOBULE_VERSION_MAJOR) + "." + std::to_string(GLOBULE_VERSION_MINOR) +
                                 "." + std::to_string(GLOBULE_VERSION_PATCH);
    CHECK(version() == expected);
}

TEST_CASE("empty handles are refused") {
    Scene scene;
    Frame frame;
    Reconstructor reconstructor;
    Simulation simulation;
    Tissue tissue;
    CHECK(!scene);
    CHECK(!frame);
    CHECK_SAYS(scene.spacing(), "scene: expected a scene, got an empty handle");
    CHECK_SAYS(scene.render({}), "scene: expected");
    CHECK_SAYS(frame.color(), "frame: expected a frame");
    CHECK_SAYS(reconstructor.volume(), "reconstructor: expected a reconstructor");
    CHECK_SAYS(simulation.step(), "simulation: expected a simulation");
    CHECK_SAYS(tissue.tear(1), "tissue: expected a tissue");
    scene.cancel();  // nothing is running
    reconstructor.cancel();
}

TEST_CASE("moved-from handles are empty, copies are the same scene") {
    const std::vector<float> p = cube(3);
    Scene a({.positions = p}, on_cpu);
    const Scene copy = a;
    Scene b = std::move(a);
    CHECK(!a);
    CHECK_SAYS(a.size(), "scene: expected");
    b.update({.positions = cube(2)});
    CHECK(copy.size() == 8);
    a = b;
    CHECK(a.size() == 8);
    Frame f = b.render(Camera::fit(p), 8, 8);
    const Frame g = std::move(f);
    CHECK_SAYS(f.width(), "frame: expected");
    b = {};
    a = {};
    CHECK(g.image().size() == 192);  // a frame outlives the handles of its scene
}

TEST_CASE("options are checked") {
    CHECK_SAYS(Scene(SceneOptions{.device = "gpu"}), "device: expected auto, cpu, cuda or cuda:N, got \"gpu\"");
    CHECK_SAYS(Scene(SceneOptions{.threshold = -1, .device = "cpu"}), "threshold: expected a positive number");
    CHECK_SAYS(Scene(SceneOptions{.key_bits = 48}), "key_bits: expected 32 or 64, got 48");
    CHECK_SAYS(Scene(SceneOptions{.key_bits = 64, .octree = OctreeKind::dense}), "key_bits: expected 32");
    CHECK_SAYS(Scene(SceneOptions{.level = 11}), "level: expected 0 to 10, got 11");
    CHECK_SAYS(Scene(SceneOptions{.threads = -1}), "threads: expected 0 to 4096");
    CHECK_SAYS(Scene(SceneOptions{.bounds = Box{{1, 0, 0}, {0, 1, 1}}}), "bounds: expected");
    if (devices().size() == 1) {
        CHECK(!error_of([] { Scene(SceneOptions{.device = "cuda"}); }, ErrorCode::device).empty());
        CHECK(!find_device().note.empty());
    }
    CHECK(find_device("cpu").name == "cpu");
}

TEST_CASE("settings, cameras and layers are checked") {
    const std::vector<float> p = cube(3);
    const Scene s({.positions = p}, on_cpu);
    const Camera c = Camera::fit(p);
    const auto draw = [&](const RenderSettings& settings, const std::vector<Clip>& clips = {}) {
        s.render(c, 8, 8, settings, clips);
    };
    CHECK_SAYS(draw({.samples = 0}), "samples: expected 1 to 65536, got 0");
    CHECK_SAYS(draw({.exposure = NAN}), "exposure: expected a number >= 0");
    CHECK_SAYS(draw({.lights = std::vector<Light>(9, Headlight{})}), "lights: expected at most 8, got 9");
    CHECK_SAYS(draw({.lights = {DirectionalLight{.direction = {0, 0, 0}}}}), "direction: expected a direction");
    CHECK_SAYS(draw({.material = {.index = 0.5}}), "index: expected 1 to 4, got 0.5");
    CHECK_SAYS(draw({}, {ClipBox{{1, 0, 0}, {0, 1, 1}}}), "high: expected above low");
    CHECK_SAYS(s.render(c, 0, 8), "size: expected");
    CHECK_SAYS(s.render({.eye = {1, 1, 1}, .look_at = {1, 1, 1}}), "look_at: expected a point other than eye");
    CHECK_SAYS(s.render({.fov = 180}), "fov: expected");
    CHECK_SAYS(render({}, c), "layers: expected 1 to 4, got 0");
    CHECK_SAYS(Environment(std::vector<float>(6)), "image: expected shape (H, W, 3)");
    CHECK(render({{s}, {s, Material{.transmission = 0.5}}}, c, 8, 8).image().size() == 192);
}

TEST_CASE("a scene without particles asks for them") {
    Scene s(on_cpu);
    CHECK(error_of([&] { s.spacing(); }, ErrorCode::stale) ==
          "scene: its octree was not finished: update the scene first");
    CHECK_SAYS(s.update({.positions = std::vector<float>(2)}), "positions");
    error_of([&] { s.render({}); }, ErrorCode::stale);
    s.update({.positions = std::vector<float>()});
    CHECK(s.size() == 0);
    CHECK(s.render({}, 4, 4).mask() == std::vector<std::uint8_t>(16));
    s.update({.positions = cube(3)});
    CHECK(s.size() == 27);
}

TEST_CASE("the measured support stays, one that is given counts") {
    const std::vector<float> p = cube(8);
    Scene s({.positions = p}, on_cpu);
    const double measured = s.support();
    CHECK(measured == doctest::Approx(0.2).epsilon(1e-4));
    CHECK(s.spacing() == doctest::Approx(0.1).epsilon(1e-4));
    CHECK(s.margin() == doctest::Approx(0.85 * measured));
    std::vector<float> wide = p;
    for (float& v : wide) v *= 2;
    s.update({.positions = wide});
    CHECK(s.support() == measured);
    s.update({.positions = wide, .support = 0.5});
    CHECK(s.support() == 0.5);
    s.update({.positions = wide, .support = std::vector<float>(512, 0.4f)});
    CHECK(s.support() == 0);
    CHECK(s.margin() == doctest::Approx(0.85 * 0.4));
    CHECK(Scene({.positions = p, .support = 7}, {.support = 0.3, .device = "cpu"}).support() == 0.3);
}

TEST_CASE("a frame is refined only of the scene that it shows") {
    const std::vector<float> p = cube(4);
    Scene s({.positions = p}, on_cpu);
    const Frame one = s.render(Camera::fit(p), 32, 24);
    const auto before = one.image();
    const Frame four = one.refine(3);
    CHECK(one.samples() == 1);
    CHECK(four.samples() == 4);
    CHECK(one.image() == before);
    CHECK(four.distance() == one.distance());
    RenderSettings settings;
    settings.samples = 4;
    CHECK(four.image() == s.render(Camera::fit(p), 32, 24, settings).image());
    s.update({.positions = p});
    CHECK_SAYS(one.refine(), "refine: expected the scene as it was rendered");
    CHECK(one.image() == before);
}

TEST_CASE("a simulation, its arrays and its scene") {
    SimulationSettings settings{.spacing = 0.1, .domain = {{0, 0, 0}, {1, 1, 1}}};
    CHECK_SAYS(Simulation(SimulationSettings{}), "spacing: expected a positive number");
    Simulation sim(settings, {.walls = true, .device = "cpu"});
    const std::size_t walls = sim.size();
    CHECK(walls == 12 * 12 * 12 - 10 * 10 * 10);
    std::vector<float> water;
    for (int i = 0; i < 64; ++i)
        for (const int c : {i / 16, i / 4 % 4, i % 4}) water.push_back(0.1f * float(c) + 0.35f);
    const std::uint32_t first = sim.add(water, "fluid", {0, 0.5, 0});
    CHECK(first == walls);
    CHECK(sim.size() == walls + 64);
    CHECK_SAYS(sim.add(water, "oil"), "phase: expected one of fluid, walls, got \"oil\"");
    CHECK_SAYS(sim.add(std::vector<float>{NAN, 0, 0}), "positions: expected a finite number");
    CHECK_SAYS(sim.step(-1), "dt: expected a positive number");
    CHECK_SAYS(sim.remove({99999}), "ids: expected numbers that add() gave, got 99999");
    CHECK_SAYS(sim.configure({.spacing = 0.2, .domain = settings.domain}), "spacing: expected 0.1 as at the start");
    const Scene scene = sim.scene();
    const Camera camera{.eye = {0.5, 0.5, 3}, .look_at = {0.5, 0.5, 0.5}};
    const Frame before = scene.render(camera, 64, 48);
    const auto seen = before.mask();
    CHECK(std::count(seen.begin(), seen.end(), 1) > 10);
    const StepReport report = sim.step();
    CHECK(report.dt > 0);
    CHECK(report.n == sim.size());
    CHECK(sim.time() == report.time);
    CHECK_SAYS(before.refine(), "refine: expected the scene as it was rendered");
    CHECK(sim.run(0.05)->time == doctest::Approx(0.05 + report.time));
    CHECK(scene.size() == sim.size());
    CHECK(scene.render(camera, 64, 48).distance() != before.distance());
    const auto ids = sim.ids();
    CHECK(std::is_sorted(ids.begin(), ids.end()));
    sim.remove({first});
    CHECK(sim.ids().size() == walls + 63);
    CHECK(sim.positions().size() == 3 * (walls + 63));
    CHECK(sim.phase()[0] == 1);
    CHECK(sim.velocities().size() == sim.positions().size());
    CHECK(sim.pressure().size() == sim.size());
    CHECK_SAYS(Scene(scene).update({.positions = water}), "update: the scene of a simulation follows its particles");
    sim = {};
    CHECK(scene.render(camera, 64, 48).mask().size() == 64 * 48);  // it keeps its simulation
}

TEST_CASE("volumes: layout, types, errors") {
    const int n = 3, h = 4, w = 5;
    std::vector<std::uint8_t> frames(std::size_t(n) * h * w);
    for (std::size_t i = 0; i < frames.size(); ++i) frames[i] = std::uint8_t(i + 1);
    std::vector<double> poses;
    for (int f = 0; f < n; ++f) {
        const Matrix4 m{1, 0, 0, 10, 0, 1, 0, 20, 0, 0, 1, double(f), 0, 0, 0, 1};
        poses.insert(poses.end(), m.begin(), m.end());
    }
    const Sweep sweep{
        .frames = ArrayView(frames.data(), {n, h, w}), .world_from_image = ArrayView(poses.data(), {n, 4, 4})};
    const Volume v = reconstruct(sweep, {.spacing = 1, .device = "cpu"});
    CHECK(v.size == std::array<std::size_t, 3>{5, 4, 3});
    CHECK(std::vector<std::uint8_t>(v.values<std::uint8_t>().begin(), v.values<std::uint8_t>().end()) ==
          frames);  // x fastest
    CHECK(v.values<float>().empty());
    CHECK(v.world_from_voxel[3] == doctest::Approx(10));
    CHECK(v.filled() == std::vector<std::uint8_t>(60, 1));
    std::vector<float> floats(frames.begin(), frames.end());
    const Volume f = reconstruct(
        {.frames = ArrayView(floats.data(), {n, h, w}), .world_from_image = ArrayView(poses.data(), {n, 4, 4})},
        {.spacing = 1, .device = "cpu"});
    CHECK(std::vector<float>(f.values<float>().begin(), f.values<float>().end()) == floats);
    CHECK_SAYS(reconstruct(sweep, {.device = "cpu"}), "spacing, size: expected one of them, got neither");
    CHECK_SAYS(reconstruct(sweep, {.spacing = 1, .max_kernel = 2}), "max_kernel: expected an odd number");
    CHECK_SAYS(
        reconstruct(sweep, {.method = ReconstructionMethod::vvn, .spacing = 1, .compounding = Compounding::latest}),
        "compounding: expected mean");
    CHECK_SAYS(reconstruct({}, {.spacing = 1, .device = "cpu"}), "frames: expected shape");
    CHECK_SAYS(reconstruct({.frames = sweep.frames, .world_from_image = floats}, {.spacing = 1, .device = "cpu"}),
        "world_from_image: expected float64");
    CHECK_SAYS(reconstruct(sweep, {.spacing = 1, .region = Box{{90, 90, 90}, {91, 91, 91}}, .device = "cpu"}),
        "region: expected a box that meets");
    CHECK(error_of([&] { reconstruct(sweep, {.spacing = 1e-4, .device = "cpu"}); }, ErrorCode::memory)
              .find("mm would fit") != std::string::npos);

    Reconstructor r({.spacing = 1, .device = "cpu"});
    CHECK_SAYS(r.volume(), "volume: expected frames to be added first");
    r.add(sweep.frames, sweep.world_from_image);
    CHECK(r.n_frames() == 3);
    CHECK(r.volume().size == v.size);
    CHECK_SAYS(r.add(ArrayView(frames.data(), {5, 4}), ArrayView(poses.data(), {4, 4})),
        "frames: expected (4, 5) uint8 as before, got (5, 4) uint8");
    CHECK_SAYS(
        Reconstructor({.spacing = 1, .compounding = Compounding::median}), "compounding: a median needs all frames");
}
