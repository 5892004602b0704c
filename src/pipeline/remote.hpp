// A layer of a picture whose particles lie elsewhere: its rays go to the host, which knows who answers
// (docs/design/pieces.md).
#pragma once
#include <vector>

#include "backends/backend.hpp"
#include "exec/buffer.hpp"
#include "exec/interrupt.hpp"
#include "trace/segment.hpp"

namespace globule::core {

/// The same three questions as to Traced.
template <class Exec> class RemoteScene {
public:
    explicit RemoteScene(Exec& exec) : floats_(exec), looks_(exec), sides_(exec), places_(exec) {}

    void ask(const Remote& who) { who_ = who; }

    void march(Exec& exec, const WaveRays& rays, int layer, LayerHits& found) {
        const std::size_t n = rays.source.n;
        float* ray = floats_.reserve(6 * n);
        std::int8_t* side = sides_.reserve(n);
        exec.for_each(n, ListRays{rays, layer, ray, side});
        download(exec, ray, 6 * n, side, n);
        std::vector<std::size_t> kept;
        for (std::size_t i = 0; i < n; ++i)
            if (host_sides_[i] != kNoRay) kept.push_back(i);
        const std::size_t m = kept.size();
        pack(kept, 6);
        t_.resize(m);
        cap_.resize(m);
        sent_looks_.resize(8 * m);
        const RemoteRays asked{m, packed_.data(), nullptr, packed_sides_.data()};
        if (!who_.march(who_.who, asked, {t_.data(), packed_sides_.data(), cap_.data(), sent_looks_.data()}))
            throw Cancelled{};
        // Back to where the rays are; those that have none meet nothing.
        host_floats_.assign(n, infinity());
        host_caps_.assign(n, -1);
        host_looks_.assign(8 * n, 0.0f);
        std::fill(host_sides_.begin(), host_sides_.end(), std::int8_t(1));
        for (std::size_t k = 0; k < m; ++k) {
            host_floats_[kept[k]] = t_[k];
            host_caps_[kept[k]] = cap_[k];
            host_sides_[kept[k]] = packed_sides_[k];
            std::copy_n(&sent_looks_[8 * k], 8, &host_looks_[8 * kept[k]]);
        }
        exec.upload(found.t, host_floats_.data(), n * sizeof(float));
        exec.upload(found.cap, host_caps_.data(), n * sizeof(std::int32_t));
        exec.upload(found.sign, host_sides_.data(), n);
        exec.upload(looks_.reserve(8 * n), host_looks_.data(), 8 * n * sizeof(float));
    }
    void keep(
        Exec& exec, const Clips& clips, const WaveRays& rays, int layer, const LayerHits& found, const WaveHits& hits) {
        exec.for_each_uneven(
            rays.source.n_items(), Keep<RemoteSurface>{{looks_.data()}, clips, rays, layer, found, hits});
        exec.synchronize();  // another band of the picture uses the same room
    }
    void occlude(Exec& exec, const Lighting& lighting, const WaveRays& rays, const WaveHits& hits, int layer,
        float* visibility) {
        const std::size_t items = rays.source.n_items(), all = items * lighting.n_visibilities();
        const std::size_t most = max<std::size_t>(1, kAtOnce / max<std::size_t>(items, 1)) * items;
        for (std::size_t first = 0; first < all; first += most) {
            const std::size_t n = min(most, all - first);
            float* ray = floats_.reserve(7 * n);
            std::int8_t* side = sides_.reserve(n);
            std::uint32_t* place = places_.reserve(n);
            exec.for_each(n, ListShadowRays{lighting, rays, hits, layer, visibility, first, ray, side, place});
            download(exec, ray, 7 * n, side, n);
            host_places_.resize(n);
            exec.download(host_places_.data(), place, n * sizeof(std::uint32_t));
            std::vector<std::size_t> kept;
            for (std::size_t k = 0; k < n; ++k)
                if (host_floats_[7 * k + 6] >= 0.0f) kept.push_back(k);
            const std::size_t m = kept.size();
            pack(kept, 7);
            for (std::size_t k = 0; k < m; ++k) host_places_[k] = host_places_[kept[k]];
            t_.assign(m, 1.0f);
            const RemoteRays asked{m, packed_.data(), distance_.data(), packed_sides_.data()};
            if (!who_.occlude(who_.who, asked, t_.data())) throw Cancelled{};
            exec.upload(place, host_places_.data(), m * sizeof(std::uint32_t));
            exec.upload(ray, t_.data(), m * sizeof(float));
            exec.for_each(m, Dim{visibility, place, ray});
            exec.synchronize();
        }
    }

private:
    static constexpr std::size_t kAtOnce = 1 << 22;  ///< shadow rays in host memory

    void download(Exec& exec, const float* ray, std::size_t n_floats, const std::int8_t* side, std::size_t n) {
        host_floats_.resize(n_floats);
        host_sides_.resize(n);
        exec.download(host_floats_.data(), ray, n_floats * sizeof(float));
        exec.download(host_sides_.data(), side, n);
    }
    /// The rays that there are, and of seven floats the last by itself.
    void pack(const std::vector<std::size_t>& kept, std::size_t width) {
        packed_.resize(6 * kept.size());
        packed_sides_.resize(kept.size());
        distance_.resize(width > 6 ? kept.size() : 0);
        for (std::size_t k = 0; k < kept.size(); ++k) {
            const float* from = &host_floats_[width * kept[k]];
            std::copy_n(from, 6, &packed_[6 * k]);
            packed_sides_[k] = host_sides_[kept[k]];
            if (width > 6) distance_[k] = from[6];
        }
    }

    Remote who_{};
    Buffer<float, Exec> floats_, looks_;
    Buffer<std::int8_t, Exec> sides_;
    Buffer<std::uint32_t, Exec> places_;
    std::vector<float> host_floats_, host_looks_, packed_, sent_looks_, t_, distance_;
    std::vector<std::int8_t> host_sides_, packed_sides_;
    std::vector<std::int32_t> host_caps_, cap_;
    std::vector<std::uint32_t> host_places_;
};

}  // namespace globule::core
