// Normals at the corners of a mesh: the mean of those of the triangles around that meet this one at less than an angle,
// weighted by their own angles there (Thürmer & Wüthrich 1998).  Where very many corners share a place (an apex, the
// cap of a cylinder, faces filled up with zeros) their normals are first added up by direction, so that a mesh takes
// time for its corners and not for their pairs; the angle is then that to a direction's mean.
#pragma once
#include "base/quad.hpp"
#include "base/vec.hpp"

namespace globule::core {

/// Corners by place: those of place v are corners[begin[v]] to corners[begin[v + 1] - 1], each 3 face + k.
struct CornersByPlace {
    const std::uint32_t *corners, *begin;
    GB_FN std::uint32_t count(std::uint32_t v) const { return begin[v + 1] - begin[v]; }
};

inline constexpr std::uint32_t kManyCorners = 96;  ///< from so many on by direction
inline constexpr std::uint32_t kPart = 2048;       ///< corners that one thread adds up

/// The places that have many, ascending, and where each one's parts begin among all.
struct ManyCorners {
    const std::uint32_t *places, *parts_begin;
    std::uint32_t n;
    /// The last of n ascending numbers that is not above x.
    GB_FN static std::uint32_t rank(const std::uint32_t* ascending, std::uint32_t n, std::uint32_t x) {
        std::uint32_t lo = 0;
        while (n > 1) {
            const std::uint32_t half = n / 2;
            if (ascending[lo + half] <= x) lo += half;
            n -= half;
        }
        return lo;
    }
    GB_FN std::uint32_t of_place(std::uint32_t v) const { return rank(places, n, v); }
    GB_FN std::uint32_t of_part(std::uint32_t part) const { return rank(parts_begin, n, part); }
};

/// Directions in cells of the sides of a cube.
struct DirectionCells {
    static constexpr int kAcross = 4, n = 6 * kAcross * kAcross;
    GB_FN static int cell(const float3& d) {
        const float ax = abs(d.x), ay = abs(d.y), az = abs(d.z), most = max(ax, max(ay, az));
        const int axis = ax == most ? 0 : ay == most ? 1 : 2;
        const float w = axis == 0   ? d.x
                        : axis == 1 ? d.y
                                    : d.z,
                    u = (axis == 0 ? d.y : d.x) / most, v = (axis == 2 ? d.y : d.z) / most;
        const auto at = [](float x) { return min(int((x + 1.0f) * (0.5f * kAcross)), kAcross - 1); };
        return ((2 * axis + (w < 0.0f)) * kAcross + at(u)) * kAcross + at(v);
    }
};

/// Each corner's triangle normal, and its angle; 0 and 0 where the triangle has none.
struct CornerNormals {
    const float* vertices;
    const std::uint32_t* faces;
    Quad* normals;
    GB_FN float3 vertex(std::size_t corner) const {
        const float* p = vertices + std::size_t(3) * faces[corner];
        return {p[0], p[1], p[2]};
    }
    GB_FN void operator()(std::size_t k) const {
        const std::size_t first = k - k % 3;
        const float3 p = vertex(k), a = normalize(vertex(first + (k + 1) % 3) - p),
                     b = normalize(vertex(first + (k + 2) % 3) - p);
        const float3 n = normalize(cross(a, b));
        normals[k] = {n.x, n.y, n.z, acosf(min(max(dot(a, b), -1.0f), 1.0f))};
    }
};

/// Sums of a part's normals by direction.
struct AddByDirection {
    const Quad* normals;
    CornersByPlace by_place;
    ManyCorners many;
    float3* sums;  ///< (parts, cells)
    GB_FN void operator()(std::size_t part) const {
        const std::uint32_t i = many.of_part(std::uint32_t(part)), v = many.places[i];
        const std::uint32_t first = by_place.begin[v] + (std::uint32_t(part) - many.parts_begin[i]) * kPart,
                            end = min(first + kPart, by_place.begin[v + 1]);
        float3* sum = sums + part * DirectionCells::n;
        for (int c = 0; c < DirectionCells::n; ++c) sum[c] = {0, 0, 0};
        for (std::uint32_t j = first; j < end; ++j) {
            const Quad n = normals[by_place.corners[j]];
            if (dot(n.xyz(), n.xyz()) > 0.0f)
                sum[DirectionCells::cell(n.xyz())] = sum[DirectionCells::cell(n.xyz())] + n.xyz() * n.w;
        }
    }
};
/// Those of all parts of a place into the first one's.
struct AddParts {
    ManyCorners many;
    float3* sums;
    GB_FN void operator()(std::size_t k) const {
        const std::size_t i = k / DirectionCells::n, c = k % DirectionCells::n;
        float3 sum{0, 0, 0};
        for (std::size_t part = many.parts_begin[i]; part < many.parts_begin[i + 1]; ++part)
            sum = sum + sums[part * DirectionCells::n + c];
        sums[many.parts_begin[i] * std::size_t(DirectionCells::n) + c] = sum;
    }
};

struct SmoothNormals {
    const Quad* normals;
    const std::uint32_t* place_of_corner;
    CornersByPlace by_place;
    ManyCorners many;
    const float3* sums;
    float cosine;
    float* out;
    GB_FN void operator()(std::size_t k) const {
        const float3 own = normals[k].xyz();
        float3 sum{0, 0, 0};
        const std::uint32_t v = place_of_corner[k];
        if (by_place.count(v) < kManyCorners) {
            for (std::uint32_t j = by_place.begin[v]; j < by_place.begin[v + 1]; ++j) {
                const Quad other = normals[by_place.corners[j]];
                if (dot(own, other.xyz()) >= cosine) sum = sum + other.xyz() * other.w;
            }
        } else {
            const float3* of = sums + many.parts_begin[many.of_place(v)] * std::size_t(DirectionCells::n);
            for (int c = 0; c < DirectionCells::n; ++c)
                if (dot(own, of[c]) >= cosine * length(of[c])) sum = sum + of[c];
        }
        const float3 normal = dot(sum, sum) > 0.0f ? normalize(sum) : own;
        out[3 * k] = normal.x;
        out[3 * k + 1] = normal.y;
        out[3 * k + 2] = normal.z;
    }
};

}  // namespace globule::core
