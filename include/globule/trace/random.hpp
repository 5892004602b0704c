// Numbers for sampling: the additive recurrence of the plastic number, shifted by a hash of the pixel,
// so that any prefix of a pixel's samples is well spread, and the same on every backend.
#pragma once
#include "globule/base/vec.hpp"

namespace globule {

GB_FN std::uint32_t hash(std::uint32_t v) {  // PCG output function, O'Neill 2014
    v = v * 747796405u + 2891336453u;
    v = ((v >> ((v >> 28) + 4)) ^ v) * 277803737u;
    return (v >> 22) ^ v;
}

struct Pair {
    float u, v;  ///< in [0, 1)
};

/// Sample k of a pixel's stream.
GB_FN Pair sample(std::uint32_t pixel, std::uint32_t stream, std::uint32_t k) {
    const std::uint32_t a = hash(pixel ^ hash(stream)), b = hash(a);
    // 2^32 / 1.3247179… and its square: exact wrap-around in integers.
    return {float((a + k * 3242174889u) >> 8) * 0x1p-24f, float((b + k * 2447445414u) >> 8) * 0x1p-24f};
}

/// Two unit vectors that make a right-handed frame with n.  Duff et al. 2017
GB_FN void frame_of(const float3& n, float3& s, float3& t) {
    const float sign = n.z >= 0.0f ? 1.0f : -1.0f, a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    s = {1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x};
    t = {b, sign + n.y * n.y * a, -n.y};
}

/// Direction about n, density cosine / pi.
GB_FN float3 cosine_direction(const float3& n, const Pair& at) {
    float3 s, t;
    frame_of(n, s, t);
    const float r = root(at.u), angle = 6.2831853f * at.v;
    return normalize(s * (r * cosf(angle)) + t * (r * sinf(angle)) + n * root(most(1.0f - at.u, 0.0f)));
}

/// Point of the unit disc.
GB_FN Pair disc(const Pair& at) {
    const float r = root(at.u), angle = 6.2831853f * at.v;
    return {r * cosf(angle), r * sinf(angle)};
}

}  // namespace globule
