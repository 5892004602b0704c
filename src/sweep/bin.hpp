// Bin filling: every pixel's value goes to the voxel that it falls into.
//
// All sums are of integers, and maximum, latest and first are greatest values of integers that hold
// rank and value, so the order in which threads arrive cannot change a bit.
#pragma once
#include "sweep/blocks.hpp"

namespace globule::core::sweep {

enum class Compounding { mean, maximum, latest, first, median };

inline constexpr int kCountBits = 24;  ///< of a packed mean; the sum has the other 40

/// How a value is turned into integers and back.
struct Coding {
    Compounding mode;
    bool wide;     ///< mean: sum and count in a word each, instead of packed in one
    double scale;  ///< sums are of rint(value * scale); 1 for pixels that are integers
    GB_FN int words() const { return mode == Compounding::mean && wide ? 2 : 1; }
};

GB_FN std::uint32_t ordered_bits(float v) {
    std::uint32_t b;
    memcpy(&b, &v, 4);
    return b & 0x80000000u ? ~b : b | 0x80000000u;
}
GB_FN std::uint32_t ordered_bits(std::uint8_t v) { return v; }
GB_FN std::uint32_t ordered_bits(std::uint16_t v) { return v; }
template <class T> GB_FN T from_ordered_bits(std::uint32_t b) {
    if constexpr (sizeof(T) == 4) {
        b = b & 0x80000000u ? b & 0x7fffffffu : ~b;
        T v;
        memcpy(&v, &b, 4);
        return v;
    } else {
        return T(b);
    }
}
template <class T> GB_FN std::int64_t quantized(T v, double scale) {
    if constexpr (sizeof(T) == 4) return std::int64_t(rint(v * scale));
    else return v;
}
template <class T> inline constexpr bool is_real = sizeof(T) == 4;

/// Sums over the run of pixels of a row that fall into one voxel; then one addition to memory.
template <class T> struct BinRows {
    Images<T> images;
    Grid grid;
    Coding coding;
    const std::uint32_t* slots;
    std::uint64_t* bins;  ///< (slots, 64[, 2])
    int sign;             ///< -1 takes pixels out again (mean only)

    GB_FN void operator()(std::size_t row) const {
        const T* values = images.values + row * images.width;
        const std::uint32_t order = images.first_order + std::uint32_t(row) * images.width;
        for_each_run(images, row, grid, [&](std::size_t block, int voxel, int from, int to) {
            const std::size_t at = std::size_t(slots[block]) * kVoxels + voxel;
            if (coding.mode == Compounding::mean) {
                std::int64_t sum = 0;
                for (int i = from; i < to; ++i) sum += quantized(values[i], coding.scale);
                deposit(at, sum, to - from);
            } else {
                std::uint64_t best = 0;
                for (int i = from; i < to; ++i) best = max(best, ranked(values[i], order + i));
                atomic_max(bins + at, best);
            }
        });
    }
    GB_FN std::uint64_t ranked(T value, std::uint32_t order) const {
        const std::uint64_t v = ordered_bits(value);
        if (coding.mode == Compounding::maximum) return v + 1;
        const std::uint64_t rank =
            coding.mode == Compounding::latest ? std::uint64_t(order) + 1 : ~std::uint64_t(order) & kNone;
        return rank << 32 | v;
    }
    GB_FN void deposit(std::size_t at, std::int64_t sum, std::uint64_t count) const {
        if (coding.wide) {
            atomic_add(bins + 2 * at, std::uint64_t(sign * sum));
            atomic_add(bins + 2 * at + 1, std::uint64_t(std::int64_t(count) * sign));
        } else {
            const std::uint64_t both = std::uint64_t(sum) << kCountBits | count;
            atomic_add(bins + at, sign > 0 ? both : ~both + 1);
        }
    }
};
/// The same, a pixel a thread.
template <class T> struct BinPixels {
    BinRows<T> rows;
    GB_FN void operator()(std::size_t i) const {
        visit_pixel(rows.images, i, rows.grid, [&](std::size_t block, int voxel) {
            const std::size_t at = std::size_t(rows.slots[block]) * kVoxels + voxel;
            const T value = rows.images.values[i];
            if (rows.coding.mode == Compounding::mean) rows.deposit(at, quantized(value, rows.coding.scale), 1);
            else atomic_max(rows.bins + at, rows.ranked(value, rows.images.first_order + std::uint32_t(i)));
        });
    }
};

/// Bins of one block become values and a mask of the voxels that have one.  A group takes a block, its lanes are
/// voxels.
template <class T> struct FinishBlock {
    Coding coding;
    const std::uint32_t* block_of_slot;
    const std::uint64_t* bins;
    const std::uint32_t* changed;  ///< per block, or null: all did
    T* values;                     ///< (slots, 64)
    std::uint64_t* masks;          ///< per block of the grid
    struct Nothing {};
    template <class Group> using Scratch = Nothing;
    template <class Group> GB_FN void operator()(Group& g, Nothing&, std::size_t slot) const {
        const std::size_t block = block_of_slot[slot];
        if (changed && !changed[block]) return;
        std::uint64_t mask = 0;
        for (int first = 0; first < kVoxels; first += Group::width) {
            typename Group::B known = g.none();
            Group::for_lanes([&](int lane) {
                const std::size_t at = slot * kVoxels + first + g.lane_number(lane);
                T value{};
                Group::put(known, lane, finish(at, value));
                values[at] = value;
            });
            mask |= std::uint64_t(g.set_of(known)) << first;
        }
        if (g.is_first()) masks[block] = mask;
    }
    GB_FN bool finish(std::size_t at, T& value) const {
        if (coding.mode != Compounding::mean) {
            const std::uint64_t b = bins[at];
            if (b) value = from_ordered_bits<T>(std::uint32_t(coding.mode == Compounding::maximum ? b - 1 : b));
            return b != 0;
        }
        const std::uint64_t b = bins[coding.wide ? 2 * at : at];
        const std::uint64_t count = coding.wide ? bins[2 * at + 1] : b & ((1u << kCountBits) - 1);
        if (!count) return false;
        const std::uint64_t sum = coding.wide ? b : b >> kCountBits;
        if constexpr (is_real<T>) value = T(double(std::int64_t(sum)) / double(count) / coding.scale);
        else value = rounded(sum, count * std::uint64_t(coding.scale));
        return true;
    }
    /// To nearest, halves up.
    GB_FN static T rounded(std::uint64_t sum, std::uint64_t count) { return T((sum + count / 2) / count); }
};

}  // namespace globule::core::sweep
