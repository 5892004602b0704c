// What a compiled backend offers for volumes from tracked sweeps.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

namespace globule {

enum class ScalarType { u8, u16, f32 };

/// An array in host memory, or in the backend's device memory.
struct AnyArray {
    const void* data = nullptr;
    bool on_device = false;
};

/// A reconstruction as the PLUS toolkit does it; numbers of the enumerations as in sweep/plus_*.hpp.
struct PlusRequest {
    AnyArray frames;                         ///< (n_frames, height, width)
    ScalarType type;
    int n_frames, height, width;
    const double* voxel_from_image;          ///< (n_frames, 3, 4): columns x, y, normal (unused), origin
    const std::int32_t* sources;             ///< (n_masks, height, width)
    int n_masks;
    const std::uint32_t* mask_of_frame;      ///< (n_frames,)
    const std::uint8_t* importance;          ///< (height, width) or null
    int size[3];                             ///< voxels along x, y, z
    int interpolation, optimization, compounding;
    bool rejects;
    double rejection;
    struct Filler {
        int type, size, n_sticks;
        float least_ratio;
        std::vector<float> weights;
    };
    std::vector<Filler> fillers;             ///< none: holes stay
    bool fill_holes;
    void* values;                            ///< out: (z, y, x) of the frames' type
    std::uint16_t* accumulator;              ///< out: (z, y, x)
    double insert_seconds, fill_seconds;     ///< out
};

struct Reconstructor {
    virtual ~Reconstructor() = default;
    virtual void plus(PlusRequest& request) = 0;
};

}  // namespace globule
