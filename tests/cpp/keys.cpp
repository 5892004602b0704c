// Morton keys against plain arithmetic with coordinates, for both widths.
#include <limits>

#include "morton/quantize.hpp"
#include "random.hpp"

namespace morton = core::morton;

namespace {

#define KEYS std::uint32_t, std::uint64_t

template <class Key> struct Some {
    static constexpr int levels = morton::Traits<Key>::levels;
    static constexpr Key inside = morton::Traits<Key>::inside, top = (Key(1) << levels) - 1;
    Random random{7};
    /// At the borders, in the middle, or anywhere on a level.
    Key coordinate(int level) {
        const Key last = (Key(1) << level) - 1, some[] = {0, last, Key(last / 2), Key(random.below(last + 1))};
        return some[random.below(4)];
    }
    morton::Cell<Key> cell(int level) { return {coordinate(level), coordinate(level), coordinate(level)}; }
    static Key key(const morton::Cell<Key>& c, int level) {
        const int shift = levels - level;
        return inside | morton::encode<Key>(c.x << shift, c.y << shift, c.z << shift);
    }
    int level() { return int(random.below(levels + 1)); }
    Key any() { return key(cell(levels), levels); }
};
template <class Key> bool operator==(const morton::Cell<Key>& a, const morton::Cell<Key>& b) {
    return a.x == b.x && a.y == b.y && a.z == b.z;
}

}  // namespace

TEST_CASE_TEMPLATE("the triplets of a key interleave z y x", Key, KEYS) {
    Some<Key> some;
    for (int i = 0; i < 1000; ++i) {
        const auto c = some.cell(some.levels);
        Key key = 0;
        for (int b = 0; b < some.levels; ++b)
            key |= (c.x >> b & 1) << 3 * b | (c.y >> b & 1) << (3 * b + 1) | (c.z >> b & 1) << (3 * b + 2);
        CHECK(morton::encode(c.x, c.y, c.z) == key);
        CHECK((morton::decode(key) == c));
    }
}

TEST_CASE_TEMPLATE("two zero bits follow each bit that is spread, and higher bits are left out", Key, KEYS) {
    for (int b = 0; b < int(8 * sizeof(Key)); ++b) {
        const Key spread = morton::spread(Key(Key(1) << b));
        CHECK(spread == (b < Some<Key>::levels ? Key(1) << 3 * b : 0));
        CHECK(morton::compact(spread) == (b < Some<Key>::levels ? Key(1) << b : 0));
    }
    CHECK(morton::compact(Key(~Key(0))) == Some<Key>::top);
}

TEST_CASE_TEMPLATE("an octant's bits are x, y and z of the child, whose parent is the cell", Key, KEYS) {
    Some<Key> some;
    for (int i = 0; i < 300; ++i) {
        const int level = int(some.random.below(some.levels));
        const auto c = some.cell(level);
        const Key key = some.key(c, level);
        for (Key octant = 0; octant < 8; ++octant) {
            const Key child = morton::child(key, level, int(octant));
            CHECK(child ==
                  some.key({2 * c.x + (octant & 1), 2 * c.y + (octant >> 1 & 1), 2 * c.z + (octant >> 2)}, level + 1));
            CHECK(morton::parent(child, level + 1) == key);
        }
    }
}

TEST_CASE_TEMPLATE("an ancestor's coordinates are the cell's without their last bits", Key, KEYS) {
    Some<Key> some;
    for (int i = 0; i < 300; ++i) {
        const auto c = some.cell(some.levels);
        const int level = 1 + int(some.random.below(some.levels)), shift = some.levels - level;
        CHECK(morton::ancestor(some.key(c, some.levels), level) ==
              some.key({Key(c.x >> shift), Key(c.y >> shift), Key(c.z >> shift)}, level));
    }
}

TEST_CASE_TEMPLATE("keys share as many triplets as there are cells that hold both", Key, KEYS) {
    Some<Key> some;
    for (int i = 0; i < 2000; ++i) {
        const Key a = some.any(), b = a ^ (some.any() & ~some.inside) >> some.random.below(3 * some.levels);
        const int levels = some.level();
        int shared = 0;
        while (shared < levels && morton::ancestor(a, shared + 1) == morton::ancestor(b, shared + 1)) ++shared;
        CHECK(morton::common_levels(a, b, levels) == shared);
    }
}

