// The cells of trace/cells.hpp, from the octree: a group a brick gathers the particles that reach it
// and bounds the field in each cell from their nearest and farthest points.
#pragma once
#include "exec/bits.hpp"
#include "field/kernels.hpp"
#include "trace/gather.hpp"
#include "trace/plan_cells.hpp"
#include "trace/stretched.hpp"

namespace globule::core {

inline constexpr std::uint32_t kAlmostFull = kListed + 1;  ///< of classify(), until look_closer()
inline constexpr float kAlmost = 0.4f;                     ///< bounds over a whole cell give so much of the threshold
inline constexpr float kCloseBy =
    0.2f;  ///< in supports: particles no farther away tell a full brick (docs/design/cells.md)

template <class Lanes, class Kernel, bool PerParticle> struct BuildCells {
    template <class Group>
    struct Scratch : TileScratch<Group, std::conditional_t<PerParticle, BallCandidate, AlikeCandidate>> {
        CellList cell[kBrickCells];  ///< n: particles that reach; first: state until lists have places
    };
    static constexpr int kStride = block_stride(PerParticle, Kernel::stretched);

    Tree tree;
    SortedParticles particles;
    Kernel kernel;
    float tau;  ///< over the common weight unless PerParticle
    CellGrid* grid;
    std::uint32_t* bricks;
    const std::uint32_t* next;  ///< bricks to be looked at
    CellList* lists;
    float* blocks;
    std::uint32_t max_lists, max_blocks;

    template <class Group> GB_FN void operator()(Group& g, Scratch<Group>& scratch, std::size_t i) const {
        if (i >= grid->n_next) return;
        const std::uint32_t brick = next[i];
        g.sync();
        const float3 lo = corner(brick);
        const std::uint32_t state = is_deep_inside(g, scratch, lo) ? kFull : lay_out(g, scratch, lo);
        if (g.is_first()) bricks[brick] = state;
    }

private:
    GB_FN static constexpr int cube(int v) { return v * v * v; }

    GB_FN float3 corner(std::size_t brick) const {
        const int x = int(brick % grid->nx), y = int(brick / grid->nx % grid->ny), z = int(brick / grid->nx / grid->ny);
        const float span = kBrick * grid->edge;
        return {grid->lo.x + x * span, grid->lo.y + y * span, grid->lo.z + z * span};
    }

    /// Whether the particles in the brick and close to it alone fill it: most bricks need no others.
    template <class Group> GB_FN bool is_deep_inside(Group& g, Scratch<Group>& scratch, const float3& lo) const {
        if constexpr (PerParticle) {
            return false;
        } else {
            const int n = collect(g, scratch, lo, kBrick * grid->edge, kCloseBy);
            return n > 0 && classify(g, scratch, kBrick, n) == kFull;
        }
    }

    /// Cells and lists of the brick at lo; returns its state.  Where more particles reach it than the scratch holds,
    /// by parts of it.
    template <class Group> GB_FN std::uint32_t lay_out(Group& g, Scratch<Group>& scratch, const float3& lo) const {
        std::uint32_t place = kUnlisted;
        int size = kBrick;  // of a part, in cells
        for (int part = 0; part < cube(kBrick / size); ++part) {
            const int per = kBrick / size;
            const int x = part % per * size, y = part / per % per * size, z = part / (per * per) * size;
            const float3 from{lo.x + x * grid->edge, lo.y + y * grid->edge, lo.z + z * grid->edge};
            const int n = collect(g, scratch, from, size * grid->edge);
            if (n < 0 && size > 1) {
                size /= 2;
                part = -1;
                continue;
            }
            std::uint32_t alike = n < 0 ? kUnlisted : classify(g, scratch, size, n);
            if (alike == kListed) alike = look_closer(g, scratch, size, n);
            if (size == kBrick && alike <= kFull) return alike;
            if (place == kUnlisted) place = kListed + take(g, &grid->n_lists, 1);
            if (place - kListed >= max_lists) return kUnlisted;
            CellList* first = lists + std::size_t(place - kListed) * kBrickCells + (z * kBrick + y) * kBrick + x;
            write_cells(g, scratch, first, size, n);
        }
        return place;
    }

    /// A part's cells, the first of which is `first`, as classify() left them in the scratch; n < 0: it could not be
    /// told.
    template <class Group>
    GB_FN void write_cells(Group& g, Scratch<Group>& scratch, CellList* first, int size, int n) const {
        for (int c = 0; c < cube(size); ++c) {
            const CellList found = n < 0 ? CellList{kUnlisted, 0, 0, 0} : scratch.cell[c];
            const CellList written =
                found.first == kListed ? list(g, scratch, size, c, n, found) : CellList{found.first, 0, 0, 0};
            const int x = c % size, y = c / size % size, z = c / (size * size);
            if (g.is_first()) first[(z * kBrick + y) * kBrick + x] = written;
        }
    }

    /// One lane takes n from the counter; all lanes know where it begins.
    template <class Group> GB_FN static std::uint32_t take(Group& g, std::uint32_t* counter, std::uint32_t n) {
        return g.from_first([&] { return atomic_take(counter, n); });
    }

    /// Particles whose support, or with `share` the inner part of it, meets the cube at `corner`, relative to its
    /// middle, scaled; -1: too many.
    template <class Group>
    GB_FN int collect(Group& g, Scratch<Group>& scratch, const float3& corner, float edge, float share = 1.0f) const {
        using F = typename Group::F;
        using B = typename Group::B;
        const float scale = 1.0f / tree.header->typical_support;
        const F half(0.5f * edge);
        const float3 at{corner.x + 0.5f * edge, corner.y + 0.5f * edge, corner.z + 0.5f * edge};
        const float slack = grid->slack * edge;
        // Nodes' boxes hold whole supports.
        const float more = slack - (PerParticle ? 0.0f : (1.0f - share) * particles.support.uniform);
        const float3 lo = corner - float3{more, more, more},
                     hi = corner + float3{edge + more, edge + more, edge + more};
        int n = 0;
        bool room = true;
        walk_tree(
            g, scratch.stack, tree,
            [&](const B& lanes, const Boxes<Group>& b) {
                return lanes & (b.lo[0] <= F(hi.x)) & (b.hi[0] >= F(lo.x)) & (b.lo[1] <= F(hi.y)) &
                       (b.hi[1] >= F(lo.y)) & (b.lo[2] <= F(hi.z)) & (b.hi[2] >= F(lo.z));
            },
            [&](const B& leaves, const Boxes<Group>& boxes) {
                room = list_particles(g, scratch, particles, at, scale, leaves, boxes, n,
                    [&](const B& present, const F& x, const F& y, const F& z, const F& a, std::uint32_t) {
                        const F reach = (PerParticle ? a : a * F(share)) + F(slack);
                        const F nx = max(abs(x) - half, F(0.0f)), ny = max(abs(y) - half, F(0.0f)),
                                nz = max(abs(z) - half, F(0.0f));
                        return present & (a > F(0.0f)) & (nx * nx + ny * ny + nz * nz < reach * reach);
                    });
                return room;
            });
        g.sync();
        return room ? n : -1;
    }

    /// Bounds the field in each of size^3 cells.  Returns kEmpty or kFull where all are, else kListed.
    template <class Group> GB_FN std::uint32_t classify(Group& g, Scratch<Group>& scratch, int size, int n) const {
        using F = typename Group::F;
        using B = typename Group::B;
        const float edge = grid->edge / tree.header->typical_support, half = (0.5f + grid->slack) * edge;
        const float margin = 1e-4f * (tau + 1.0f);
        bool all_empty = true, all_full = true;
        for (int first = 0; first < cube(size); first += Group::width) {
            F cx(0.0f), cy(0.0f), cz(0.0f);
            const B cells = g.first_lanes(min(cube(size) - first, int(Group::width)));
            g.for_lanes([&](int lane) {
                const int c = first + g.lane_number(lane);
                Group::put(cx, lane, (float(c % size) + 0.5f - 0.5f * size) * edge);
                Group::put(cy, lane, (float(c / size % size) + 0.5f - 0.5f * size) * edge);
                Group::put(cz, lane, (float(c / (size * size)) + 0.5f - 0.5f * size) * edge);
            });
            F low(0.0f), high(0.0f), count(0.0f);
            // Every eighth particle, eight times: cells deep inside are full long before the last.
            for (int turn = 0; turn < 8; ++turn) {
                for (int j = turn; j < n; j += 8) {
                    const float3 q = scratch.list.point(j);
                    const F near = bound(low, high, F(q.x) - cx, F(q.y) - cy, F(q.z) - cz, half,
                        scratch.shape[j].inverse_a2, scratch.shape[j].weight, scratch.list.number(j));
                    count += select(near < F(1.0002f), F(1.0f), F(0.0f));
                }
                if (!PerParticle && !g.any(cells & (low <= F(tau + margin)))) break;
            }
            const B empty = cells & (high < F(tau - margin)), full = cells & (low > F(tau + margin));
            g.per_lane(cells, [&](int lane) {
                const std::uint32_t state = Group::get(empty, lane)                 ? kEmpty
                                            : Group::get(full, lane)                ? kFull
                                            : Group::get(low, lane) > kAlmost * tau ? kAlmostFull
                                                                                    : kListed;
                scratch.cell[first + g.lane_number(lane)] = {state, std::uint32_t(Group::get(count, lane)), 0, 0};
            });
            all_empty = all_empty && !g.any(cells & !empty);
            all_full = all_full && !g.any(cells & !full);
        }
        g.sync();
        return all_empty ? kEmpty : all_full ? kFull : kListed;
    }

    /// Writes cell c's particles to blocks of their own; found: as classify() counted them.
    template <class Group>
    GB_FN CellList list(Group& g, Scratch<Group>& scratch, int size, int c, int n, const CellList& found) const {
        using F = typename Group::F;
        using B = typename Group::B;
        constexpr int W = Lanes::width;
        const std::uint32_t wanted = found.n,
                            n_blocks = ceil_div<std::uint32_t>(wanted, W * Lanes::list_unit) * Lanes::list_unit;
        const std::uint32_t first = take(g, &grid->n_blocks, n_blocks);
        if (first + n_blocks > max_blocks || wanted == 0) return {kUnlisted, 0, 0, 0};
        float* to = blocks + std::size_t(first) * (W * kStride);
        const float edge = grid->edge / tree.header->typical_support, half = (0.5f + grid->slack) * edge;
        const float3 at{(float(c % size) + 0.5f - 0.5f * size) * edge,
            (float(c / size % size) + 0.5f - 0.5f * size) * edge,
            (float(c / (size * size)) + 0.5f - 0.5f * size) * edge};
        int filled = 0;
        for (int j = 0; j < n; j += Group::width) {
            const Vec3<F> q = scratch.list.points(g, j);
            const F x = q.x - F(at.x), y = q.y - F(at.y), z = q.z - F(at.z);
            const F nx = max(abs(x) - F(half), F(0.0f)), ny = max(abs(y) - F(half), F(0.0f)),
                    nz = max(abs(z) - F(half), F(0.0f));
            const F i2 = g.map([&](int k) { return j + k < n ? scratch.shape[j + k].inverse_a2 : 0.0f; });
            F least_x = (nx * nx + ny * ny + nz * nz) * i2;
            Sym3<F> form;  // the square of an ellipsoid's matrix
            if constexpr (Kernel::stretched) {
                F m[6], most_x;
                for (int c = 0; c < 6; ++c)
                    m[c] = g.map(
                        [&](int k) { return j + k < n ? kernel.component(scratch.list.number(j + k), c) : 0.0f; });
                const Sym3<F> matrix{m[0], m[1], m[2], m[3], m[4], m[5]};
                range_in_cube(matrix, Vec3<F>{x, y, z}, half, least_x, most_x);
                form = square(matrix);
            }
            const B near = g.first_lanes(min(n - j, int(Group::width))) & (least_x < F(1.0002f));
            filled = g.append(near, filled, [&](int k, int place) {
                if (place >= int(n_blocks) * W) return;  // rounding: it only just does not reach
                float* block = to + std::size_t(place / W) * (W * kStride) + place % W;
                const int from = j + g.lane_number(k);
                Lanes::store(block, Group::get(x, k), Group::get(y, k), Group::get(z, k), scratch.list.number(from));
                if constexpr (PerParticle) {
                    block[4 * W] = scratch.shape[from].inverse_a2;
                    block[5 * W] = scratch.shape[from].weight;
                }
                if constexpr (Kernel::stretched) {
                    const float six[6] = {Group::get(form.xx, k), Group::get(form.yy, k), Group::get(form.zz, k),
                        Group::get(form.xy, k), Group::get(form.xz, k), Group::get(form.yz, k)};
                    for (int c = 0; c < 6; ++c) block[(6 + c) * W] = six[c];
                }
            });
        }
        filled = min(filled, int(n_blocks) * W);
        // The last blocks are filled up with particles that reach nothing.
        for (int place = filled; place % (W * Lanes::list_unit); ++place) {
            float* block = to + std::size_t(place / W) * (W * kStride) + place % W;
            Lanes::store(block, 64.0f, 64.0f, 64.0f, 0);
            if constexpr (PerParticle) {
                block[4 * W] = 1.0f;
                block[5 * W] = 0.0f;
            }
            if constexpr (Kernel::stretched)
                for (int c = 0; c < 6; ++c) block[(6 + c) * W] = c < 3 ? 1.0f : 0.0f;
        }
        if (filled == 0) return {kEmpty, 0, 0, 0};
        CellList made{first, std::uint32_t(filled), 0, 0};
        octants(g, to, edge, made);
        return made;
    }

    /// Bounds the field in the octants of a listed cell.
    template <class Group> GB_FN void octants(Group& g, const float* of, float edge, CellList& made) const {
        using F = typename Group::F;
        constexpr int W = Lanes::width;
        const float quarter = 0.25f * edge, half = (0.25f + grid->slack) * edge, margin = 1e-4f * (tau + 1.0f);
        g.sync();
        for (int first = 0; first < 8; first += Group::width) {
            const F cx = g.map([&](int lane) { return (first + lane) & 1 ? quarter : -quarter; });
            const F cy = g.map([&](int lane) { return (first + lane) & 2 ? quarter : -quarter; });
            const F cz = g.map([&](int lane) { return (first + lane) & 4 ? quarter : -quarter; });
            F low(0.0f), high(0.0f);
            for (int j = 0; j < int(made.n); ++j) {
                const float* block = of + std::size_t(j / W) * (W * kStride);
                const float* p = block + j % W;
                bound(low, high, F(p[0]) - cx, F(p[W]) - cy, F(p[2 * W]) - cz, half, PerParticle ? p[4 * W] : 1.0f,
                    PerParticle ? p[5 * W] : 1.0f, Lanes::slot(block, j % W));
            }
            const typename Group::B eight = g.first_lanes(8 - first);
            made.empty |= g.set_of(eight & (high < F(tau - margin))) << first;
            made.full |= g.set_of(eight & (low > F(tau + margin))) << first;
        }
    }

    /// Whether the octants of cells that classify() found almost full are full, so that they need no list: bounds over
    /// a whole cell cannot tell where the field inside is only twice the threshold, as a fluid's is.  Returns what
    /// classify() does.
    template <class Group> GB_FN std::uint32_t look_closer(Group& g, Scratch<Group>& scratch, int size, int n) const {
        using F = typename Group::F;
        constexpr int at_once = Group::width < 8 ? 1 : Group::width / 8;  // cells
        const float edge = grid->edge / tree.header->typical_support, quarter = 0.25f * edge,
                    half = (0.25f + grid->slack) * edge, margin = 1e-4f * (tau + 1.0f);
        bool rises = true;  // the field, by each particle
        for (int j = 0; PerParticle && j < n; ++j) rises = rises && scratch.shape[j].weight >= 0.0f;
        for (int c = 0; c < cube(size);) {
            int which[at_once], found = 0;
            bool full[at_once];
            for (; c < cube(size) && found < at_once; ++c) {
                if (scratch.cell[c].first != kAlmostFull) continue;
                which[found] = c;
                full[found++] = true;
            }
            for (int first = 0; first < 8 * found; first += Group::width) {
                F cx(0.0f), cy(0.0f), cz(0.0f), low(0.0f), high(0.0f);
                g.for_lanes([&](int lane) {
                    const int o = first + g.lane_number(lane), at = which[min(o / 8, found - 1)];
                    const auto center = [&](int cell, int upper) {
                        return (float(cell) + 0.5f - 0.5f * size) * edge + (upper ? quarter : -quarter);
                    };
                    Group::put(cx, lane, center(at % size, o & 1));
                    Group::put(cy, lane, center(at / size % size, o & 2));
                    Group::put(cz, lane, center(at / (size * size), o & 4));
                });
                const auto octants = g.first_lanes(min(8 * found - first, int(Group::width)));
                for (int turn = 0; turn < 8; ++turn) {
                    for (int j = turn; j < n; j += 8) {
                        const float3 q = scratch.list.point(j);
                        bound(low, high, F(q.x) - cx, F(q.y) - cy, F(q.z) - cz, half, scratch.shape[j].inverse_a2,
                            scratch.shape[j].weight, scratch.list.number(j));
                    }
                    if (rises && !g.any(octants & (low <= F(tau + margin)))) break;
                }
                const std::uint32_t not_full = g.set_of(octants & (low <= F(tau + margin)));
                for (int i = first / 8; i < found && 8 * i < first + Group::width;
                    ++i)  // of a group of 4 lanes half a cell
                    full[i] = full[i] && (Group::width < 8 ? not_full : not_full >> (8 * i - first) & 0xff) == 0;
            }
            g.sync();
            for (int i = 0; g.is_first() && i < found; ++i) scratch.cell[which[i]].first = full[i] ? kFull : kListed;
        }
        g.sync();
        bool all = true;
        for (int c = 0; c < cube(size); ++c) all = all && scratch.cell[c].first == kFull;
        return all ? kFull : kListed;
    }

    /// Adds one particle's bounds over cubes, it being (x, y, z) away from their centers; returns how near they come,
    /// in supports squared.
    template <class F>
    GB_FN F bound(
        F& low, F& high, const F& x, const F& y, const F& z, float half, float i2, float c, std::uint32_t slot) const {
        const F dx = abs(x), dy = abs(y), dz = abs(z);
        const F nx = max(dx - F(half), F(0.0f)), ny = max(dy - F(half), F(0.0f)), nz = max(dz - F(half), F(0.0f));
        const F fx = dx + F(half), fy = dy + F(half), fz = dz + F(half);
        F near = (nx * nx + ny * ny + nz * nz) * F(i2), far = (fx * fx + fy * fy + fz * fz) * F(i2);
        if constexpr (Kernel::stretched)
            range_in_cube(kernel.template matrix<float>(slot), Vec3<F>{x, y, z}, half, near, far);
        F most_b, least_b;
        kernel.range(min(near, F(1.0f)), min(far, F(1.0f)), least_b, most_b);
        low += F(c) * (c > 0.0f ? least_b : most_b);
        high += F(c) * (c > 0.0f ? most_b : least_b);
        return near;
    }
};

}  // namespace globule::core
