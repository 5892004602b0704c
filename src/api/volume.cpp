#include "globule/volume.hpp"

#include <algorithm>
#include <cstring>
#include <tuple>
#include <utility>

#include "api/device.hpp"
#include "api/impl.hpp"
#include "api/sweep_grid.hpp"

namespace globule {
namespace {

constexpr int kMaxKernel = 253, kLargestTable = 31;  ///< radius up to which hole weights come from a table
constexpr int kBlock = 4, kTile = 16;  ///< voxels; blocks of x: the grid grows by whole blocks, along x by whole tiles

/// Largest radius of a hole's kernel, voxels.
int reach_of(int max_kernel, const std::optional<double>& max_distance, double spacing) {
    int reach = (max_kernel - 1) / 2;
    if (max_distance)
        reach = std::min(reach, int(std::min(std::floor(*max_distance / spacing + 1e-9), double(kMaxKernel))));
    return reach;
}
void check_filling(int max_kernel, const std::optional<double>& max_distance) {
    if (max_kernel < 1 || max_kernel > kMaxKernel || max_kernel % 2 == 0)
        refuse("max_kernel", "an odd number of 1 to " + std::to_string(kMaxKernel) + " voxels",
            std::to_string(max_kernel));
    if (max_distance && !(*max_distance >= 0)) refuse("max_distance", "0 mm or more", text(*max_distance));
}
void check_compounding(Compounding c) {
    if (int(c) < 0 || int(c) > int(Compounding::median))
        refuse("compounding", "one of the five", std::to_string(int(c)));
}

/// exp(-d2 / sigma2) as integers of 24 bits: [sigma2][d2], both up to 3 reach^2, voxels^2; empty where too large.
std::vector<std::uint32_t> hole_weights(int reach) {
    if (reach > kLargestTable) return {};
    const int n = 3 * reach * reach + 1;
    std::vector<std::uint32_t> table(std::size_t(n) * n);
    for (int s = 0; s < n; ++s)
        for (int d = 0; d < n; ++d)
            table[std::size_t(s) * n + d] =
                std::uint32_t(std::rint(std::exp(-double(d) / std::max(double(s), 1.0)) * 16777216.0));
    return table;
}

/// What values are multiplied with before they are summed as integers.
double value_scale(const float* values, std::size_t n) {
    float largest = 0;
    for (std::size_t i = 0; i < n; ++i) largest = std::max(largest, std::abs(values[i]));
    int exponent = 0;
    std::frexp(double(largest), &exponent);
    return largest > 0 ? std::ldexp(1.0, 30 - exponent) : 1.0;
}

Poses poses_of(const ArrayView& view, std::size_t n) {
    if (view.where().device != Location::host) refuse("world_from_image", "host memory", "memory of a GPU");
    if (view.dtype() != DType::float64) refuse("world_from_image", "float64", name_of(view.dtype()));
    const Shape& s = view.shape();
    const bool shaped = s == Shape(n, 4, 4) || s == Shape(n, 16) || s == Shape(16 * n) || (n == 1 && s == Shape(4, 4));
    if (n && !view.data()) refuse("world_from_image", "an address", "null");
    if (!shaped) refuse("world_from_image", "shape (" + std::to_string(n) + ", 4, 4)", text(s));
    Poses poses(n);
    if (n) std::memcpy(poses.data(), view.data(), n * sizeof(Matrix4));
    return poses;
}
bool finite(const Matrix4& m) {
    return std::all_of(m.begin(), m.end(), [](double v) { return std::abs(v) <= 1e9; });
}
void check_pose(const Matrix4& m, std::size_t i) {
    const std::string frame = " (frame " + std::to_string(i) + ")";
    if (!finite(m)) refuse("world_from_image", "finite numbers up to 1e9 mm", "another" + frame);
    if (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] != 1)
        refuse("world_from_image", "last row 0 0 0 1",
            text(m[12]) + " " + text(m[13]) + " " + text(m[14]) + " " + text(m[15]) + frame);
    const Vec3 x{m[0], m[4], m[8]}, y{m[1], m[5], m[9]};
    if (!(norm(cross(x, y)) > 1e-9 * (dot(x, x) + dot(y, y))))
        refuse("world_from_image", "columns 0 and 1 that span a plane", "a singular matrix" + frame);
}

/// Frames in host memory or on the reconstructor's device; floats on the host, where they are looked at.
struct Frames {
    int n = 0, height = 0, width = 0;
    core::ScalarType type{};
    DType dtype{};
    std::size_t item = 1;
    core::AnyArray at;
    Inputs here, host{core::kHost};
    std::vector<char> picked;

