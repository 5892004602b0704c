// Three-vectors of any lane type: Vec3<float> for one point, Vec3<Wide<float>> for a packet.
#pragma once
#include "base/scalar.hpp"

namespace globule::core {

template <class F> struct Vec3 { F x, y, z; };

using float3 = Vec3<float>;
GB_FN float3 to_float(const Vec3<double>& v) { return {float(v.x), float(v.y), float(v.z)}; }

template <class F> GB_FN Vec3<F> operator+(const Vec3<F>& a, const Vec3<F>& b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class F> GB_FN Vec3<F> operator-(const Vec3<F>& a, const Vec3<F>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class F> GB_FN Vec3<F> operator*(const Vec3<F>& a, const F& s) { return {a.x * s, a.y * s, a.z * s}; }
template <class F> GB_FN F dot(const Vec3<F>& a, const Vec3<F>& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
template <class F> GB_FN F length(const Vec3<F>& a) { return sqrt(dot(a, a)); }
template <class F> GB_FN Vec3<F> cross(const Vec3<F>& a, const Vec3<F>& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
/// A symmetric matrix.
template <class F> struct Sym3 { F xx, yy, zz, xy, xz, yz; };
template <class F> GB_FN Vec3<F> operator*(const Sym3<F>& m, const Vec3<F>& v) {
    return {m.xx * v.x + m.xy * v.y + m.xz * v.z, m.xy * v.x + m.yy * v.y + m.yz * v.z,
        m.xz * v.x + m.yz * v.y + m.zz * v.z};
}
template <class F> GB_FN Sym3<F> operator*(const Sym3<F>& m, F s) {
    return {m.xx * s, m.yy * s, m.zz * s, m.xy * s, m.xz * s, m.yz * s};
}
template <class F> GB_FN Sym3<F> square(const Sym3<F>& m) {
    return {m.xx * m.xx + m.xy * m.xy + m.xz * m.xz, m.xy * m.xy + m.yy * m.yy + m.yz * m.yz,
        m.xz * m.xz + m.yz * m.yz + m.zz * m.zz, m.xx * m.xy + m.xy * m.yy + m.xz * m.yz,
        m.xx * m.xz + m.xy * m.yz + m.xz * m.zz, m.xy * m.xz + m.yy * m.yz + m.yz * m.zz};
}
/// a / |a|, or a itself where its length is zero.
template <class F> GB_FN Vec3<F> normalize(const Vec3<F>& a) {
    const F n = length(a);
    return a * (F(1.0f) / select(n > F(0.0f), n, F(1.0f)));
}

}  // namespace globule::core
