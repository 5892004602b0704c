// Bins of tracked images: what falls into a voxel, pixel by pixel; holes; the check of messages.
#include <map>
#include <string>
#include <vector>

#include "base/crc64.hpp"
#include "exec/cpu.hpp"
#include "random.hpp"
#include "sweep/between.hpp"
#include "sweep/points.hpp"

namespace {

using namespace core::sweep;
#define PIXELS std::uint8_t, std::uint16_t, float

constexpr Grid grid_of(int x, int y, int z) { return {{x, y, z}, {(x + 3) / 4, (y + 3) / 4, (z + 3) / 4}}; }

/// Images at random places and angles, some pixels outside of the grid and some masked; each block has its number's
/// place.
template <class T> struct Sweep {
    static constexpr int n = 5, height = 20, width = 150;
    Grid grid = grid_of(18, 13, 9);
    std::vector<T> values;
    std::vector<Pose> poses;
    std::vector<std::uint8_t> mask;
    std::vector<std::uint32_t> slots, changed;
    core::Cpu cpu{core::kHost, 2, nullptr};

    Sweep()
        : values(n * height * width), poses(n), mask(height * width), slots(grid.n_blocks()), changed(slots.size()) {
        Random random(1);
        for (T& v : values) v = T(random(0, sizeof(T) == 1 ? 255 : 9999));
        for (Pose& p : poses)
            for (int k = 0; k < 3; ++k) {
                p.origin[k] = Fix(random(-1, 8) * 0x1p32);
                p.x[k] = Fix(random(-0.05, 0.12) * 0x1p32);
                p.y[k] = Fix(random(-0.4, 0.4) * 0x1p32);
            }
        poses[0].x[2] = 0;
        for (std::uint8_t& m : mask) m = random() < 0.9;
        for (std::uint32_t b = 0; b < slots.size(); ++b) slots[b] = b;
    }
    Images<T> images() const { return {values.data(), poses.data(), mask.data(), n, height, width, 100}; }
    /// Each voxel's pixels, in order: by their places alone.
    std::map<std::size_t, std::vector<std::uint32_t>> right() const {
        std::map<std::size_t, std::vector<std::uint32_t>> pixels;
        for (std::uint32_t i = 0; i < values.size(); ++i) {
            const Pose& p = poses[i / (height * width)];
            const std::uint32_t row = i / width % height, column = i % width;
            int at[3];
            bool inside = mask[row * width + column];
            for (int k = 0; k < 3; ++k) {
                at[k] = int(std::floor(double(p.origin[k] + row * p.y[k] + column * p.x[k]) * 0x1p-32));
                inside &= at[k] >= 0 && at[k] < grid.size[k];
            }
            const Cell v{at[0], at[1], at[2]};
            if (inside) pixels[grid.block(Block::of(v)) * kVoxels + Block::place(v)].push_back(i);
        }
        return pixels;
    }
    std::vector<std::uint64_t> bin(const Coding& coding, int sign = 1, bool by_pixel = false) {
        std::vector<std::uint64_t> bins(slots.size() * kVoxels * coding.words());
        bin(bins, coding, sign, by_pixel);
        return bins;
    }
    void bin(std::vector<std::uint64_t>& bins, const Coding& coding, int sign, bool by_pixel) {
        const BinRows<T> rows{images(), grid, coding, slots.data(), bins.data(), sign};
        if (by_pixel) cpu.for_each(values.size(), BinPixels<T>{rows});
        else cpu.for_each(n * height, rows);
    }
    /// Values by place in the bins, and whether there is one.
    std::pair<std::vector<T>, std::vector<bool>> finish(const Coding& coding, const std::vector<std::uint64_t>& bins) {
        std::vector<T> out(slots.size() * kVoxels);
        std::vector<std::uint64_t> masks(slots.size());
        cpu.for_each_tile(
            slots.size(), FinishBlock<T>{coding, slots.data(), bins.data(), nullptr, out.data(), masks.data()});
        std::vector<bool> known;
        for (std::size_t i = 0; i < out.size(); ++i) known.push_back(masks[i / kVoxels] >> i % kVoxels & 1);
        return {out, known};
    }
};
template <class T> Coding mean_of() { return {Compounding::mean, sizeof(T) == 4, sizeof(T) == 4 ? 1024.0 : 1.0}; }
double exact_mean(const auto& values, const std::vector<std::uint32_t>& pixels) {
    double sum = 0;
    for (const std::uint32_t i : pixels) sum += values[i];
    return sum / double(pixels.size());
}

}  // namespace