    Frames(const ArrayView& view, int device) : here(device) {
        const Shape& s = view.shape();
        if ((s.rank() != 3 && s.rank() != 2) || s.size() == 0)
            refuse("frames", "shape (F, H, W), none of them 0", text(s));
        if (!view.data()) refuse("frames", "an address", "null");
        if (s.size() >= std::size_t(1) << 32)
            refuse("frames", "fewer than 2^32 pixels in all", std::to_string(s.size()));
        const int first = s.rank() - 2;
        if (s[0] > 0x7fffffff || s[1] > 0x7fffffff) refuse("frames", "fewer than 2^31 along an axis", text(s));
        n = first ? int(s[0]) : 1;
        height = int(s[first]);
        width = int(s[first + 1]);
        dtype = view.dtype();
        type = scalar("frames", dtype);
        item = size_of(dtype);
        at = type == core::ScalarType::f32 ? host.bytes("frames", view) : here.bytes("frames", view);
        if (type == core::ScalarType::f32)
            for (std::size_t i = 0; i < pixels(); ++i)
                if (!std::isfinite(floats()[i])) refuse("frames", "finite values", "NaN or infinity");
    }
    std::size_t pixels() const { return std::size_t(n) * height * width; }
    const float* floats() const { return static_cast<const float*>(at.data); }
    double scale() const { return type == core::ScalarType::f32 ? value_scale(floats(), pixels()) : 1.0; }

    /// Only these frames, on the host.
    void pick(const ArrayView& view, const std::vector<std::size_t>& which) {
        const core::AnyArray all = host.bytes("frames", view);
        const std::size_t bytes = item * height * width;
        picked.resize(which.size() * bytes);
        for (std::size_t k = 0; k < which.size(); ++k)
            std::memcpy(&picked[k * bytes], static_cast<const char*>(all.data) + which[k] * bytes, bytes);
        at = {picked.data(), core::kHost, 0};
        n = int(which.size());
    }
};

Volume made(const VoxelGrid& grid, DType dtype) {
    Volume v;
    for (int k = 0; k < 3; ++k) v.size[k] = std::size_t(grid.size[k]);
    v.spacing = grid.spacing;
    v.world_from_voxel = grid.world_from_voxel();
    v.dtype = dtype;
    const std::size_t n = v.size[0] * v.size[1] * v.size[2];
    v.bytes.resize(n * size_of(dtype));
    v.radius.resize(n);
    return v;
}
core::GridRequest request_of(
    core::ScalarType type, Compounding compounding, bool wide, double scale, const VoxelGrid& grid) {
    return {type, int(compounding), wide, scale, {int(grid.size[0]), int(grid.size[1]), int(grid.size[2])}};
}

std::vector<std::uint8_t> mask_of(const ArrayView& mask, int height, int width) {
    if (!mask.given()) return {};
    if (mask.where().device != Location::host || mask.dtype() != DType::uint8)
        refuse("mask", "uint8 in host memory", "another array");
    if (!(mask.shape() == Shape(height, width)) && !(mask.shape() == Shape(std::size_t(height) * width)))
        refuse("mask", "shape " + text(Shape(height, width)) + " as the frames", text(mask.shape()));
    const auto* p = static_cast<const std::uint8_t*>(mask.data());
    std::vector<std::uint8_t> out(p, p + mask.shape().size());
    for (std::uint8_t& v : out) v = v != 0;
    return out;
}

}  // namespace

