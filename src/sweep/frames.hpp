// Interpolation between neighboring images along the probe's path (after Coupe et al., "3D freehand ultrasound
// reconstruction based on probe trajectory", MICCAI 2005; their weights by distance, at pixel coordinates that move
// with the probe).
//
// A voxel at the signed distances d0 and d1 from the planes of two consecutive images lies between them where the signs
// differ. At the share t = d0 / (d0 - d1) of the way its pixel is (u, v) = (1 - t) (u0, v0) + t (u1, v1), where (u0,
// v0) and (u1, v1) are the voxel's projections onto the planes; its value is (1 - t) I0(u, v) + t I1(u, v), the images
// bilinear. Where several passes of the probe enclose a voxel, their values are averaged with weights 1 / (q + kOwn), q
// = |d0 d1| / |d0 - d1|: the variance of a linear interpolation grows with q where values differ in proportion to their
// distance (linear variogram).
//
// A voxel stands for its volume: averaged over n by n pixels before, and then bilinear, an image is smoothed with the
// variance n^2 / 12 + n^2 / 6 along an axis, that of a voxel's width s, s^2 / 12, where n = s / sqrt 3.
//
// One worker owns a brick of voxels and takes pairs of images in their order: the same bits for any number of threads.
// Floats are relative to anchors every 16 voxels on both backends, and nothing is contracted: the same bits on both.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "sweep/between.hpp"

namespace globule::core::sweep {

inline constexpr float kOwn = 1;                           ///< voxels; added to q
inline constexpr double kFootprint = 0.57735026918962576;  ///< 1 / sqrt 3, voxels
inline constexpr int kAnchor = 16;

/// From a voxel (x, y, z, 1) to its distance from an image's plane, voxels, and to its column and row among averaged
/// pixels.
struct Plane {
    double map[3][4];
    GB_FN double at(int k, double x, double y, double z) const {
        return ((map[k][3] + map[k][2] * z) + map[k][1] * y) + map[k][0] * x;
    }
    GB_FN double reach(int k, double x, double y, double z) const {
        return abs(map[k][0]) * x + abs(map[k][1]) * y + abs(map[k][2]) * z;
    }
};

/// How many pixels are averaged, and of what size the images then are.
struct Averaging {
    int x, y, width, height;
    bool any() const { return x > 1 || y > 1; }
};

/// What the host knows of the probe's path.
struct Path {
    Averaging averaging;
    std::vector<Plane> planes;
    std::vector<std::uint8_t> joined;  ///< whether an image is joined to the next