TEST_CASE_TEMPLATE("a bin's mean is that of the pixels that fall into it", T, PIXELS) {
    Sweep<T> s;
    const auto right = s.right();
    const auto [values, known] = s.finish(mean_of<T>(), s.bin(mean_of<T>()));
    CHECK(right.size() > 100);
    CHECK(std::size_t(std::count(known.begin(), known.end(), true)) == right.size());
    for (const auto& [at, pixels] : right) {
        REQUIRE(known[at]);
        const double mean = exact_mean(s.values, pixels);
        if (sizeof(T) == 4) CHECK(std::abs(values[at] - mean) < 1e-3);
        else CHECK(values[at] == T(std::floor(mean + 0.5)));
    }
}

TEST_CASE_TEMPLATE("row by row and pixel by pixel bins are the same, to the bit", T, PIXELS) {
    Sweep<T> s;
    for (const Compounding mode : {Compounding::mean, Compounding::maximum, Compounding::latest, Compounding::first}) {
        Coding coding = mean_of<T>();
        coding.mode = mode;
        CHECK(s.bin(coding) == s.bin(coding, 1, true));
    }
}

TEST_CASE_TEMPLATE("what is taken out again leaves bins as they were", T, PIXELS) {
    Sweep<T> s;
    for (const bool wide : {false, true}) {
        if (sizeof(T) == 4 && !wide) continue;
        const Coding coding{Compounding::mean, wide, 1.0};
        const auto before = s.bin(coding);
        auto bins = before;
        s.bin(bins, coding, 1, false);
        s.bin(bins, coding, -1, true);
        CHECK(bins == before);
        s.bin(bins, coding, -1, false);
        CHECK(bins == std::vector<std::uint64_t>(bins.size()));
    }
}

TEST_CASE_TEMPLATE("maximum, latest and first are those of the pixels in a bin", T, PIXELS) {
    Sweep<T> s;
    for (const Compounding mode : {Compounding::maximum, Compounding::latest, Compounding::first}) {
        const Coding coding{mode, false, 1.0};
        const auto [values, known] = s.finish(coding, s.bin(coding));
        for (const auto& [at, pixels] : s.right()) {
            T most = s.values[pixels[0]];
            for (const std::uint32_t i : pixels) most = std::max(most, s.values[i]);
            CHECK(known[at]);
            CHECK(values[at] == (mode == Compounding::maximum     ? most
                                    : mode == Compounding::latest ? s.values[pixels.back()]
                                                                  : s.values[pixels[0]]));
        }
    }
}

TEST_CASE_TEMPLATE("a median is the middle pixel, or the mean of the middle two", T, PIXELS) {
    Sweep<T> s;
    std::vector<std::uint64_t> keys, masks(s.slots.size());
    const EmitPoints<T> emit{s.images(), s.grid, Keying::bins, s.slots.data(), nullptr, nullptr, nullptr};
    const auto right = s.right();
    for (const auto& [at, pixels] : right)
        for (const std::uint32_t i : pixels) keys.push_back(emit.key(at / kVoxels, int(at % kVoxels), i));
    std::sort(keys.begin(), keys.end());
    std::vector<T> out(s.slots.size() * kVoxels);
    s.cpu.for_each(keys.size(), TakeMedian<T>{keys.size(), keys.data(), s.slots.data(), out.data(), masks.data()});
    for (const auto& [at, pixels] : right) {
        std::vector<double> v;
        for (const std::uint32_t i : pixels) v.push_back(s.values[i]);
        std::sort(v.begin(), v.end());
        const double middle = 0.5 * (v[(v.size() - 1) / 2] + v[v.size() / 2]);
        if (sizeof(T) == 4) CHECK(out[at] == doctest::Approx(middle));
        else CHECK(out[at] == T(std::floor(middle + 0.5)));
        CHECK((masks[at / kVoxels] >> at % kVoxels & 1) == 1);
    }
}