std::vector<std::uint8_t> Volume::filled() const {
    std::vector<std::uint8_t> out(radius.size());
    for (std::size_t i = 0; i < out.size(); ++i)
        out[i] = radius[i] == empty_radius ? 0 : radius[i] == 0 ? 1 : radius[i] < 128 ? 2 : 3;
    return out;
}

Volume reconstruct(const Sweep& sweep, const ReconstructOptions& o) {
    using enum ReconstructionMethod;
    if (int(o.method) < 0 || o.method > along_path) refuse("method", "one of the six", std::to_string(int(o.method)));
    check_compounding(o.compounding);
    if (o.method != pvn_om && o.compounding != Compounding::mean)
        refuse("compounding", "mean for this method", "another");
    check_filling(o.max_kernel, o.max_distance);
    const int threads = whole("threads", o.threads, 0, 4096);
    const Chosen chosen = choose(o.device);
    const core::Handle<core::Reconstructor> core =
        core::make_reconstructor(*chosen.backend, chosen.index, threads, o.poll);

    if (sweep.frames.shape().rank() != 3) refuse("frames", "shape (F, H, W)", text(sweep.frames.shape()));
    Frames frames(sweep.frames, core.device());
    const Poses all = poses_of(sweep.world_from_image, std::size_t(frames.n));
    const std::uint8_t* valid = nullptr;
    if (sweep.valid.given()) {
        if (sweep.valid.where().device != Location::host || sweep.valid.dtype() != DType::uint8 ||
            !(sweep.valid.shape() == Shape(frames.n)))
            refuse("valid", text(Shape(frames.n)) + " uint8 in host memory",
                text(sweep.valid.shape()) + " " + name_of(sweep.valid.dtype()));
        valid = static_cast<const std::uint8_t*>(sweep.valid.data());
    }
    std::vector<std::size_t> which;
    Poses poses_mm;
    for (std::size_t f = 0; f < all.size(); ++f) {
        if (!finite(all[f]) || (valid && !valid[f])) continue;
        check_pose(all[f], f);
        which.push_back(f);
        poses_mm.push_back(all[f]);
    }
    if (which.empty()) throw Error(ErrorCode::invalid, "sweep: expected at least one valid frame, got none");
    if (which.size() < all.size()) frames.pick(sweep.frames, which);
    const std::vector<std::uint8_t> mask = mask_of(sweep.mask, frames.height, frames.width);
    const FrameShape shape{frames.height, frames.width, mask.empty() ? nullptr : mask.data()};
    const Box box = bounds(poses_mm, shape);
    const VoxelGrid grid = make_grid(box, o.spacing, o.size, o.region, bounds({poses_mm[0]}, shape).low);
    const Vec3 top = grid.top();
    for (int k = 0; k < 3; ++k)
        if (grid.low[k] > box.high[k] || top[k] < box.low[k])
            refuse("region", "a box that meets the frames', " + text(box.low) + " to " + text(box.high) + " mm",
                text(grid.low) + " to " + text(top));
    const std::vector<FixedPose> poses = grid.poses(poses_mm);
    const std::uint64_t on_device = core.call<&core::Reconstructor::free_bytes>();
    check_memory(grid, poses, shape, frames.item, o.method, on_device ? on_device : free_host_bytes());

    const core::FramesView view{frames.at, poses[0].data(), shape.mask, frames.n, frames.height, frames.width, 0};
    const bool floats = frames.type == core::ScalarType::f32;
    const bool wide = crowded(poses, shape) || floats || o.method == bezier;
    const double scale = floats ? frames.scale() : o.method == bezier ? 65536.0 : 1.0;
    const int reach = reach_of(o.max_kernel, o.max_distance, grid.spacing);
    const std::vector<std::uint32_t> weights = hole_weights(reach);
    Volume volume = made(grid, frames.dtype);
    const core::Gates inside({core.gate().get()});
    const CoreGrid g(core, frames.type, inside);
    g.call<&core::SweepGrid::start>(request_of(frames.type, o.compounding, wide, scale, grid));
    if (o.method == bezier) g.call<&core::SweepGrid::bezier>(view);
    else if (o.method == pvn_om && o.compounding == Compounding::median) g.call<&core::SweepGrid::median>(view);
    else if (o.method == pvn_om || o.method == along_path) {
        const int step = o.progress ? (frames.n + 31) / 32 : frames.n;  // the bits are the same
        for (int first = 0; first < frames.n; first += step) {
            core::FramesView part = view;
            const std::size_t before = std::size_t(first) * frames.height * frames.width;
            part.values.data = static_cast<const char*>(view.values.data) + before * frames.item;
            part.poses = poses[std::size_t(first)].data();
            part.n = std::min(step, frames.n - first);
            part.first_order = std::uint32_t(before);
            g.call<&core::SweepGrid::add>(part, 1);
            if (o.progress && first + part.n < frames.n) o.progress(std::size_t(first + part.n), std::size_t(frames.n));
        }
    }
    const FillMethod fill = o.method == vvn_om       ? FillMethod::points
                            : o.method == pvn        ? FillMethod::plain_bins
                            : o.method == vvn        ? FillMethod::plain_points
                            : o.method == along_path ? FillMethod::frames
                                                     : FillMethod::bins;
    g.call<&core::SweepGrid::fill>(fill, view,
        core::FillRequest{reach, weights.empty() ? nullptr : weights.data(), 0, volume.bytes.data(),
            volume.radius.data(), o.extrapolate,
            o.method == along_path && o.max_distance ? 2 * *o.max_distance / grid.spacing : -1});
    if (o.progress) o.progress(std::size_t(frames.n), std::size_t(frames.n));
    return volume;
}

