// Particles whose supports are ellipsoids (Yu and Turk 2013): c b(|G (x - q)|), G symmetric.  Along a ray
// that is a ball's field, seen in the space that G maps to.
#pragma once
#include "field/kernels.hpp"
#include "octree/types.hpp"

namespace globule::core {

/// A kernel, with each particle's matrix.
template <class Base> struct StretchedKernel : Base {
    static constexpr bool stretched = true;
    const float* matrices;  ///< SortedParticles::stretch
    const TreeHeader* header;

    /// Over 1 / typical support.
    GB_FN float component(std::size_t slot, int k) const { return matrices[6 * slot + k] * header->typical_support; }
    template <class F> GB_FN Sym3<F> matrix(std::size_t slot) const {
        return {F(component(slot, 0)), F(component(slot, 1)), F(component(slot, 2)), F(component(slot, 3)),
            F(component(slot, 4)), F(component(slot, 5))};
    }
};

/// Bounds of |G w|^2 over all w in the cube of half edge `half` around v; one matrix for all lanes, or one in each.
template <class M, class F> GB_FN void range_in_cube(const Sym3<M>& m, const Vec3<F>& v, float half, F& near, F& far) {
    const M x = abs(m.xx) + abs(m.xy) + abs(m.xz), y = abs(m.xy) + abs(m.yy) + abs(m.yz),
            z = abs(m.xz) + abs(m.yz) + abs(m.zz);
    const F reach(M(1.0001f * half) * sqrt(x * x + y * y + z * z));
    const F middle = length(Sym3<F>{F(m.xx), F(m.yy), F(m.zz), F(m.xy), F(m.xz), F(m.yz)} * v);
    near = max(middle - reach, F(0.0f));
    near = near * near;
    far = (middle + reach) * (middle + reach);
}

}  // namespace globule::core
