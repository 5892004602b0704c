// The grid under a reconstructor: bins, holes, maps, growing, and PLUS.
#include <algorithm>
#include <numeric>

#include "helpers.hpp"

using namespace globule;

namespace {

constexpr int kFrames = 3, kHeight = 4, kWidth = 5, kPixels = kFrames * kHeight * kWidth;
constexpr std::array<int, 3> kSize{8, 8, 8};
constexpr std::size_t kVoxels = 512;

/// Planes z = 0, step, ... of pixels that are as wide as voxels.
struct Images {
    std::vector<std::uint8_t> values = std::vector<std::uint8_t>(kPixels);
    std::vector<std::int64_t> poses;
    std::vector<double> matrices;

    explicit Images(int step = 1) {
        std::iota(values.begin(), values.end(), std::uint8_t(1));
        for (int f = 0; f < kFrames; ++f) {
            const std::int64_t one = std::int64_t(1) << 32, half = one / 2;
            poses.insert(poses.end(), {half, half, step * f * one + half, one, 0, 0, 0, one, 0});
            matrices.insert(matrices.end(), {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, double(step * f)});
        }
    }
    ArrayView frames() const { return {values.data(), Shape(kFrames, kHeight, kWidth)}; }
    GridFrames here(std::uint32_t first_order = 0) const { return {frames(), poses, {}, first_order}; }
};
std::size_t at(int x, int y, int z) { return std::size_t(x + 8 * (y + 8 * z)); }

struct Dense {
    std::vector<std::uint8_t> values = std::vector<std::uint8_t>(kVoxels), radius = values;
    explicit Dense(const SweepGrid& grid, const GridFrames& frames = {}, FillMethod method = FillMethod::bins) {
        SweepGrid(grid).fill(frames, {.method = method, .reach = 1, .values = values, .radius = radius});
    }
};

SweepGrid started(Compounding compounding = Compounding::mean) {
    SweepGrid g({.device = "cpu"});
    g.start({.compounding = compounding, .size = kSize});
    return g;
}

}  // namespace

TEST_CASE("voxels have the mean of their pixels, holes between them are filled") {
    const Images images(2);
    SweepGrid g = started();
    g.add(images.here());
    const Dense d(g);
    for (int f = 0; f < kFrames; ++f)
        for (int y = 0; y < kHeight; ++y)
            for (int x = 0; x < kWidth; ++x) {
                CHECK(d.values[at(x, y, 2 * f)] == images.values[std::size_t(x + kWidth * (y + kHeight * f))]);
                CHECK(d.radius[at(x, y, 2 * f)] == 0);
            }
    CHECK(d.radius[at(2, 2, 1)] == 1);
    CHECK(
        d.values[at(2, 2, 1)] == doctest::Approx(0.5 * (d.values[at(2, 2, 0)] + d.values[at(2, 2, 2)])).epsilon(0.05));
    CHECK(d.radius[at(7, 7, 7)] == Volume::empty_radius);
    CHECK(g.facts().n_blocks == 4);
    CHECK(g.layout().size == kSize);
    CHECK(Dense(g, images.here(), FillMethod::points).radius[at(0, 0, 0)] == 0);
}

TEST_CASE("what is taken out of a mean is gone") {
    const Images images;
    SweepGrid g = started();
    g.add(images.here());
    g.add(images.here(), -1);
    const Dense d(g);
    CHECK(std::count(d.radius.begin(), d.radius.end(), 255) == kVoxels);
    CHECK_SAYS(started(Compounding::maximum).add(images.here(), -1), "sign: expected 1, or -1 of a mean, got -1");
}

TEST_CASE("of several pixels the first, the latest, the largest, the middle one") {
    Images low, high;
    std::fill(low.values.begin(), low.values.end(), std::uint8_t(10));
    std::fill(high.values.begin(), high.values.end(), std::uint8_t(30));
    for (const auto& [compounding, expected] : {std::pair{Compounding::mean, 20}, {Compounding::maximum, 30},
             {Compounding::latest, 10}, {Compounding::first, 30}}) {
        SweepGrid g = started(compounding);
        g.add(high.here(0));
        g.add(low.here(kPixels));
        CHECK(Dense(g).values[at(1, 1, 1)] == expected);
    }
    SweepGrid g = started(Compounding::median);
    g.median(low.here());
    CHECK(Dense(g).values[at(1, 1, 1)] == 10);
}

TEST_CASE("a grid keeps its volume, which can be read in parts, and grows") {
    Images images;
    for (std::size_t i = 0; i < images.poses.size(); ++i)
        if (i % 9 < 3) images.poses[i] += std::int64_t(8) << 32;  // farther inside than a kernel reaches
    SweepGrid g = started();
    g.start({.size = {32, 16, 24}});
    g.add(images.here());
    g.fill({}, {.reach = 1});
    CHECK_SAYS(g.filled(), "filled: expected a grid on a GPU");
    const std::vector<std::uint8_t> expected{12, 13, 14, 17, 18, 19};
    std::vector<std::uint8_t> part(6), radii(6);
    g.read_filled({9, 10, 8}, {3, 2, 1}, part, radii);
    CHECK(part == expected);
    CHECK(radii == std::vector<std::uint8_t>(6));
    CHECK_SAYS(g.read_filled({30, 0, 0}, {3, 1, 1}, {}, {}), "size: expected a box within the grid");
    g.grow({128, 32, 24}, {16, 1, 0});
    g.fill({}, {.reach = 1});
    g.read_filled({73, 14, 8}, {3, 2, 1}, part, {});
    CHECK(part == expected);
    CHECK_SAYS(g.grow({256, 32, 24}, {1, 0, 0}), "shift: expected the old grid within the new one");
}