/// As python/globule/ultrasound/reconstructor.py has it: the grid grows by whole blocks around what comes.
struct Reconstructor::Impl {
    ReconstructorOptions options;
    Chosen chosen;
    core::Handle<core::Reconstructor> core;
    int margin = 0;  ///< blocks around all pixels: what the grid grows by lies beyond the reach of what is in it

    // Behind the gate.
    std::optional<VoxelGrid> grid;
    Vec3 face{};  ///< a corner of the lattice of voxels
    using Voxel = std::array<std::int64_t, 3>;
    Voxel origin{};       ///< the grid's first voxel on the lattice
    Voxel low{}, high{};  ///< the volume's, and past its last
    DType dtype{};
    core::ScalarType type{};
    int height = 0, width = 0;
    double scale = 1;
    std::uint64_t order = 0;
    std::size_t n_frames = 0;

    FrameShape shape() const { return {height, width, options.mask.empty() ? nullptr : options.mask.data()}; }
    int reach() const { return reach_of(options.max_kernel, options.max_distance, options.spacing); }
    /// The frames' first voxels on the lattice, and those past their last.
    std::pair<Voxel, Voxel> lattice(const Box& box) const {
        std::pair<Voxel, Voxel> out;
        for (int k = 0; k < 3; ++k) {
            out.first[k] = on_lattice(box.low[k], face[k], options.spacing);
            out.second[k] = on_lattice(box.high[k], face[k], options.spacing) + 1;
        }
        return out;
    }
    Vec3 place(const Voxel& v) const {
        return {face[0] + double(v[0]) * options.spacing, face[1] + double(v[1]) * options.spacing,
            face[2] + double(v[2]) * options.spacing};
    }
    void reserve(const VoxelGrid& g, const Poses& poses, const core::Gates& inside) const {
        const std::int64_t largest = std::max({g.size[0], g.size[1], g.size[2]});
        if (largest > kMaxAxis)
            refuse("world_from_image", "at most " + std::to_string(kMaxAxis) + " voxels along an axis",
                std::to_string(largest));
        const std::uint64_t there = core.call_inside<&core::Reconstructor::free_bytes>(inside);
        check_memory(g, g.poses(poses), shape(), size_of(dtype), ReconstructionMethod::pvn_om,
            there ? there : free_host_bytes());
    }
    void make_room(const Poses& poses, const core::Gates& inside);
    void add(const ArrayView& frames, const ArrayView& world_from_image);
    Volume volume();
};

