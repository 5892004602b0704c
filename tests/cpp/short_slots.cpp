// Slots of neighbors in 16 bits: the same neighbors, or all 32 bits where a packet's are too far from each other.
#include <doctest.h>

#include <cstdint>
#include <vector>

#include "exec/cpu_packet.hpp"
#include "sim/neighbors.hpp"

namespace core = globule::core;
namespace sim = core::sim;

namespace {

using Packet = core::CpuPacket;
constexpr std::uint32_t kNobody = 1'000'000, kPlaces = 4;

/// The first packet's lists; the last row has none.
struct Some {
    std::vector<std::uint32_t> count, index;
    std::vector<sim::Pairs<Packet>> pairs;
    Packet::Bases bases{77};
    sim::Lists<Packet> lists;

    Some() : count(Packet::width, kPlaces), index(kPlaces * Packet::width, kNobody), pairs(kPlaces) {
        lists.n_rows = Packet::width;
        lists.places = kPlaces;
        lists.n = kNobody;
        lists.count = count.data();
        lists.index = index.data();
        lists.pairs = pairs.data();
        lists.bases = &bases;
        count[Packet::width - 1] = 0;
        for (std::size_t row = 0; row + 1 < std::size_t(Packet::width); ++row)
            for (std::uint32_t k = 0; k < kPlaces; ++k)
                index[lists.at(row, k)] = std::uint32_t(300'000 + 10 * row + 1000 * k);
    }
    /// Whether 16 bits are enough; either way they tell of the same neighbors, with the first in the place of nobody.
    bool shorten() {
        std::vector<float> number(kNobody + 1);
        for (std::uint32_t i = 0; i <= kNobody; ++i) number[i] = float(i);
        Packet::ShortSlots shorts(lists.index, lists.count, lists.n_rows);
        for (std::uint32_t k = 0; k < kPlaces; ++k) {
            const Packet::F g = Packet::map([](int lane) { return 0.5f * float(lane); });
            const auto kept = lists.keep_pair(lists.at(0, k), shorts, {g, g, g});
            for (int lane = 0; lane < Packet::width; ++lane) CHECK(Packet::get(kept.y, lane) == 0.5f * float(lane));
        }
        shorts.finish(lists.bases);
        lists.with_slots(0, [&](const auto& gather) {
            for (std::uint32_t k = 0; k < kPlaces; ++k) {
                const std::size_t at = lists.at(0, k);
                const Packet::F found = gather(number.data(), at, lists.read_pair(at));
                for (int lane = 0; lane < Packet::width; ++lane) {
                    const std::uint32_t slot = index[at + lane];
                    CHECK(Packet::get(found, lane) == float(slot == kNobody && !bases.are_far() ? bases.first : slot));
                    CHECK(lists.one_gradient(at + lane).z == 0.5f * float(lane));
                }
            }
        });
        return !bases.are_far();
    }
};

}  // namespace

TEST_CASE("near slots have 16 bits") {
    Some some;
    CHECK(some.shorten());
    CHECK(some.bases.first == 300'000);
    some.index[some.lists.at(1, 2)] = kNobody;
    CHECK(some.shorten());
    some.index[some.lists.at(2, 3)] = 300'000 + 65'535;
    CHECK(some.shorten());
}

TEST_CASE("far slots have 32 bits") {
    Some some;
    some.index[some.lists.at(2, 3)] = 300'000 + 65'536;
    CHECK(!some.shorten());
    Some below;
    below.index[below.lists.at(1, 2)] = 299'999;  // out of order, as in a periodic domain
    CHECK(!below.shorten());
}

TEST_CASE("nobody has neighbors") {
    Some some;
    some.count.assign(some.count.size(), 0);
    some.index.assign(some.index.size(), kNobody);
    CHECK(!some.shorten());
}
