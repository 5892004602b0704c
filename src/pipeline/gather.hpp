// One frame of those that several ranks of a host have made of the same image, on the device of one of them: of each
// pixel the nearest, or that of the rank to which it is dealt.
#pragma once
#include <vector>

#include "pipeline/frame_images.hpp"

namespace globule::core {

/// The images of a frame that are asked for, one after the other in lent memory.
struct LentImages {
    struct Part {
        Image image;
        std::uint8_t* own;
        std::size_t bytes, at;  ///< a pixel's; where the image begins
    };
    static constexpr int kMost = 6;
    Part parts[kMost];
    int n_parts = 0;
    std::size_t bytes = 0;

    /// images: 1 << Image for each; a frame's position comes from its depth.
    template <class Exec> LentImages(const FrameImages<Exec>& frame, unsigned images) {
        const auto add = [&](Image image, void* own, std::size_t pixel) {
            if (!(images >> int(image) & 1)) return;
            parts[n_parts++] = {image, static_cast<std::uint8_t*>(own), pixel, bytes};
            bytes += pixel * frame.rays.n;
        };
        const Hits hits = frame.hits();
        add(Image::depth, hits.t, 4);
        add(Image::normal, hits.normal, 12);
        add(Image::albedo, hits.albedo, 12);
        add(Image::color, frame.color(), 12);
        add(Image::picture, frame.picture(), 3);
        if (!frame.plain) add(Image::layer, frame.layer(), 1);
    }
};

/// others[k] is what rank k lends; rank 0's own frame becomes the whole one.
struct TakePixels {
    static constexpr int kMostRanks = 16;
    const char* others[kMostRanks];
    int n_ranks;
    bool nearest;  ///< else as dealt
    Share dealt;
    int width;
    const float* t;
    LentImages images;

    GB_FN void operator()(std::size_t i) const {
        int from = 0;
        if (nearest) {
            float best = t[i];
            for (int k = 1; k < n_ranks; ++k) {  // depth is the first image
                const float other = reinterpret_cast<const float*>(others[k])[i];
                if (other < best) best = other, from = k;
            }
        } else {
            from = dealt.owner(int(i % std::size_t(width)), int(i / std::size_t(width)));
        }
        if (from == 0) return;
        for (int p = 0; p < images.n_parts; ++p) {
            const LentImages::Part& part = images.parts[p];
            const char* source = others[from] + part.at + i * part.bytes;
            std::uint8_t* to = part.own + i * part.bytes;
            if (part.bytes % 4 == 0)
                for (std::size_t b = 0; b < part.bytes; b += 4)
                    *reinterpret_cast<float*>(to + b) = *reinterpret_cast<const float*>(source + b);
            else
                for (std::size_t b = 0; b < part.bytes; ++b) to[b] = std::uint8_t(source[b]);
        }
    }
};

/// For the frames of one scene.
template <class Exec> class FrameGatherer {
public:
    /// The images of a finished frame where others find them, until the next are lent.
    LentPlace lend(Exec& exec, const FrameImages<Exec>& frame, unsigned images) {
        const LentImages lent(frame, images);
        char* to = lent_.reserve(lent.bytes, exec.device());
        for (int p = 0; p < lent.n_parts; ++p)
            exec.copy(to + lent.parts[p].at, lent.parts[p].own, lent.parts[p].bytes * frame.rays.n);
        exec.synchronize();
        return lent_.place();
    }
    /// False: this device does not reach them all, and nothing was done.
    bool take(Exec& exec, const FrameImages<Exec>& frame, unsigned images, const std::vector<LentPlace>& places,
        const Share* dealt) {
        if (places.size() > TakePixels::kMostRanks) return false;
        TakePixels pixels{{}, int(places.size()), !dealt, dealt ? *dealt : Share{}, frame.rays.camera.width,
            frame.hits().t, LentImages(frame, images)};
        for (std::size_t k = 1; k < places.size(); ++k)
            if (!(pixels.others[k] = borrowed_.reach(k, places[k], exec.device()))) return false;
        exec.for_each(frame.rays.n, pixels);
        exec.synchronize();  // what is lent may be written again
        return true;
    }

private:
    typename Exec::Lent lent_;
    typename Exec::Borrowed borrowed_;
};

}  // namespace globule::core
