// Volumes from tracked ultrasound sweeps; lengths in mm.
#pragma once
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "globule/array.hpp"
#include "globule/error.hpp"
#include "globule/poll.hpp"
#include "globule/values.hpp"
#include "globule/vector.hpp"

namespace globule {

/// Tracked images.
struct Sweep {
    ArrayView frames{};            ///< (F, H, W) uint8, uint16 or float32; row 0 next to the probe
    ArrayView world_from_image{};  ///< (F, 4, 4) float64, host, mm: pixel center (column, row, 0, 1) to the world
    ArrayView valid{};             ///< (F,) uint8, host: images that count; default: those whose pose is finite
    ArrayView mask{};              ///< (H, W) uint8, host: pixels that count; default: all
};

/// Of several pixels in one voxel.
enum class Compounding : int { mean, maximum, latest, first, median };
/// pvn_om bins pixels into voxels and fills holes from a growing kernel; vvn_om averages the pixels in a growing
/// sphere; pvn and vvn are the same without the octree, for comparison; bezier lays curves through the pixels of four
/// images; along_path interpolates between neighboring images along the probe's path.
enum class ReconstructionMethod : int { pvn_om, vvn_om, pvn, vvn, bezier, along_path };

struct ReconstructOptions {
    ReconstructionMethod method = ReconstructionMethod::pvn_om;
    std::optional<double> spacing{};  ///< edge of a voxel, mm; or
    std::optional<int> size{};        ///< voxels along the longest axis; exactly one of the two is needed
    int max_kernel = 9;               ///< edge of the largest kernel that fills holes, odd, voxels; 1: holes stay
    Compounding compounding = Compounding::mean;  ///< others with pvn_om only
    std::optional<Box> region{};  ///< mm, world: with a spacing the voxels whose centers lie in it; default: all pixels
    std::optional<double> max_distance{};  ///< holes farther than this along an axis from any pixel stay empty, mm
    bool extrapolate = false;              ///< also fill holes without data on both sides
    std::string device = "auto";           ///< "auto", "cpu", "cuda" or "cuda:N"
    int threads = 0;                       ///< of the CPU; 0: all
    Poll* poll = nullptr;
    std::function<void(std::size_t done, std::size_t of)> progress{};  ///< called on this thread: images
};

/// Cubic voxels and where their values come from.
struct Volume {
    std::array<std::size_t, 3> size{};  ///< voxels along x, y, z
    double spacing = 0;                 ///< edge of a voxel, mm
    Matrix4 world_from_voxel{};         ///< voxel index (x, y, z, 1) to the voxel's center, mm
    DType dtype = DType::uint8;         ///< of the values: that of the sweep's images
    std::vector<std::uint8_t> bytes{};  ///< of the values
    /// (Z, Y, X): 0 measured; k filled from a cube of (2 k + 1)^3 voxels between data; 128 + k the same, extrapolated;
    /// 255 empty.
    std::vector<std::uint8_t> radius{};

    static constexpr std::uint8_t empty_radius = 255;

    /// (Z, Y, X), x fastest; 0 where empty.  T: std::uint8_t, std::uint16_t or float, as `dtype` has it; else it is
    /// empty.
    template <Element T> std::span<const T> values() const {
        if (dtype_of<T>() != dtype) return {};
        return {reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)};
    }
    /// (Z, Y, X): 0 empty, 1 measured, 2 filled between measured voxels, 3 extrapolated from measured voxels.
    GLOBULE_API std::vector<std::uint8_t> filled() const;
};

/// A volume of all valid images of a sweep.  Its mean is exact and rounded to nearest, the same bits on any device.
///
/// Throws Error: invalid names the argument; memory where the volume cannot fit, with the spacing that would; device.
GLOBULE_API Volume reconstruct(const Sweep& sweep, const ReconstructOptions& options);

struct ReconstructorOptions {
    double spacing = 0;  ///< edge of a voxel, mm
    int max_kernel = 9;
    Compounding compounding = Compounding::mean;  ///< not median
    std::optional<Box> region{};                  ///< default: the volume grows with the images
    std::optional<double> max_distance{};
    bool extrapolate = false;
    std::vector<std::uint8_t> mask{};  ///< (H, W) pixels that count; default: all
    std::string device = "auto";
    int threads = 0;
    Poll* poll = nullptr;
};

/// Bins images as they come (PVN-OM); the volume equals that of all images at once.  Voxels lie on a lattice that the
/// first image, or the region, fixes.  Copies are handles of the same object.
///
/// Any thread may call any method; calls on one object wait for each other.  Errors are those of `reconstruct`, and
/// stale where an earlier call to add failed half way: the images must then be added to a new object.  A cancelled
/// volume() changes nothing.
class GLOBULE_API Reconstructor {
public:
    /// An empty handle.
    Reconstructor() noexcept = default;
    explicit Reconstructor(const ReconstructorOptions& options);
    explicit operator bool() const noexcept { return impl_ != nullptr; }

    /// Adds images: (F, H, W) or (H, W), of one type and size in all calls, and their poses (F, 4, 4) or (4, 4), or
    /// flat (16 F,), float64, host, mm, world_from_image.  All is read during the call.
    void add(const ArrayView& frames, const ArrayView& world_from_image);
    /// The volume of all images so far; a copy.
    Volume volume() const;
    std::size_t n_frames() const;
    const std::string& device() const;

