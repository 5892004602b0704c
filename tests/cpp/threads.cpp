// Handles from several threads; calls that are stopped.
#include <atomic>
#include <functional>
#include <thread>

#include "helpers.hpp"

using namespace globule;

namespace {

/// Runs fn(k) on n threads; what they throw fails the test.
template <class Fn> void on_threads(int n, const Fn& fn) {
    std::vector<std::thread> threads;
    std::atomic<int> n_failed{0};
    for (int k = 0; k < n; ++k)
        threads.emplace_back([&, k] {
            try {
                fn(k);
            } catch (const std::exception& e) {
                ++n_failed;
                MESSAGE(e.what());
            }
        });
    for (std::thread& t : threads) t.join();
    CHECK(n_failed == 0);
}

/// Whether a call was stopped by another thread, which after a while asks again and again until the call has ended.
bool is_stopped(int yields, const std::function<void()>& stop, const std::function<void()>& call) {
    std::atomic<bool> begun{false}, ended{false};
    std::thread stopper([&] {
        begun = true;
        for (int i = 0; i < yields && !ended; ++i) std::this_thread::yield();
        while (!ended) stop();
    });
    while (!begun) std::this_thread::yield();
    bool stopped = false;
    try {
        call();
    } catch (const Error& e) {
        CHECK(int(e.code()) == int(ErrorCode::cancelled));
        stopped = true;
    }
    ended = true;
    stopper.join();
    return stopped;
}

}  // namespace

TEST_CASE("threads on one scene wait for each other; frames are read by any") {
    const std::vector<float> small = cube(6), large = cube(9);
    const Camera camera = Camera::fit(large);
    const auto of_small = Scene({.positions = small}, on_cpu).render(camera, 64, 48).image();
    Scene s({.positions = small}, {.support = 0.2, .device = "cpu"});
    const auto expected_small = s.render(camera, 64, 48).image(),
               expected_large =
                   Scene({.positions = large}, {.support = 0.2, .device = "cpu"}).render(camera, 64, 48).image();
    const Frame shared = s.render(camera, 64, 48);
    std::atomic<int> wrong{0};
    on_threads(4, [&](int k) {
        Scene mine = s;  // a handle each
        for (int i = 0; i < 20; ++i) {
            if (k == 0) mine.update({.positions = i % 2 ? small : large});
            const auto picture = mine.render(camera, 64, 48).image();
            wrong += picture != expected_small && picture != expected_large;
            wrong += shared.image() != expected_small;
            wrong += mine.field(small).size() != small.size() / 3;
        }
    });
    CHECK(wrong == 0);
    CHECK(of_small.size() == expected_small.size());
}

TEST_CASE("scenes of their own run in parallel") {
    const std::vector<float> p = cube(6);
    const Camera camera = Camera::fit(p);
    const auto expected = Scene({.positions = p}, on_cpu).render(camera, 64, 48).image();
    std::atomic<int> wrong{0};
    on_threads(4, [&](int) {
        for (int i = 0; i < 5; ++i) wrong += Scene({.positions = p}, on_cpu).render(camera, 64, 48).image() != expected;
    });
    CHECK(wrong == 0);
}

TEST_CASE("two threads draw layers in opposite orders") {
    const std::vector<float> p = cube(5);
    const Camera camera = Camera::fit(p);
    const Scene a({.positions = p}, on_cpu), b({.positions = cube(4)}, on_cpu);
    on_threads(2, [&](int k) {
        for (int i = 0; i < 10; ++i)
            render(k ? std::vector<Layer>{{a}, {b}} : std::vector<Layer>{{b}, {a}}, camera, 32, 24);
    });
}

