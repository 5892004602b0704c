// Densities and the solver's coefficients, once a step; gradients are kept for all later passes.
//
// Volumes instead of masses, so that fluids of different density mix: every fluid or tissue particle
// has the volume V of its place in the lattice, a boundary particle the one that it stands for (Akinci 2012);
// of two sizes (sizes.hpp), V_i / V_j weighs |g_ij|^2 in alpha.
//   delta_i = sum_j V_j W_ij                       density over rest density
//   g_ij    = V_j grad W_ij,   G_i = sum_j g_ij
//   alpha_i = 1 / (|G_i|^2 / rho_i + sum_j |g_ij|^2 / rho_j)      j: fluid and tissue only
#pragma once
#include "sim/neighbors.hpp"

namespace globule::core::sim {

/// Per row, so that a packet reads them side by side.
struct Rows {
    float* density;       ///< delta
    float *gx, *gy, *gz;  ///< G
    float* inverse_rho;   ///< 0: not in the density solve
    float* alpha;
    float* boundary;  ///< distance of the nearest boundary particle
    float* bulk;      ///< 1 where there is fluid or wall all around
};

inline constexpr float kFreeGradient = 0.4f;  ///< of the density, per spacing: more is a surface's (a lattice's: 0.51)
inline constexpr float kLeastDensity = 0.5f;  ///< of what is inside of a fluid
/// Least share of the lattice's value below |G|^2 / rho + ...: where gradients cancel, as between the
/// particles of a wall, the step along them must not grow without bounds.
inline constexpr float kLeastStiffness = 0.2f;

template <class Packet_, bool periodic, bool mixed> struct Densities {
    Lists<Packet_> lists;
    const Quad* place;
    Rows out;
    Spline spline;
    Period period;
    float volume;
    float lattice_squares;  ///< sum of |g h|^2 in the lattice
    const float* within;    ///< density that is there without the lists, per row, 0 of what is no solid; null: none
    Sizes sizes;
    template <class Packet> GB_FN void run(std::size_t row) const {
        using F = typename Packet::F;
        const Four<F> mine = Packet::gather(place, lists.rows + row);
        const F zero = F(0.0f), h = F(spline.support), own = F(volume);
        F size = F(1.0f);
        if constexpr (mixed) size = Packet::gather(sizes.of, lists.rows + row);
        F density = within ? own * spline(zero) + Packet::load(within + row) : own * spline(zero), gx = zero, gy = zero,
          gz = zero, squares = zero, nearest = h;
        const std::uint32_t n = Packet::longest(lists.count + row);
        std::size_t at = lists.at(row);
        typename Packet::ShortSlots shorts(lists.index + at, lists.count + row, lists.n_rows - row);
        for (std::uint32_t k = 0; k < n; ++k, at += Packet::stride) {
            lists.fetch_next(at);
            const Four<F> other = Packet::gather(place, lists.index + at);
            const auto [dx, dy, dz] = period.template shortest<periodic>(mine.xyz() - other.xyz());
            F w, slope;
            const F r = sqrt(dx * dx + dy * dy + dz * dz);
            F v = own, weight = F(1.0f);
            if constexpr (mixed) {
                const Pair<F> pair = Pair<F>::of(size, Packet::gather(sizes.of, lists.index + at));
                pair.kernel(spline, r, w, slope);
                v *= pair.volume;
                weight = size * size * size / pair.volume;
            } else {
                spline(r, w, slope);
            }
            nearest = select(other.w > zero, min(nearest, r), nearest);
            v = select(other.w > zero, other.w, v);
            density += v * w;
            const F s = v * slope * h;
            const auto [x, y, z] = lists.keep_pair(at, shorts, {dx * s, dy * s, dz * s});
            gx += x;
            gy += y;
            gz += z;
            squares += mixed ? (x * x + y * y + z * z) * max(-other.w, zero) * weight
                             : (x * x + y * y + z * z) * max(-other.w, zero);
        }
        shorts.finish(lists.bases + row / Packet::stride);
        const F rho = max(-mine.w, zero);  // its inverse
        const F sum = (gx * gx + gy * gy + gz * gz) * rho + squares;
        const F solved = select(rho > zero, F(1.0f), zero);
        const F alpha = solved * select(sum > zero,
                                     h * h /
                                         max(sum, mixed ? F(kLeastStiffness * lattice_squares) * rho / (size * size)
                                                        : F(kLeastStiffness * lattice_squares) * rho),
                                     zero);
        Packet::store(out.density + row, density);
        Packet::store(out.gx + row, gx);
        Packet::store(out.gy + row, gy);
        Packet::store(out.gz + row, gz);
        Packet::store(out.inverse_rho + row, rho);
        Packet::store(out.alpha + row, alpha);
        Packet::store(out.boundary + row, nearest);
        const float free = 2.0f * kFreeGradient;  // per support
        auto inside = (mixed ? gx * gx + gy * gy + gz * gz < F(free * free) / (size * size)
                             : gx * gx + gy * gy + gz * gz < F(free * free)) &
                      (density > F(kLeastDensity));
        if (within)
            inside =
                inside & (Packet::load(within + row) <= zero) &
                (Packet::load(within + row) >= zero);  // neighbors of solids are not in the lists: nothing may pull
        Packet::store(out.bulk + row, select(inside, F(1.0f), zero));
    }
};

/// Of the rows that take part: sum and largest of max(delta - 1, 0), how many they are, how many are at a
/// surface, the sum of delta, of heights over where gravity leads and of their squares (spacings), and how many are
/// compressed by more than kLeastStep 2^k.
inline constexpr int kSteps = 16;
inline constexpr double kLeastStep = 1e-5;
inline constexpr double kLayers = 30.0;  ///< with so many, velocities may leave all that is allowed
struct Compression {
    double sum, most, n, n_free, density, height, height2;
    double all;  ///< n, and rows that were left out
    std::uint32_t over[kSteps];

