// What frames tell of a flow beside velocities and pressures: density and vorticity.
//
//   curl v_i from grad v_i = (sum_j (v_j - v_i) g_ij^T) M_i^-1,   M_i = sum_j (x_j - x_i) g_ij^T
// over fluid and tissue: exact for linear velocities, also at a surface (Bonet & Lok 1999).
#pragma once
#include "sim/density.hpp"

namespace globule::core::sim {

/// Below this determinant of M (a half space has 0.1), neighbors do not tell a curl: 0.
inline constexpr float kLeastMoment = 0.003f;

template <class Packet_, bool periodic> struct Flow {
    Lists<Packet_> lists;
    const Quad *place, *velocity;
    Rows rows;
    Period period;
    float inverse_support;
    Quad* out;  ///< vorticity and density over rest density, per slot
    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        const Four<F> mine = Packet::gather(place, lists.rows + row), v = Packet::gather(velocity, lists.rows + row);
        const F zero = F(0.0f), one = F(1.0f), s = F(inverse_support);
        F xx = zero, yy = zero, zz = zero, xy = zero, xz = zero, yz = zero;  // M, which is symmetric
        F ux = zero, uy = zero, uz = zero, vx = zero, vy = zero, vz = zero, wx = zero, wy = zero, wz = zero;
        const std::uint32_t n = Packet::longest(lists.count + row);
        std::size_t at = lists.at(row);
        for (std::uint32_t k = 0; k < n; ++k, at += Packet::stride) {
            lists.fetch_next(at);
            const Four<F> other = Packet::gather(place, lists.index + at),
                          u = Packet::gather(velocity, lists.index + at);
            const Vec3<F> d = period.template shortest<periodic>(mine.xyz() - other.xyz());
            const F m = select(other.w < zero, s, zero);
            const auto [gx, gy, gz] = lists.gradient(at) * m;
            xx -= d.x * gx;
            yy -= d.y * gy;
            zz -= d.z * gz;
            xy -= d.x * gy;
            xz -= d.x * gz;
            yz -= d.y * gz;
            const F a = u.x - v.x, b = u.y - v.y, c = u.z - v.z;
            ux += a * gx;
            uy += a * gy;
            uz += a * gz;
            vx += b * gx;
            vy += b * gy;
            vz += b * gz;
            wx += c * gx;
            wy += c * gy;
            wz += c * gz;
        }
        // The inverse: its columns times the determinant.
        const F axx = yy * zz - yz * yz, ayy = xx * zz - xz * xz, azz = xx * yy - xy * xy;
        const F axy = xz * yz - xy * zz, axz = xy * yz - xz * yy, ayz = xy * xz - xx * yz,
                det = xx * axx + xy * axy + xz * axz;
        const auto told = det > F(kLeastMoment);
        const F f = select(told, one / select(told, det, one), zero);
        const F dw_dy = wx * axy + wy * ayy + wz * ayz, dv_dz = vx * axz + vy * ayz + vz * azz;
        const F du_dz = ux * axz + uy * ayz + uz * azz, dw_dx = wx * axx + wy * axy + wz * axz;
        const F dv_dx = vx * axx + vy * axy + vz * axz, du_dy = ux * axy + uy * ayy + uz * ayz;
        Packet::scatter(out, lists.rows + row,
            {f * (dw_dy - dv_dz), f * (du_dz - dw_dx), f * (dv_dx - du_dy), Packet::load(rows.density + row)});
    }
};

}  // namespace globule::core::sim
