#include "api/sweep_grid.hpp"

#include <algorithm>
#include <fstream>
#include <string>

namespace globule {

Matrix4 VoxelGrid::world_from_voxel() const {
    Matrix4 m{};
    for (int k = 0; k < 3; ++k) {
        m[5 * k] = spacing;
        m[4 * k + 3] = low[k] + 0.5 * spacing;
    }
    m[15] = 1;
    return m;
}
VoxelGrid VoxelGrid::coarser(double times) const {
    VoxelGrid g{low, spacing * times, {}};
    for (int k = 0; k < 3; ++k) g.size[k] = std::max<std::int64_t>(1, std::int64_t(std::ceil(double(size[k]) / times)));
    return g;
}
std::vector<FixedPose> VoxelGrid::poses(const Poses& world_from_image) const {
    std::vector<FixedPose> out(world_from_image.size());
    for (std::size_t f = 0; f < out.size(); ++f)
        for (int part = 0; part < 3; ++part)  // origin, column step, row step
            for (int k = 0; k < 3; ++k) {
                const double m = world_from_image[f][4 * k + (part == 0 ? 3 : part - 1)];
                const double v = part == 0 ? (m - low[k]) / spacing : m / spacing;
                if (!(std::abs(v) < 268435456.0))
                    throw Error(ErrorCode::invalid, "sweep: a pose lies too far from the volume for this spacing");
                out[f][3 * part + k] = std::int64_t(std::rint(v * 4294967296.0));
            }
    return out;
}

Box bounds(const Poses& world_from_image, const FrameShape& s) {
    int left = 0, right = s.width - 1, top = 0, bottom = s.height - 1;
    if (s.mask) {
        left = s.width, right = -1, top = s.height, bottom = -1;
        for (int y = 0; y < s.height; ++y)
            for (int x = 0; x < s.width; ++x)
                if (s.mask[std::size_t(y) * s.width + x]) {
                    left = std::min(left, x), right = std::max(right, x);
                    top = std::min(top, y), bottom = std::max(bottom, y);
                }
        if (right < 0) throw Error(ErrorCode::invalid, "mask: expected pixels that count, got none");
    }
    Box box{{kInfinity, kInfinity, kInfinity}, {-kInfinity, -kInfinity, -kInfinity}};
    for (const Matrix4& m : world_from_image)
        for (const int x : {left, right})
            for (const int y : {top, bottom})
                for (int k = 0; k < 3; ++k) {
                    const double at = m[4 * k] * x + m[4 * k + 1] * y + m[4 * k + 2] * 0.0 + m[4 * k + 3];
                    box.low[k] = std::min(box.low[k], at);
                    box.high[k] = std::max(box.high[k], at);
                }
    return box;
}

VoxelGrid make_grid(Box box, std::optional<double> spacing, std::optional<int> size, const std::optional<Box>& region,
    const Vec3& anchor) {
    if (spacing.has_value() == size.has_value())
        throw Error(
            ErrorCode::invalid, std::string("spacing, size: expected one of them, got ") + (size ? "both" : "neither"));
    if (region) {
        box = *region;
        for (int k = 0; k < 3; ++k)
            if (!(std::isfinite(box.low[k]) && std::isfinite(box.high[k]) && box.low[k] < box.high[k]))
                refuse("region", "two finite corners, low below high", text(box.low) + " and " + text(box.high));
    }
    const Vec3 extent = box.high - box.low;
    double edge, n[3];
    Vec3 corner;
    if (size) {
        const double wanted = whole("size", *size, 1, int(kMaxAxis)),
                     slack = region ? 1.0 : 1 + 1e-6;  // so that the last pixels lie inside
        edge = std::max({extent[0] * slack / wanted, extent[1] * slack / wanted, extent[2] * slack / wanted});
        if (!(edge > 0)) throw Error(ErrorCode::invalid, "size: all pixels lie at one place, give a spacing");
        for (int k = 0; k < 3; ++k) {
            n[k] = std::max(std::ceil(extent[k] / edge - 1e-9), 1.0);
            corner[k] = region ? box.low[k] : 0.5 * (box.low[k] + box.high[k]) - 0.5 * n[k] * edge;
        }
    } else {
        edge = positive("spacing", *spacing);
        for (int k = 0; k < 3; ++k) {
            const double face = anchor[k] - 0.5 * edge;
            const auto first = [&](double p) {
                return region ? std::ceil((p - anchor[k]) / edge - 1e-6) : std::floor((p - face) / edge + 1e-9);
            };
            n[k] = region ? std::max(first(box.high[k]) - first(box.low[k]), 1.0)
                          : first(box.high[k]) - first(box.low[k]) + 1;
            corner[k] = face + first(box.low[k]) * edge;
        }
    }
    VoxelGrid grid{corner, edge, {}};
    for (int k = 0; k < 3; ++k) {
        if (!(n[k] <= double(kMaxAxis)))
            refuse("spacing", "at most " + std::to_string(kMaxAxis) + " voxels along an axis", text(n[k]));
        grid.size[k] = std::int64_t(n[k]);
    }
    return grid;
}

bool crowded(const std::vector<FixedPose>& poses, const FrameShape& s) {
    // A plane meets a voxel in a disc of diameter sqrt 3 at most; rows and columns fit into that as their distances
    // allow.
    const double whole = double(s.height) * s.width;
    double sum = 0;
    for (const FixedPose& p : poses) {
        Vec3 x, y;
        for (int k = 0; k < 3; ++k) x[k] = double(p[3 + k]) / 4294967296.0, y[k] = double(p[6 + k]) / 4294967296.0;
        const double column = norm(x), row = norm(cross(x, y)) / column;
        const double bound = (std::sqrt(3.0) / column + 1) * (std::sqrt(3.0) / row + 1);
        sum += std::isfinite(bound) ? std::min(bound, whole) : whole;
    }
    return sum >= 16777216.0;
}

namespace {

/// Memory that a reconstruction takes besides the frames, at most, bytes; voxels so many times larger.
double estimate(const VoxelGrid& grid, const std::vector<FixedPose>& poses, double times, const FrameShape& s,
    std::size_t item, ReconstructionMethod method) {
    using enum ReconstructionMethod;
    const double n = grid.n_voxels(), pixels = double(poses.size()) * s.height * s.width;
    double blocks = 1;
    for (const std::int64_t k : grid.size) blocks *= double((k + 3) / 4);
    const double dense = n * double(item + 1) + blocks * 24;
    if (method == pvn) return dense + n * double(17 + item);
    const double points = method == vvn || method == vvn_om ? pixels * double(36 + item) : 0;
    if (method == vvn) return dense + points + 8 * n;
    // A frame's plane crosses at most about three blocks for each block that its face covers.
    double touched = 0;
    for (const FixedPose& p : poses) {
        double step[2] = {};
        for (int k = 0; k < 6; ++k)
            step[k / 3] = std::max(step[k / 3], std::abs(double(p[3 + k])) / times / 17179869184.0);
        touched += 3 * (step[0] * s.width + 2) * (step[1] * s.height + 2);
    }
    return dense + points + std::min({blocks, touched, pixels}) * 64 * double(16 + item + 8);
}

}  // namespace

void check_memory(const VoxelGrid& grid, const std::vector<FixedPose>& poses, const FrameShape& shape, std::size_t item,
    ReconstructionMethod method, std::uint64_t available) {
    const auto needed = [&](double times) {
        return estimate(times == 1 ? grid : grid.coarser(times), poses, times, shape, item, method);
    };
    const double least = needed(1), there = double(available);
    if (!available || least <= there) return;
    constexpr double kMostTimes = 1e5;
    double times = std::cbrt(least / there);
    while (needed(times) > 0.95 * there && times < kMostTimes) times *= 1.05;
    std::string size;
    for (const std::int64_t k : grid.size) size += (size.empty() ? "" : " x ") + std::to_string(k);
    throw Error(ErrorCode::memory, "spacing: " + size + " voxels at " + text(grid.spacing) + " mm need up to " +
                                       text(least / 1073741824.0) + " GiB, " + text(there / 1073741824.0) +
                                       " GiB are free; " +
                                       (times >= kMostTimes ? std::string("no spacing would fit, take fewer frames")
                                                            : text(grid.spacing * times * 1.005) + " mm would fit"));
}

std::uint64_t free_host_bytes() {
    std::ifstream file("/proc/meminfo");
    for (std::string line; std::getline(file, line);)
        if (line.starts_with("MemAvailable:")) return 1024 * std::strtoull(line.c_str() + 13, nullptr, 10);
    return 0;
}

}  // namespace globule