TEST_CASE_TEMPLATE("codes of values have their order, and lead back", T, PIXELS) {
    std::vector<T> values{T(0), T(1), T(7), T(200), std::numeric_limits<T>::max()};
    if (sizeof(T) == 4) values.insert(values.begin(), {T(-1e30f), T(-2.5f), T(-1e-30f)});
    for (std::size_t i = 0; i < values.size(); ++i) {
        CHECK(from_ordered_bits<T>(ordered_bits(values[i])) == values[i]);
        if (i) CHECK(ordered_bits(values[i - 1]) < ordered_bits(values[i]));
    }
}

TEST_CASE_TEMPLATE("a row's piece inside of a grid is what its pixels say one by one", T, std::uint8_t, float) {
    Sweep<T> s;
    for (std::size_t i = 0; i < s.n * s.height; ++i) {
        const Row row = row_inside(s.images(), i, s.grid.size);
        const Pose& p = s.poses[i / s.height];
        for (int column = 0; column < s.width; ++column) {
            bool inside = true;
            for (int k = 0; k < 3; ++k) {
                const Fix at = p.origin[k] + Fix(i % s.height) * p.y[k] + column * p.x[k];
                inside &= at >= 0 && at >> kFraction < s.grid.size[k];
                if (column == row.first && row.first <= row.last) CHECK(row.at[k] == at);
            }
            CHECK(inside == (row.first <= column && column <= row.last));
        }
    }
}

TEST_CASE("blocks, voxels and places have numbers that lead back") {
    const Grid grid = grid_of(9, 7, 5);
    CHECK(grid.n_blocks() == 3 * 2 * 2);
    for (std::size_t i = 0; i < grid.n_voxels(); ++i) {
        const Cell v = grid.voxel(i), again = Block::voxel(grid.block(grid.block(Block::of(v))), Block::place(v));
        CHECK(grid.voxel(v) == i);
        CHECK(square(again - v) == 0);
        CHECK((grid.has_voxel(v) && grid.has_block(Block::of(v))));
    }
    CHECK(!grid.has_voxel({9, 0, 0}));
    CHECK((!grid.has_block({0, -1, 0}) && !grid.has_block({0, 0, 2})));
}

TEST_CASE("means of integers are rounded to nearest, halves up") {
    CHECK(FinishBlock<std::uint8_t>::rounded(5, 2) == 3);
    CHECK(FinishBlock<std::uint8_t>::rounded(4, 3) == 1);
    CHECK(FinishBlock<std::uint8_t>::rounded(5, 3) == 2);
    CHECK(FinishBlock<std::uint16_t>::rounded(65535ull * 1000, 1000) == 65535);
}

