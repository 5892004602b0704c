// A hierarchy of boxes over items of any shape, and the triangles of a mesh.
#pragma once
#include "base/quad.hpp"
#include "base/vec.hpp"

namespace globule::core {

struct Box {
    float3 lo, hi;
    GB_FN static Box nothing() {
        const float inf = infinity();
        return {{inf, inf, inf}, {-inf, -inf, -inf}};
    }
    GB_FN Box united(const Box& b) const {
        return {{min(lo.x, b.lo.x), min(lo.y, b.lo.y), min(lo.z, b.lo.z)},
            {max(hi.x, b.hi.x), max(hi.y, b.hi.y), max(hi.z, b.hi.z)}};
    }
    GB_FN float3 middle() const {
        return {0.5f * lo.x + 0.5f * hi.x, 0.5f * lo.y + 0.5f * hi.y, 0.5f * lo.z + 0.5f * hi.z};
    }
    /// Half its surface.
    GB_FN float area() const {
        const float3 d = hi - lo;
        return d.x * d.y + d.y * d.z + d.z * d.x;
    }
    GB_FN float farthest() const {
        return max(max(max(abs(lo.x), abs(hi.x)), max(abs(lo.y), abs(hi.y))), max(abs(lo.z), abs(hi.z)));
    }
};

/// Up to four children side by side.  A child is an inner node's number, or leaf | (items - 1) << 29 | first item.
struct alignas(64) WideNode {
    static constexpr int width = 4;
    static constexpr std::uint32_t leaf = 1u << 31, none = 0xffffffffu;
    static constexpr std::uint32_t max_items = 1u << 29, most_of_leaf = 4;

    float lo[3][width], hi[3][width];
    std::uint32_t child[width];
    GB_FN static std::uint32_t leaf_of(std::uint32_t first, std::uint32_t n) { return leaf | (n - 1) << 29 | first; }
    GB_FN static std::uint32_t first_of(std::uint32_t child) { return child & (max_items - 1); }
    GB_FN static std::uint32_t count_of(std::uint32_t child) { return (child >> 29 & 3) + 1; }
};

/// What a build finds out; lives beside the tree, on the device.
struct BoxTreeHeader {
    Box box;     ///< of all items
    float near;  ///< rounding of positions nearby: rays that begin on a surface look so far back
};

/// Items in Morton order and the boxes around them.
struct BoxTree {
    const BoxTreeHeader* header;
    const WideNode* nodes;
    const std::uint32_t *first, *last;  ///< of each inner node's items
    const std::uint32_t* index;         ///< of each item, its place in the caller's arrays
};

/// Where a solid stands: world = R local + at, R's rows.
struct Pose {
    float3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1}, at{0, 0, 0};
    GB_FN float3 turned(const float3& v) const { return {dot(x, v), dot(y, v), dot(z, v)}; }
    GB_FN float3 turned_back(const float3& v) const { return x * v.x + y * v.y + z * v.z; }
    GB_FN float3 to_local(const float3& p) const { return turned_back(p - at); }
};

}  // namespace globule::core
