// Loops of the CPU's threads: sums, scans and sorts against the standard library's, at sizes around their parts; what
// an item throws is thrown by the loop and does not end the process.
#include <doctest.h>

#include <algorithm>
#include <cstdint>
#include <new>
#include <numeric>
#include <vector>

#include "exec/cpu.hpp"

namespace core = globule::core;

namespace {

struct RunsOut {
    void operator()(std::size_t i) const {
        if (i == 700) throw std::bad_alloc();
    }
};
struct TileRunsOut {
    template <class Group> struct Scratch {};
    template <class Group> void operator()(Group&, Scratch<Group>&, std::size_t i) const { RunsOut{}(i); }
};
struct ScratchRunsOut : TileRunsOut {
    template <class Group> struct Scratch : TileRunsOut::Scratch<Group> {
        Scratch() { throw std::bad_alloc(); }
    };
};

}  // namespace

TEST_CASE("loops throw what their items throw") {
    core::Cpu cpu(core::kHost, 0, nullptr);
    CHECK_THROWS_AS(cpu.for_each_uneven(1000, RunsOut{}), std::bad_alloc);
    CHECK_THROWS_AS(cpu.for_each_task(1000, RunsOut{}), std::bad_alloc);
    CHECK_THROWS_AS(cpu.for_each_tile(1000, TileRunsOut{}), std::bad_alloc);
    CHECK_THROWS_AS(cpu.for_each_tile(1, ScratchRunsOut{}), std::bad_alloc);
    CHECK_NOTHROW(cpu.for_each_task(700, RunsOut{}));
}

TEST_CASE("sums, scans and sorts are the standard library's") {
    for (const int threads : {1, 2, 3}) {
        core::Cpu cpu(core::kHost, threads, nullptr);
        for (const std::size_t n : {0, 1, 2, 1023, 1024, 1025, 4097, 30'000}) {
            std::vector<std::uint32_t> values(n), index(n), spare_index(n);
            std::vector<std::uint64_t> keys(n), spare(n);
            for (std::size_t i = 0; i < n; ++i) {
                keys[i] = i * 0x9e3779b97f4a7c15ull >> 40;
                values[i] = std::uint32_t(keys[i] % 97);
                index[i] = std::uint32_t(i);
            }
            const auto map = [&](std::size_t i) { return std::uint64_t(values[i]); };
            const auto add = [](std::uint64_t a, std::uint64_t b) { return a + b; };
            const std::uint64_t right = std::accumulate(values.begin(), values.end(), std::uint64_t(0));
            std::uint64_t sum = 1;
            cpu.reduce(n, map, add, std::uint64_t(0), &sum);
            CHECK(sum == right);
            cpu.reduce_in_order(n, map, add, std::uint64_t(0), &sum);
            CHECK(sum == right);

            std::vector<std::uint32_t> scanned = values, expected(n);
            cpu.exclusive_scan(n, scanned.data());
            std::exclusive_scan(values.begin(), values.end(), expected.begin(), 0u);
            CHECK(scanned == expected);

            std::vector<std::uint32_t> order = index;
            std::stable_sort(
                order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return keys[a] < keys[b]; });
            cpu.sort_pairs(n, keys.data(), spare.data(), index.data(), spare_index.data(), 24);
            CHECK(std::is_sorted(keys.begin(), keys.end()));
            CHECK(index == order);
        }
    }
}