void Reconstructor::Impl::make_room(const Poses& poses, const core::Gates& inside) {
    const Box box = bounds(poses, shape());
    const CoreGrid core_grid(core, type, inside);
    if (!grid) {
        const Vec3 anchor = bounds({poses[0]}, shape()).low;
        for (int k = 0; k < 3; ++k) face[k] = anchor[k] - 0.5 * options.spacing;
        VoxelGrid g;
        Voxel first{}, from{}, to{};
        if (options.region) {
            g = make_grid(box, options.spacing, {}, options.region, anchor);
            for (int k = 0; k < 3; ++k) {
                first[k] = from[k] = std::int64_t(std::rint((g.low[k] - face[k]) / options.spacing));
                to[k] = from[k] + g.size[k];
            }
        } else {
            std::tie(from, to) = lattice(box);
            g.spacing = options.spacing;
            for (int k = 0; k < 3; ++k) {
                first[k] = from[k] - margin * kBlock;
                g.size[k] = (to[k] - first[k] + kBlock - 1) / kBlock * kBlock + margin * kBlock;
            }
            g.low = place(first);
        }
        reserve(g, poses, inside);
        core_grid.call<&core::SweepGrid::start>(request_of(type, options.compounding, true, scale, g));
        grid = g;
        origin = first;
        low = from;
        high = to;
        return;
    }
    if (options.region) return;
    auto [from, to] = lattice(box);
    std::array<std::int64_t, 3> before{}, after{};
    const auto blocks = [](std::int64_t voxels) {
        return voxels > 0 ? (voxels + kBlock - 1) / kBlock : -(-voxels / kBlock);
    };  // rounded up
    bool grows = false;
    for (int k = 0; k < 3; ++k) {
        from[k] = std::min(from[k], low[k]);
        to[k] = std::max(to[k], high[k]);
        before[k] = std::max<std::int64_t>(blocks(origin[k] - from[k]) + margin, 0);
        after[k] = std::max<std::int64_t>(blocks(to[k] - origin[k] - grid->size[k]) + margin, 0);
        grows = grows || before[k] || after[k];
    }
    if (grows) {
        VoxelGrid g = *grid;
        Voxel first = origin;
        int size[3], shift[3];
        for (int k = 0; k < 3; ++k) {
            // An eighth more than needed on each side that grows, so that few calls grow.
            const std::int64_t slack = std::int64_t(std::ceil(double(grid->size[k]) / kBlock / 8));
            if (before[k]) before[k] += slack;
            if (after[k]) after[k] += slack;
            if (k == 0) before[k] = (before[k] + kTile - 1) / kTile * kTile;
            g.size[k] += kBlock * (before[k] + after[k]);
            first[k] -= before[k] * kBlock;
            size[k] = int(std::min(g.size[k], 2 * kMaxAxis));
            shift[k] = int(before[k]);
        }
        g.low = place(first);
        reserve(g, poses, inside);
        core_grid.call<&core::SweepGrid::grow>(size, shift);
        grid = g;
        origin = first;
    }
    low = from;
    high = to;
}

