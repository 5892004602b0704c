// A bundle's way in slabs: how deep each is, so that a list holds the particles that the bundle meets there.
#pragma once
#include "trace/gather.hpp"

namespace globule::core {

inline constexpr float kMaxWindows = 32.0f;  ///< a slab is at most so many of the list's smallest supports deep

/// Slabs at distance z are at least so deep, or float32 would not move on.
GB_FN float least_advance(float z) { return 4e-7f * z; }

struct Slab {
    float z;        ///< begins at this distance
    float dz;       ///< and ends so much farther on
    float3 at;      ///< the axis point at z, which the list is relative to
    float typical;  ///< support
    float whole;    ///< depth where nothing speaks against it, in supports

    GB_FN Slab(float from, float typical_support, float supports)
        : z(from), dz(supports * typical_support), at{0, 0, 0}, typical(typical_support), whole(supports) {}

    GB_FN float end() const { return z + dz; }
    /// Over empty space.
    GB_FN void skip_to(float next) {
        z = next;
        dz = whole * typical;
    }
    /// Half as deep, unless it is very thin already.
    GB_FN bool halve() {
        if (!(dz > max(typical * (1.0f / 64.0f), 2.0f * least_advance(z)))) return false;
        dz *= 0.5f;
        return true;
    }
    /// So deep that march() would take too many windows: then less.
    GB_FN bool shorten(float smallest_support) {
        if (!(dz > max(kMaxWindows * smallest_support, least_advance(z)))) return false;
        dz = 0.5f * kMaxWindows * smallest_support;
        return true;
    }
    /// On to the slab behind this one.
    GB_FN void step(float smallest_support, bool deeper) {
        z += dz;
        if (deeper) dz = min(whole * max(typical, smallest_support), 2.0f * dz);
    }
};

/// The slab's particles.  Where the list cannot hold them narrow() may take rays from the bundle; while it returns
/// false the slab is made thinner.  n < 0: even the thinnest holds too much.
template <class Candidate, class Group, class Narrow>
GB_FN Gathered gather_slab(Group& g, TileScratch<Group, Candidate>& scratch, const Tree& tree,
    const SortedParticles& particles, const Bundle& bundle, Slab& slab, const Narrow& narrow) {
    const float scale = 1.0f / slab.typical;
    for (;;) {
        slab.dz = max(slab.dz, least_advance(slab.z));
        slab.at = bundle.axis_point(slab.z);
        Walk<Candidate, Group> walk(g, scratch, tree, particles, bundle, slab.z, slab.at);
        const Gathered found = gather(walk, slab.dz, scale);
        if (found.n < 0 && (narrow() || slab.halve())) continue;
        if (found.n > 0 && slab.shorten(slab.typical / found.sharpest)) continue;
        return found;
    }
}

}  // namespace globule::core
