// Slots of neighbours in 16 bits: the same neighbours, or all 32 bits where a packet's are too far from each other.
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
    std::vector<std::uint32_t> count, index, first;
    std::vector<std::uint16_t> shorts;
    sim::Lists<Packet> lists;

    Some() : count(Packet::width, kPlaces), index(kPlaces * Packet::width, kNobody), first(1, 77), shorts(index.size(), 77) {
        lists.places = kPlaces;
        lists.n = kNobody;
        lists.count = count.data();
        lists.index = index.data();
        lists.first = first.data();
        lists.short_index = shorts.data();
        count[Packet::width - 1] = 0;
        for (std::size_t row = 0; row + 1 < std::size_t(Packet::width); ++row)
            for (std::uint32_t k = 0; k < kPlaces; ++k) index[lists.at(row, k)] = std::uint32_t(300'000 + 10 * row + 1000 * k);
    }
    /// Whether 16 bits are enough; then they tell of the same neighbours, and the first in the place of nobody.
    bool shorten() {
        sim::ShortenSlots<Packet> shorten(lists, 0);
        for (std::uint32_t k = 0; k < kPlaces; ++k) shorten.add(lists, lists.at(0, k));
        shorten.finish(lists, 0);
        bool is_short = false;
        lists.with_slots(0, [&]<class Index>(const Index* slots, std::uint32_t from) {
            is_short = sizeof(Index) == 2;
            for (std::size_t i = 0; i < index.size(); ++i) CHECK(from + slots[i] == (is_short && index[i] == kNobody ? from : index[i]));
        });
        return is_short;
    }
};

}  // namespace

TEST_CASE("near slots have 16 bits") {
    Some some;
    CHECK(some.shorten());
    CHECK(some.first[0] == 300'000);
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

TEST_CASE("nobody has neighbours") {
    Some some;
    some.count.assign(some.count.size(), 0);
    some.index.assign(some.index.size(), kNobody);
    CHECK(!some.shorten());
}
