// PLUS' hole fillers, 64 voxels of a row at once: which of them are known, and which are still holes, are the bits of a
// word.
//
//   MarkOccupied   one bit a voxel: where the accumulator is not 0
//   MarkNear       the words that have anything within the fillers' reach; in the others all fillers fail
//   FillRow        each filler in turn takes the holes that are left, until none are or none can
//
// A filler looks at one voxel after the other (plus_holes.hpp), but for the two that can be told from bits alone:
// the smallest cube that holds something, and the shortest stick.
#pragma once
#include "exec/bits.hpp"
#include "sweep/plus_holes.hpp"

namespace globule::core::plus {

/// One bit a voxel along x, 64 voxels a word: set where the accumulator is not 0.
struct Occupancy {
    const std::uint64_t* words;
    int n_words, ny, nz;
    struct Place {
        int w, y, z;  ///< word of a row, row, plane
    };
    GB_FN Place place(std::size_t i) const { return {int(i % n_words), int(i / n_words % ny), int(i / n_words / ny)}; }
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

/// True where anything lies within `reach` rows and planes of a word's row, in it or its neighbors.
struct MarkNear {
    Occupancy rows;
    int reach;
    int axis;  ///< 0: neighbor words; 1: along y; 2: along z
    std::uint64_t* out;
    GB_FN void operator()(std::size_t i) const {
        const auto [w, y, z] = rows.place(i);
        std::uint64_t any = 0;
        const int n = axis == 0 ? (reach + 63) / 64 : reach;
        for (int d = -n; d <= n && !any; ++d)
            any |= rows.word(w + (axis == 0 ? d : 0), y + (axis == 1 ? d : 0), z + (axis == 2 ? d : 0));
        out[i] = any;
    }
};

/// 64 voxels of a row: each filler in turn, until one succeeds.
template <class T> struct FillRow {
    Holes<T> holes;
    Occupancy known;
    const std::uint64_t* near;
    int n_fillers;
    Filler fillers[kMaxFillers];
    T* out;
    std::uint8_t* origin;  ///< 0 measured, 1 filled, 255 neither

    static constexpr std::uint64_t kOne = 1;

    /// The 64 voxels: word w of row y in plane z; the number of the first.
    struct Word {
        int w, y, z;
        std::size_t base;
    };

    GB_FN void operator()(std::size_t i) const {
        const auto [w, y, z] = known.place(i);
        const Word at{w, y, z, holes.grid.index(64 * w, y, z)};
        const int count = min(64, holes.grid.n[0] - 64 * w);
        const std::uint64_t here = known.words[i];
        std::uint64_t todo = ~here & (~std::uint64_t(0) >> (64 - count));
        if (!near[i]) {
            for (int k = 0; k < count; ++k) {
                out[at.base + k] = T(0);
                origin[at.base + k] = 255;
            }
            return;
        }
        for (int k = 0; k < count; ++k) out[at.base + k] = here >> k & 1 ? holes.values[at.base + k] : T(0);
        for (int f = 0; f < n_fillers && todo; ++f) todo &= ~fill(fillers[f], at, todo);
        for (int k = 0; k < count; ++k) origin[at.base + k] = here >> k & 1 ? 0 : todo >> k & 1 ? 255 : 1;
    }
    /// Fills what it can of the voxels whose bits are set; which ones.
    GB_FN std::uint64_t fill(const Filler& filler, const Word& at, std::uint64_t todo) const {
        if (filler.type == FillerType::stick && filler.n_sticks == 1 && filler.size <= kLongest + 1)
            return shortest_sticks(filler.size, at, todo);
        if (!Scalar<T>::is_float && filler.type == FillerType::nearest_neighbor && filler.size <= 2 * kWidest + 2)
            return smallest_cubes(filler, at, todo);
        return one_by_one(filler, at, todo);
    }
    GB_FN std::uint64_t one_by_one(const Filler& filler, Word at, std::uint64_t todo) const {
        std::uint64_t done = 0;
        for (; todo; todo &= todo - 1) {
            const int k = trailing_zeros(todo);
            T value;  // not out[] itself: for all the compiler knows, that changes what is read here
            if (holes.fill(filler, 64 * at.w + k, at.y, at.z, value)) done |= kOne << k;
            out[at.base + k] = value;
        }
        return done;
    }

    // The smallest cubes that hold something.  A cube holds something where the rows within its radius do within as
    // many voxels along x: rows of bits are widened by a voxel on either side a radius, and or-ed.  Sums of integers do
    // not mind the order, so bits say which values are added up; floats go one voxel after the other.

    static constexpr int kWidest = 4;  ///< radius

    /// Bits of the rows around: the words left of ours, ours and right of it, by plane and row.
    struct Around {
        static constexpr int n = 2 * kWidest + 1;
        std::uint64_t left[n][n], here[n][n], right[n][n];
        /// 64 bits of row (z, y) that begin `from` to the right of ours; |from| < 64.
        GB_FN std::uint64_t bits(int z, int y, int from) const {
            const std::uint64_t a = left[z + kWidest][y + kWidest], b = here[z + kWidest][y + kWidest],
                                c = right[z + kWidest][y + kWidest];
            return from < 0 ? b << -from | a >> (64 + from) : from ? b >> from | c << (64 - from) : b;
        }
    };
    GB_FN std::uint64_t smallest_cubes(const Filler& filler, const Word& at, std::uint64_t todo) const {
        const int reach = (filler.size - 1) / 2;
        Around rows;
        std::uint64_t wide[Around::n][Around::n];  // rows of `here`, widened
        for (int z = kWidest - reach; z <= kWidest + reach; ++z)
            for (int y = kWidest - reach; y <= kWidest + reach; ++y) {
                const int row = at.y + y - kWidest, plane = at.z + z - kWidest;
                rows.left[z][y] = known.word(at.w - 1, row, plane);
                wide[z][y] = rows.here[z][y] = known.word(at.w, row, plane);
                rows.right[z][y] = known.word(at.w + 1, row, plane);
            }
        std::uint64_t done = 0;
        for (int r = 1; r <= reach && todo; ++r) {
            std::uint64_t hit = widen(rows, wide, reach, r) & todo;
            todo &= ~hit;
            for (; hit; hit &= hit - 1) {
                const int bit = trailing_zeros(hit);
                double sum = 0;
                int count = 0;
                add_cube(rows, at, bit, r, sum, count);
                if (holes.finish(filler, sum, count, count, out[at.base + bit])) done |= kOne << bit;
            }
        }
        return done;
    }
    /// From radius r - 1 to r; the voxels whose cube of radius r holds something.
    GB_FN static std::uint64_t widen(
        const Around& rows, std::uint64_t (&wide)[Around::n][Around::n], int reach, int r) {
        std::uint64_t hit = 0;
        for (int z = kWidest - reach; z <= kWidest + reach; ++z)
            for (int y = kWidest - reach; y <= kWidest + reach; ++y) {
                const std::uint64_t here = rows.here[z][y];
                wide[z][y] |= here << r | rows.left[z][y] >> (64 - r) | here >> r | rows.right[z][y] << (64 - r);
                if (max(z - kWidest, kWidest - z) <= r && max(y - kWidest, kWidest - y) <= r) hit |= wide[z][y];
            }
        return hit;
    }
    /// Sum and number of what the cube of radius r around a voxel holds.
    GB_FN void add_cube(const Around& rows, const Word& at, int bit, int r, double& sum, int& count) const {
        for (int z = -r; z <= r; ++z)
            for (int y = -r; y <= r; ++y) {
                std::uint64_t row = rows.bits(z, y, bit - r) & ((kOne << (2 * r + 1)) - 1);
                if (!row) continue;
                const T* values = holes.values + (holes.grid.index(64 * at.w, at.y + y, at.z + z) + bit - r);
                for (; row; row &= row - 1, ++count) sum += values[trailing_zeros(row)];
            }
    }

    // The shortest stick alone, all ties of it averaged.  Bits say, for each direction and number of steps, which
    // voxels have their first known voxel there; a stick of so many steps altogether has its ends where both of two
    // such words are set.

    static constexpr int kLongest = 8;                   ///< steps
    using Steps = std::uint64_t[kSticks][kLongest + 1];  ///< [direction][steps to the first known voxel]

    GB_FN std::uint64_t shortest_sticks(int limit, const Word& at, std::uint64_t todo) const {
        Steps ahead, behind;
        for (int i = 0; i < kSticks; ++i) {
            const bool any = first_known(limit, at, i, 1, todo, ahead[i]);
            first_known(limit, at, i, -1, any ? todo : 0, behind[i]);
        }
        // Lengths in ascending order: t = 3, 4 ... voxels from end to end, both counted, times 1, sqrt 2 or sqrt 3.
        int next[4] = {0, 3, 3, 3};  // t that is next, by squared length of the direction
        std::uint64_t done = 0;
        while (todo & ~done) {
            const int length2 = shortest(next, limit);
            if (!length2) break;
            const int steps = next[length2]++ - 1;  // forward + backward
            const int first = StickDirections::first(length2), last = StickDirections::first(length2 + 1);
            std::uint64_t hit = 0;
            for (int i = first; i < last; ++i)
                for (int j = 1; j < steps; ++j) hit |= ahead[i][j] & behind[i][steps - j];
            hit &= ~done;
            done |= hit;
            for (; hit; hit &= hit - 1) {
                const int k = trailing_zeros(hit);
                out[at.base + k] = average(ahead, behind, first, last, steps, k, at.base + k);
            }
        }
        return done;
    }
    /// Steps to the first known voxel along a direction, forward (sign 1) or back, of the voxels whose bits are set;
    /// whether any has one.
    GB_FN bool first_known(int limit, const Word& at, int direction, int sign, std::uint64_t open,
        std::uint64_t (&steps)[kLongest + 1]) const {
        const signed char* d = StickDirections::number(direction);
        const std::uint64_t all = open;
        for (int j = 1; j < limit; ++j) {
            const int k = sign * j;
            steps[j] = open ? open & known.shifted(at.w, at.y + k * d[1], at.z + k * d[2], k * d[0]) : 0;
            open &= ~steps[j];
        }
        return open != all;
    }
    /// Which of the next lengths is the shortest, t^2 times squared length of the direction; 0: all are too long.
    GB_FN static int shortest(const int (&next)[4], int limit) {
        int best = 0;
        for (int c = 1; c <= 3; ++c)
            if (next[c] <= limit && (!best || next[c] * next[c] * c < next[best] * next[best] * best)) best = c;
        return best;
    }
    GB_FN T average(
        const Steps& ahead, const Steps& behind, int from, int to, int steps, int bit, std::size_t at) const {
        const Grid& grid = holes.grid;
        double sum = 0, weight_sum = 0;
        for (int i = from; i < to; ++i)
            for (int j = 1; j < steps; ++j) {
                if (!((ahead[i][j] & behind[i][steps - j]) >> bit & 1)) continue;
                const signed char* d = StickDirections::number(i);
                const long long step = (d[2] * (long long)grid.n[1] + d[1]) * grid.n[0] + d[0];
                const double weight = Holes<T>::stick_weight(j, steps - j, d);
                sum += Holes<T>::stick_value(
                           j, steps - j, holes.values[at + j * step], holes.values[at - (steps - j) * step]) *
                       weight;
                weight_sum += weight;
            }
        return T(sum / weight_sum);
    }
};

}  // namespace globule::core::plus
