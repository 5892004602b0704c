// Eigenvalues and axes of symmetric 3 x 3 matrices, in as many lanes as F has.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

template <class F> struct Eigen3 {
    F value[3];
    Vec3<F> axis[3];  ///< unit vectors

    /// sum over k of s[k] axis[k] axis[k]^T
    GB_FN Sym3<F> compose(const F* s) const {
        Sym3<F> m{F(0.0f), F(0.0f), F(0.0f), F(0.0f), F(0.0f), F(0.0f)};
        for (int k = 0; k < 3; ++k) {
            const Vec3<F>& e = axis[k];
            const Vec3<F> t = e * s[k];
            m = {m.xx + t.x * e.x, m.yy + t.y * e.y, m.zz + t.z * e.z, m.xy + t.x * e.y, m.xz + t.x * e.z,
                m.yz + t.y * e.z};
        }
        return m;
    }
};

/// By Jacobi's cyclic rotations; five sweeps leave nothing that float32 could hold.
template <class F> GB_FN Eigen3<F> eigen(const Sym3<F>& m) {
    const F zero = F(0.0f), one = F(1.0f);
    F d[3] = {m.xx, m.yy, m.zz}, off[3] = {m.yz, m.xz, m.xy};  // off[k]: of the two other axes
    Vec3<F> e[3] = {{one, zero, zero}, {zero, one, zero}, {zero, zero, one}};
    for (int sweep = 0; sweep < 5; ++sweep)
        for (int k = 0; k < 3; ++k) {
            const int p = k == 0 ? 1 : 0, q = k == 2 ? 1 : 2;  // p < q, the plane of the rotation
            const F apart = d[q] - d[p], twice = off[k] + off[k];
            const F root = sqrt(apart * apart + twice * twice) + abs(apart);
            const F t = select(root > zero, select(apart < zero, -twice, twice) / select(root > zero, root, one), zero);
            const F c = one / sqrt(one + t * t), s = t * c;
            d[p] = d[p] - t * off[k];
            d[q] = d[q] + t * off[k];
            off[k] = zero;
            const F op = off[p], oq = off[q];  // off[p] couples q and k, off[q] couples p and k
            off[q] = c * oq - s * op;
            off[p] = s * oq + c * op;
            const Vec3<F> ep = e[p], eq = e[q];
            e[p] = ep * c - eq * s;
            e[q] = ep * s + eq * c;
        }
    return {{d[0], d[1], d[2]}, {e[0], e[1], e[2]}};
}

}  // namespace globule::core
