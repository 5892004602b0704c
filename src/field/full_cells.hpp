// Which particles lie so deep in fluid that their kernels cannot reach a surface, by the number of particles in cells
// of the octree around them (docs/design/surface.md).
#pragma once
#include "octree/types.hpp"

namespace globule::core {

/// Cells of one level, 0.75 to 1.5 spacings wide, and blocks of them 3 to 4.5 spacings wide.
struct FullCells {
    static constexpr int kMostLevel = 8;                  ///< 34 MB for counts and blocks; keys have more levels
    static constexpr float kCell = 0.75f, kBlock = 3.0f;  ///< least widths, spacings
    static constexpr float kShare = 0.64f;  ///< of a full block's particles: one with fewer may hold some surface
    static constexpr float kReach = 1.85f;  ///< how far around a particle blocks must be full, spacings

    const TreeHeader* header;
    const void* keys;  ///< sorted; of 64 bits where `wide`
    bool wide;
    std::size_t n;
    float spacing;
    int most_level;
    std::uint8_t *counts, *blocks;  ///< (8^most_level,), x first; a block is named after its lowest cell; 1: full

    /// Finest level whose cells are not too small.
    struct Level {
        int number;
        float edge;  ///< spacings
        GB_FN bool is_fine() const { return edge < 2.0f * kCell; }
        GB_FN int n() const { return 1 << number; }  ///< cells along an axis
        GB_FN std::uint32_t index(int x, int y, int z) const {
            return (std::uint32_t(z) << 2 * number) + (std::uint32_t(y) << number) + std::uint32_t(x);
        }
        /// Cells along a block.
        GB_FN int across() const { return 3.0f * edge >= kBlock ? 3 : 4; }
    };
    GB_FN Level level() const {
        Level l{0, header->space.extent / spacing};
        while (l.number < most_level && l.edge >= 2.0f * kCell) ++l.number, l.edge *= 0.5f;
        return l;
    }
    GB_FN std::uint32_t cell_of(std::size_t slot, int level) const {
        const std::uint64_t key =
            wide ? static_cast<const std::uint64_t*>(keys)[slot] : static_cast<const std::uint32_t*>(keys)[slot];
        const int bits = 3 * (wide ? morton::Traits<std::uint64_t>::levels : morton::Traits<std::uint32_t>::levels);
        return std::uint32_t(key >> (bits - 3 * level)) & ((1u << 3 * level) - 1u);
    }
    /// Whether all blocks in the middle of which a kernel from the cell may find a surface are full.
    GB_FN bool surrounds(std::uint32_t cell, const Level& l) const {
        const float half = 0.5f * float(l.across()), far = kReach / l.edge;
        const int from = -int(far + half + 0.5f), to = int(far - half + 1.5f), n = l.n();
        const auto c = morton::decode(cell);
        const int x = int(c.x), y = int(c.y), z = int(c.z);
        if (min(min(x, y), z) + from < 0 || max(max(x, y), z) + to >= n) return false;
        for (int k = z + from; k <= z + to; ++k)
            for (int j = y + from; j <= y + to; ++j)
                for (int i = x + from; i <= x + to; ++i)
                    if (!blocks[l.index(i, j, k)]) return false;
        return true;
    }
};

/// The first particle of each cell counts it.
struct CountCells {
    FullCells cells;
    GB_FN void operator()(std::size_t i) const {
        const std::size_t outside = cells.header->n_outside;
        const FullCells::Level level = cells.level();
        if (i < outside || !level.is_fine()) return;
        const std::uint32_t cell = cells.cell_of(i, level.number);
        if (i > outside && cells.cell_of(i - 1, level.number) == cell) return;
        const std::size_t most = min(cells.n, i + std::size_t(255));
        std::size_t end = i + 1;
        while (end < most && cells.cell_of(end, level.number) == cell) ++end;
        const auto c = morton::decode(cell);
        cells.counts[level.index(int(c.x), int(c.y), int(c.z))] = std::uint8_t(end - i);
    }
};
/// A row of blocks along x.
struct FindFullBlocks {
    FullCells cells;
    GB_FN void operator()(std::size_t row) const {
        const FullCells::Level level = cells.level();
        if (!level.is_fine() || row >> 2 * level.number) return;
        const int n = level.n(), across = level.across(), y = int(row) & (n - 1), z = int(row >> level.number);
        const float width = float(across) * level.edge, enough = FullCells::kShare * width * width * width;
        std::uint32_t next[3] = {0, 0, 0};  // particles of the columns further along
        for (int x = n - 1; x >= 0; --x) {
            std::uint32_t here = 0;
            for (int k = z; k < min(z + across, n); ++k)
                for (int j = y; j < min(y + across, n); ++j) here += cells.counts[level.index(x, j, k)];
            const std::uint32_t sum = here + next[0] + next[1] + (across > 3 ? next[2] : 0);
            cells.blocks[level.index(x, y, z)] = float(sum) >= enough;
            next[2] = next[1];
            next[1] = next[0];
            next[0] = here;
        }
    }
};

}  // namespace globule::core