    /// max_gap: farthest that two images may be apart that are joined, at their corners, voxels; negative: five of the
    /// sweep's steps.
    template <class T> Path(const Images<T>& images, double max_gap) : planes(images.n), joined(images.n) {
        const auto whole = [](const Fix* step) {
            const double length =
                std::sqrt(double(step[0]) * step[0] + double(step[1]) * step[1] + double(step[2]) * step[2]) * 0x1p-32;
            return length > 0 ? int(std::clamp(std::floor(kFootprint / length + 1e-6), 1.0, 64.0)) : 1;
        };
        const Pose& first = images.poses[0];
        averaging = {whole(first.x), whole(first.y), 0, 0};
        averaging.width = ceil_div(images.width, averaging.x);
        averaging.height = ceil_div(images.height, averaging.y);
        for (int f = 0; f < images.n; ++f) planes[f] = plane(images.poses[f]);
        join(images, max_gap);
    }

private:
    static void cross(const double* a, const double* b, double* c) {
        for (int k = 0; k < 3; ++k) c[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
    }
    Plane plane(const Pose& pose) const {
        double x[3], y[3], o[3], n[3], rows[3][3];
        for (int k = 0; k < 3; ++k) {
            x[k] = double(pose.x[k]) * 0x1p-32;
            y[k] = double(pose.y[k]) * 0x1p-32;
            o[k] = double(pose.origin[k]) * 0x1p-32 - 0.5;  // of voxel centers
        }
        cross(x, y, n);
        const double area2 = n[0] * n[0] + n[1] * n[1] + n[2] * n[2], area = std::sqrt(area2);
        std::copy(n, n + 3, rows[0]);
        cross(y, n, rows[1]);
        cross(n, x, rows[2]);
        const double scale[3] = {1 / area, 1 / area2 / averaging.x, 1 / area2 / averaging.y};
        const double shift[3] = {0, (averaging.x - 1) * 0.5 / averaging.x, (averaging.y - 1) * 0.5 / averaging.y};
        Plane p;
        for (int i = 0; i < 3; ++i) {
            p.map[i][3] = -shift[i];
            for (int k = 0; k < 3; ++k) {
                p.map[i][k] = rows[i][k] * scale[i];
                p.map[i][3] -= p.map[i][k] * o[k];
            }
        }
        return p;
    }
    template <class T> void join(const Images<T>& images, double max_gap) {
        int left = 0, right = images.width - 1, top = 0, bottom = images.height - 1;
        if (images.mask) {
            left = images.width, right = 0, top = images.height, bottom = 0;
            for (int j = 0; j < images.height; ++j)
                for (int i = 0; i < images.width; ++i)
                    if (images.mask[std::size_t(j) * images.width + i])
                        left = std::min(left, i), right = std::max(right, i), top = std::min(top, j),
                        bottom = std::max(bottom, j);
        }
        std::vector<double> steps;
        for (int f = 0; f + 1 < images.n; ++f) {
            const Pose &a = images.poses[f], &b = images.poses[f + 1];
            double longest = 0;
            for (int corner = 0; corner < 4; ++corner) {
                const Fix column = corner & 1 ? right : left, row = corner & 2 ? bottom : top;
                double square = 0;
                for (int k = 0; k < 3; ++k) {
                    const double step =
                        double(b.origin[k] - a.origin[k] + column * (b.x[k] - a.x[k]) + row * (b.y[k] - a.y[k])) *
                        0x1p-32;
                    square += step * step;
                }
                longest = std::max(longest, std::sqrt(square));
            }
            steps.push_back(longest);
        }
        const double most = max_gap < 0 ? 5 * usual(steps) : max_gap;
        for (int f = 0; f + 1 < images.n; ++f) {
            const double *a = planes[f].map[0], *b = planes[f + 1].map[0];
            joined[f] = steps[f] <= most && a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > 0;
        }
    }
    /// The middle one of the steps that are no rest: above a tenth of the upper quartile.
    static double usual(std::vector<double> steps) {
        if (steps.empty()) return 0;
        std::sort(steps.begin(), steps.end());
        const double rest = 0.1 * steps[3 * (steps.size() - 1) / 4];
        const auto moving = std::upper_bound(steps.begin(), steps.end(), rest);
        return moving == steps.end() ? 0 : *(moving + (steps.end() - moving) / 2);
    }
};

/// Means of averaging.x by averaging.y pixels; of those inside of the mask.
template <class T> struct AverageRows {
    Images<T> images;
    Averaging averaging;
    float* out;          ///< (n, height, width)
    std::uint8_t* mask;  ///< (height, width) written with the first image; or null
    GB_FN void operator()(std::size_t row) const {
        const std::size_t f = row / averaging.height;
        const int j = int(row % averaging.height), first = j * averaging.y,
                  last = min(first + averaging.y, images.height);
        for (int i = 0; i < averaging.width; ++i) {
            const int left = i * averaging.x, right = min(left + averaging.x, images.width);
            float sum = 0;
            int n = 0;
            for (int y = first; y < last; ++y)
                for (int x = left; x < right; ++x) {
                    if (images.mask && !images.mask[std::size_t(y) * images.width + x]) continue;
                    sum += float(images.values[(f * images.height + y) * images.width + x]);
                    ++n;
                }
            out[row * averaging.width + i] = n ? sum / float(n) : 0.0f;
            if (mask && f == 0) mask[std::size_t(j) * averaging.width + i] = n != 0;
        }
    }
};

/// Images as they are sampled: pixels as they came, or averaged.
template <class V> struct Sampled {
    const V* values;           ///< (n, height, width)
    const std::uint8_t* mask;  ///< (height, width), or null
    int n, height, width;
    float right, bottom;  ///< just past the last column and row of pixels

    /// Values of images f and f + 1 at n places (u, v), for those that are wanted; no longer wanted are those without a
    /// pixel. Everything but the reading of pixels is the same for all places, so that a CPU takes them together.
    template <int n> GB_FN void at(int f, const float* u, const float* v, int* wanted, float* a, float* b) const {
        float s[n], r[n], w00[n], w10[n], w01[n], w11[n];
        float p00[n], p10[n], p01[n], p11[n], q00[n], q10[n], q01[n], q11[n];
        int at00[n], at10[n], at01[n], at11[n];
        for (int l = 0; l < n; ++l) {
            wanted[l] = wanted[l] & (u[l] >= -0.5f) & (u[l] < right) & (v[l] >= -0.5f) & (v[l] < bottom);
            const float x = wanted[l] ? u[l] : 0.0f, y = wanted[l] ? v[l] : 0.0f;
            const int i = int(x + 1.0f) - 1, j = int(y + 1.0f) - 1;
            s[l] = x - float(i), r[l] = y - float(j);
            const int i0 = max(i, 0), i1 = min(i + 1, width - 1), j0 = max(j, 0) * width,
                      j1 = min(j + 1, height - 1) * width;
            at00[l] = j0 + i0, at10[l] = j0 + i1, at01[l] = j1 + i0, at11[l] = j1 + i1;
            w00[l] = (1.0f - s[l]) * (1.0f - r[l]), w10[l] = s[l] * (1.0f - r[l]), w01[l] = (1.0f - s[l]) * r[l],
            w11[l] = s[l] * r[l];
        }
        const std::size_t image = std::size_t(height) * width;
        const V *p = values + f * image, *q = p + image;
        for (int l = 0; l < n; ++l) {
            if (mask && wanted[l])
                weigh(l, s[l], r[l], at00[l], at10[l], at01[l], at11[l], wanted[l], w00, w10, w01, w11);
            if (!wanted[l]) {
                p00[l] = p10[l] = p01[l] = p11[l] = q00[l] = q10[l] = q01[l] = q11[l] = 0.0f;
                continue;
            }
            p00[l] = float(p[at00[l]]), p10[l] = float(p[at10[l]]), p01[l] = float(p[at01[l]]),
            p11[l] = float(p[at11[l]]);
            q00[l] = float(q[at00[l]]), q10[l] = float(q[at10[l]]), q01[l] = float(q[at01[l]]),
            q11[l] = float(q[at11[l]]);
        }
        for (int l = 0; l < n; ++l) {
            a[l] = (w00[l] * p00[l] + w10[l] * p10[l]) + (w01[l] * p01[l] + w11[l] * p11[l]);
            b[l] = (w00[l] * q00[l] + w10[l] * q10[l]) + (w01[l] * q01[l] + w11[l] * q11[l]);
        }
    }

private:
    /// The weights of place l among the pixels inside of the mask; not wanted if the nearest one is none.
    GB_FN void weigh(int l, float s, float r, int at00, int at10, int at01, int at11, int& wanted, float* w00,
        float* w10, float* w01, float* w11) const {
        if (!mask[r < 0.5f ? (s < 0.5f ? at00 : at10) : (s < 0.5f ? at01 : at11)]) {
            wanted = 0;
            return;
        }
        if (!mask[at00]) w00[l] = 0;
        if (!mask[at10]) w10[l] = 0;
        if (!mask[at01]) w01[l] = 0;
        if (!mask[at11]) w11[l] = 0;
        const float share = 1.0f / ((w00[l] + w10[l]) + (w01[l] + w11[l]));
        w00[l] *= share, w10[l] *= share, w01[l] *= share, w11[l] *= share;
    }
};

/// A brick of voxels, by a group.
template <class T, class V, bool on_device> struct FillBetween {
    static constexpr int kLanes = on_device ? 1 : kAnchor;  ///< voxels along x at a time
    static constexpr int kX = on_device ? 8 : kAnchor, kY = on_device ? 8 : kAnchor, kZ = on_device ? 4 : kAnchor;
    static constexpr int kRows = kX / kLanes * kY * kZ, kPairs = 64;

    Sampled<V> images;
    const Plane* planes;
    const std::uint8_t* joined;
    Bins<T> bins;
    DenseVolume<T> out;
    float *spread, *contrast;  ///< (z, y, x) or null: see FillRequest

    /// A pair's first and second plane relative to an anchor.
    struct Pair {
        float map[2][3][4];
        int frame;
        GB_FN float at(int which, int k, float x, float y, float z) const {
            const float* m = map[which][k];
            return ((m[3] + m[2] * z) + m[1] * y) + m[0] * x;
        }
    };
    struct Sum { float value[kLanes], weight[kLanes], number[kLanes], contrast[kLanes], nearest[kLanes]; };
    struct Room {
        std::uint32_t list[kPairs + 64];
        Pair pairs[kPairs];
        Sum sums[kRows];
    };
    template <class Group> using Scratch = Room;

    static std::size_t n_bricks(const Grid& g) {
        return std::size_t(ceil_div(g.size[0], kX)) * ceil_div(g.size[1], kY) * ceil_div(g.size[2], kZ);
    }

    template <class Group> GB_FN void operator()(Group& g, Room& room, std::size_t i) const {
        const Grid& grid = bins.grid;
        const int nx = ceil_div(grid.size[0], kX), ny = ceil_div(grid.size[1], kY);
        const Cell first{int(i % nx) * kX, int(i / nx % ny) * kY, int(i / nx / ny) * kZ};
        const Cell anchor{first.x / kAnchor * kAnchor, first.y / kAnchor * kAnchor, first.z / kAnchor * kAnchor};
        g.share(kRows, [&](int row) {
            Sum& sum = room.sums[row];
            for (int l = 0; l < kLanes; ++l)
                sum.value[l] = sum.weight[l] = sum.number[l] = sum.contrast[l] = 0.0f, sum.nearest[l] = 1e9f;
        });
        int n = 0;
        for (int k = 0; k < images.n - 1; k += Group::width) {
            typename Group::B near = g.none();
            Group::for_lanes([&](int lane) {
                const int pair = k + g.lane_number(lane);
                Group::put(
                    near, lane, pair < images.n - 1 && joined[pair] && meets(first, planes[pair], planes[pair + 1]));
            });
            if (!g.any(near)) continue;
            if (n + Group::width > kPairs) {
                take(g, room, n, first, anchor);
                n = 0;
            }
            g.keep(near, g.numbers(k), room.list + n);
            n += g.count(near);
            g.sync();
        }
        take(g, room, n, first, anchor);
        g.share(kRows, [&](int row) { finish(room.sums[row], voxel_of(first, row)); });
    }

private:
    GB_FN static Cell voxel_of(Cell first, int row) {
        constexpr int columns = kX / kLanes;
        return first + Cell{row % columns * kLanes, row / columns % kY, row / columns / kY};
    }
    /// Whether the space between two images may meet a brick.
    GB_FN bool meets(Cell first, const Plane& a, const Plane& b) const {
        const double hx = 0.5 * (kX - 1), hy = 0.5 * (kY - 1), hz = 0.5 * (kZ - 1), slack = 1e-3;
        const double x = first.x + hx, y = first.y + hy, z = first.z + hz;
        for (int k = 0; k < 3; ++k) {
            const double p = a.at(k, x, y, z), q = b.at(k, x, y, z), rp = a.reach(k, hx, hy, hz) + slack,
                         rq = b.reach(k, hx, hy, hz) + slack;
            const double low = k ? -0.5 : 0.0, high = k == 0 ? 0.0 : k == 1 ? images.right : images.bottom;
            if ((p + rp < low && q + rq < low) || (p - rp > high && q - rq > high)) return false;
        }
        return true;
    }
    template <class Group> GB_FN_APART void take(Group& g, Room& room, int n, Cell first, Cell anchor) const {
        g.share(n, [&](int i) {
            Pair& pair = room.pairs[i];
            pair.frame = int(room.list[i]);
            for (int which = 0; which < 2; ++which)
                for (int k = 0; k < 3; ++k) {
                    const Plane& plane = planes[pair.frame + which];
                    for (int axis = 0; axis < 3; ++axis) pair.map[which][k][axis] = float(plane.map[k][axis]);
                    pair.map[which][k][3] = float(plane.at(k, anchor.x, anchor.y, anchor.z));
                }
        });
        g.share(kRows, [&](int row) {
            const Cell at = voxel_of(first, row) - anchor;
            for (int i = 0; i < n; ++i) add(room.pairs[i], at, room.sums[row]);
        });
    }
    GB_FN void add(const Pair& pair, Cell at, Sum& sum) const {
        float d0[kLanes], d1[kLanes];
        int between[kLanes], any = 0;
        const float y = float(at.y), z = float(at.z);
        for (int l = 0; l < kLanes; ++l) {
            const float x = float(at.x + l);
            d0[l] = pair.at(0, 0, x, y, z);
            d1[l] = pair.at(1, 0, x, y, z);
            between[l] = (d0[l] < 0) != (d1[l] < 0);
            any |= between[l];
        }
        if (!any) return;
        float t[kLanes], u[kLanes], v[kLanes], a[kLanes], b[kLanes];
        for (int l = 0; l < kLanes; ++l) {
            const float x = float(at.x + l);
            t[l] = d0[l] / (d0[l] - d1[l]);
            const float u0 = pair.at(0, 1, x, y, z), u1 = pair.at(1, 1, x, y, z);
            const float v0 = pair.at(0, 2, x, y, z), v1 = pair.at(1, 2, x, y, z);
            u[l] = u0 + t[l] * (u1 - u0);
            v[l] = v0 + t[l] * (v1 - v0);
        }
        images.template at<kLanes>(pair.frame, u, v, between, a, b);
        for (int l = 0; l < kLanes; ++l) {
            const bool known = between[l];
            const float weight = known ? 1.0f / (abs(d1[l] * t[l]) + kOwn) : 0.0f, step = b[l] - a[l];
            sum.value[l] += weight * (known ? a[l] + t[l] * step : 0.0f);
            sum.weight[l] += weight;
            sum.number[l] += known ? 1.0f : 0.0f;
            sum.contrast[l] += weight * (step * step);
            const float near = min(abs(d0[l]), abs(d1[l]));
            sum.nearest[l] = known ? min(sum.nearest[l], near) : sum.nearest[l];
        }
    }
    GB_FN void finish(const Sum& sum, Cell first) const {
        const Grid& grid = bins.grid;
        if (first.y >= grid.size[1] || first.z >= grid.size[2]) return;
        for (int l = 0; l < kLanes && first.x + l < grid.size[0]; ++l) {
            const Cell v{first.x + l, first.y, first.z};
            const std::size_t at = grid.voxel(v), block = grid.block(Block::of(v));
            const int place = Block::place(v);
            const bool measured = bins.masks[block] >> place & 1, known = sum.weight[l] > 0;
            T value{};
            if (known) value = rounded(sum.value[l] / sum.weight[l]);
            else if (measured) value = bins.values[std::size_t(bins.slots[block]) * kVoxels + place];
            out.values[at] = value;
            out.radius[at] = measured ? 0 : known ? std::uint8_t(min(int(sum.nearest[l]) + 1, kMostFilled)) : kFar;
            if (!spread) continue;
            spread[at] = known      ? max(sum.number[l] / sum.weight[l] - kOwn, 0.0f)
                         : measured ? 0.0f
                                    : -1.0f;  // the weighted mean of q
            contrast[at] = known ? sum.contrast[l] / sum.weight[l] : -1.0f;
        }
    }
    GB_FN static T rounded(float v) {
        if constexpr (is_real<T>) return v;
        else return T(v + 0.5f);
    }
};

}  // namespace globule::core::sweep