    /// From any thread: the call that is running, if any, is to stop; it throws Error: cancelled.
    void cancel() const noexcept;

private:
    friend struct Inside;
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

/// Frames with their places in a grid.
struct GridFrames {
    ArrayView frames{};             ///< (F, H, W) of the grid's type
    ArrayView poses{};              ///< (F, 9) int64, host: origin, column step, row step; voxels, 32 fractional bits
    ArrayView mask{};               ///< (H, W) uint8, host; default: all
    std::uint32_t first_order = 0;  ///< of the first pixel, for latest and first
};

/// How a grid keeps values.
struct GridLayout {
    DType dtype = DType::uint8;
    Compounding compounding = Compounding::mean;
    bool wide = true;           ///< a voxel may hold 2^24 pixels or more; always of floats and of bezier
    double scale = 1;           ///< what values are multiplied with before they are summed as integers
    std::array<int, 3> size{};  ///< voxels along x, y, z
};

struct FillOptions {
    FillMethod method = FillMethod::bins;
    int reach = 4;        ///< largest radius of a hole's kernel, voxels
    ArrayView weights{};  ///< (3 reach^2 + 1) squared uint32: [sigma^2][d^2], 2^24 = 1; default: computed where needed
    HoleWeights kind = HoleWeights::normalized;
    bool extrapolate = false;
    double max_gap = -1;  ///< of frames: farthest that joined images may be apart, voxels; below 0: five usual steps
    MutableArrayView values{};  ///< (Z, Y, X) of the grid's type; default: the grid keeps the volume, and fills of bins
                                ///< only what changed
    MutableArrayView radius{};  ///< (Z, Y, X) uint8, beside values
    MutableArrayView spread{};  ///< of frames, (Z, Y, X) float32: mean of |d0 d1| / |d0 - d1|, voxels; -1: none
    MutableArrayView contrast{};  ///< of frames, (Z, Y, X) float32: mean square of both images' difference; -1: none
};

/// A reconstruction as the PLUS toolkit makes it, bit by bit.  Arrays but the frames are in host memory.
struct PlusSweep {
    ArrayView frames{};                 ///< (F, H, W) uint8, uint16 or float32
    ArrayView voxel_from_image{};       ///< (F, 3, 4) float64
    ArrayView sources{};                ///< (K, H, W) int32: the pixel that each one's value comes from; below 0: none
    ArrayView source_of_frame{};        ///< (F,) uint32, which of them
    ArrayView importance{};             ///< (H, W) uint8, for the compounding by it
    std::array<int, 3> size{};          ///< voxels along x, y, z
    int interpolation = 0;              ///< nearest neighbor, linear
    int optimization = 0;               ///< none, partial, full
    int compounding = 0;                ///< latest, maximum, mean, importance mask
    std::optional<double> rejection{};  ///< pixels below it do not count
    bool fill_holes = false;
    std::vector<PlusFiller> fillers{};  ///< at most 16
    MutableArrayView values{};          ///< (Z, Y, X) of the frames' type
    MutableArrayView accumulator{};     ///< (Z, Y, X) uint16
    MutableArrayView origin{};          ///< (Z, Y, X) uint8: 0 measured, 1 filled, 255 neither
};

struct SweepGridOptions {
    std::string device = "auto";
    int threads = 0;
    Poll* poll = nullptr;
};

/// The sparse grid under a Reconstructor, step by step: for own lattices, maps of what voxels hold, and PLUS.  Copies
/// are handles of the same grid.
///
/// Any thread may call any method; calls on one grid wait for each other.  Errors are those of Reconstructor.
class GLOBULE_API SweepGrid {
public:
    /// An empty handle.
    SweepGrid() noexcept = default;
    explicit SweepGrid(const SweepGridOptions& options);
    explicit operator bool() const noexcept { return impl_ != nullptr; }

    /// Forgets all frames.
    void start(const GridLayout& layout);
    GridLayout layout() const;
    /// A larger grid that holds the old one `shift` blocks of 4 voxels inside, along x a multiple of 16 blocks.  New
    /// blocks must be farther from all data than a kernel reaches.
    void grow(const std::array<int, 3>& size, const std::array<int, 3>& shift);
    /// Bins frames; sign -1 takes them out of a mean again.
    void add(const GridFrames& frames, int sign = 1);
    void median(const GridFrames& frames);
    void bezier(const GridFrames& frames);
    /// Methods on points and frames take the frames, the others what was added.
    void fill(const GridFrames& frames, const FillOptions& options);

    /// Of the volume that a grid on a GPU keeps: values and radii (Z, Y, X) where they lie, until the grid changes.
    std::pair<ArrayView, ArrayView> filled() const;
    /// A box of it; either array may be left out.
    void read_filled(const std::array<int, 3>& first, const std::array<int, 3>& size, const MutableArrayView& values,
        const MutableArrayView& radius) const;

    // Maps (Z, Y, X) of what was added.
    void count_map(const MutableArrayView& out) const;                               ///< uint32: pixels
    void variance_map(const GridFrames& frames, const MutableArrayView& out) const;  ///< float32
    void source_map(std::uint32_t pixels, const MutableArrayView& out) const;        ///< int32: frame of so many pixels

    VolumeFacts facts() const;
    /// Memory that may still be taken, bytes; 0 where unknown.
    std::uint64_t free_bytes() const;
    /// Seconds for pixels, and for holes.
    std::pair<double, double> plus(const PlusSweep& sweep) const;
    const std::string& device() const;
    void cancel() const noexcept;

private:
    friend struct Inside;
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

}  // namespace globule