void Reconstructor::Impl::add(const ArrayView& frames_view, const ArrayView& world_from_image) {
    const core::Gates inside({core.gate().get()});
    const Frames frames(frames_view, core.device());
    const Poses poses = poses_of(world_from_image, std::size_t(frames.n));
    for (std::size_t f = 0; f < poses.size(); ++f) check_pose(poses[f], f);
    if (!grid) {
        if (!options.mask.empty() && options.mask.size() != std::size_t(frames.height) * frames.width)
            refuse("mask", "shape " + text(Shape(frames.height, frames.width)) + " as the frames",
                std::to_string(options.mask.size()) + " pixels");
        dtype = frames.dtype, type = frames.type, height = frames.height, width = frames.width;
        scale = frames.scale();
    }
    if (frames.dtype != dtype || frames.height != height || frames.width != width)
        refuse("frames", text(Shape(height, width)) + " " + name_of(dtype) + " as before",
            text(Shape(frames.height, frames.width)) + " " + name_of(frames.dtype));
    if (type == core::ScalarType::f32) {
        float largest = 0;
        for (std::size_t i = 0; i < frames.pixels(); ++i) largest = std::max(largest, std::abs(frames.floats()[i]));
        if (double(largest) * scale > 274877906944.0)
            throw Error(ErrorCode::invalid, "frames: values are more than 256 times those of the first frames");
    }
    const bool ordered = options.compounding == Compounding::latest || options.compounding == Compounding::first;
    if (ordered && order + frames.pixels() >= std::uint64_t(1) << 32)
        refuse("frames", "fewer than 2^32 pixels in all", "more");
    make_room(poses, inside);
    const std::vector<FixedPose> fixed = grid->poses(poses);
    const core::FramesView view{
        frames.at, fixed[0].data(), shape().mask, frames.n, height, width, std::uint32_t(order)};
    CoreGrid(core, type, inside).call<&core::SweepGrid::add>(view, 1);
    order += frames.pixels();
    n_frames += std::size_t(frames.n);
}

Volume Reconstructor::Impl::volume() {
    const core::Gates inside({core.gate().get()});
    if (!grid) throw Error(ErrorCode::invalid, "volume: expected frames to be added first, got none");
    const CoreGrid core_grid(core, type, inside);
    VoxelGrid part{place(low), options.spacing, {}};
    int first[3], size[3];
    for (int k = 0; k < 3; ++k) {
        first[k] = int(low[k] - origin[k]);
        size[k] = int(high[k] - low[k]);
        part.size[k] = size[k];
    }
    const std::vector<std::uint32_t> weights = hole_weights(reach());
    Volume v = made(part, dtype);
    core_grid.call<&core::SweepGrid::fill>(FillMethod::bins, core::FramesView{},
        core::FillRequest{
            reach(), weights.empty() ? nullptr : weights.data(), 0, nullptr, nullptr, options.extrapolate});
    core_grid.call<&core::SweepGrid::read_filled>(first, size, core::DenseArrays{v.bytes.data(), v.radius.data()});
    return v;
}

Reconstructor::Reconstructor(const ReconstructorOptions& o) : impl_(std::make_shared<Impl>()) {
    positive("spacing", o.spacing);
    check_filling(o.max_kernel, o.max_distance);
    check_compounding(o.compounding);
    if (o.compounding == Compounding::median)
        throw Error(ErrorCode::invalid, "compounding: a median needs all frames at once, use globule::reconstruct");
    if (o.region) make_grid({}, o.spacing, {}, o.region, {});
    const int threads = whole("threads", o.threads, 0, 4096);
    impl_->options = o;
    for (std::uint8_t& v : impl_->options.mask) v = v != 0;
    impl_->chosen = choose(o.device);
    impl_->core = core::make_reconstructor(*impl_->chosen.backend, impl_->chosen.index, threads, o.poll);
    impl_->margin = (impl_->reach() + kBlock - 1) / kBlock;
}
void Reconstructor::add(const ArrayView& frames, const ArrayView& world_from_image) {
    Inside::of(*this, "reconstructor");
    impl_->add(frames, world_from_image);
}
Volume Reconstructor::volume() const {
    Inside::of(*this, "reconstructor");
    return impl_->volume();
}
std::size_t Reconstructor::n_frames() const {
    const Impl& r = Inside::of(*this, "reconstructor");
    const core::Gates inside({r.core.gate().get()});
    return r.n_frames;
}
const std::string& Reconstructor::device() const { return Inside::of(*this, "reconstructor").chosen.device.name; }
void Reconstructor::cancel() const noexcept {
    if (impl_) impl_->core.object()->cancel();
}

}  // namespace globule
