// Frames in which light makes several turns: waves of rays (pipeline/waves.hpp) through all layers, band by band, pass
// after pass.
#pragma once
#include <deque>
#include <vector>

#include "base/on_failure.hpp"
#include "pipeline/frame_pool.hpp"
#include "pipeline/remote.hpp"
#include "pipeline/trace.hpp"
#include "pipeline/waves.hpp"
#include "trace/edges.hpp"

namespace globule::core {

/// One scene of the picture, ready to be traced.
template <class Exec> struct PictureLayer {
    Traced<Exec> scene;
    FieldRequest field;
    Clips clips;
    RemoteScene<Exec>* remote = nullptr;  ///< instead of the scene, where there is one
};

/// What pictures of one scene keep from frame to frame.
template <class Exec> class PictureMaker {
public:
    explicit PictureMaker(std::shared_ptr<Exec> exec) : exec_(std::move(exec)), sky_(*exec_), spare_(*exec_) {}

    /// The clips of layer k where rays can read them.
    Clips bring_clips(std::size_t k, const std::vector<Clip>& clips) {
        while (clips_.size() <= k) clips_.emplace_back(*exec_);
        Clip* room = clips_[k].reserve(clips.size() + 1);
        if (!clips.empty()) exec_->upload(room, clips.data(), clips.size() * sizeof(Clip));
        return {room, int(clips.size())};
    }
    /// The scene of layer k that others answer for.
    RemoteScene<Exec>* remote(std::size_t k, const Remote& who) {
        if (!who) return nullptr;
        while (remotes_.size() <= k) remotes_.emplace_back(*exec_);
        remotes_[k].ask(who);
        return &remotes_[k];
    }
    /// The sky's image, sent once.
    const float* bring_sky(const PictureRequest& request) {
        if (!request.sky_image) return nullptr;
        const std::size_t floats = std::size_t(request.lighting.sky.width) * request.lighting.sky.height * 3;
        if (request.sky_id != sky_id_) {
            sky_id_ = 0;
            exec_->upload(sky_.reserve(floats), request.sky_image, floats * sizeof(float));
            sky_id_ = request.sky_id;
        }
        return sky_.data();
    }

    /// by_tiles: light makes no turns but shadows, and nothing is cut (trace/seen.hpp); else layers have their cells.
    void add_passes(const std::vector<PictureLayer<Exec>>& layers, const Lighting& lighting, FrameImages<Exec>& frame,
        int passes, bool by_tiles) {
        const typename Exec::Stage stage("frame of waves");
        by_tiles_ = by_tiles;
        const std::size_t n = frame.rays.n;
        frame.sums.reserve(frame.floats_of_sums(n));
        // Some bands at once, so that one works while another's last rays are on their way.
        while (waves_.size() < Exec::n_streams) waves_.emplace_back(waves_.empty() ? exec_ : exec_->sibling());
        const OnFailure gathers(
            [&] { gather(); });  // a frame that was stopped lets its images go: nobody writes them any more then
        scatter();
        for (int p = 0; p < passes; ++p) {
            const int pass = frame.n_passes++;
            add_pass(layers, lighting, frame, pass, pass ? spare(n) : frame.hits(), nullptr);
        }
        gather();
        if (frame.n_passes == 1 && lighting.edge_samples > 0 && !layers[0].field.thesis)
            smooth_edges(layers, lighting, frame);
    }

private:
    /// More samples of the pixels at edges.
    void smooth_edges(
        const std::vector<PictureLayer<Exec>>& layers, const Lighting& lighting, FrameImages<Exec>& frame) {
        const typename Exec::Stage stage("edges");
        const std::size_t n = frame.rays.n;
        std::uint8_t* edge = frame.edge();
        const bool contrast = lighting.edge_contrast && lighting.ambient_rays == 0;  // their noise is everywhere
        exec_->for_each(
            n, MarkEdges{frame.rays, frame.hits(), frame.layer(), contrast ? frame.picture() : nullptr, edge});
        frame.has_edges = true;
        scatter();
        if (by_tiles_) add_pass(layers, lighting, frame, 1, spare(n), edge, lighting.edge_samples);
        for (int k = 1; !by_tiles_ && k <= lighting.edge_samples; ++k)
            add_pass(layers, lighting, frame, k, spare(n), edge);
        gather();
    }
    void scatter() {
        for (auto& waves : waves_)
            if (&waves.exec() != exec_.get()) waves.exec().follow(*exec_);
    }
    void gather() {
        for (auto& waves : waves_)
            if (&waves.exec() != exec_.get()) exec_->follow(waves.exec());
    }
    /// Later passes must not change depth and normals.
    Hits spare(std::size_t n) {
        float* room = spare_.reserve(7 * n);
        return {room, room + n, room + 4 * n, {}};
    }

    /// only: the pixels that have a ray; null: all.  packed: of so many passes at once, or 0.
    void add_pass(const std::vector<PictureLayer<Exec>>& layers, const Lighting& lighting, FrameImages<Exec>& frame,
        int pass, const Hits& first, const std::uint8_t* only, int packed = 0) {
        const CameraRays& camera = frame.rays.camera;
        const std::size_t n_streams = layers[0].field.thesis ? 1 : Exec::n_streams;
        const std::uint32_t height = std::uint32_t(camera.height), band = rows_of_band(camera, n_streams);
        const int n_layers = int(layers.size());
        const auto turn = [&](Waves<Exec>& waves) { trace(layers, lighting, waves, n_layers); };
        std::uint32_t next_row = 0;
        while (next_row < height) {
            std::vector<Band> bands;
            for (std::size_t k = 0; k < n_streams && next_row < height; ++k) {
                const std::uint32_t rows = min(band, height - next_row);
                const std::size_t at = std::size_t(next_row) * camera.width;
                waves_[k].start(camera, next_row, rows, std::uint32_t(pass), only ? only + at : nullptr,
                    std::uint32_t(packed), {first.t + at, first.normal + 3 * at, first.albedo + 3 * at, {}});
                turn(waves_[k]);
                bands.push_back({&waves_[k], at, std::size_t(rows) * camera.width});
                next_row += rows;
            }
            while (!bands.empty())
                std::erase_if(bands, [&](const Band& b) {
                    if (b.waves->go_on(lighting)) {
                        turn(*b.waves);
                        return false;
                    }
                    finish(b, lighting, frame, pass + std::max(packed, 1), only);
                    return true;
                });
        }
    }

    /// Rows whose waves are in memory at one time.
    struct Band {
        Waves<Exec>* waves;
        std::size_t at, n;  ///< pixels
    };
    /// So that the waves' memory does not grow with the picture; whole tiles high.
    static std::uint32_t rows_of_band(const CameraRays& camera, std::size_t n_streams) {
        constexpr std::size_t kRows = 16;
        const std::size_t most_rows = Exec::wave_size / n_streams / camera.width,
                          share = ceil_div<std::size_t>(camera.height, n_streams);
        return std::uint32_t(max(kRows, min(most_rows / kRows, ceil_div<std::size_t>(share, kRows)) * kRows));
    }

    void trace(const std::vector<PictureLayer<Exec>>& layers, const Lighting& lighting, Waves<Exec>& waves,
        int n_layers) const {
        const auto by_tiles = [&](int k) { return by_tiles_ && !layers[k].scene.mesh.is_there(); };
        waves.trace(
            lighting, n_layers, by_tiles_ ? Share::kTile : 1,
            [&](Exec& exec, const WaveRays& rays, int k, LayerHits& found) {
                if (by_tiles(k)) return layers[k].scene.see(exec, layers[k].field, rays.source, waves.seen(found));
                if (layers[k].remote) return layers[k].remote->march(exec, rays, k, found);
                layers[k].scene.march(exec, layers[k].field, layers[k].clips, rays, k, found, n_layers == 1);
            },
            [&](Exec& exec, const WaveRays& rays, int k, const LayerHits& found, const WaveHits& hits) {
                if (by_tiles(k))
                    return exec.for_each(
                        rays.source.n, KeepSeen{layers[k].scene.attributes(), rays, k, waves.seen(found), hits});
                if (layers[k].remote) return layers[k].remote->keep(exec, layers[k].clips, rays, k, found, hits);
                layers[k].scene.keep(exec, layers[k].field, layers[k].clips, rays, k, found, hits);
            },
            [&](Exec& exec, const WaveRays& rays, const WaveHits& hits, int k, float* visibility) {
                if (by_tiles(k)) return cast_shadows(exec, layers[k], lighting, waves, rays, hits, k, visibility);
                if (layers[k].remote) return layers[k].remote->occlude(exec, lighting, rays, hits, k, visibility);
                layers[k].scene.occlude(exec, layers[k].field, layers[k].clips, lighting, rays, hits, k, visibility);
            });
    }
    /// Of an opaque layer, light by light.
    static void cast_shadows(Exec& exec, const PictureLayer<Exec>& layer, const Lighting& lighting, Waves<Exec>& waves,
        const WaveRays& rays, const WaveHits& hits, int k, float* visibility) {
        const typename Exec::Stage stage("shadows");
        const std::size_t n = rays.source.n;
        float *origin, *direction, *distance;
        Hits ends;
        std::uint8_t* wanted;
        waves.shadow_room(origin, direction, distance, ends, wanted);
        RaySource source = rays.source;
        source.origins = origin;
        source.directions = direction;
        source.only = wanted;
        source.of_pixels = !source.packed;
        source.apart = source.of_pixels && lighting.has_size();
        for (int which = 0; which < lighting.n_visibilities(); ++which) {
            exec.for_each(
                n, AimShadows{lighting, rays, hits, k, which, visibility, origin, direction, distance, wanted});
            layer.scene.see_shadows(exec, layer.field, source, ends);
            exec.for_each(n, Darken{wanted, ends.t, distance, visibility + std::size_t(which) * n});
        }
    }
    void finish(
        const Band& b, const Lighting& lighting, FrameImages<Exec>& frame, int passes, const std::uint8_t* only) {
        const std::size_t n = frame.rays.n;
        float* sums = frame.sums.data();
        b.waves->exec().for_each(b.n, Finish{b.waves->sum(), b.waves->first_hits().layer, b.waves->place_of(),
                                          lighting.edge_samples, only ? only + b.at : nullptr, b.at, lighting.exposure,
                                          passes, sums, sums + 3 * n, frame.color(), frame.picture(), frame.layer()});
    }

    std::shared_ptr<Exec> exec_;
    bool by_tiles_ = false;
    std::deque<Waves<Exec>> waves_;  ///< one a stream
    std::deque<Buffer<Clip, Exec>> clips_;
    std::deque<RemoteScene<Exec>> remotes_;
    Buffer<float, Exec> sky_, spare_;
    std::uint64_t sky_id_ = 0;
};

}  // namespace globule::core