TEST_CASE("a call that is stopped leaves its scene right or asks for an update") {
    const std::vector<float> p = cube(30);
    const Camera camera = Camera::fit(p);
    RenderSettings settings;
    settings.shadows = true;
    settings.ambient_rays = 2;
    Scene s({.positions = p}, {.support = 0.2, .device = "cpu"});
    const auto picture = [&] { return s.render(camera, 24, 18, settings).image(); };
    const auto expected = picture();
    int n_stopped[2] = {0, 0}, wrong = 0;
    for (int i = 0; n_stopped[0] < 4 || n_stopped[1] < 4; ++i) {
        const bool updates = i % 2;
        const bool stopped = is_stopped(
            i / 2 % 4 * 200, [&] { s.cancel(); },
            [&] {
                if (updates) s.update({.positions = p});
                else wrong += picture() != expected;
            });
        n_stopped[updates] += stopped;
        try {
            wrong += picture() != expected;
        } catch (const Error& e) {
            CHECK(int(e.code()) == int(ErrorCode::stale));
            CHECK((stopped && updates));
            s.update({.positions = p});
            wrong += picture() != expected;
        }
    }
    CHECK(wrong == 0);
}

TEST_CASE("a reconstruction that is stopped is right at the next call, or says that it cannot be") {
    const int n = 8, edge = 80;
    const std::vector<std::uint8_t> frames(std::size_t(n) * edge * edge, 100);
    std::vector<double> poses;
    for (int f = 0; f < n; ++f) {
        const Matrix4 m{0.25, 0, 0, 0, 0, 0.25, 0, 0, 0, 0, 1, 2.0 * f, 0, 0, 0, 1};
        poses.insert(poses.end(), m.begin(), m.end());
    }
    const ArrayView images(frames.data(), {n, edge, edge}), places(poses.data(), {n, 4, 4});
    const ReconstructorOptions options{.spacing = 0.5, .device = "cpu"};
    Reconstructor reference(options);
    reference.add(images, places);
    const Volume expected = reference.volume();
    int n_stopped = 0, wrong = 0;
    for (int i = 0; n_stopped < 6; ++i) {
        Reconstructor r(options);
        bool added = false;
        n_stopped += is_stopped(
            i % 6 * 2000, [&] { r.cancel(); },
            [&] {
                r.add(images, places);
                added = true;
                wrong += r.volume().bytes != expected.bytes;
            });
        try {
            if (!added) r.add(images, places);
            wrong += r.volume().bytes != expected.bytes;
        } catch (const Error& e) { CHECK(int(e.code()) == int(ErrorCode::stale)); }
    }
    CHECK(wrong == 0);
}

TEST_CASE("what is asked while calls work can end them") {
    static std::atomic<int> n_asked;
    static std::atomic<bool> stops;
    n_asked = 0, stops = false;
    Poll poll{[] { return ++n_asked, stops.load(); }};
    poll.pause_ms = 0;
    const std::vector<float> p = cube(30);
    Scene s({.positions = p}, {.device = "cpu", .poll = &poll});
    CHECK(n_asked > 0);
    stops = true;
    error_of([&] { s.update({.positions = p}); }, ErrorCode::cancelled);
    stops = false;
    s.update({.positions = p});
    CHECK(s.octree().n_inside == 27000);
}

TEST_CASE("a reconstruction tells how far it is") {
    const std::vector<std::uint8_t> frames(std::size_t(40) * 16, 100);
    std::vector<double> poses;
    for (int f = 0; f < 40; ++f) {
        const Matrix4 m{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, double(f), 0, 0, 0, 1};
        poses.insert(poses.end(), m.begin(), m.end());
    }
    const Sweep sweep{.frames = ArrayView(frames.data(), {40, 4, 4}), .world_from_image = poses};
    std::vector<std::size_t> told;
    const auto tell = [&](std::size_t done, std::size_t of) {
        CHECK(of == 40);
        told.push_back(done);
    };
    const ReconstructOptions quiet{.spacing = 1, .compounding = Compounding::latest, .device = "cpu"};
    ReconstructOptions telling = quiet;
    telling.progress = tell;
    CHECK(reconstruct(sweep, telling).bytes == reconstruct(sweep, quiet).bytes);
    CHECK(told.size() == 20);
    CHECK(told.front() == 2);
    CHECK(told.back() == 40);
}
