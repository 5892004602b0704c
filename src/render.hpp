// Pictures: waves of rays through the layers of one picture, pass after pass.
#pragma once
#include "backend.hpp"
#include "globule/exec/buffer.hpp"
#include "globule/trace/resolve.hpp"
#include "globule/trace/wave.hpp"

namespace globule {

/// Buffers of the rays in flight.  They grow to the largest wave and stay.
template <class Exec>
class Waves {
public:
    explicit Waves(Exec& exec)
        : exec_(exec), sides_{Side(exec), Side(exec)}, hits_(exec), first_(exec), layer_(exec), found_(exec), cap_(exec), sign_(exec),
          visibility_(exec), n_children_(exec), sum_(exec) {}

    /// One pass over rows [first_row, first_row + rows) of the camera's picture.  march(rays, layer, found):
    /// distances; keep(rays, layer, found, hits): what is nearest; occlude(rays, hits, layer, visibility).
    template <class March, class Keep, class Occlude>
    WaveHits run(const Lighting& lighting, const CameraRays& camera, std::uint32_t first_row, std::uint32_t rows,
                 std::uint32_t pass, int n_layers, float* first_t, float* first_normal, float* first_albedo,
                 const March& march, const Keep& keep, const Occlude& occlude) {
        const std::size_t n_pixels = std::size_t(rows) * camera.width;
        std::uint64_t* sum = sum_.reserve(3 * n_pixels);
        exec_.clear(sum, 3 * n_pixels * sizeof(std::uint64_t));
        Side* side = &sides_[0];
        Side* other = &sides_[1];
        WaveRays rays{{camera, nullptr, nullptr, n_pixels, first_row, pass}, nullptr, nullptr, side->ids.reserve(2 * n_pixels)};
        const std::uint32_t first_pixel = first_row * std::uint32_t(camera.width);
        WaveHits primary{};
        for (int generation = 0;; ++generation) {
            const std::size_t n = rays.source.n, items = rays.source.n_items();
            WaveHits hits;
            if (generation == 0) {
                // The first wave's hits are kept: they are the picture's depth, normals and colours.
                std::uint32_t* layer = layer_.reserve(n);
                float* more = first_.reserve(2 * n);
                primary = hits = {first_t, first_normal, first_albedo, more, more + n, layer};
            } else {
                float* block = hits_.reserve(10 * n);
                hits = {block, block + n, block + 4 * n, block + 7 * n, block + 8 * n, reinterpret_cast<std::uint32_t*>(block + 9 * n)};
            }
            const LayerHits found{found_.reserve(n), cap_.reserve(n), sign_.reserve(n)};
            for (int layer = 0; layer < n_layers; ++layer) {
                LayerHits of_layer = found;
                march(rays, layer, of_layer);
                keep(rays, layer, of_layer, hits);
            }
            if (lighting.ground.present) exec_.for_each(n, MeetGround{lighting.ground, lighting.scale, rays, hits});
            const int n_visibilities = lighting.n_visibilities();
            float* visibility = n_visibilities ? visibility_.reserve(n_visibilities * n) : nullptr;
            for (int layer = 0; n_visibilities && layer < n_layers; ++layer) occlude(rays, hits, layer, visibility);
            std::uint32_t* place = n_children_.reserve(2 * items + 1);
            exec_.clear(place + 2 * items, sizeof *place);
            exec_.for_each(items, Lit{lighting, rays, hits, visibility, generation, sum, first_pixel, place});
            if (generation >= lighting.depth || exec_.cancelled()) break;
            exec_.exclusive_scan(2 * items + 1, place);
            std::uint32_t total;
            exec_.download(&total, place + 2 * items, sizeof total);
            if (total == 0) break;
            const std::size_t m = total;
            float* block = other->floats.reserve(9 * m);
            std::uint32_t* ids = other->ids.reserve(2 * m);
            const WaveRays next{{camera, block, block + 3 * m, m, first_row, pass}, block + 6 * m, ids + m, ids};
            exec_.for_each(items, Spawn{lighting, rays, hits, generation, place, next, block, block + 3 * m});
            rays = next;
            std::swap(side, other);
        }
        return primary;
    }
    const std::uint64_t* sum() const { return sum_.data(); }

private:
    struct Side {
        Buffer<float, Exec> floats;
        Buffer<std::uint32_t, Exec> ids;
        explicit Side(Exec& exec) : floats(exec), ids(exec) {}
    };
    Exec& exec_;
    Side sides_[2];
    Buffer<float, Exec> hits_, first_;
    Buffer<std::uint32_t, Exec> layer_;
    Buffer<float, Exec> found_;
    Buffer<std::int32_t, Exec> cap_;
    Buffer<std::int8_t, Exec> sign_;
    Buffer<float, Exec> visibility_;
    Buffer<std::uint32_t, Exec> n_children_;
    Buffer<std::uint64_t, Exec> sum_;
};

}  // namespace globule
