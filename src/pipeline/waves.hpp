// Pictures: waves of rays through the layers of one picture, pass after pass.
#pragma once
#include "backends/backend.hpp"
#include "exec/buffer.hpp"
#include "trace/resolve.hpp"
#include "trace/packed.hpp"
#include "trace/wave.hpp"

namespace globule::core {

/// One band of rows and its buffers, which grow to the largest wave and stay.  start, then trace and go_on
/// by turns; between the two the host may turn to another band, on a stream of its own.
template <class Exec> class Waves {
public:
    explicit Waves(std::shared_ptr<Exec> exec)
        : exec_(std::move(exec)),
          sides_{Side(*exec_), Side(*exec_)},
          hits_(*exec_),
          first_(*exec_),
          layer_(*exec_),
          found_(*exec_),
          cap_(*exec_),
          sign_(*exec_),
          item_(*exec_),
          visibility_(*exec_),
          n_children_(*exec_),
          sum_(*exec_),
          undecided_(*exec_),
          tile_floats_(*exec_),
          packed_(*exec_),
          wanted_(*exec_),
          is_there_(*exec_) {}

    Exec& exec() { return *exec_; }

    /// One pass over rows [first_row, first_row + rows) of the camera's picture, or of those pixels that `only` names;
    /// the first hits go to `first`.  packed: so many passes over those pixels, packed.
    void start(const CameraRays& camera, std::uint32_t first_row, std::uint32_t rows, std::uint32_t pass,
        const std::uint8_t* only, std::uint32_t packed, const Hits& first) {
        const std::size_t n_pixels = std::size_t(rows) * camera.width;
        std::uint64_t* sum = sum_.reserve(3 * n_pixels);
        exec_->clear(sum, 3 * n_pixels * sizeof(std::uint64_t));
        side_ = &sides_[0];
        other_ = &sides_[1];
        rays_ = {{camera, nullptr, nullptr, n_pixels, first_row, pass, only}, nullptr, nullptr,
            side_->ids.reserve(2 * n_pixels)};
        rays_.source.dithered = !only;
        std::uint32_t* layer = layer_.reserve(n_pixels);
        float* more = first_.reserve(3 * n_pixels);
        hits_now_ =
            first_hits_ = {first.t, first.normal, first.albedo, more, more + n_pixels, more + 2 * n_pixels, layer};
        generation_ = 0;
        place_of_ = nullptr;
        if (packed) pack(packed);
    }

    /// The present generation.  march(exec, rays, layer, found): distances; keep(exec, rays, layer, found, hits):
    /// what is nearest; occlude(exec, rays, hits, layer, visibility).  margin: of pixels around a share's own.
    template <class March, class Keep, class Occlude>
    void trace(const Lighting& lighting, int n_layers, int margin, const March& march, const Keep& keep,
        const Occlude& occlude) {
        const std::size_t n = rays_.source.n, items = rays_.source.n_items();
        std::uint32_t* undecided = undecided_.reserve(n + 1);
        const LayerHits found{
            found_.reserve(n), cap_.reserve(n), sign_.reserve(n), item_.reserve(n), {undecided, undecided + 1}};
        for (int layer = 0; layer < n_layers; ++layer) {
            LayerHits of_layer = found;
            march(*exec_, rays_, layer, of_layer);
            keep(*exec_, rays_, layer, of_layer, hits_now_);
        }
        if (lighting.ground.present) exec_->for_each(n, MeetGround{lighting.ground, rays_, hits_now_, margin});
        const int n_visibilities = lighting.n_visibilities();
        float* visibility = n_visibilities ? visibility_.reserve(n_visibilities * n) : nullptr;
        for (int layer = 0; n_visibilities && layer < n_layers; ++layer)
            occlude(*exec_, rays_, hits_now_, layer, visibility);
        std::uint32_t* place = n_children_.reserve(2 * items + 1);
        exec_->clear(place + 2 * items, sizeof *place);
        const std::uint32_t first_pixel = rays_.source.first_row * std::uint32_t(rays_.source.camera.width);
        exec_->for_each(
            items, Lit{lighting, rays_, hits_now_, visibility, generation_, sum_.data(), first_pixel, place});
        if (generation_ < lighting.bounces) exec_->exclusive_scan(2 * items + 1, place);
    }

    /// To the next generation; false where there is none.
    bool go_on(const Lighting& lighting) {
        if (generation_ >= lighting.bounces) return false;
        const std::size_t items = rays_.source.n_items();
        std::uint32_t* place = n_children_.data();
        std::uint32_t total;
        exec_->download(&total, place + 2 * items, sizeof total);
        if (total == 0) return false;
        const std::size_t n = total;
        float* block = other_->floats.reserve(9 * n);
        std::uint32_t* ids = other_->ids.reserve(2 * n);
        const RaySource& now = rays_.source;
        WaveRays next{{now.camera, block, block + 3 * n, n, now.first_row, now.pass}, block + 6 * n, ids + n, ids};
        next.source.dithered = now.dithered;
        exec_->for_each(items, Spawn{lighting, rays_, hits_now_, generation_, place, next, block, block + 3 * n});
        rays_ = next;
        std::swap(side_, other_);
        float* hits = hits_.reserve(11 * n);
        hits_now_ = {hits, hits + n, hits + 4 * n, hits + 7 * n, hits + 8 * n, hits + 9 * n,
            reinterpret_cast<std::uint32_t*>(hits + 10 * n)};
        ++generation_;
        return true;
    }
    /// Room for what tiles see of a layer: as Hits, with the wave's own distances.
    Hits seen(const LayerHits& found) {
        const std::size_t n = rays_.source.n;
        float* room = tile_floats_.reserve(8 * n);
        return {found.t, room, room + 3 * n, found.undecided, found.sign, room + 6 * n};
    }
    /// Room for shadow rays, while the layer's hits are not needed any more: origins, directions, distances of the
    /// light, and where rays end.
    void shadow_room(float*& origin, float*& direction, float*& distance, Hits& hits, std::uint8_t*& wanted) {
        const std::size_t n = rays_.source.n;
        origin = tile_floats_.reserve(8 * n);
        direction = origin + 3 * n;
        distance = origin + 6 * n;
        std::uint32_t* undecided = undecided_.reserve(n + 1);
        hits = {origin + 7 * n, nullptr, nullptr, {undecided, undecided + 1}};
        wanted = wanted_.reserve(n);
    }
    const WaveHits& first_hits() const { return first_hits_; }
    const std::uint64_t* sum() const { return sum_.data(); }
    /// Where packed rays are, by pixel; null: at the pixels' own places.
    const std::uint32_t* place_of() const { return place_of_; }

private:
    /// The first wave's rays side by side.
    void pack(std::uint32_t samples) {
        RaySource& source = rays_.source;
        const RaySource pixels = source;
        constexpr std::uint32_t size = Exec::Group::width * Exec::Group::vectors;  // of a tile
        const std::size_t items = source.n_items(), blocks = items / RaySource::kBlock;
        std::uint32_t *place = n_children_.reserve(items + blocks + 2), *tile = place + items + 1, n_tiles = 0;
        exec_->for_each(items, CountMarked{pixels, place});
        exec_->clear(place + items, sizeof *place);
        exec_->exclusive_scan(items + 1, place);
        exec_->for_each(blocks, CountTiles{samples, size, place, tile});
        exec_->clear(tile + blocks, sizeof *tile);
        exec_->exclusive_scan(blocks + 1, tile);
        exec_->download(&n_tiles, tile + blocks, sizeof n_tiles);
        const std::size_t n = std::size_t(n_tiles) * size;
        float* room = side_->floats.reserve(6 * n + 1);  // never null, which would be the camera's rays
        std::uint32_t* numbers = packed_.reserve(n + pixels.n);
        std::uint8_t* is_there = is_there_.reserve(n + 1);
        exec_->clear(is_there, n);
        exec_->for_each(
            items, PackMarked{pixels, samples, size, place, tile, room, room + 3 * n, numbers, numbers + n, is_there});
        source.n = n;
        source.origins = room;
        source.directions = room + 3 * n;
        source.only = is_there;
        source.packed = samples;
        rays_.pixel = numbers;
        rays_.inside = side_->ids.reserve(2 * n);
        place_of_ = numbers + n;
        exec_->clear(sum_.reserve(3 * n), 3 * n * sizeof(std::uint64_t));
        float* hits = hits_.reserve(10 * n);  // nobody asks for these later
        hits_now_ =
            first_hits_ = {hits, hits + n, hits + 4 * n, hits + 7 * n, hits + 8 * n, hits + 9 * n, layer_.reserve(n)};
    }

    struct Side {
        Buffer<float, Exec> floats;
        Buffer<std::uint32_t, Exec> ids;
        explicit Side(Exec& exec) : floats(exec), ids(exec) {}
    };
    std::shared_ptr<Exec> exec_;
    Side sides_[2];
    Side *side_ = nullptr, *other_ = nullptr;
    WaveRays rays_{};
    WaveHits hits_now_{}, first_hits_{};
    int generation_ = 0;
    Buffer<float, Exec> hits_, first_;
    Buffer<std::uint32_t, Exec> layer_;
    Buffer<float, Exec> found_;
    Buffer<std::int32_t, Exec> cap_;
    Buffer<std::int8_t, Exec> sign_;
    Buffer<std::uint32_t, Exec> item_;
    Buffer<float, Exec> visibility_;
    Buffer<std::uint32_t, Exec> n_children_;
    Buffer<std::uint64_t, Exec> sum_;
    Buffer<std::uint32_t, Exec> undecided_;
    Buffer<float, Exec> tile_floats_;
    Buffer<std::uint32_t, Exec> packed_;
    Buffer<std::uint8_t, Exec> wanted_, is_there_;
    const std::uint32_t* place_of_ = nullptr;
};

}  // namespace globule::core
