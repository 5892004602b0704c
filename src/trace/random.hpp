// Numbers for sampling: the additive recurrence of the plastic number (R2, Roberts 2018), its order shuffled
// and its start shifted by a hash of pixel and stream, so that any power of two of a pixel's samples is well
// spread, streams are independent of one another, and every backend gets the same.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

GB_FN std::uint32_t hash(std::uint32_t v) {  // PCG output function, O'Neill 2014
    v = v * 747796405u + 2891336453u;
    v = ((v >> ((v >> 28) + 4)) ^ v) * 277803737u;
    return (v >> 22) ^ v;
}

struct Pair {
    float u, v;  ///< in [0, 1)
};

/// Nested uniform scramble of an index (Laine & Karras 2011, Burley 2020): runs of 2^m samples stay such runs.
GB_FN std::uint32_t reversed(std::uint32_t v) {
    v = (v >> 1 & 0x55555555u) | (v & 0x55555555u) << 1;
    v = (v >> 2 & 0x33333333u) | (v & 0x33333333u) << 2;
    v = (v >> 4 & 0x0f0f0f0fu) | (v & 0x0f0f0f0fu) << 4;
    v = (v >> 8 & 0x00ff00ffu) | (v & 0x00ff00ffu) << 8;
    return v >> 16 | v << 16;
}
GB_FN std::uint32_t shuffled(std::uint32_t k, std::uint32_t seed) {
    k = reversed(k) + seed;
    k ^= k * 0x6c50b47cu;
    k ^= k * 0xb82f1e52u;
    k ^= k * 0xc7afe638u;
    k ^= k * 0x8d22f6e6u;
    return reversed(k);
}

/// Sample k of a pixel's stream.
GB_FN Pair sample(std::uint32_t pixel, std::uint32_t stream, std::uint32_t k) {
    const std::uint32_t a = hash(pixel ^ hash(stream)), b = hash(a);
    k = shuffled(k, hash(b));
    // 2^32 / 1.3247179… and its square: exact wrap-around in integers.
    return {float((a + k * 3242174889u) >> 8) * 0x1p-24f, float((b + k * 2447445414u) >> 8) * 0x1p-24f};
}

/// The same moved around the unit square's edges, by one of four well spread moves: pixels that lie `kDither` apart
/// have the same, neighbors unlike ones (Keller & Heidrich 2001; the pattern of Bayer 1973).
inline constexpr std::uint32_t kDither = 2;
GB_FN Pair dithered(const Pair& at, std::uint32_t x, std::uint32_t y) {
    const std::uint32_t e = x ^ y;
    const auto wrapped = [](float v) { return v < 1.0f ? v : v - 1.0f; };
    return {
        wrapped(at.u + float((e & 1) << 1 | (y & 1)) * 0.25f), wrapped(at.v + float((y & 1) << 1 | (e & 1)) * 0.25f)};
}

/// Two unit vectors that with n make a right-handed set of axes.  Duff et al. 2017
GB_FN void tangents(const float3& n, float3& s, float3& t) {
    const float sign = n.z >= 0.0f ? 1.0f : -1.0f, a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    s = {1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x};
    t = {b, sign + n.y * n.y * a, -n.y};
}

/// Direction about n, density cosine / pi.
GB_FN float3 cosine_direction(const float3& n, const Pair& at) {
    float3 s, t;
    tangents(n, s, t);
    const float r = sqrt(at.u), angle = 6.2831853f * at.v;
    return normalize(s * (r * cosf(angle)) + t * (r * sinf(angle)) + n * sqrt(max(1.0f - at.u, 0.0f)));
}

/// Point of the unit disc.
GB_FN Pair disc(const Pair& at) {
    const float r = sqrt(at.u), angle = 6.2831853f * at.v;
    return {r * cosf(angle), r * sinf(angle)};
}

}  // namespace globule::core
