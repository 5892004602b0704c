// What a compiled backend offers for volumes from tracked sweeps.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "backends/object.hpp"
#include "base/device.hpp"
#include "globule/values.hpp"

namespace globule::core {

enum class ScalarType { u8, u16, f32 };

/// A reconstruction as the PLUS toolkit does it; numbers of the enumerations as in sweep/plus_*.hpp.
struct PlusRequest {
    AnyArray frames;  ///< (n_frames, height, width)
    ScalarType type;
    int n_frames, height, width;
    const double* voxel_from_image;  ///< (n_frames, 3, 4): columns x, y, normal (unused), origin
    const std::int32_t* sources;     ///< (n_masks, height, width)
    int n_masks;
    const std::uint32_t* mask_of_frame;  ///< (n_frames,)
    const std::uint8_t* importance;      ///< (height, width) or null
    int size[3];                         ///< voxels along x, y, z
    int interpolation, optimization, compounding;
    bool rejects;
    double rejection;
    using Filler = PlusFiller;
    std::vector<Filler> fillers;  ///< none: holes stay
    bool fill_holes;
    void* values;                         ///< out: (z, y, x) of the frames' type
    std::uint16_t* accumulator;           ///< out: (z, y, x)
    std::uint8_t* origin;                 ///< out: (z, y, x) 0 measured, 1 filled, 255 neither
    double insert_seconds, fill_seconds;  ///< out
};

/// A volume's grid and how values are kept; sweep/bin.hpp.
struct GridRequest {
    ScalarType type;
    int compounding;  ///< sweep::Compounding
    bool wide;
    double scale;
    int size[3];  ///< voxels along x, y, z
};

struct FramesView {
    AnyArray values;            ///< (n, height, width) of the grid's type
    const std::int64_t* poses;  ///< (n, 9): origin, column step, row step; 32 fractional bits
    const std::uint8_t* mask;   ///< (height, width) or null
    int n, height, width;
    std::uint32_t first_order;
};

struct FillRequest {
    int reach;                     ///< largest radius of a kernel, voxels
    const std::uint32_t* weights;  ///< (3 reach^2 + 1) squared: [sigma^2][d^2], 2^24 = 1
    int kind;                      ///< sweep::HoleWeights
    void* values;  ///< out: (z, y, x); null: kept by the backend, and of `bins` only what changed since is filled
    std::uint8_t* radius;     ///< out: (z, y, x): 0 measured, k filled, 128 + k extrapolated, 255 empty
    bool extrapolate;         ///< keep what is filled without data on both sides
    double max_gap = -1;      ///< frames: farthest that joined images may be apart, voxels; negative: five usual steps
    float* spread = nullptr;  ///< out, frames: (z, y, x) mean of |d0 d1| / |d0 - d1| of the distances from the images
                              ///< on both sides, voxels; -1: no value
    float* contrast =
        nullptr;  ///< out, frames: (z, y, x) mean square of the difference of both images; -1: not between images
};

/// A dense volume, (z, y, x); none where null.
struct DenseArrays {
    void* values;
    std::uint8_t* radius;
};

/// The sparse grid of one volume.
struct SweepGrid : Object {
    /// Forgets all frames; the grid is empty.
    virtual void start(const GridRequest& request) = 0;
    /// A larger grid that holds the old one `shift` blocks of 4 voxels inside, along x a multiple of 16. What is kept
    /// moves with it; the new blocks must be farther from all data than a kernel reaches.
    virtual void grow(const int size[3], const int shift[3]) = 0;
    /// Bins frames; sign -1 takes them out again (mean only).
    virtual void add(const FramesView& frames, int sign) = 0;
    virtual void median(const FramesView& frames) = 0;
    virtual void bezier(const FramesView& frames) = 0;
    /// The dense volume; methods on points take the frames, the others what was added.
    virtual void fill(FillMethod method, const FramesView& frames, const FillRequest& request) = 0;
    /// The volume that the backend keeps as arrays, on a device.
    virtual DenseArrays filled() = 0;
    /// A box of the volume that the backend keeps, voxels.
    virtual void read_filled(const int first[3], const int size[3], const DenseArrays& out) = 0;
    virtual void count_map(std::uint32_t* out) = 0;
    virtual void variance_map(const FramesView& frames, float* out) = 0;
    virtual void source_map(std::uint32_t pixels, std::int32_t* out) = 0;
    virtual VolumeFacts facts() = 0;
};

struct Reconstructor : Object {
    virtual void plus(PlusRequest& request) = 0;
    /// The grid for frames of a type; the one of another type is dropped.
    virtual SweepGrid* grid(ScalarType type) = 0;
    /// Memory that may still be taken, bytes; 0 where unknown.
    virtual std::uint64_t free_bytes() = 0;
};

}  // namespace globule::core
