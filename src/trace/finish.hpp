// From radiance to picture.
#pragma once
#include "trace/wave_rays.hpp"

namespace globule::core {

/// One pass more into the picture.
struct Finish {
    const std::uint64_t* sum;    ///< (n, 3) of this pass, of the pixels from `first` on
    const std::uint32_t* layer;  ///< (n,) what the pass's primary rays met
    const std::uint32_t*
        place_of;  ///< (n,) a pixel's first ray, of packed rays, which are several passes'; null: its own place
    int n_passes;  ///< of packed rays
    const std::uint8_t* only;  ///< (n,) pixels that the pass had; null: all
    std::size_t first;
    float exposure;
    int passes;            ///< with these
    float *total, *shown;  ///< (all pixels, 3) sums over passes, as light and as displayed
    float* color;
    std::uint8_t* picture;
    std::uint8_t* seen;  ///< (all pixels,) what the first pass met: kMissed, kGround, or the layer
    GB_FN void operator()(std::size_t i) const {
        if (only && !only[i]) return;
        if (passes == 1) seen[first + i] = std::uint8_t(layer[i]);
        const std::size_t begin = place_of ? place_of[i] : i, end = begin + (place_of ? n_passes : 1);
        for (int k = 0; k < 3; ++k) {
            const std::size_t at = 3 * (first + i) + k;
            for (std::size_t ray = begin; ray < end; ++ray) {
                const float c = float(double(sum[3 * ray + k]) * (1.0 / 4294967296.0));
                const float s = layer[ray] != kMissed ? shoulder(c * exposure) : c;  // background as it is given
                total[at] = passes > 1 ? total[at] + c : c;
                shown[at] = passes > 1 ? shown[at] + s : s;
            }
            color[at] = total[at] / float(passes);
            picture[at] = display(shown[at] / float(passes));
        }
    }
};

}  // namespace globule::core
