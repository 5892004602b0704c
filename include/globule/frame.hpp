// A finished image.
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "globule/array.hpp"
#include "globule/version.hpp"

namespace globule {

/// A finished image, in its device's memory until it is read.  It never changes: any thread may read it at any time,
/// also while its scene is updated or rendered.  Copies share the image.
///
/// The methods without an argument return host arrays, row 0 at the top, pixels row after row.  Those with an argument
/// copy into the caller's array, which is host memory, or memory of the same GPU: then the copy comes after what the
/// array's stream was given before the call, and the stream goes on after it.
///
/// They throw Error: invalid where the array has another shape or type or lies on another device, or the handle is
/// empty.
class GLOBULE_API Frame {
public:
    /// An empty handle.
    Frame() noexcept = default;
    explicit operator bool() const noexcept { return impl_ != nullptr; }

    int width() const;
    int height() const;
    /// Rays per pixel so far.
    int samples() const;
    /// Device time from the first ray to the shaded image, seconds; waits for the image.
    double trace_seconds() const;
    /// "cpu" or "cuda:N".
    const std::string& device() const;

    std::vector<float> color() const;         ///< (H, W, 3) linear
    std::vector<std::uint8_t> image() const;  ///< (H, W, 3) sRGB
    std::vector<float> distance() const;      ///< (H, W) along the ray, world; infinite where missed
    std::vector<float> normal() const;        ///< (H, W, 3) world, out of the medium; 0 where missed
    std::vector<float> position() const;      ///< (H, W, 3) world; NaN where missed
    std::vector<float> albedo() const;        ///< (H, W, 3) blended color of the surface
    std::vector<std::uint8_t> mask() const;   ///< (H, W) 1 where something was hit, else 0
    std::vector<std::uint8_t> layer()
        const;  ///< (H, W) number of the layer that was hit; larger: the ground, or nothing

    void color(const MutableArrayView& out) const;     ///< (H, W, 3) float32
    void image(const MutableArrayView& out) const;     ///< (H, W, 3) uint8
    void distance(const MutableArrayView& out) const;  ///< (H, W) float32
    void normal(const MutableArrayView& out) const;    ///< (H, W, 3) float32
    void position(const MutableArrayView& out) const;  ///< (H, W, 3) float32
    void albedo(const MutableArrayView& out) const;    ///< (H, W, 3) float32
    void mask(const MutableArrayView& out) const;      ///< (H, W) uint8, host memory only
    void layer(const MutableArrayView& out) const;     ///< (H, W) uint8

    /// A new frame with more samples per pixel: edges, soft shadows and rough reflections get smooth.  Distances,
    /// normals and positions stay those of the pixels' centers.  Throws Error: invalid if a scene has changed since it
    /// was rendered.
    Frame refine(int samples = 1) const;

private:
    friend struct Inside;
    struct Impl;
    std::shared_ptr<const Impl> impl_;
};

}  // namespace globule
