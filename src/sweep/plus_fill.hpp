// PLUS' hole fillers.  Each looks at the unfilled volume only, at voxels whose accumulator is not 0.
#pragma once
#include "exec/bits.hpp"
#include "sweep/plus_insert.hpp"

namespace globule::core::plus {

enum class FillerType { gaussian, gaussian_accumulation, distance_weight_inverse, nearest_neighbor, stick };

struct Filler {
    FillerType type;
    int size;               ///< of the kernel, or the longest stick
    int n_sticks;
    float least_ratio;      ///< of known voxels in the kernel; more is needed
    const float* weights;   ///< (size, size, size) z y x, or null
    GB_FN int reach() const { return type == FillerType::stick ? max(size - 1, 0) : max((size - 1) / 2, 0); }
};

inline constexpr int kMaxFillers = 16;
inline constexpr int kSticks = 13;

struct StickDirections {
    GB_FN static const signed char* of(int i) {
        static constexpr signed char all[kSticks][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 0}, {1, 0, 1},
                                                        {0, 1, 1}, {1, -1, 0}, {1, 0, -1}, {0, 1, -1}, {1, 1, 1},
                                                        {-1, 1, 1}, {1, -1, 1}, {-1, -1, 1}};
        return all[i];
    }
};

/// One bit a voxel along x, 64 voxels a word: set where the accumulator is not 0.
struct Occupancy {
    const std::uint64_t* words;
    int n_words, ny, nz;
    GB_FN std::uint64_t word(int w, int y, int z) const {
        if (w < 0 || w >= n_words || y < 0 || y >= ny || z < 0 || z >= nz) return 0;
        return words[(std::size_t(z) * ny + y) * n_words + w];
    }
    /// Bits of the 64 voxels that start `shift` to the right of word w; |shift| < 64.
    GB_FN std::uint64_t shifted(int w, int y, int z, int shift) const {
        if (shift == 0) return word(w, y, z);
        if (shift > 0) return word(w, y, z) >> shift | word(w + 1, y, z) << (64 - shift);
        return word(w, y, z) << -shift | word(w - 1, y, z) >> (64 + shift);
    }
};

struct MarkOccupied {
    Grid grid;
    int n_words;
    const std::uint16_t* acc;
    std::uint64_t* words;
    GB_FN void operator()(std::size_t i) const {
        const int w = int(i % n_words);
        const std::uint16_t* row = acc + i / n_words * grid.n[0] + 64 * w;
        const int count = min(64, grid.n[0] - 64 * w);
        std::uint64_t bits = 0;
        for (int k = 0; k < count; ++k) bits |= std::uint64_t(row[k] != 0) << k;
        words[i] = bits;
    }
};

struct MarkMeasured {
    const std::uint16_t* acc;
    std::uint8_t* origin;
    GB_FN void operator()(std::size_t i) const { origin[i] = acc[i] ? 0 : 255; }
};

/// True where anything lies within `reach` rows and planes of a word's row, in it or its neighbours.
struct MarkNear {
    Occupancy rows;
    int reach;
    int axis;  ///< 0: neighbour words; 1: along y; 2: along z
    std::uint64_t* out;
    GB_FN void operator()(std::size_t i) const {
        const int w = int(i % rows.n_words), y = int(i / rows.n_words % rows.ny), z = int(i / rows.n_words / rows.ny);
        std::uint64_t any = 0;
        const int n = axis == 0 ? (reach + 63) / 64 : reach;
        for (int d = -n; d <= n && !any; ++d)
            any |= rows.word(w + (axis == 0 ? d : 0), y + (axis == 1 ? d : 0), z + (axis == 2 ? d : 0));
        out[i] = any;
    }
};

template <class T>
struct Holes {
    Grid grid;
    const T* values;
    const std::uint16_t* acc;

    /// Weighted mean of the known voxels in the kernel, in PLUS' order of summation (x outermost).
    GB_FN bool kernel(const Filler& filler, int x, int y, int z, T& out) const {
        const int size = filler.size, range = (size - 1) / 2;
        double sum = 0, weight_sum = 0;
        int known = 0;
        for (int i = max(x - range, 0); i <= min(x + range, grid.n[0] - 1); ++i)
            for (int j = max(y - range, 0); j <= min(y + range, grid.n[1] - 1); ++j)
                for (int k = max(z - range, 0); k <= min(z + range, grid.n[2] - 1); ++k) {
                    const std::size_t at = grid.index(i, j, k);
                    const std::uint16_t a = acc[at];
                    if (!a) continue;
                    const float w = filler.weights[size * size * (k - z + range) + size * (j - y + range) + (i - x + range)];
                    const double weight = filler.type == FillerType::gaussian_accumulation ? a * w : w;
                    sum += values[at] * weight;
                    weight_sum += weight;
                    ++known;
                }
        return finish(filler, sum, weight_sum, known, out);
    }
    GB_FN bool finish(const Filler& filler, double sum, double weight_sum, int known, T& out) const {
        out = T(0);
        if (weight_sum == 0 || !(double(known) / (filler.size * filler.size * filler.size) > filler.least_ratio)) return false;
        out = T(sum / weight_sum);
        return true;
    }

