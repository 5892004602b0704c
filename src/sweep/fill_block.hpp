// The holes of one block by a group of lanes, for the GPU: the occupied voxels around it are brought
// together once, then the radius of each hole's cube is known without looking into the cubes one by one.
//
// A row of 12 voxels, the block's four and four on either side, is 12 bits.  Rows are joined over the
// y and then the z that a cube spans; a cube of radius r holds something where the joined row meets 2 r + 1 bits.
//
// What it holds lies on its surface, where a distance belongs to voxels at (+-a, +-b, +-r) in any order, a <= b <= r:
// integers are added up by distance before they are weighted.  Sums of floats depend on their order, which is that
// of holes.hpp.
#pragma once
#include "sweep/holes.hpp"

namespace globule::core::sweep {

template <class T> struct FillBlock {
    static constexpr int kReach = kBlock, kWide = 3 * kBlock;  ///< largest radius; voxels of a row

    static constexpr int kSumBits = 24;  ///< of up to 48 values of 16 bits; their number lies above

    FillVoxel<T> each;

    struct Room {
        std::uint64_t masks[27];
        std::uint32_t slots[27];
        std::uint16_t rows[kWide][kWide];             ///< [z][y]
        std::uint16_t strips[kReach][kWide][kBlock];  ///< [radius - 1][z][y], joined over y
        std::uint16_t cubes[kReach][kBlock][kBlock];  ///< and over z
        std::uint32_t
            values[is_real<T> ? 1 : kWide * kWide * kWide];  ///< (z, y, x); of integers: 1 << kSumBits | value, or 0
    };
    template <class Group> using Scratch = Room;

    template <class Group> GB_FN void operator()(Group& group, Room& s, std::size_t block) const {
        const Bins<T>& bins = each.filler.bins;
        const Grid& grid = bins.grid;
        if (each.skips(block)) return;
        const Cell b = grid.block(block);
        if (!each.near[block]) {
            if (each.dirty) group.share(kVoxels, [&](int place) { each(b, block, place); });
            return;
        }
        group.share(27, [&](int i) {
            const Cell other = b + Cell{i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1};
            const bool inside = grid.has_block(other);
            const std::size_t at = inside ? grid.block(other) : block;
            s.masks[i] = inside ? bins.masks[at] : 0;
            s.slots[i] = bins.slots[at];
        });
        group.share(kWide * kWide, [&](int i) {
            const int y = i % kWide, z = i / kWide, shift = Block::place({0, y, z});
            const std::uint64_t* m = s.masks + (z / kBlock * 3 + y / kBlock) * 3;
            s.rows[z][y] = std::uint16_t((m[0] >> shift & 15) | (m[1] >> shift & 15) << 4 | (m[2] >> shift & 15) << 8);
        });
        group.share(kWide * kBlock, [&](int i) {
            const int y = i % kBlock + kBlock, z = i / kBlock;
            std::uint16_t row = s.rows[z][y];
            for (int r = 1; r <= kReach; ++r)
                s.strips[r - 1][z][y - kBlock] = row |= s.rows[z][y - r] | s.rows[z][y + r];
        });
        group.share(kBlock * kBlock * kReach, [&](int i) {
            const int y = i % kBlock, z = i / kBlock % kBlock + kBlock, r = i / (kBlock * kBlock) + 1;
            std::uint16_t row = 0;
            for (int d = -r; d <= r; ++d) row |= s.strips[r - 1][z + d][y];
            s.cubes[r - 1][z - kBlock][y] = row;
        });
        if constexpr (!is_real<T>)
            group.share(27 * kVoxels, [&](int i) {
                const int at = i / kVoxels, v = i % kVoxels;
                std::uint32_t value = 0;
                if (s.masks[at] >> v & 1) value = 1u << kSumBits | bins.values[std::size_t(s.slots[at]) * kVoxels + v];
                const Cell c = Block::voxel({at % 3, at / 3 % 3, at / 9}, v);
                s.values[(c.z * kWide + c.y) * kWide + c.x] = value;
            });
        group.share(kVoxels, [&](int place) { fill(s, b, block, place); });
    }

    GB_FN void fill(const Room& s, Cell b, std::size_t block, int place) const {
        const HoleFiller<T>& filler = each.filler;
        const Grid& grid = filler.bins.grid;
        const Cell l = Block::inside(place), v = Block::voxel(b, place);
        if (!grid.has_voxel(v)) return;
        const std::size_t at = grid.voxel(v);
        T value{};
        std::uint8_t radius = kFar;
        if (filler.bins.masks[block] >> place & 1) {
            value = filler.bins.values[std::size_t(filler.bins.slots[block]) * kVoxels + place];
            radius = 0;
        } else {
            int r = 1;
            while (r <= filler.tables.cubes.reach &&
                   !(s.cubes[r - 1][l.z][l.y] >> (kBlock + l.x - r) & ((2u << 2 * r) - 1)))
                ++r;
            if (r <= filler.tables.cubes.reach) {
                radius = std::uint8_t(r);
                if constexpr (is_real<T>) {
                    filler.weigh(l, value, [&](const auto& visit) { for_each_hit(s, l, r, visit); });
                } else {
                    const std::uint32_t* middle =
                        s.values + ((l.z + kBlock) * kWide + l.y + kBlock) * kWide + l.x + kBlock;
                    if (r == 1) value = weighted<1>(middle);
                    else if (r == 2) value = weighted<2>(middle);
                    else if (r == 3) value = weighted<3>(middle);
                    else value = weighted<4>(middle);
                }
            }
        }
        each.out.values[at] = value;
        each.out.radius[at] = radius;
    }
    /// Values at (+-x, +-y, +-z).
    GB_FN static std::uint32_t mirrored(const std::uint32_t* v, int x, int y, int z) {
        std::uint32_t sum = 0;
        GB_UNROLL
        for (int signs = 0; signs < 8; ++signs) {
            if ((signs & 1 && !x) || (signs & 2 && !y) || (signs & 4 && !z)) continue;
            sum += v[((signs & 4 ? -z : z) * kWide + (signs & 2 ? -y : y)) * kWide + (signs & 1 ? -x : x)];
        }
        return sum;
    }
    template <int r> GB_FN T weighted(const std::uint32_t* v) const {
        constexpr int n = (r + 1) * (r + 2) / 2;
        std::uint32_t sums[n];
        int sigma2 = 0;
        GB_UNROLL
        for (int b = 0; b <= r; ++b) GB_UNROLL
        for (int a = 0; a <= b; ++a) {
            std::uint32_t sum = mirrored(v, a, b, r);
            if (b != r) sum += mirrored(v, a, r, b) + mirrored(v, r, a, b);
            if (a != b)
                sum += mirrored(v, b, a, r) +
                       (b != r ? mirrored(v, b, r, a) + mirrored(v, r, b, a) : mirrored(v, r, r, a));
            sums[b * (b + 1) / 2 + a] = sum;
            if (sum) sigma2 = max(sigma2, a * a + b * b + r * r);
        }
        const HoleTables& tables = each.filler.tables;
        std::uint64_t total = 0, weight = 0, known = 0;
        GB_UNROLL
        for (int b = 0; b <= r; ++b) GB_UNROLL
        for (int a = 0; a <= b; ++a) {
            const std::uint32_t sum = sums[b * (b + 1) / 2 + a];
            if (!sum) continue;
            const std::uint64_t w = tables.weight(sigma2, a * a + b * b + r * r);
            total += w * (sum & ((1u << kSumBits) - 1));
            weight += w * (sum >> kSumBits);
            known += sum >> kSumBits;
        }
        return Sums<T>::quotient(total, tables.kind == HoleWeights::normalized ? weight : known << 24);
    }
    template <class Visit> GB_FN void for_each_hit(const Room& s, Cell l, int r, const Visit& visit) const {
        each.filler.tables.cubes.for_each_block(l, r, [&](Cell away, std::uint64_t cube) {
            const int i = ((away.z + 1) * 3 + away.y + 1) * 3 + away.x + 1;
            const std::uint64_t hits = s.masks[i] & cube;
            if (hits) visit(away, s.slots[i], hits);
        });
    }
};

}  // namespace globule::core::sweep