TEST_CASE("a hole takes the mean of the first cube that holds anything, weighted by exp(-(d / farthest)^2)") {
    const Grid grid = grid_of(12, 12, 12);
    const int reach = 5;
    const auto cubes = cube_masks(reach, 2);
    std::vector<std::uint32_t> slots(grid.n_blocks());
    for (std::uint32_t b = 0; b < slots.size(); ++b) slots[b] = b;
    Random random(2);
    std::vector<float> values(slots.size() * kVoxels);
    std::vector<std::uint64_t> masks(slots.size());
    for (float& v : values) v = float(random(0, 100));
    for (int i = 0; i < 25; ++i) masks[random.below(masks.size())] |= 1ull << random.below(64);
    const HoleFiller<float> filler{{grid, slots.data(), masks.data(), values.data()},
        {{reach, 2, cubes.data()}, nullptr, HoleWeights::normalized}};
    for (int i = 0; i < 200; ++i) {
        const Cell v{int(random.below(12)), int(random.below(12)), int(random.below(12))};
        const std::size_t own = grid.block(Block::of(v));
        if (masks[own] >> Block::place(v) & 1) continue;
        int radius = 99, farthest = 0;
        double sum = 0, weight = 0;
        const auto each = [&](const auto& fn) {
            for (std::size_t at = 0; at < values.size(); ++at) {
                const Cell d = Block::voxel(grid.block(at / kVoxels), int(at % kVoxels)) - v;
                if (masks[at / kVoxels] >> at % kVoxels & 1)
                    fn(at, square(d), std::max({std::abs(d.x), std::abs(d.y), std::abs(d.z)}));
            }
        };
        each([&](std::size_t, int, int r) { radius = std::min(radius, r); });
        each([&](std::size_t, int d2, int r) { farthest = r <= radius ? std::max(farthest, d2) : farthest; });
        each([&](std::size_t at, int d2, int r) {
            const double w = r <= radius ? std::exp(-double(d2) / farthest) : 0;
            sum += w * values[at], weight += w;
        });
        float out;
        const int found = filler.fill(Block::of(v), Block::place(v), out);
        CHECK(found == (radius <= reach ? radius : kFar));
        CHECK(out == doctest::Approx(radius <= reach ? sum / weight : 0).epsilon(1e-5));
    }
}

TEST_CASE("filled voxels stay where data lie on both sides along a line") {
    const Grid grid = grid_of(70, 5, 5);
    std::vector<float> values(grid.n_voxels(), 1.0f);
    std::vector<std::uint8_t> radius(grid.n_voxels(), kFar);
    const auto at = [&](int x, int y, int z) { return grid.voxel(Cell{x, y, z}); };
    radius[at(62, 2, 2)] = radius[at(66, 2, 2)] = radius[at(10, 0, 0)] = radius[at(12, 2, 2)] = 0;
    for (const auto& [x, y, z] : {std::tuple{64, 2, 2}, {65, 2, 2}, {67, 2, 2}, {11, 1, 1}, {11, 1, 2}})
        radius[at(x, y, z)] = 2;
    Words words{2, 5, 5, nullptr};
    std::vector<std::uint64_t> bits(words.size());
    words.bits = bits.data();
    const MarkMeasured<float> mark{grid, words, {values.data(), radius.data()}};
    for (std::size_t i = 0; i < words.size(); ++i) mark(i);
    for (std::size_t i = 0; i < words.size(); ++i) KeepBetween<float>{mark, 3, false, nullptr}(i);
    CHECK((radius[at(64, 2, 2)] == 2 && radius[at(65, 2, 2)] == 2));  // across the border of two words
    CHECK(radius[at(11, 1, 1)] == 2);                                 // along a diagonal
    CHECK((radius[at(67, 2, 2)] == kFar && values[at(67, 2, 2)] == 0));
    CHECK(radius[at(11, 1, 2)] == kFar);
}

TEST_CASE("the cyclic check of ECMA-182, in one piece or in parts of any length") {
    const auto check = [](const std::string& s, std::uint64_t crc = 0) {
        return core::crc64(reinterpret_cast<const std::uint8_t*>(s.data()), s.size(), crc);
    };
    CHECK(check("123456789") == 0x6C40DF5F0B497347ull);
    std::string text;
    for (int i = 0; i < 100; ++i) text += char(i * 37);
    for (std::size_t n = 0; n <= 100; ++n) CHECK(check(text.substr(n), check(text.substr(0, n))) == check(text));
    CHECK(check("") == 0);
}