    /// Mean of the known voxels of the smallest cube that holds one: all lie on its surface.
    GB_FN bool nearest(const Filler& filler, int x, int y, int z, T& out) const {
        double sum = 0;
        int known = 0;
        for (int r = 1; r <= (filler.size - 1) / 2 && !known; ++r)
            for (int i = x - r; i <= x + r; ++i) {
                if (i < 0 || i >= grid.n[0]) continue;
                for (int j = y - r; j <= y + r; ++j) {
                    if (j < 0 || j >= grid.n[1]) continue;
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
        return finish(filler, sum, known, known, out);
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

    GB_FN bool sticks(const Filler& filler, int x, int y, int z, T& out) const {
        T found[kSticks];
        double weights[kSticks];
        for (int i = 0; i < kSticks; ++i) {
            const signed char* d = StickDirections::of(i);
            T ahead{}, behind{};
            weights[i] = 0;
            const int forward = walk(x, y, z, d, 1, filler.size - 1, ahead);
            if (!forward) continue;
            const int backward = walk(x, y, z, d, -1, filler.size - 1 - forward, behind);
            if (!backward) continue;
            weights[i] = stick_weight(forward, backward, d);
            found[i] = stick_value(forward, backward, ahead, behind);
        }
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

    GB_FN bool fill(const Filler& filler, int x, int y, int z, T& out) const {
        if (filler.type == FillerType::stick) return sticks(filler, x, y, z, out);
        if (filler.type == FillerType::nearest_neighbor) return nearest(filler, x, y, z, out);
        return kernel(filler, x, y, z, out);
    }
};

/// 64 voxels of a row: each filler in turn, until one succeeds.
template <class T>
struct FillRow {
    Holes<T> holes;
    Occupancy known;
    const std::uint64_t* near;
    int n_fillers;
    Filler fillers[kMaxFillers];
    T* out;
    std::uint8_t* origin;  ///< 0 measured, 1 filled, 255 neither

    GB_FN void operator()(std::size_t i) const {
        const Grid& grid = holes.grid;
        const int w = int(i % known.n_words), y = int(i / known.n_words % known.ny), z = int(i / known.n_words / known.ny);
        const std::size_t base = grid.index(64 * w, y, z);
        const int count = min(64, grid.n[0] - 64 * w);
        const std::uint64_t here = known.words[i];
        std::uint64_t todo = ~here & (~std::uint64_t(0) >> (64 - count));
        if (!near[i]) {  // nothing within reach: all fillers fail
            for (int k = 0; k < count; ++k) {
                out[base + k] = T(0);
                origin[base + k] = 255;
            }
            return;
        }
        for (int k = 0; k < count; ++k) out[base + k] = here >> k & 1 ? holes.values[base + k] : T(0);
        for (int f = 0; f < n_fillers && todo; ++f) {
            if (fillers[f].type == FillerType::stick && fillers[f].n_sticks == 1 && fillers[f].size <= kLongest + 1)
                todo &= ~shortest_sticks(fillers[f].size, w, y, z, base, todo);
            else if (!Scalar<T>::is_float && fillers[f].type == FillerType::nearest_neighbor && fillers[f].size <= 2 * kWidest + 2)
                todo &= ~smallest_cubes(fillers[f], w, y, z, base, todo);
            else
                for (std::uint64_t rest = todo; rest; rest &= rest - 1) {
                    const int k = trailing_zeros(rest);
                    if (holes.fill(fillers[f], 64 * w + k, y, z, out[base + k])) todo &= ~(std::uint64_t(1) << k);
                }
        }
        for (int k = 0; k < count; ++k) origin[base + k] = here >> k & 1 ? 0 : todo >> k & 1 ? 255 : 1;
    }

    static constexpr int kWidest = 4;

    /// The smallest cubes with a known voxel, 64 voxels at once; sums of integers do not mind the order.
    GB_FN std::uint64_t smallest_cubes(const Filler& filler, int w, int y, int z, std::size_t base, std::uint64_t todo) const {
        constexpr int n = 2 * kWidest + 1;
        const int reach = (filler.size - 1) / 2;
        std::uint64_t left[n][n], here[n][n], right[n][n], near[n][n];
        for (int k = -reach; k <= reach; ++k)
            for (int j = -reach; j <= reach; ++j) {
                left[k + kWidest][j + kWidest] = known.word(w - 1, y + j, z + k);
                near[k + kWidest][j + kWidest] = here[k + kWidest][j + kWidest] = known.word(w, y + j, z + k);
                right[k + kWidest][j + kWidest] = known.word(w + 1, y + j, z + k);
            }
        std::uint64_t done = 0;
        for (int r = 1; r <= reach && todo; ++r) {
            std::uint64_t hit = 0;
            for (int k = kWidest - reach; k <= kWidest + reach; ++k)
                for (int j = kWidest - reach; j <= kWidest + reach; ++j) {
                    near[k][j] |= here[k][j] << r | left[k][j] >> (64 - r) | here[k][j] >> r | right[k][j] << (64 - r);
                    if (magnitude_of(k - kWidest) <= r && magnitude_of(j - kWidest) <= r) hit |= near[k][j];
                }
            hit &= todo;
            todo &= ~hit;
            for (; hit; hit &= hit - 1) {
                const int bit = trailing_zeros(hit);
                double sum = 0;
                int count = 0;
                for (int k = -r; k <= r; ++k)
                    for (int j = -r; j <= r; ++j) {
                        const std::uint64_t a = left[k + kWidest][j + kWidest], b = here[k + kWidest][j + kWidest], c = right[k + kWidest][j + kWidest];
                        const int from = bit - r;
                        std::uint64_t row = from < 0 ? b << -from | a >> (64 + from) : from ? b >> from | c << (64 - from) : b;
                        row &= (std::uint64_t(1) << (2 * r + 1)) - 1;
                        if (!row) continue;
                        const T* values = holes.values + (holes.grid.index(64 * w, y + j, z + k) + bit - r);
                        for (; row; row &= row - 1, ++count) sum += values[trailing_zeros(row)];
                    }
                if (holes.finish(filler, sum, count, count, out[base + bit])) done |= std::uint64_t(1) << bit;
            }
        }
        return done;
    }
    GB_FN static int magnitude_of(int v) { return v < 0 ? -v : v; }

    static constexpr int kLongest = 8;

    /// The shortest stick alone, all ties of it averaged: 64 voxels at once.  ahead[j] marks the
    /// voxels whose first known voxel along the direction is j steps away.
    GB_FN std::uint64_t shortest_sticks(int limit, int w, int y, int z, std::size_t base, std::uint64_t todo) const {
        std::uint64_t ahead[kSticks][kLongest + 1], behind[kSticks][kLongest + 1];
        for (int i = 0; i < kSticks; ++i) {
            const signed char* d = StickDirections::of(i);
            std::uint64_t open = todo, back = todo;
            for (int j = 1; j < limit; ++j) {
                ahead[i][j] = open ? open & known.shifted(w, y + j * d[1], z + j * d[2], j * d[0]) : 0;
                open &= ~ahead[i][j];
            }
            if (open == todo) back = 0;
            for (int j = 1; j < limit; ++j) {
                behind[i][j] = back ? back & known.shifted(w, y - j * d[1], z - j * d[2], -j * d[0]) : 0;
                back &= ~behind[i][j];
            }
        }
        // Lengths in ascending order: total steps t = 3, 4 ... times 1, sqrt 2 or sqrt 3.
        const int first_of[4] = {0, 3, 9, kSticks};
        int next[3] = {3, 3, 3};
        std::uint64_t done = 0;
        while (todo & ~done) {
            int kind = -1;
            for (int c = 0; c < 3; ++c)
                if (next[c] <= limit &&
                    (kind < 0 || next[c] * next[c] * (c + 1) < next[kind] * next[kind] * (kind + 1)))
                    kind = c;
            if (kind < 0) break;
            const int steps = next[kind]++ - 1;  // forward + backward
            std::uint64_t hit = 0;
            for (int i = first_of[kind]; i < first_of[kind + 1]; ++i)
                for (int j = 1; j < steps; ++j) hit |= ahead[i][j] & behind[i][steps - j];
            hit &= ~done;
            done |= hit;
            for (; hit; hit &= hit - 1) {
                const int k = trailing_zeros(hit);
                out[base + k] = average(ahead, behind, first_of[kind], first_of[kind + 1], steps, k, base + k);
            }
        }
        return done;
    }
    GB_FN T average(const std::uint64_t (*ahead)[kLongest + 1], const std::uint64_t (*behind)[kLongest + 1], int from, int to,
                    int steps, int bit, std::size_t at) const {
        const Grid& grid = holes.grid;
        double sum = 0, weight_sum = 0;
        for (int i = from; i < to; ++i)
            for (int j = 1; j < steps; ++j) {
                if (!((ahead[i][j] & behind[i][steps - j]) >> bit & 1)) continue;
                const signed char* d = StickDirections::of(i);
                const long long step = (d[2] * (long long)grid.n[1] + d[1]) * grid.n[0] + d[0];
                const double weight = Holes<T>::stick_weight(j, steps - j, d);
                sum += Holes<T>::stick_value(j, steps - j, holes.values[at + j * step],
                                             holes.values[at - (steps - j) * step]) * weight;
                weight_sum += weight;
            }
        return T(sum / weight_sum);
    }
};

}  // namespace globule::core::plus
