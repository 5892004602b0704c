// Ghost neighbors (§5.3): a particle acts on its own leaf and on those of the 26 around it that its
// support reaches, found by key arithmetic.  Right while no support is larger than a leaf's edge.
//
// So a surface may lie in a leaf without particles (Fig. 5.6a), and the traversal must open that too:
// before the rays start, every particle raises a flag in each leaf that it acts on and in all their
// ancestors.
#pragma once
#include "exec/bits.hpp"
#include "trace/thesis/stack.hpp"

namespace globule::core::thesis {

using Key = std::uint32_t;

/// A leaf's box.
struct CellBox {
    float3 lo, hi;
    GB_FN CellBox(const Grid& grid, Key key) {
        const int level = grid.depth;
        const Key triplets = (key & (morton::Traits<Key>::inside - 1)) >> morton::shift_of<Key>(level);
        const auto c = morton::decode(triplets);
        const float3 from = grid.space.lo;
        lo = {grid.plane(from.x, level, c.x), grid.plane(from.y, level, c.y), grid.plane(from.z, level, c.z)};
        hi = {
            grid.plane(from.x, level, c.x + 1), grid.plane(from.y, level, c.y + 1), grid.plane(from.z, level, c.z + 1)};
    }
    /// Is the particle's distance to the cell at most its support?
    GB_FN bool within(const SortedParticles& particles, std::uint32_t slot) const {
        const float3 q = particles.position(slot), below = lo - q, above = q - hi;
        const float3 apart{
            max(max(below.x, above.x), 0.0f), max(max(below.y, above.y), 0.0f), max(max(below.z, above.z), 0.0f)};
        const float a = particles.support[slot];
        return dot(apart, apart) <= a * a;
    }
};

/// The 27 keys around a leaf, itself included, from six face steps.
class Neighborhood {
public:
    GB_FN Neighborhood(Key key, int level) {
        for (int axis = 0; axis < 3; ++axis)
            for (int step = -1; step <= 1; ++step) {
                Key moved = key;
                if (step && !morton::face_neighbor(key, level, axis, step, moved)) moved = 0;
                part_[axis][step + 1] = moved & (morton::Traits<Key>::inside | morton::spread(~Key(0)) << axis);
            }
    }
    /// False where that neighbor lies outside the octree.
    GB_FN bool get(int dx, int dy, int dz, Key& out) const {
        const Key x = part_[0][dx + 1], y = part_[1][dy + 1], z = part_[2][dz + 1];
        out = x | y | z;
        return x & y & z & morton::Traits<Key>::inside;
    }

private:
    Key part_[3][3];  ///< an axis' bits and the descriptor; without that: outside
};

/// One thread a particle.
struct MarkNear {
    DenseTree tree;
    SortedParticles particles;
    const Key* keys;
    std::uint8_t* near;
    GB_FN void operator()(std::size_t i) const {
        if (!(keys[i] & morton::Traits<Key>::inside)) return;
        const Grid grid{tree.header->space, tree.header->depth, tree.nodes[0].reach};
        const Neighborhood around(morton::ancestor(keys[i], grid.depth), grid.depth);
        for (int k = 0; k < 27; ++k) {
            Key there;
            if (!around.get(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1, there)) continue;
            if (k != 13 && !CellBox(grid, there).within(particles, std::uint32_t(i))) continue;
            std::uint64_t at = morton::dense_index(there, grid.depth);
            while (!flag_is_up(near + at)) {  // whoever raised it sees to its ancestors
                raise_flag(near + at);
                if (at) at = (at - 1) / 8;
            }
        }
    }
};

}  // namespace globule::core::thesis
