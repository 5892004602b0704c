// The grid that a sweep is reconstructed on: where its voxels lie, and whether they fit in memory.  As
// python/globule/ultrasound/grid.py has it, operation by operation, so that volumes are equal bit by bit.
#pragma once
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "api/checks.hpp"
#include "globule/volume.hpp"

namespace globule {

constexpr std::int64_t kMaxAxis = 1 << 20;
using Poses = std::vector<Matrix4>;             ///< world_from_image, mm
using FixedPose = std::array<std::int64_t, 9>;  ///< origin, column step, row step, in voxels with 32 fractional bits

/// Pixels of a frame that count; null: all.
struct FrameShape {
    int height = 0, width = 0;
    const std::uint8_t* mask = nullptr;
};

/// Cubic voxels: `low` is the outer corner of voxel (0, 0, 0), mm, world; `size` is x, y, z.
struct VoxelGrid {
    Vec3 low{0, 0, 0};
    double spacing = 1;
    std::array<std::int64_t, 3> size{};

    double n_voxels() const { return double(size[0]) * double(size[1]) * double(size[2]); }
    Vec3 top() const {
        return {
            low[0] + spacing * double(size[0]), low[1] + spacing * double(size[1]), low[2] + spacing * double(size[2])};
    }
    Matrix4 world_from_voxel() const;
    /// The same box in voxels so many times larger.
    VoxelGrid coarser(double times) const;
    std::vector<FixedPose> poses(const Poses& world_from_image) const;
};

/// The box of the used pixels' centers over all frames, mm.
Box bounds(const Poses& world_from_image, const FrameShape& shape);
/// Which voxel of a lattice a coordinate lies in, counted from the corner `face`.
inline std::int64_t on_lattice(double point, double face, double spacing) {
    return std::int64_t(std::floor((point - face) / spacing + 1e-9));
}
/// Over the box of all pixels, or over `region`; one of spacing and size is given. With a spacing, a voxel's center
/// lies at the anchor, the lowest corner of the first frame's box.
VoxelGrid make_grid(Box box, std::optional<double> spacing, std::optional<int> size, const std::optional<Box>& region,
    const Vec3& anchor);
/// Whether a voxel may hold 2^24 pixels or more.
bool crowded(const std::vector<FixedPose>& poses, const FrameShape& shape);
/// Throws what does not fit in so many bytes (0: unknown), naming the spacing that would.
void check_memory(const VoxelGrid& grid, const std::vector<FixedPose>& poses, const FrameShape& shape, std::size_t item,
    ReconstructionMethod method, std::uint64_t available);
/// Bytes of main memory that programs can still take; 0 where the system does not say.
std::uint64_t free_host_bytes();

core::ScalarType scalar(const char* name, DType type);

/// The grid of a reconstructor in a backend, its gate held.
class CoreGrid {
public:
    CoreGrid(const core::Handle<core::Reconstructor>& core, core::ScalarType type, const core::Gates& inside)
        : inside_(inside),
          handle_(core.backend(),
              std::shared_ptr<core::SweepGrid>(
                  core.object(), core.call_inside<&core::Reconstructor::grid>(inside, type)),
              nullptr) {}
    template <auto Method, class... A> auto call(A&&... arguments) const {
        return handle_.call_inside<Method>(inside_, std::forward<A>(arguments)...);
    }

private:
    const core::Gates& inside_;
    core::Handle<core::SweepGrid> handle_;
};

}  // namespace globule
