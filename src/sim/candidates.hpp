// Finds which candidates of a bunch of rows are near which of its rows.
//
// Two ways make the same lists:
//   by row    a CPU: one row after the other tests a vector of candidates at a time, and packs the near ones
//   by lane   a GPU: each lane is a row; all test the same candidate, and the signs of their answers are bits of a mask
#pragma once
#include "base/quad.hpp"
#include "octree/types.hpp"
#include "sim/sizes.hpp"

namespace globule::core::sim {

/// Squared distances that float32 cannot tell from the support's: these pairs are decided in float64.
inline constexpr float kDoubt = 4e-6f;

/// Rows that lie together, and the box around them.
struct Bunch {
    std::uint32_t set;
    float3 lo, hi;

    GB_FN float3 middle() const { return {0.5f * (lo.x + hi.x), 0.5f * (lo.y + hi.y), 0.5f * (lo.z + hi.z)}; }
};

/// The rows of a tile, a lane each; `count`: neighbors so far.
template <class Group> struct TileRows {
    typename Group::F x, y, z;
    typename Group::U slot, count;
};

/// Where a tile's lists are.
struct TileLists {
    std::uint32_t* index;
    std::uint32_t places;  ///< what goes beyond is counted, and not written
};

/// Particles are near that are closer than the support; of two sizes, than the mean of both supports.
struct Nearness {
    SortedParticles particles;
    float support;  ///< of size 1
    Sizes sizes;
};

template <class Group, bool mixed, int capacity> struct CandidatesByRow {
    static constexpr int places = capacity + Group::width;
    float x[places], y[places], z[places];
    std::uint32_t slot[places], found[places];
    float size[mixed ? places : 1];

    /// Of a group's worth of particles from `begin` on, at (px, py, pz), those that may be near; how many there are
    /// then.
    GB_FN int add(const Group& g, int n, typename Group::B may, const typename Group::F& px,
        const typename Group::F& py, const typename Group::F& pz, std::uint32_t begin, const Nearness& near,
        const Bunch&) {
        g.keep(may, px, x + n);
        g.keep(may, py, y + n);
        g.keep(may, pz, z + n);
        g.keep(may, g.numbers(begin), slot + n);
        if constexpr (mixed) g.keep(may, g.load_run(near.sizes.of + begin), size + n);
        return n + g.count(may);
    }
    /// The bunch's rows take up those of n candidates that are theirs.
    GB_FN void look(const Group& g, int n, TileRows<Group>& rows, const Bunch& b, const Nearness& near, const float3&,
        const TileLists& out) {
        g.sync();
        for (std::uint32_t set = b.set; set; set &= set - 1) {
            const int row = trailing_zeros(set);
            const std::uint32_t before = g.pick(rows.count, row);
            const int m = find(
                g, n, {g.pick(rows.x, row), g.pick(rows.y, row), g.pick(rows.z, row)}, g.pick(rows.slot, row), near);
            g.sync();
            const int room = max(int(out.places) - int(before), 0);
            g.share(min(m, room), [&](int k) { out.index[std::size_t(before + k) * Group::width + row] = found[k]; });
            g.per_lane(g.only(row), [&](int lane) { Group::put(rows.count, lane, before + std::uint32_t(m)); });
        }
        g.sync();
    }

private:
    /// Puts the candidates near a place, but for the one in slot `own`, into `found`; how many.
    GB_FN int find(const Group& g, int n_near, const float3& at, std::uint32_t own, const Nearness& near) {
        using V = typename Group::F;
        const float h2 = near.support * near.support;
        V sure = V(h2 * (1.0f - kDoubt)), possible = V(h2 * (1.0f + kDoubt));
        [[maybe_unused]] const float of_own = near.sizes.at(own);
        int n = 0;
        for (int k = 0; k < n_near; k += Group::width) {
            if constexpr (mixed) {
                const V mean = V(0.5f) * (V(of_own) + g.load_run(size + k)), m2 = mean * mean;
                sure = V(h2 * (1.0f - kDoubt)) * m2;
                possible = V(h2 * (1.0f + kDoubt)) * m2;
            }
            const V dx = V(at.x) - g.load_run(x + k), dy = V(at.y) - g.load_run(y + k),
                    dz = V(at.z) - g.load_run(z + k);
            const V r2 = dx * dx + dy * dy + dz * dz;
            typename Group::B mine = g.first_lanes(n_near - k) & (r2 < possible) & g.differ(slot + k, own);
            const typename Group::B doubtful = mine & !(r2 < sure);
            if (g.any(doubtful))
                g.per_lane(doubtful, [&](int lane) {
                    const int j = k + g.lane_number(lane);
                    double h = near.support;
                    if constexpr (mixed) h *= 0.5 * (double(of_own) + size[j]);
                    const double ex = double(at.x) - x[j], ey = double(at.y) - y[j], ez = double(at.z) - z[j];
                    Group::put(mine, lane, ex * ex + ey * ey + ez * ez < h * h);
                });
            g.keep(mine, g.load_run(slot + k), found + n);
            n += g.count(mine);
        }
        return n;
    }
};

/// With places from the bunch's middle, t = |c|^2 - 2 x.c + |x|^2 - h^2 is below 0 where c is near x: four operations a
/// candidate, since |c|^2 is the same for all rows.  Its roundings add up to less than kDoubt times the square of the
/// farthest place; where t is as close to 0, float64 decides.
template <class Group, bool mixed, int capacity> struct CandidatesByLane {
    static constexpr int places = capacity + 32, words = places / 32;
    Quad item[places];  ///< c, |c|^2; of two sizes less (h s / 2)^2
    std::uint32_t slot[places];
    float size[mixed ? places : 1];
    std::uint32_t mask[words][32];  ///< of each row, the first candidate in the highest bit
    std::uint8_t lane_of[32];

    GB_FN int add(const Group& g, int n, bool may, float px, float py, float pz, std::uint32_t begin,
        const Nearness& near, const Bunch& b) {
        return g.append(may, n, [&](int lane, int at) {
            const float3 o = b.middle();
            const float x = px - o.x, y = py - o.y, z = pz - o.z;
            item[at] = {x, y, z, x * x + y * y + z * z};
            slot[at] = begin + lane;
            if constexpr (mixed) {
                const float s = near.sizes.of[begin + lane], hs = 0.5f * near.support * s;
                item[at].w -= hs * hs;
                size[at] = s;
            }
        });
    }
    GB_FN void look(const Group& g, int n, TileRows<Group>& rows, const Bunch& b, const Nearness& near,
        const float3& shift, const TileLists& out) {
        const int lane = g.lane();
        const bool mine = b.set >> lane & 1;
        if (lane < (32 - n % 32) % 32) {  // so that words are full
            item[n + lane] = {0.0f, 0.0f, 0.0f, infinity()};
            if constexpr (mixed) size[n + lane] = 0.0f;
        }
        if (mine) lane_of[count_bits(b.set & ((1u << lane) - 1))] = std::uint8_t(lane);
        g.sync();
        test(g, n, rows, b, near, shift);
        g.sync();
        std::uint32_t m = 0, full = 0, total = 0;  // of this row: the word that is read, those that have bits, bits
        for (int w = 0; mine && 32 * w < n; ++w) {
            const std::uint32_t of_word = mask[w][lane];
            total += std::uint32_t(count_bits(of_word));
            full |= std::uint32_t(of_word != 0) << w;
        }
        // All rows write their k-th neighbor together.
        const std::uint32_t longest = g.largest(total);
        int first = 0;
        for (std::uint32_t k = 0; k < longest; ++k) {
            if (m == 0 && full) {
                const int w = trailing_zeros(full);
                full &= full - 1;
                first = 32 * w;
                m = mask[w][lane];
            }
            const int bit = leading_zeros(m | 1u);
            const std::uint32_t s = slot[first + bit];
            const bool is = (m != 0) & (s != rows.slot);
            m &= ~(0x80000000u >> bit);
            if (is & (rows.count < out.places)) out.index[rows.count * 32 + lane] = s;
            rows.count += is;
        }
        g.sync();
    }

private:
    /// The masks.  Where rows are few, several lanes share the words of one.
    GB_FN void test(
        const Group& g, int n, const TileRows<Group>& rows, const Bunch& b, const Nearness& near, const float3& shift) {
        const int n_rows = count_bits(b.set), log_share = n_rows > 16 ? 0 : n_rows > 8 ? 1 : 2;
        const bool busy = g.lane() >> log_share < n_rows;
        const int row = busy ? lane_of[g.lane() >> log_share] : 0;
        const std::uint32_t own = g.pick(rows.slot, row);
        const float3 o = b.middle(), half = b.hi - o;
        const float x = g.pick(rows.x, row) - o.x, y = g.pick(rows.y, row) - o.y, z = g.pick(rows.z, row) - o.z;
        const float h = mixed ? 0.5f * near.support * near.sizes.of[own] : near.support,
                    reach = sqrt(dot(half, half)) + near.support, band = kDoubt * reach * reach;
        const float square = busy ? x * x + y * y + z * z - h * h : infinity(), x2 = -2.0f * x, y2 = -2.0f * y,
                    z2 = -2.0f * z;
        [[maybe_unused]] const float cross = -h * near.support;
        const auto beyond = [&](int k) {
            const Quad& c = item[k];
            float t = c.w + square;
            if constexpr (mixed) t += cross * size[k];
            return x2 * c.x + (y2 * c.y + (z2 * c.z + t));
        };
        for (int w = g.lane() & ((1 << log_share) - 1); 32 * w < n; w += 1 << log_share) {
            std::uint32_t m = 0, doubt = 0;
            float least = infinity();
            for (int k = 32 * w; k < 32 * w + 32; ++k) {
                const float t = beyond(k);
                m = g.shift_in_sign(m, t);
                least = fminf(least, abs(t));
            }
            if (least < band) {  // in a lattice, many pairs are as far apart as the support is long
                const int end = min(32 * w + 32, n);
                for (int k = 32 * w; k < end; ++k) doubt |= std::uint32_t(abs(beyond(k)) < band) << (31 - k % 32);
            }
            while (doubt) {
                const int k = leading_zeros(doubt);
                const std::uint32_t bit = 0x80000000u >> k;
                m = is_near(own, slot[32 * w + k], near, shift) ? m | bit : m & ~bit;
                doubt &= ~bit;
            }
            if (busy) mask[w][row] = m;
        }
    }
    GB_FN static bool is_near(std::uint32_t i, std::uint32_t j, const Nearness& near, const float3& shift) {
        const float3 a = near.particles.position(i), c = near.particles.position(j) + shift;
        double h = near.support;
        if constexpr (mixed) h *= 0.5 * (double(near.sizes.of[i]) + near.sizes.of[j]);
        const double ex = double(a.x) - c.x, ey = double(a.y) - c.y, ez = double(a.z) - c.z;
        return ex * ex + ey * ey + ez * ez < h * h;
    }
};

}  // namespace globule::core::sim