TEST_CASE_TEMPLATE("what lies outside shares nothing, not even the root", Key, KEYS) {
    const Key in = Some<Key>{}.any();
    CHECK(morton::common_levels(Key(0), in, 5) == -1);
    CHECK(morton::common_levels(in, Key(0), 5) == -1);
    CHECK(morton::common_levels(Key(0), Key(0), 5) == -1);
    CHECK(morton::common_levels(in, in, 0) == 0);
}

TEST_CASE_TEMPLATE("the 26 neighbors of a cell, and none beyond the border", Key, KEYS) {
    Some<Key> some;
    for (int i = 0; i < 500; ++i) {
        const int level = i < 40 ? i / 10 : some.level();
        const auto c = some.cell(level);
        const Key last = (Key(1) << level) - 1;
        for (int n = 0; n < 27; ++n) {
            const int dx = n % 3 - 1, dy = n / 3 % 3 - 1, dz = n / 9 - 1;
            const morton::Cell<Key> to{Key(c.x + dx), Key(c.y + dy), Key(c.z + dz)};  // below 0: far above the last
            Key out = 0;
            const bool found = morton::neighbor(some.key(c, level), level, dx, dy, dz, out);
            REQUIRE(found == (to.x <= last && to.y <= last && to.z <= last));
            if (found) CHECK(out == some.key(to, level));
        }
    }
}

TEST_CASE_TEMPLATE(
    "dense indices count all cells level by level, and the children of i are 8 i + 1 to 8 i + 8", Key, KEYS) {
    std::uint64_t index = 0;
    for (int level = 0; level < 5; ++level)
        for (std::uint64_t v = 0; v < 1ull << 3 * level; ++v, ++index) {
            const Key key = morton::dense_key<Key>(index);
            CHECK(morton::dense_level(index) == level);
            CHECK(morton::dense_index(key, level) == index);
            for (int octant = 0; level < 4 && octant < 8; ++octant)
                CHECK(morton::dense_index(morton::child(key, level, octant), level + 1) == 8 * index + 1 + octant);
        }
    CHECK(morton::dense_offset(9) == 19'173'961);
}

TEST_CASE_TEMPLATE("a coordinate's cell begins where it does, and the space's end is in the last one", Key, KEYS) {
    const float cells = float(1 << Some<Key>::levels), scale = cells / 8.0f;
    for (const float cell : {0.0f, 1.0f, 7.0f, cells / 2, cells - 1}) {
        const float at = cell / scale;
        CHECK(morton::quantize<Key>(at, 0.0f, scale) == Key(cell));
        if (cell > 0) CHECK(morton::quantize<Key>(std::nextafter(at, 0.0f), 0.0f, scale) == Key(cell) - 1);
    }
    CHECK(morton::quantize<Key>(8.0f, 0.0f, scale) == Some<Key>::top);
    CHECK(morton::quantize<Key>(9.0f, 0.0f, scale) == Some<Key>::top);
    CHECK(morton::quantize<Key>(-1.0f, 0.0f, scale) == 0);
}

TEST_CASE_TEMPLATE("the corners of a space are in its corner cells; a point is a space, too", Key, KEYS) {
    const morton::Space space{{-1, 2, 3}, 4.0f};
    CHECK(morton::key_of<Key>({-1, 2, 3}, space) == Some<Key>::inside);
    CHECK(morton::key_of<Key>({3, 6, 7}, space) == (Some<Key>::inside | (Some<Key>::inside - 1)));
    CHECK(morton::key_of<Key>({3, 2, 3}, space) == (Some<Key>::inside | morton::encode<Key>(Some<Key>::top, 0, 0)));
    CHECK(morton::key_of<Key>({1, 1, 1}, {{1, 1, 1}, 0.0f}) == Some<Key>::inside);
}

TEST_CASE("the borders of a box are inside, numbers that are none are not") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const float3 lo{0, 0, 0}, hi{1, 2, 3};
    CHECK(morton::is_inside(lo, lo, hi));
    CHECK(morton::is_inside(hi, lo, hi));
    for (const float3 p : {float3{-1e-9f, 1, 1}, {1, 2.0001f, 1}, {1, 1, 4}, {nan, 1, 1}, {1, nan, 1}, {1, 1, nan}})
        CHECK(!morton::is_inside(p, lo, hi));
}
