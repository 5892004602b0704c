#include <algorithm>

#include "api/device.hpp"
#include "api/impl.hpp"
#include "api/sweep_grid.hpp"

namespace globule {

core::ScalarType scalar(const char* name, DType type) {
    switch (type) {
        case DType::uint8:
            return core::ScalarType::u8;
        case DType::uint16:
            return core::ScalarType::u16;
        case DType::float32:
            return core::ScalarType::f32;
        default:
            refuse(name, "uint8, uint16 or float32", name_of(type));
    }
}

struct SweepGrid::Impl {
    Chosen chosen;
    core::Handle<core::Reconstructor> core;

    // Behind the gate.
    GridLayout layout;

    std::size_t n() const { return std::size_t(layout.size[0]) * layout.size[1] * layout.size[2]; }
    core::Gates gates() const { return core::Gates({core.gate().get()}); }
    template <auto Method, class... A> auto call(const core::Gates& inside, A&&... arguments) const {
        return CoreGrid(core, scalar("dtype", layout.dtype), inside).call<Method>(std::forward<A>(arguments)...);
    }
    template <auto Method, class... A> auto ask(A&&... arguments) const {
        const core::Gates inside = gates();
        return call<Method>(inside, std::forward<A>(arguments)...);
    }
};

namespace {

void check_size(const std::array<int, 3>& size) {
    double n = 1;
    for (const int k : size) n *= whole("size", k, 1, int(2 * kMaxAxis));
    if (n > 1e15) refuse("size", "fewer than 1e15 voxels", text(n));
}

/// Frames where a grid's device can use them.
struct View : core::FramesView {
    core::Arrays arrays;

