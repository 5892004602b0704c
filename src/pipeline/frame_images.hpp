// The memory of one frame's images.
#pragma once
#include <vector>

#include "backends/backend.hpp"
#include "exec/buffer.hpp"
#include "trace/camera.hpp"
#include "trace/shade.hpp"

namespace globule::core {

/// The images of one frame, and when it was made.
template <class Exec> struct FrameImages {
    Buffer<float, Exec> block;  ///< per pixel: depth, normal, albedo, color, then bytes: picture, layer
    Buffer<float, Exec> sums;   ///< over passes: light, and as displayed
    typename Exec::Timer timer;
    RaySource rays{};
    int n_passes = 0;
    bool plain = false;                 ///< made in one go, without sums
    bool has_edges = false;             ///< some pixels have more samples than n_passes
    std::vector<std::uint64_t> states;  ///< of the layers' scenes, each another number after it has changed

    explicit FrameImages(Exec& exec) : block(exec), sums(exec), undecided_(exec) {}

    void resize(const RaySource& source) {
        rays = source;
        block.reserve(11 * rays.n);
        undecided(rays.n);
    }
    /// Room for the list of as many rays.
    UndecidedRays undecided(std::size_t n_rays) {
        std::uint32_t* p = undecided_.reserve(n_rays + 1);
        return {p, p + 1};
    }
    Hits hits() const {
        return {
            block.data(), block.data() + rays.n, block.data() + 4 * rays.n, {undecided_.data(), undecided_.data() + 1}};
    }
    float* color() const { return block.data() + 7 * rays.n; }
    std::uint8_t* picture() const { return reinterpret_cast<std::uint8_t*>(block.data() + 10 * rays.n); }
    std::uint8_t* layer() const { return picture() + 3 * rays.n; }
    /// Pixels with more samples.  A plain frame has no layers; the sums of others leave room.
    std::uint8_t* edge() const { return plain ? layer() : reinterpret_cast<std::uint8_t*>(sums.data() + 6 * rays.n); }
    static std::size_t floats_of_sums(std::size_t n) { return 6 * n + ceil_div<std::size_t>(n, sizeof(float)); }

private:
    Buffer<std::uint32_t, Exec> undecided_;  ///< their number, then the rays that float64 finishes
};

}  // namespace globule::core
