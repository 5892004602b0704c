// PLUS' hole fillers, one voxel at a time, as PLUS states them.  Each looks at the unfilled volume only, at voxels
// whose accumulator is not 0; it gives a value, or 0 and no.  plus_fill.hpp asks them, or does the same for 64 voxels
// at once.
//
//   Gaussian and its like   the mean of what is known in a window, weighted by the place in it, if enough is known
//   nearest                 the mean of what the smallest cube holds that holds something
//   sticks                  lines through the voxel in 13 directions, from what is known on one side to what is on the
//   other:
//                           the shortest ones' values between their ends
#pragma once
#include "sweep/plus_insert.hpp"

namespace globule::core::plus {

enum class FillerType { gaussian, gaussian_accumulation, distance_weight_inverse, nearest_neighbor, stick };

struct Filler {
    FillerType type;
    int size;  ///< of the window, or the longest stick
    int n_sticks;
    float least_ratio;     ///< of known voxels in the window; more is needed
    const float* weights;  ///< (size, size, size) z y x, or null
    GB_FN int reach() const { return type == FillerType::stick ? max(size - 1, 0) : max((size - 1) / 2, 0); }
};

inline constexpr int kMaxFillers = 16;

inline constexpr int kSticks = 13;
/// First the directions of length 1, then those of sqrt 2, then of sqrt 3.
struct StickDirections {
    GB_FN static const signed char* number(int i) {
        static constexpr signed char all[kSticks][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 0}, {1, 0, 1},
            {0, 1, 1}, {1, -1, 0}, {1, 0, -1}, {0, 1, -1}, {1, 1, 1}, {-1, 1, 1}, {1, -1, 1}, {-1, -1, 1}};
        return all[i];
    }
    /// The first direction of squared length 1, 2 or 3; 4: past the last.
    GB_FN static int first(int length2) {
        static constexpr int all[5] = {0, 0, 3, 9, kSticks};
        return all[length2];
    }
};

template <class T> struct Holes {
    Grid grid;
    const T* values;
    const std::uint16_t* acc;

    GB_FN bool fill(const Filler& filler, int x, int y, int z, T& out) const {
        if (filler.type == FillerType::stick) return sticks(filler, x, y, z, out);
        if (filler.type == FillerType::nearest_neighbor) return nearest(filler, x, y, z, out);
        return window(filler, x, y, z, out);
    }

    /// Sums are taken in PLUS' order, x outermost: their doubles depend on it.
    GB_FN bool window(const Filler& filler, int x, int y, int z, T& out) const {
        const int size = filler.size, range = (size - 1) / 2;
        double sum = 0, weight_sum = 0;
        int known = 0;
        for (int i = max(x - range, 0); i <= min(x + range, grid.n[0] - 1); ++i)
            for (int j = max(y - range, 0); j <= min(y + range, grid.n[1] - 1); ++j)
                for (int k = max(z - range, 0); k <= min(z + range, grid.n[2] - 1); ++k) {
                    const std::size_t at = grid.index(i, j, k);
                    const std::uint16_t a = acc[at];
                    if (!a) continue;
                    const float w =
                        filler.weights[size * size * (k - z + range) + size * (j - y + range) + (i - x + range)];
                    const double weight = filler.type == FillerType::gaussian_accumulation ? a * w : w;
                    sum += values[at] * weight;
                    weight_sum += weight;
                    ++known;
                }
        return finish(filler, sum, weight_sum, known, out);
    }
    GB_FN bool finish(const Filler& filler, double sum, double weight_sum, int known, T& out) const {
        out = T(0);
        if (weight_sum == 0 || !(double(known) / (filler.size * filler.size * filler.size) > filler.least_ratio))
            return false;
        out = T(sum / weight_sum);
        return true;
    }

    GB_FN bool nearest(const Filler& filler, int x, int y, int z, T& out) const {
        double sum = 0;
        int known = 0;
        for (int r = 1; r <= (filler.size - 1) / 2 && !known; ++r) add_surface(x, y, z, r, sum, known);
        return finish(filler, sum, known, known, out);
    }
    /// What the surface of a cube holds: all that is in it, since the smaller ones were empty.
    GB_FN void add_surface(int x, int y, int z, int r, double& sum, int& known) const {
        const Span xs = around(x, r, 0), ys = around(y, r, 1);
        for (int i = xs.first; i <= xs.last; ++i)
            for (int j = ys.first; j <= ys.last; ++j) {
                // A column of a side face as a whole, of the others its two ends.
                const bool on_side = i == x - r || i == x + r || j == y - r || j == y + r;
                for (int k = z - r; k <= z + r; k += on_side ? 1 : 2 * r) {
                    if (k < 0 || k >= grid.n[2]) continue;
                    const std::size_t at = grid.index(i, j, k);
                    if (!acc[at]) continue;
                    sum += values[at];
                    ++known;
                }
            }
    }

    GB_FN bool sticks(const Filler& filler, int x, int y, int z, T& out) const {
        T found[kSticks];
        double weights[kSticks];
        for (int i = 0; i < kSticks; ++i) weights[i] = stick(filler, x, y, z, StickDirections::number(i), found[i]);
        // The shortest n_sticks of them, and those that are as short as the last.
        double sum = 0, weight_sum = 0;
        for (int used = 0; used < filler.n_sticks;) {
            double best = 0;
            for (int i = 0; i < kSticks; ++i) best = max(best, weights[i]);
            if (best == 0) break;
            for (int i = 0; i < kSticks; ++i) {
                if (weights[i] != best) continue;
                sum += found[i] * best;
                weight_sum += best;
                weights[i] = 0;
                ++used;
            }
        }
        out = weight_sum != 0 ? T(sum / weight_sum) : T(0);
        return weight_sum != 0;
    }
    /// The value between the ends of a stick, and its weight; 0 where it has no two ends.
    GB_FN double stick(const Filler& filler, int x, int y, int z, const signed char* d, T& value) const {
        T ahead{}, behind{};
        const int forward = walk(x, y, z, d, 1, filler.size - 1, ahead);
        if (!forward) return 0;
        const int backward = walk(x, y, z, d, -1, filler.size - 1 - forward, behind);
        if (!backward) return 0;
        value = stick_value(forward, backward, ahead, behind);
        return stick_weight(forward, backward, d);
    }
    /// Steps along a stick to the first known voxel, at most `limit`; 0 where there is none.
    GB_FN int walk(int x, int y, int z, const signed char* d, int sign, int limit, T& value) const {
        for (int j = 1; j <= limit; ++j) {
            x += sign * d[0];
            y += sign * d[1];
            z += sign * d[2];
            if (x < 0 || x >= grid.n[0] || y < 0 || y >= grid.n[1] || z < 0 || z >= grid.n[2]) return 0;
            const std::size_t at = grid.index(x, y, z);
            if (!acc[at]) continue;
            value = values[at];
            return j;
        }
        return 0;
    }
    GB_FN static double stick_weight(int forward, int backward, const signed char* d) {
        const double distance = forward + backward + 1;
        return 1.0 / (distance * sqrt(double(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])));
    }
    /// Linear between the ends, cast to the voxel's type.
    GB_FN static T stick_value(int forward, int backward, T ahead, T behind) {
        const double distance = forward + backward + 1;
        const double w = (backward + 1) / distance;
        return T((1.0 - w) * behind + w * ahead);
    }

private:
    struct Span { int first, last; };
    /// Voxels within r along an axis that lie inside of the grid.
    GB_FN Span around(int v, int r, int axis) const { return {max(v - r, 0), min(v + r, grid.n[axis] - 1)}; }
};

}  // namespace globule::core::plus
