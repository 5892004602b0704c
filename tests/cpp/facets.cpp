// Lanes of a group that stand for no pair of neighbors read what is left in memory: no facet may come of it.
#include <doctest.h>

#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "exec/cpu_group.hpp"
#include "sim/facets.hpp"

namespace core = globule::core;
namespace sim = core::sim;

namespace {

using Packet = core::CpuPacket;
using Find = sim::FindFacets<Packet, false>;
using Scratch = Find::Scratch<core::CpuGroup>;

/// A triangle of particles far from all others: its two sides are the only facets.
struct Triangle {
    static constexpr std::size_t n = 3, padded = 64;
    std::vector<core::Quad> place, normal;
    std::vector<std::uint32_t> rows, counts, index, facets, count, open;
    std::uint32_t n_rows = n;
    sim::Directions directions;

    Triangle()
        : place(padded, {2e18f, 2e18f, 2e18f, 0.0f}),
          normal(padded, {0, 0, 0, 0}),
          rows(padded, n),
          counts(padded, 0),
          index(padded * padded, n),
          facets(2 * sim::kMostFacets * padded, 77),
          count(padded, 0),
          open(sim::kDirections / 32 * padded, ~0u) {
        place[0] = {0.0f, 0.0f, 0.0f, 1.0f};
        place[1] = {1.0f, 0.0f, 0.0f, 1.0f};
        place[2] = {0.4f, 0.9f, 0.1f, 1.0f};
        for (std::uint32_t row = 0; row < n; ++row) {
            rows[row] = row;
            counts[row] = 2;
            index[lists().at(row, 0)] = (row + 1) % 3;
            index[lists().at(row, 1)] = (row + 2) % 3;
        }
    }
    sim::Lists<Packet> lists() {
        sim::Lists<Packet> l;
        l.n_rows = n;
        l.places = 8;
        l.n = n;
        l.rows = rows.data();
        l.count = counts.data();
        l.index = index.data();
        return l;
    }
    /// How many facets each particle finds, with these bits in all of the scratch memory.
    std::vector<std::uint32_t> find(std::uint32_t left) {
        const sim::Skin skin{
            place.data(), normal.data(), facets.data(), count.data(), open.data(), rows.data(), &n_rows, padded};
        const Find find{lists(), skin, {}, &directions, 1.0f, sim::kReach * sim::kReach};
        const auto scratch = std::make_unique<Scratch>();
        std::vector<std::uint32_t> words(sizeof(Scratch) / 4, left);
        core::CpuGroup group;
        for (std::uint32_t row = 0; row < n; ++row) {
            std::memcpy(static_cast<void*>(scratch.get()), words.data(), sizeof(Scratch));
            find(group, *scratch, row);
        }
        return {count.begin(), count.begin() + n};
    }
};

std::uint32_t bits(float v) {
    std::uint32_t b;
    std::memcpy(&b, &v, 4);
    return b;
}

}  // namespace

TEST_CASE("facets do not depend on what is left in memory") {
    const float inf = std::numeric_limits<float>::infinity();
    for (const std::uint32_t left :
        {0u, ~0u, bits(1.0f), bits(1e10f), bits(-1e19f), bits(1e30f), bits(3e38f), bits(inf), bits(-inf)}) {
        CAPTURE(left);
        Triangle t;
        CHECK(t.find(left) == std::vector<std::uint32_t>{2, 2, 2});
    }
}