    /// As many evenly filled layers stand as high.
    GB_FN double layers() const {
        const double mean = height / max(n, 1.0);
        return sqrt(12.0 * max(height2 / max(n, 1.0) - mean * mean, 0.0));
    }
    /// Share of its tolerance that a solve for velocities may leave: what is left in each layer adds up to a column's
    /// fall, and under its pressure steps are shorter.
    GB_FN double share_of_layers() const {
        const double few = kLayers / max(layers(), kLayers), many = 2.0 * few;
        return max(few * few, min(0.25, many * many));
    }

    /// What a share of the particles exceeds: exact at the steps, between them as a power.
    double exceeded_by(double share) const {
        const double limit = share * all;
        if (!(over[0] > limit)) return std::min(kLeastStep, most);
        for (int k = 1; k < kSteps; ++k) {
            if (over[k] > limit) continue;
            const double a = std::log(double(over[k - 1])), b = std::log(std::max(double(over[k]), 0.5));
            return std::min(
                most, kLeastStep * std::exp2(k - 1 + (a - std::log(std::max(limit, 0.5))) / std::max(a - b, 1e-9)));
        }
        return most;
    }
};
struct CompressionOf {
    Rows rows;
    float free_gradient;  ///< |G| times the support of those at a surface
    const std::uint32_t* slot;
    const Quad* place;
    float3 up;  ///< over the spacing
    GB_FN Compression operator()(std::size_t row) const {
        Compression c{};
        if (!(rows.inverse_rho[row] > 0.0f)) return c;
        const double e = max(rows.density[row] - 1.0f, 0.0f);
        const float3 g{rows.gx[row], rows.gy[row], rows.gz[row]};
        const double h = dot(place[slot[row]].xyz(), up);
        c = {e, e, 1.0, dot(g, g) > free_gradient * free_gradient ? 1.0 : 0.0, rows.density[row], h, h * h, 1.0, {}};
        float step = float(kLeastStep);
        for (int k = 0; k < kSteps; ++k, step *= 2.0f) c.over[k] = e > step;
        return c;
    }
};
struct AddCompression {
    GB_FN Compression operator()(const Compression& a, const Compression& b) const {
        Compression c{a.sum + b.sum, a.most > b.most ? a.most : b.most, a.n + b.n, a.n_free + b.n_free,
            a.density + b.density, a.height + b.height, a.height2 + b.height2, a.all + b.all, {}};
        for (int k = 0; k < kSteps; ++k) c.over[k] = a.over[k] + b.over[k];
        return c;
    }
};

struct AddAlone {
    double n;
    Compression* compression;
    GB_FN void operator()(std::size_t) const { compression->all += n; }
};

}  // namespace globule::core::sim
