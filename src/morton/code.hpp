// Morton keys: bits of three octree coordinates interleaved, z y x in each triplet (x least
// significant), most significant triplet = level 1.  Thesis §2.2, §3.1-3.3, §5.3.
//
//   32 bit:  0 d | z y x | z y x | ... ten triplets      d (bit 30) = inside the octree's space
//   64 bit:  d   | z y x | z y x | ... 21 triplets       d (bit 63)
#pragma once
#include "exec/bits.hpp"

namespace globule::core::morton {

template <class Key> struct Traits;
template <> struct Traits<std::uint32_t> {
    static constexpr int levels = 10;
    static constexpr std::uint32_t inside = 1u << 30;
};
template <> struct Traits<std::uint64_t> {
    static constexpr int levels = 21;
    static constexpr std::uint64_t inside = 1ull << 63;
};

/// Spread the low 10 bits of v so that two zero bits follow each.
GB_FN std::uint32_t spread(std::uint32_t v) {
    v &= 0x3ff;                      // ---- ---- ---- ---- ---- --98 7654 3210
    v = (v | v << 16) & 0x030000ff;  // ---- --98 ---- ---- ---- ---- 7654 3210
    v = (v | v << 8) & 0x0300f00f;   // ---- --98 ---- ---- 7654 ---- ---- 3210
    v = (v | v << 4) & 0x030c30c3;   // ---- --98 ---- 76-- --54 ---- 32-- --10
    v = (v | v << 2) & 0x09249249;   // ---- 9--8 --7- -6-- 5--4 --3- -2-- 1--0
    return v;
}
GB_FN std::uint32_t compact(std::uint32_t v) {
    v &= 0x09249249;
    v = (v | v >> 2) & 0x030c30c3;
    v = (v | v >> 4) & 0x0300f00f;
    v = (v | v >> 8) & 0x030000ff;
    v = (v | v >> 16) & 0x3ff;
    return v;
}
/// The same for 21 bits.
GB_FN std::uint64_t spread(std::uint64_t v) {
    v &= 0x1fffff;
    v = (v | v << 32) & 0x001f00000000ffffull;
    v = (v | v << 16) & 0x001f0000ff0000ffull;
    v = (v | v << 8) & 0x100f00f00f00f00full;
    v = (v | v << 4) & 0x10c30c30c30c30c3ull;
    v = (v | v << 2) & 0x1249249249249249ull;
    return v;
}
GB_FN std::uint64_t compact(std::uint64_t v) {
    v &= 0x1249249249249249ull;
    v = (v | v >> 2) & 0x10c30c30c30c30c3ull;
    v = (v | v >> 4) & 0x100f00f00f00f00full;
    v = (v | v >> 8) & 0x001f0000ff0000ffull;
    v = (v | v >> 16) & 0x001f00000000ffffull;
    v = (v | v >> 32) & 0x1fffff;
    return v;
}

template <class Key> struct Cell { Key x, y, z; };

/// Interleave three coordinates; no descriptor.
template <class Key> GB_FN Key encode(Key x, Key y, Key z) { return spread(x) | spread(y) << 1 | spread(z) << 2; }
template <class Key> GB_FN Cell<Key> decode(Key code) {
    return {compact(code), compact(Key(code >> 1)), compact(Key(code >> 2))};
}

/// Bits below the k-th triplet of a particle key.
template <class Key> GB_FN int shift_of(int level) { return 3 * (Traits<Key>::levels - level); }

/// Key of the level-k cell that holds `key`: its first k triplets, zero filled; descriptor kept.
template <class Key> GB_FN Key ancestor(Key key, int level) {
    return key >> shift_of<Key>(level) << shift_of<Key>(level);
}
template <class Key> GB_FN Key parent(Key key, int level) { return ancestor(key, level - 1); }
/// Octant 0..7 of a level-k cell's child, zero filled (Table 3.1).
template <class Key> GB_FN Key child(Key key, int level, int octant) {
    return key | Key(octant) << shift_of<Key>(level + 1);
}

/// How many leading triplets two keys share, at most `levels`; -1 where either lies outside.
template <class Key> GB_FN int common_levels(Key a, Key b, int levels) {
    if (!(a & b & Traits<Key>::inside)) return -1;
    const Key diff = a ^ b;
    if (!diff) return levels;
    const int spare = int(8 * sizeof(Key)) - 3 * Traits<Key>::levels;
    const int shared = (leading_zeros(diff) - spare) / 3;
    return shared < levels ? shared : levels;
}

/// Masked addition on the dilated coordinate: the code one cell further along an axis (0 x, 1 y,
/// 2 z) in direction +1 or -1 at `level`.  False when the neighbor lies outside the octree.
template <class Key> GB_FN bool face_neighbor(Key key, int level, int axis, int direction, Key& out) {
    const Key all = (Traits<Key>::inside - 1) & ~Key(0);
    const Key lanes = spread(Key(~Key(0))) << axis;
    const Key mine = key & lanes;
    const Key edge = lanes >> (shift_of<Key>(level)) << (shift_of<Key>(level)) & lanes & all;
    if (direction > 0 ? (mine & edge) == edge : (mine & edge) == 0) return false;
    const Key unit = Key(1) << (shift_of<Key>(level) + axis);  // level 0, where that is too far, has no neighbors
    const Key moved = direction > 0 ? ((mine | ~lanes) + unit) & lanes : (mine - unit) & lanes;
    out = (key & ~lanes) | moved;
    return true;
}

/// The 26 neighbors by composed face steps: dx, dy, dz in {-1, 0, 1}.
template <class Key> GB_FN bool neighbor(Key key, int level, int dx, int dy, int dz, Key& out) {
    out = key;
    const int step[3] = {dx, dy, dz};
    for (int axis = 0; axis < 3; ++axis)
        if (step[axis] && !face_neighbor(out, level, axis, step[axis], out)) return false;
    return true;
}

// The dense octree's array L: index of the level-k cell with triplet value v is (8^k - 1)/7 + v,
// so that the children of i are 8 i + 1 ... 8 i + 8.  (Thesis (3.3)-(3.5), corrected.)

/// Nodes of all levels above `level`: (8^level - 1) / 7.
GB_FN std::uint64_t dense_offset(int level) { return ((1ull << 3 * level) - 1) / 7; }
template <class Key> GB_FN std::uint64_t dense_index(Key key, int level) {
    const Key value = (key & (Traits<Key>::inside - 1)) >> shift_of<Key>(level);
    return dense_offset(level) + value;
}
GB_FN int dense_level(std::uint64_t index) {
    int level = 0;
    while (dense_offset(level + 1) <= index) ++level;
    return level;
}
template <class Key> GB_FN Key dense_key(std::uint64_t index) {
    const int level = dense_level(index);
    return Traits<Key>::inside | Key(index - dense_offset(level)) << shift_of<Key>(level);
}

}  // namespace globule::core::morton