TEST_CASE("maps tell how many pixels, which frame, and how they differ") {
    const Images images;
    SweepGrid g = started();
    g.add(images.here());
    g.add(images.here());
    std::vector<std::uint32_t> count(kVoxels);
    g.count_map(count);
    CHECK(count[at(4, 3, 2)] == 2);
    CHECK(std::accumulate(count.begin(), count.end(), 0u) == 2 * kPixels);
    std::vector<float> variance(kVoxels, 1.0f);
    g.variance_map(images.here(), variance);
    CHECK_SAYS(g.count_map(variance), "out: expected uint32 in host memory, got float32");
    SweepGrid latest = started(Compounding::latest);
    latest.add(images.here());
    std::vector<std::int32_t> source(kVoxels);
    latest.source_map(kHeight * kWidth, source);
    CHECK(source[at(0, 0, 0)] == 0);
    CHECK(source[at(4, 3, 2)] == 2);
    CHECK(source[at(7, 7, 7)] == -1);
}

TEST_CASE("frames that do not fit a grid are refused") {
    const Images images;
    SweepGrid none, g = started();
    CHECK_SAYS(none.facts(), "grid: expected a grid, got an empty handle");
    GridFrames f = images.here();
    f.poses = std::vector<std::int64_t>();
    CHECK_SAYS(g.add(f), "poses: expected 27 numbers, got (0,)");
    f.poses = {};
    CHECK_SAYS(g.add(f), "poses: expected one of each frame, got none");
    g.start({.dtype = DType::float32, .size = kSize});
    CHECK_SAYS(g.add(images.here()), "frames: expected float32, got uint8");
    CHECK_SAYS(g.start({.dtype = DType::int64, .size = kSize}), "dtype: expected uint8, uint16 or float32, got int64");
    CHECK_SAYS(g.start({.size = {0, 1, 1}}), "size: expected 1 to 2097152, got 0");
    CHECK_SAYS(g.fill({}, {.reach = 200}), "reach: expected 0 to 126, got 200");
    std::vector<float> values(kVoxels);
    CHECK_SAYS(g.fill({}, {.values = values}), "radius: expected values and radius, or neither, got one");
}

TEST_CASE("PLUS puts the nearest pixel into each voxel, and a hole's neighbors into holes") {
    const Images images(2);
    std::vector<std::int32_t> sources(kHeight * kWidth);
    std::iota(sources.begin(), sources.end(), 0);
    const std::vector<std::uint32_t> which(kFrames);
    std::vector<std::uint8_t> values(kVoxels), origin(kVoxels);
    std::vector<std::uint16_t> accumulator(kVoxels);
    PlusSweep plus{.frames = images.frames(),
        .voxel_from_image = images.matrices,
        .sources = sources,
        .source_of_frame = which,
        .size = kSize,
        .values = values,
        .accumulator = accumulator,
        .origin = origin};
    const SweepGrid g({.device = "cpu"});
    CHECK(g.plus(plus).second >= 0);
    CHECK(values[at(4, 3, 2)] == 40);
    CHECK(accumulator[at(4, 3, 2)] == 256);
    CHECK(std::count(origin.begin(), origin.end(), 0) == kPixels);
    plus.fill_holes = true;
    plus.fillers = {{.type = 3, .size = 3, .least_ratio = 0.1f}};
    g.plus(plus);
    CHECK(origin[at(2, 2, 1)] == 1);
    CHECK(values[at(2, 2, 1)] > 0);
    plus.rejection = 250;
    g.plus(plus);
    CHECK(std::count(origin.begin(), origin.end(), 0) == 0);
    sources[3] = kHeight * kWidth;
    CHECK_SAYS(g.plus(plus), "sources: expected pixels of a frame, got others");
    plus.compounding = 4;
    sources[3] = -1;
    CHECK_SAYS(g.plus(plus), "compounding: expected 0 to 3, got 4");
    CHECK(g.device() == "cpu");
}

TEST_CASE("answers reach a GPU's memory") {
    if (devices().size() == 1) return;
    const std::vector<float> ones(kPixels, 1.0f), p = cube(8);
    std::vector<float> points;
    for (int i = 0; i < int(kVoxels); ++i)
        for (const int k : {i % 8, i / 8 % 8, i / 64}) points.push_back(0.1f * float(k) + 0.03f);
    const Images images;
    GridFrames frames = images.here();
    frames.frames = ArrayView(ones.data(), {kFrames, kHeight, kWidth});
    SweepGrid g({.device = "cuda:0"});  // whose volume is such memory
    g.start({.dtype = DType::float32, .size = kSize});
    g.add(frames);
    g.fill({}, {.reach = 1});
    const ArrayView there = g.filled().first;
    const auto view = [&](Shape shape, Location where) {
        return MutableArrayView(const_cast<void*>(there.data()), DType::float32, shape, where);
    };
    for (const char* device : {"cpu", "cuda:0"}) {
        const Scene s({.positions = p}, {.support = 0.2, .device = device});
        std::vector<float> found(kVoxels), first(1);
        for (const Location where : {there.where(), on_gpu()}) {
            s.field(points, view({8, 8, 8}, where));
            g.read_filled({0, 0, 0}, kSize, found, {});
            CHECK(found == s.field(points));
            s.blend(points, std::vector<float>(512, 2.0f), view({kVoxels}, where));
            g.read_filled({0, 0, 0}, kSize, found, {});
            CHECK(found == s.blend(points, std::vector<float>(512, 2.0f)));
        }
        const std::vector<float> above{0.35f, 0.35f, 3}, down{0, 0, -1};
        s.intersect(above, down, view({1}, there.where()));
        g.read_filled({0, 0, 0}, {1, 1, 1}, first, {});
        CHECK(first == s.intersect(above, down).distance);
    }
}
