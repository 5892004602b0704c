// Pixels into voxels as the PLUS toolkit does it.  Its result depends on the order of insertion
// (image, row, column), so one worker owns a brick of voxels and walks all pixels that reach it in
// that order: exact at any number of workers, without a lock or a sort.
#pragma once
#include "base/vec.hpp"
#include "sweep/plus_math.hpp"

namespace globule::core::plus {

enum class Interpolation { nearest, linear };
enum class Optimization { none, partial, full };
enum class Compounding { latest, maximum, mean, importance };

inline constexpr int kWhole = 256;  ///< accumulator of one pixel inserted with weight 1
inline constexpr int kFullest = 65535;
inline constexpr int kThreshold = kFullest - kWhole;

/// voxel = origin + column * x + row * y, in voxels; image_from_voxel maps back to column, row and
/// distance from the plane (in units of |x cross y|).
struct ImagePose {
    double origin[3], x[3], y[3];
    double image_from_voxel[3][4];
    double inverse_scale[3];  ///< of the three rows above: sum of magnitudes, for half a voxel's reach
};

struct Grid {
    int n[3];
    GB_FN std::size_t index(int x, int y, int z) const { return (std::size_t(z) * n[1] + y) * n[0] + x; }
    GB_FN std::size_t size() const { return std::size_t(n[0]) * n[1] * n[2]; }
};

/// Source pixel of an image position: -1 skips it; kTwice inserts it twice in a row.
inline constexpr std::int32_t kTwice = 1 << 30;

struct Slices {
    int n_images, height, width;
    const ImagePose* poses;
    const std::int32_t* sources;         ///< (n_masks, height, width)
    const std::uint32_t* mask_of_image;  ///< (n_images,)
    const std::uint8_t* importance;      ///< (height, width) or null
    bool rejects;
    double rejection;  ///< darker pixels are left out
    double slack;      ///< voxels that fixed-point places may differ from exact ones
};

template <class T> struct Scalar { static constexpr bool is_float = T(0.3) > 0; };

/// Nearest: the new value of a voxel and its accumulator.
template <class T>
GB_FN void insert_nearest(T pixel, int importance, T& out, std::uint16_t& acc, Compounding mode, bool counts) {
    if (mode == Compounding::latest || mode == Compounding::maximum) {
        if (mode == Compounding::latest || pixel > out) out = pixel;
        acc = std::uint16_t(counts ? min(acc + kWhole, kFullest) : kWhole);
        return;
    }
    if (acc > kThreshold) {
        out = T(pixel * (1.0 / 256) + out * (255.0 / 256));
        return;
    }
    const int weight = mode == Compounding::mean ? kWhole : importance;
    if (weight == 0) return;
    const int sum = acc + weight;
    if constexpr (Scalar<T>::is_float) out = (pixel * weight + out * acc) / sum;
    else out = T(wrap_add(wrap_multiply(pixel, weight), wrap_multiply(out, acc)) / sum);
    acc = std::uint16_t(min(sum, kFullest));
}

// Linear: weighted mean in the mixed arithmetic of PLUS' overloads.
GB_FN double blend(double f, float in, double r, float out, double a) { return (f * in + r * out) / a; }
GB_FN double blend(double f, int in, double r, int out, double a) { return (f * in + r * out) / a; }
GB_FN Fixed blend(Fixed f, int in, Fixed r, int out, Fixed a) { return (in * f + out * r) / a; }
GB_FN float blend(Fixed f, float in, Fixed r, float out, Fixed a) {
    return (f.single() * in + r.single() * out) / a.single();
}
GB_FN double blend_importance(double f, float in, int importance, int acc, float out, double a) {
    return (in * importance * f + out * acc) / a;
}
GB_FN double blend_importance(double f, int in, int importance, int acc, int out, double a) {
    return (wrap_multiply(in, importance) * f + wrap_multiply(out, acc)) / a;
}
GB_FN Fixed blend_importance(Fixed f, int in, int importance, int acc, int out, Fixed a) {
    return (wrap_multiply(in, importance) * f) / a + out * (Fixed::of_int(acc) / a);
}
GB_FN Fixed blend_importance(Fixed f, float in, int importance, int acc, float out, Fixed a) {
    return Fixed::of(in * importance * f.single() / a.single() + (Fixed::of_int(acc) / a).single() * out);
}
template <class T, class V> GB_FN T stored(V v) {
    if constexpr (!Scalar<T>::is_float) return T(round_of(v));
    else if constexpr (std::is_same_v<V, Fixed>) return v.single();
    else return T(v);
}
template <class T> struct Wide { using type = int; };
template <> struct Wide<float> { using type = float; };

/// One of the eight corners; f is its weight, not 0.
template <class F, class T>
GB_FN void insert_linear(F f, T pixel, int importance, T& out, std::uint16_t& acc, Compounding mode) {
    using W = typename Wide<T>::type;
    F a = Number<F>::of_int(acc);
    if (mode == Compounding::latest || mode == Compounding::maximum) {
        if (!Number<F>::at_least_eighth(f) || (mode == Compounding::maximum && !(pixel > out))) return;
        out = pixel;
        a = kWhole * f;
    } else if (mode == Compounding::mean) {
        const F r = Number<F>::of(acc / 256.0);
        a = f + r;
        out = stored<T>(blend(f, W(pixel), r, W(out), a));
        a = kWhole * a;
    } else {
        if (importance == 0) return;
        a = importance * f + a;
        out = stored<T>(blend_importance(f, W(pixel), importance, acc, W(out), a));
    }
    acc = std::uint16_t(min(round_of(a), kFullest));
}

template <class T, class F> struct InsertBrick {
    Slices slices;
    const T* images;  ///< (n_images, height, width)
    Grid grid;
    int edge;  ///< of a brick, voxels
    int n_bricks[3];
    Interpolation interpolation;
    Optimization optimization;
    Compounding mode;
    T* values;
    std::uint16_t* acc;

    struct Box {
        int lo[3], hi[3];  ///< voxels lo <= v < hi
        GB_FN bool has(int x, int y, int z) const {
            return x >= lo[0] && x < hi[0] && y >= lo[1] && y < hi[1] && z >= lo[2] && z < hi[2];
        }
    };

    GB_FN void operator()(std::size_t i) const {
        Box box;
        const std::size_t at[3] = {i % n_bricks[0], i / n_bricks[0] % n_bricks[1], i / n_bricks[0] / n_bricks[1]};
        for (int k = 0; k < 3; ++k) {
            box.lo[k] = int(at[k]) * edge;
            box.hi[k] = min(box.lo[k] + edge, grid.n[k]);
        }
        for (int k = 0; k < slices.n_images; ++k) insert_image(k, box);
    }

    /// Rows and columns whose pixels may reach the box: image coordinates are linear in the voxel.
    GB_FN void insert_image(int number, const Box& box) const {
        const ImagePose& pose = slices.poses[number];
        double from[3], to[3];
        for (int r = 0; r < 3; ++r) {
            const double* m = pose.image_from_voxel[r];
            double middle = m[3], reach = (1 + slices.slack) * pose.inverse_scale[r];
            for (int k = 0; k < 3; ++k) {
                middle += m[k] * 0.5 * (box.lo[k] + box.hi[k] - 1);
                reach += abs(m[k]) * 0.5 * (box.hi[k] - 1 - box.lo[k]);
            }
            from[r] = middle - reach;
            to[r] = middle + reach;
        }
        if (from[2] > 0 || to[2] < 0) return;
        const int first_row = int(max(from[1], 0.0)), last_row = int(min(to[1], slices.height - 1.0));
        const int first = int(max(from[0], 0.0)), last = int(min(to[0], slices.width - 1.0));
        if (to[1] < 0 || to[0] < 0) return;
        for (int row = first_row; row <= last_row; ++row) insert_row(number, pose, row, first, last, box);
    }

    GB_FN void insert_row(int number, const ImagePose& pose, int row, int first, int last, const Box& box) const {
        F start[3], step[3];
        double lo = first, hi = last;
        for (int k = 0; k < 3; ++k) {
            step[k] = Number<F>::of(pose.x[k]);
            start[k] = Number<F>::of(pose.origin[k]) + row * Number<F>::of(pose.y[k]);
            // Columns with box.lo - 1 <= p <= box.hi, and a little more; the test per voxel is exact.
            const double p = pose.origin[k] + row * pose.y[k], d = pose.x[k];
            const double low = box.lo[k] - 1 - slices.slack - p, high = box.hi[k] + slices.slack - p;
            if (abs(d) < 1e-9) {
                if (low > 0 || high < 0) return;
                continue;
            }
            const double a = low / d, b = high / d;
            lo = max(lo, min(a, b));
            hi = min(hi, max(a, b));
        }
        if (!(lo <= hi)) return;
        const std::size_t pixels = std::size_t(slices.height) * slices.width;
        const T* image = images + number * pixels;
        const std::int32_t* sources =
            slices.sources + slices.mask_of_image[number] * pixels + std::size_t(row) * slices.width;
        for (int column = int(lo); column <= int(hi); ++column) {
            std::int32_t source = sources[column];
            if (source < 0) continue;
            const bool twice = source & kTwice;
            source &= ~kTwice;
            const T pixel = image[source];
            if (slices.rejects && pixel < slices.rejection) continue;
            const int importance = slices.importance ? slices.importance[source] : 0;
            F p[3];
            for (int k = 0; k < 3; ++k) p[k] = place(pose, k, start[k], step[k], row, column);
            for (int times = twice ? 2 : 1; times > 0; --times) {
                if (interpolation == Interpolation::nearest) nearest(p, pixel, importance, box);
                else linear(p, pixel, importance, box);
            }
        }
    }

    GB_FN Fixed place(const ImagePose&, int, Fixed start, Fixed step, int, int column) const {
        return start + column * step;
    }
    GB_FN double place(const ImagePose& pose, int k, double start, double step, int row, int column) const {
        if (optimization == Optimization::partial) return start + column * step;
        return pose.x[k] * column + pose.y[k] * row + pose.origin[k];
    }

    GB_FN void nearest(const F* p, T pixel, int importance, const Box& box) const {
        const int x = round_of(p[0]), y = round_of(p[1]), z = round_of(p[2]);
        if (!box.has(x, y, z)) return;
        const std::size_t at = grid.index(x, y, z);
        insert_nearest(pixel, importance, values[at], acc[at], mode, optimization == Optimization::none);
    }

    GB_FN void linear(const F* p, T pixel, int importance, const Box& box) const {
        int v[3][2];
        F w[3][2];
        for (int k = 0; k < 3; ++k) {
            v[k][0] = floor_of(p[k]);
            w[k][1] = p[k] - Number<F>::of_int(v[k][0]);
            w[k][0] = Number<F>::of_int(1) - w[k][1];
            v[k][1] = v[k][0] + !is_zero(w[k][1]);
            if (v[k][0] < 0 || v[k][1] >= grid.n[k]) return;  // all eight corners or none
        }
        const F yz[4] = {w[1][0] * w[2][0], w[1][0] * w[2][1], w[1][1] * w[2][0], w[1][1] * w[2][1]};
        for (int j = 7; j >= 0; --j) {
            const int x = v[0][j >> 2], y = v[1][(j >> 1) & 1], z = v[2][j & 1];
            const F f = w[0][j >> 2] * yz[j & 3];
            if (is_zero(f) || !box.has(x, y, z)) continue;
            const std::size_t at = grid.index(x, y, z);
            insert_linear(f, pixel, importance, values[at], acc[at], mode);
        }
    }
};

}  // namespace globule::core::plus
