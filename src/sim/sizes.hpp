// Two sizes of particles in one solve: fluids may have half the spacing of everything else.
//
// A size is a spacing over the simulation's: 1, or 1/2 of fine fluids.  The kernel of a pair has the mean of both
// supports, and V_j grad W_ij the neighbor's own volume: V_i V_j grad W is the opposite of V_j V_i grad W to the bit,
// since volumes differ by a power of two, and momentum is kept as between equals.
#pragma once
#include <type_traits>

#include "sim/spline.hpp"
#include "sim/state.hpp"

namespace globule::core::sim {

inline constexpr float kFine = 0.5f;  ///< size of fine fluids

/// Of each slot, or none where all are 1.
struct Sizes {
    const float* of = nullptr;

    GB_FN float at(std::size_t slot) const { return of ? of[slot] : 1.0f; }
    /// Over that of a particle of size 1.
    GB_FN float volume(std::size_t slot) const { return at(slot) * at(slot) * at(slot); }
};

/// fn(std::bool_constant: are there two sizes).
template <class Fn> void with_sizes(const Sizes& sizes, const Fn& fn) {
    if (sizes.of) fn(std::true_type{});
    else fn(std::false_type{});
}

/// How the kernel of a pair differs from that of two of size 1.
template <class F> struct Pair {
    F inverse;  ///< 1 over the mean size
    F volume;   ///< the neighbor's

    GB_FN static Pair of(const F& mine, const F& theirs) {
        return {F(2.0f) / (mine + theirs), theirs * theirs * theirs};
    }
    /// W and W'(r)/r.
    GB_FN void kernel(const Spline& spline, const F& r, F& w, F& slope) const {
        spline(r * inverse, w, slope);
        const F cube = inverse * inverse * inverse;
        w *= cube;
        slope *= cube * inverse * inverse;
    }
    /// Of an attraction between two of size 1.
    GB_FN F attracts() const { return volume * inverse * inverse * inverse * inverse * inverse; }
};

struct SizeOf {
    State state;
    const Phase* phases;
    float* size;  ///< n + 64
    GB_FN void operator()(std::size_t i) const {
        size[i] = i < state.n && phases[state.phase[i]].kind == Kind::fluid ? kFine : 1.0f;
    }
};

}  // namespace globule::core::sim
