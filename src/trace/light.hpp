// Lights, and what of their light a surface sends on.
#pragma once
#include "base/vec.hpp"

namespace globule::core {

inline constexpr int kMaxLights = 8;
inline constexpr float kWetSpecular = 1.0f,
                       kWetShininess = 250.0f;  ///< highlight of what is wet, where dry matter has one
enum class LightKind : int { head, directional, point };

struct Light {
    LightKind kind;
    float3 place;  ///< directional: towards the light; point: position
    float3 radiance;
    float size;  ///< directional: tangent of the sun's angular radius; point: radius; 0: hard shadows
};

GB_FN float3 operator*(const float3& a, const float3& b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
GB_FN float largest(const float3& v) { return max(max(v.x, v.y), v.z); }

/// Lambert and Blinn-Phong towards l; 0 from behind.
GB_FN float3 reflected_light(const float3& albedo, float specular, float shininess, const float3& n, const float3& d,
    const float3& l, const float3& radiance) {
    const float cosine = dot(n, l);
    if (cosine <= 0.0f) return {0, 0, 0};
    const float shine = specular * pow(dot(n, normalize(l - d)), shininess);
    return radiance * (albedo * cosine + float3{shine, shine, shine});
}

/// Tone curve: linear up to 0.8, then a shoulder that never clips hard.
GB_FN float shoulder(float v) { return v > 0.8f ? 0.8f + 0.2f * (1.0f - 1.0f / (1.0f + (v - 0.8f) * 5.0f)) : v; }
/// sRGB transfer.
GB_FN std::uint8_t display(float v) {
    v = v <= 0.0031308f ? 12.92f * max(v, 0.0f) : 1.055f * pow(v, 1.0f / 2.4f) - 0.055f;
    return std::uint8_t(min(v, 1.0f) * 255.0f + 0.5f);
}

}  // namespace globule::core