    View(const core::Handle<core::Reconstructor>& core, const GridFrames& f, DType type)
        : FramesView{}, arrays(core.device()) {
        if (!f.frames.given()) return;
        const Shape& s = f.frames.shape();
        if (s.rank() != 3 || s.size() == 0 || s.size() >= std::size_t(1) << 32)
            refuse("frames", "shape (F, H, W) of fewer than 2^32 pixels, none of them 0", text(s));
        if (f.frames.dtype() != type) refuse("frames", name_of(type), name_of(f.frames.dtype()));
        values = arrays.reach_bytes(
            "frames", {f.frames.data(), f.frames.where().device, f.frames.where().stream}, s.size() * size_of(type));
        n = int(s[0]), height = int(s[1]), width = int(s[2]);
        poses = on_host<std::int64_t>("poses", f.poses, 9 * s[0]);
        if (!poses) refuse("poses", "one of each frame", "none");
        mask = on_host<std::uint8_t>("mask", f.mask, s[1] * s[2]);
        first_order = f.first_order;
    }
};

}  // namespace

SweepGrid::SweepGrid(const SweepGridOptions& o) : impl_(std::make_shared<Impl>()) {
    const int threads = whole("threads", o.threads, 0, 4096);
    impl_->chosen = choose(o.device);
    impl_->core = core::make_reconstructor(*impl_->chosen.backend, impl_->chosen.index, threads, o.poll);
}

void SweepGrid::start(const GridLayout& layout) {
    Inside::of(*this, "grid");
    const core::ScalarType type = scalar("dtype", layout.dtype);
    if (int(layout.compounding) < 0 || layout.compounding > Compounding::median)
        refuse("compounding", "one of the five", std::to_string(int(layout.compounding)));
    check_size(layout.size);
    positive("scale", layout.scale);
    const core::Gates inside = impl_->gates();
    impl_->layout = layout;
    impl_->call<&core::SweepGrid::start>(inside, core::GridRequest{type, int(layout.compounding), layout.wide,
                                                     layout.scale, {layout.size[0], layout.size[1], layout.size[2]}});
}
GridLayout SweepGrid::layout() const {
    const Impl& s = Inside::of(*this, "grid");
    const core::Gates inside = s.gates();
    return s.layout;
}
void SweepGrid::grow(const std::array<int, 3>& size, const std::array<int, 3>& shift) {
    Inside::of(*this, "grid");
    check_size(size);
    const core::Gates inside = impl_->gates();
    for (int k = 0; k < 3; ++k)
        if (shift[k] < 0 || size[k] < impl_->layout.size[k] + 4 * shift[k] || (k == 0 && shift[k] % 16))
            refuse("shift", "the old grid within the new one, along x by a multiple of 16 blocks",
                std::to_string(shift[k]));
    impl_->call<&core::SweepGrid::grow>(inside, size.data(), shift.data());
    impl_->layout.size = size;
}
void SweepGrid::add(const GridFrames& frames, int sign) {
    const Impl& s = Inside::of(*this, "grid");
    const core::Gates inside = s.gates();
    if (sign != 1 && !(sign == -1 && s.layout.compounding == Compounding::mean))
        refuse("sign", "1, or -1 of a mean", std::to_string(sign));
    s.call<&core::SweepGrid::add>(inside, View(s.core, frames, s.layout.dtype), sign);
}
void SweepGrid::median(const GridFrames& frames) {
    const Impl& s = Inside::of(*this, "grid");
    const core::Gates inside = s.gates();
    s.call<&core::SweepGrid::median>(inside, View(s.core, frames, s.layout.dtype));
}
void SweepGrid::bezier(const GridFrames& frames) {
    const Impl& s = Inside::of(*this, "grid");
    const core::Gates inside = s.gates();
    s.call<&core::SweepGrid::bezier>(inside, View(s.core, frames, s.layout.dtype));
}
void SweepGrid::fill(const GridFrames& frames, const FillOptions& o) {
    const Impl& s = Inside::of(*this, "grid");
    if (int(o.method) < 0 || o.method > FillMethod::frames)
        refuse("method", "one of the five", std::to_string(int(o.method)));
    const std::size_t side = 3 * std::size_t(whole("reach", o.reach, 0, 126)) * std::size_t(o.reach) + 1;
    const core::Gates inside = s.gates();
    const std::size_t n = s.n();
    const core::FillRequest request{o.reach, on_host<std::uint32_t>("weights", o.weights, side * side), int(o.kind),
        const_cast<void*>(on_host("values", o.values, s.layout.dtype, n)),
        out_on_host<std::uint8_t>("radius", o.radius, n), o.extrapolate, o.max_gap,
        out_on_host<float>("spread", o.spread, n), out_on_host<float>("contrast", o.contrast, n)};
    if (!request.values != !request.radius) refuse("radius", "values and radius, or neither", "one");
    s.call<&core::SweepGrid::fill>(inside, o.method, View(s.core, frames, s.layout.dtype), request);
}

std::pair<ArrayView, ArrayView> SweepGrid::filled() const {
    const Impl& s = Inside::of(*this, "grid");
    if (s.core.device() == core::kHost)
        throw Error(ErrorCode::invalid, "filled: expected a grid on a GPU: on the CPU read_filled() copies");
    const core::Gates inside = s.gates();
    const core::DenseArrays a = s.call<&core::SweepGrid::filled>(inside);
    const auto& [x, y, z] = s.layout.size;
    const Shape shape(z, y, x);
    const Location where{s.core.device()};
    return {{a.values, s.layout.dtype, shape, where}, {a.radius, shape, where}};
}
void SweepGrid::read_filled(const std::array<int, 3>& first, const std::array<int, 3>& size,
    const MutableArrayView& values, const MutableArrayView& radius) const {
    const Impl& s = Inside::of(*this, "grid");
    const core::Gates inside = s.gates();
    for (int k = 0; k < 3; ++k)
        if (first[k] < 0 || size[k] < 1 || std::int64_t(first[k]) + size[k] > s.layout.size[k])
            refuse("size", "a box within the grid", std::to_string(size[k]));
    const std::size_t n = std::size_t(size[0]) * size[1] * size[2];
    s.call<&core::SweepGrid::read_filled>(inside, first.data(), size.data(),
        core::DenseArrays{const_cast<void*>(on_host("values", values, s.layout.dtype, n)),
            out_on_host<std::uint8_t>("radius", radius, n)});
}

void SweepGrid::count_map(const MutableArrayView& out) const {
    const Impl& s = Inside::of(*this, "grid");
    const core::Gates inside = s.gates();
    s.call<&core::SweepGrid::count_map>(inside, out_on_host<std::uint32_t>("out", out, s.n()));
}
void SweepGrid::variance_map(const GridFrames& frames, const MutableArrayView& out) const {
    const Impl& s = Inside::of(*this, "grid");
    const core::Gates inside = s.gates();
    s.call<&core::SweepGrid::variance_map>(
        inside, View(s.core, frames, s.layout.dtype), out_on_host<float>("out", out, s.n()));
}
void SweepGrid::source_map(std::uint32_t pixels, const MutableArrayView& out) const {
    const Impl& s = Inside::of(*this, "grid");
    const core::Gates inside = s.gates();
    if (pixels == 0) refuse("pixels", "those of a frame", "0");
    s.call<&core::SweepGrid::source_map>(inside, pixels, out_on_host<std::int32_t>("out", out, s.n()));
}

VolumeFacts SweepGrid::facts() const { return Inside::of(*this, "grid").ask<&core::SweepGrid::facts>(); }
std::uint64_t SweepGrid::free_bytes() const {
    return Inside::of(*this, "grid").core.call<&core::Reconstructor::free_bytes>();
}
const std::string& SweepGrid::device() const { return Inside::of(*this, "grid").chosen.device.name; }
void SweepGrid::cancel() const noexcept {
    if (impl_) impl_->core.object()->cancel();
}

std::pair<double, double> SweepGrid::plus(const PlusSweep& p) const {
    const Impl& s = Inside::of(*this, "grid");
    check_size(p.size);
    const Shape& shape = p.frames.shape();
    if (shape.rank() != 3 || !p.frames.data()) refuse("frames", "shape (F, H, W)", text(shape));
    const std::size_t n = shape[0], pixels = shape[1] * shape[2],
                      voxels = std::size_t(p.size[0]) * p.size[1] * p.size[2];
    core::PlusRequest r{};
    core::Arrays arrays(s.core.device());
    r.type = scalar("frames", p.frames.dtype());
    r.frames = arrays.reach_bytes("frames", {p.frames.data(), p.frames.where().device, p.frames.where().stream},
        shape.size() * size_of(p.frames.dtype()));
    r.n_frames = int(n), r.height = int(shape[1]), r.width = int(shape[2]);
    r.voxel_from_image = on_host<double>("voxel_from_image", p.voxel_from_image, 12 * n);
    r.n_masks = pixels ? int(p.sources.shape().size() / pixels) : 0;
    r.sources = on_host<std::int32_t>("sources", p.sources, pixels * std::size_t(r.n_masks));
    r.mask_of_frame = on_host<std::uint32_t>("source_of_frame", p.source_of_frame, n);
    r.importance = on_host<std::uint8_t>("importance", p.importance, pixels);
    if (n && (!r.voxel_from_image || !r.sources || !r.mask_of_frame)) refuse("sources", "places of all frames", "none");
    if (std::any_of(r.sources, r.sources + pixels * std::size_t(r.n_masks),
            [&](std::int32_t k) { return k >= std::int64_t(pixels); }) ||
        std::any_of(r.mask_of_frame, r.mask_of_frame + n, [&](std::uint32_t k) { return int(k) >= r.n_masks; }))
        refuse("sources", "pixels of a frame", "others");
    std::copy(p.size.begin(), p.size.end(), r.size);
    r.interpolation = whole("interpolation", p.interpolation, 0, 1);
    r.optimization = whole("optimization", p.optimization, 0, 2);
    r.compounding = whole("compounding", p.compounding, 0, 3);
    if (r.compounding == 3 && !r.importance) refuse("importance", "a mask for this compounding", "none");
    r.rejects = p.rejection.has_value();
    r.rejection = p.rejection.value_or(0);
    r.fillers = p.fillers;
    r.fill_holes = p.fill_holes;
    r.values = const_cast<void*>(on_host("values", p.values, p.frames.dtype(), voxels));
    r.accumulator = out_on_host<std::uint16_t>("accumulator", p.accumulator, voxels);
    r.origin = out_on_host<std::uint8_t>("origin", p.origin, voxels);
    if (!r.values || !r.accumulator || !r.origin) refuse("values", "three arrays of the volume", "fewer");
    s.core.call<&core::Reconstructor::plus>(r);
    return {r.insert_seconds, r.fill_seconds};
}

}  // namespace globule
