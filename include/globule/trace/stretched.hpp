// Particles whose supports are ellipsoids (Yu and Turk 2013): c b(|G (x - q)|), G symmetric.  Along a ray
// that is a ball's field, seen in the space that G maps to.
#pragma once
#include "globule/field/kernels.hpp"
#include "globule/octree/types.hpp"

namespace globule {

/// Any kernel, with each particle's matrix.
struct StretchedKernel : AnyKernel {
    static constexpr bool stretched = true;
    const float* matrices;     ///< SortedParticles::stretch
    const TreeHeader* header;

    /// Over 1 / typical support.
    GB_FN float component(std::size_t slot, int k) const { return matrices[6 * slot + k] * header->typical_support; }
    template <class F>
    GB_FN Sym3<F> matrix(std::size_t slot) const {
        return {F(component(slot, 0)), F(component(slot, 1)), F(component(slot, 2)),
                F(component(slot, 3)), F(component(slot, 4)), F(component(slot, 5))};
    }
};

/// Bounds of |G w|^2 over all w in the cube of half edge `half` around v.
template <class F>
GB_FN void range_in_cube(const Sym3<F>& m, const Vec3<F>& v, float half, F& near, F& far) {
    const F x = magnitude(m.xx) + magnitude(m.xy) + magnitude(m.xz), y = magnitude(m.xy) + magnitude(m.yy) + magnitude(m.yz),
            z = magnitude(m.xz) + magnitude(m.yz) + magnitude(m.zz);
    const F reach = F(1.0001f * half) * root(x * x + y * y + z * z), middle = length(m * v);
    near = most(middle - reach, F(0.0f));
    near = near * near;
    far = (middle + reach) * (middle + reach);
}

}  // namespace globule
