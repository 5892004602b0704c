// Pieces: components of the graph of whole bonds, by hooking and pointer jumping (FastSV: Zhang, Azad &
// Hu 2020).  A piece's label is its least member, whatever the order in which threads run.
#pragma once
#include "exec/bits.hpp"
#include "sim/bonds.hpp"
#include "sim/fill.hpp"

namespace globule::core::tissue {

struct OwnLabel {
    std::uint32_t* label;
    GB_FN void operator()(std::size_t t) const { label[t] = std::uint32_t(t); }
};

/// Every particle offers its label's parent to its neighbors and to their labels.
struct Hook {
    Bonds bonds;
    std::uint32_t* label;
    std::uint32_t* changed;
    GB_FN void operator()(std::size_t i) const {
        const std::uint32_t t = std::uint32_t(i);
        const std::uint32_t mine = read_now(&label[t]);
        std::uint32_t lowest = mine;
        for (std::uint32_t e = bonds.begin(t), end = bonds.end(t); e < end; e += kBlock)
            if (bonds.length[e] > 0.0f) lowest = min(lowest, read_now(&label[bonds.other[e]]));
        lowest = min(lowest, read_now(&label[lowest]));
        if (lowest >= mine) return;
        atomic_min(&label[mine], lowest);
        atomic_min(&label[t], lowest);
        raise_flag(changed);
    }
};

struct Jump {
    std::uint32_t* label;
    GB_FN void operator()(std::size_t t) const {
        std::uint32_t root = read_now(&label[t]);
        for (std::uint32_t up = read_now(&label[root]); up < root; up = read_now(&label[root])) root = up;
        atomic_min(&label[t], root);
    }
};

/// The least id of each piece, kept at its root; then everyone's.
struct LeastId {
    const std::uint32_t* label;
    const std::uint32_t* id;
    const std::uint8_t* hold;
    std::uint32_t* least_id;
    std::uint32_t* n_pieces;
    GB_FN void operator()(std::size_t t) const {
        if (hold[t] == kGone) return;
        if (label[t] == t) atomic_take(n_pieces, 1);
        atomic_min(&least_id[label[t]], id[t]);
    }
};
struct TakeLeastId {
    const std::uint32_t* label;
    const std::uint32_t* least_id;
    std::uint32_t* piece;
    GB_FN void operator()(std::size_t t) const { piece[t] = least_id[label[t]]; }
};

}  // namespace globule::core::tissue
