// Volumes from tracked ultrasound sweeps; lengths in mm.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "globule/array.hpp"
#include "globule/error.hpp"
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

}  // namespace globule
