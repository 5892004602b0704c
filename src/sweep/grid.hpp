// Reconstruction from frames of one type, over any Exec.
#pragma once
#include <algorithm>
#include <exception>
#include <optional>
#include <vector>

#include "exec/buffer.hpp"
#include "sweep/bezier.hpp"
#include "sweep/between.hpp"
#include "sweep/fill_block.hpp"
#include "sweep/frames.hpp"
#include "sweep/maps.hpp"
#include "sweep/plain.hpp"
#include "sweep/fill_tile.hpp"
#include "backends/reconstructor.hpp"
#include "pipeline/arrays.hpp"

namespace globule::core {

template <class Exec, class T> class GridImpl final : public SweepGrid {
    template <class U> using Room = Buffer<U, Exec>;

public:
    explicit GridImpl(Exec& exec)
        : exec_(exec),
          frames_(exec),
          mask_(exec),
          poses_(exec),
          slots_(exec),
          wanted_(exec),
          changed_(exec),
          blocks_(exec),
          bins_(exec),
          squares_(exec),
          values_(exec),
          masks_(exec),
          near_(exec),
          tiles_(exec),
          tables_(exec),
          weights_(exec),
          out_(exec),
          radius_(exec),
          keys_(exec),
          pixels_(exec),
          places_(exec),
          point_values_(exec),
          runs_(exec),
          nearness_(exec),
          words_(exec),
          averaged_(exec),
          averaged_mask_(exec),
          planes_(exec),
          joined_(exec),
          spread_(exec),
          contrast_(exec) {}

    int device() const noexcept override { return exec_.device(); }
    void begin() override { exec_.interrupt().clear(); }
    void invalidate() noexcept override {
        all_changed_ = true;  // the dense volume is half written
        if (!changing_) return;
        changing_ = false;
        (first_ ? emptied_ : broken_) = true;
    }

    void start(const GridRequest& r) override {
        broken_ = emptied_ = false;
        const Change change(*this);
        coding_ = {sweep::Compounding(r.compounding), r.wide, r.scale};
        taken_ = curves_ = false;
        for (int i = 0; i < 4; ++i) exec_.mark(i);
        resize(r.size);
        empty();
    }

    void grow(const int size[3], const int shift[3]) override {
        using namespace sweep;
        const Change change(*this);
        const Grid old = grid_;
        resize(size);
        const Growth growth{{old.blocks[0], old.blocks[1], old.blocks[2]},
            {grid_.blocks[0], grid_.blocks[1], grid_.blocks[2]}, {shift[0], shift[1], shift[2]}};
        exec_.for_each(n_slots_, MoveSlots{growth, blocks_.data()});
        move(slots_, growth, kNone);
        if (all_changed_) return void(changed_.reserve(grid_.n_blocks()));
        move(masks_, growth, std::uint64_t(0));
        move(changed_, growth, 0u);
        if constexpr (Exec::on_device) {
            Room<T> values(exec_);
            Room<std::uint8_t> radius(exec_);
            const DenseVolume<T> larger{values.reserve(grid_.n_voxels()), radius.reserve(grid_.n_voxels())};
            set_empty(larger, 0, grid_.n_voxels());
            copy_box({old, kept(), {}}, {grid_, larger, {kBlock * shift[0], kBlock * shift[1], kBlock * shift[2]}},
                old.size);
            values.swap(out_);
            radius.swap(radius_);
        } else {
            move(tiles_,
                {{tile_columns(old), old.blocks[1], old.blocks[2]},
                    {tile_columns(grid_), grid_.blocks[1], grid_.blocks[2]},
                    {shift[0] * kBlock / kTile, shift[1], shift[2]}},
                kNone);
        }
    }

    void add(const FramesView& view, int sign) override {
        const typename Exec::Stage stage("bin images");
        const Change change(*this, n_slots_ == 0);  // what is added first can be dropped
        const sweep::Images<T> frames = bring(view, false);
        exec_.mark(0);
        std::uint32_t* wanted = sign > 0 ? wanted_list() : nullptr;
        touch(frames, wanted);
        if (wanted) exec_.exclusive_scan(grid_.n_blocks() + 1, wanted);
        BinArrived arrived{*this, frames, wanted, sign};
        const std::size_t bytes = std::size_t(frames.n) * frames.height * frames.width * sizeof(T);
        if constexpr (Exec::on_device)
            if (view.values.device == kHost) exec_.upload(frames_.data(), view.values.data, bytes, arrived);
        arrived(bytes);
        exec_.mark(1);
        let_callers_go_on(exec_, view.values);
    }

    void median(const FramesView& view) override {
        using namespace sweep;
        const Change change(*this, true);
        const Images<T> frames = bring(view);
        exec_.mark(0);
        std::uint32_t* wanted = wanted_list();
        touch(frames, wanted);
        exec_.exclusive_scan(grid_.n_blocks() + 1, wanted);
        place(wanted, 0);
        const std::size_t n = emit(frames, Keying::bins, 64);
        T* values = reserve_values();
        exec_.clear(values, n_slots_ * kVoxels * sizeof(T));
        exec_.for_each(n, TakeMedian<T>{n, keys_.data(), blocks_.data(), values, masks_.data()});
        taken_ = true;
        exec_.mark(1);
    }

    void bezier(const FramesView& view) override {
        using namespace sweep;
        const Change change(*this, true);
        const Images<T> frames = bring(view);
        exec_.mark(0);
        const std::size_t n = std::size_t(std::max(1, ceil_div(frames.n - 1, 3))) * frames.height;
        std::uint32_t* wanted = wanted_list();
        touch(frames, wanted);
        exec_.for_each(n, BezierRows<T>{frames, grid_, coding_.scale, slots_.data(), wanted, nullptr, nullptr});
        exec_.exclusive_scan(grid_.n_blocks() + 1, wanted);
        place(wanted, coding_.words());
        std::uint32_t* nearness = nearness_.reserve(n_slots_ * kVoxels);
        exec_.clear(nearness, n_slots_ * kVoxels * sizeof *nearness);
        exec_.for_each(n, BezierRows<T>{frames, grid_, coding_.scale, slots_.data(), nullptr, bins_.data(), nearness});
        exec_.for_each(
            rows(frames), BinPixelsOffCurves<T>{frames, grid_, coding_.scale, slots_.data(), nearness, bins_.data()});
        exec_.for_each(rows(frames), MarkPixels<T>{frames, grid_, slots_.data(), nearness});
        curves_ = true;
        exec_.mark(1);
    }

    void fill(FillMethod method, const FramesView& view, const FillRequest& r) override {
        using namespace sweep;
        const typename Exec::Stage stage("fill holes");
        check_whole();
        exec_.mark(2);
        const HoleTables tables = bring_tables(r);
        if (method == FillMethod::bins) return fill_bins(tables, r);
        const Change change(*this, true);
        const DenseVolume<T> out = dense(r);
        if (method == FillMethod::frames) return fill_frames(view, out, r);
        if (method == FillMethod::points) fill_points(bring(view), tables, out);
        else if (method == FillMethod::plain_bins) fill_plain_bins(bring(view), tables, out);
        else fill_plain_points(bring(view), tables, out);
        keep_between(out, r);
        deliver(r);
    }

    DenseArrays filled() override { return {out_.data(), radius_.data()}; }
    void read_filled(const int first[3], const int size[3], const DenseArrays& out) override {
        using namespace sweep;
        const Corner<T> from{grid_, kept(), {first[0], first[1], first[2]}};
        const Grid part{{size[0], size[1], size[2]}, {}};
        if constexpr (Exec::on_device) {
            if (part.n_voxels() == grid_.n_voxels()) return download(out, kept(), part);
            Room<T> values(exec_);
            Room<std::uint8_t> radius(exec_);
            const DenseVolume<T> packed{values.reserve(part.n_voxels()), radius.reserve(part.n_voxels())};
            copy_box(from, {part, packed, {}}, size);
            download(out, packed, part);
        } else {
            copy_box(from, {part, {static_cast<T*>(out.values), out.radius}, {}}, size);
        }
    }

    void count_map(std::uint32_t* out) override { scatter(out, 0u, sweep::CountOf{bins_.data()}); }
    void variance_map(const FramesView& view, float* out) override {
        const sweep::Images<T> frames = bring(view);
        std::uint64_t* squares = squares_.reserve(n_slots_ * sweep::kVoxels);
        exec_.clear(squares, n_slots_ * sweep::kVoxels * sizeof *squares);
        exec_.for_each(rows(frames), sweep::SquareRows<T>{frames, grid_, coding_.scale, slots_.data(), squares});
        scatter(out, 0.0f, sweep::VarianceOf{bins_.data(), squares, coding_.scale});
    }
    void source_map(std::uint32_t pixels, std::int32_t* out) override {
        scatter(out, -1, sweep::SourceOf{bins_.data(), pixels});
    }

    VolumeFacts facts() override {
        const std::uint64_t bytes =
            frames_.bytes() + slots_.bytes() + wanted_.bytes() + blocks_.bytes() + bins_.bytes() + squares_.bytes() +
            values_.bytes() + masks_.bytes() + near_.bytes() + tiles_.bytes() + out_.bytes() + radius_.bytes() +
            keys_.bytes() + pixels_.bytes() + places_.bytes() + point_values_.bytes() + runs_.bytes() +
            nearness_.bytes() + words_.bytes() + averaged_.bytes() + spread_.bytes() + contrast_.bytes();
        return {n_slots_, bytes, exec_.elapsed(0, 1), exec_.elapsed(2, 3)};
    }

private:
    /// While it lives, what was binned is changed: if that fails the bins are lost. Only what comes first may be
    /// stopped half way.
    class Change {
    public:
        explicit Change(GridImpl& grid, bool is_first = false) : grid_(grid) {
            grid.check_whole();
            if (!is_first) hold_.emplace(grid.exec_.interrupt());
            grid.first_ = is_first;
            grid.changing_ = true;
        }
        ~Change() {
            if (std::uncaught_exceptions() == exceptions_) grid_.changing_ = false;
        }

    private:
        GridImpl& grid_;
        int exceptions_ = std::uncaught_exceptions();
        std::optional<Interrupt::Hold> hold_;
    };
    void check_whole() {
        if (broken_) throw Stale("reconstruction: an earlier call failed half way: start again");
        if (emptied_) empty();
        emptied_ = false;
    }
    void empty() {
        n_slots_ = 0;
        all_changed_ = true;
        changed_.reserve(grid_.n_blocks());
        std::uint32_t* slots = slots_.reserve(grid_.n_blocks());
        exec_.for_each(grid_.n_blocks(), sweep::Set<std::uint32_t>{slots, sweep::kNone});
    }

    void resize(const int size[3]) {
        for (int k = 0; k < 3; ++k) {
            grid_.size[k] = size[k];
            grid_.blocks[k] = ceil_div(size[k], sweep::kBlock);
        }
    }
    template <class U> void move(Room<U>& table, const sweep::Growth& growth, U outside) {
        Room<U> moved(exec_);
        moved.reserve(growth.n_cells());
        exec_.for_each(std::size_t(growth.to[1]) * growth.to[2],
            sweep::MoveTableRow<U>{growth, table.data(), moved.data(), outside});
        moved.swap(table);
    }
    void copy_box(const sweep::Corner<T>& from, const sweep::Corner<T>& to, const int size[3]) {
        exec_.for_each(std::size_t(size[1]) * size[2], sweep::CopyRow<T>{from, to, {size[0], size[1], size[2]}});
    }
    void download(const DenseArrays& out, const sweep::DenseVolume<T>& from, const sweep::Grid& grid) {
        const std::size_t n = grid.n_voxels();
        if (out.values && out.radius)
            return exec_.download(out.values, from.values, n * sizeof(T), out.radius, from.radius, n);
        if (out.values) exec_.download(out.values, from.values, n * sizeof(T));
        if (out.radius) exec_.download(out.radius, from.radius, n);
    }
    static std::size_t rows(const sweep::Images<T>& frames) { return std::size_t(frames.n) * frames.height; }

    /// Bins frames as their pixels become available; the first time their blocks get places.
    struct BinArrived {
        GridImpl& grid;
        sweep::Images<T> frames;
        std::uint32_t* wanted;  ///< null: none are without a place
        int sign;
        int binned = 0;

        void operator()(std::size_t bytes) {
            const std::size_t image = std::size_t(frames.height) * frames.width;
            const int n = int(bytes / (image * sizeof(T)));
            if (n == binned || (n < frames.n && (n - binned) * image * sizeof(T) < kGroup)) return;
            if (wanted) grid.place(wanted, grid.coding_.words());
            wanted = nullptr;
            sweep::Images<T> some = frames;
            some.n = n - binned;
            some.values += binned * image;
            some.poses += binned;
            some.first_order += std::uint32_t(binned * image);
            grid.bin(some, sign);
            binned = n;
        }
    };
    static constexpr std::size_t kGroup =
        4 << 20;  ///< bytes of frames that are worth a kernel while others are on their way

    void bin(const sweep::Images<T>& frames, int sign) {
        const sweep::BinRows<T> bin{frames, grid_, coding_, slots_.data(), bins_.data(), sign};
        if constexpr (Exec::on_device) exec_.for_each(rows(frames) * frames.width, sweep::BinPixels<T>{bin});
        else exec_.for_each(rows(frames), bin);
    }

    /// Poses and mask, and the pixels unless only room for them is asked for, where kernels can read them.
    sweep::Images<T> bring(const FramesView& view, bool pixels = true) {
        static_assert(sizeof(sweep::Pose) == 9 * sizeof(std::int64_t));
        const std::size_t image = std::size_t(view.height) * view.width;
        const auto* poses = reinterpret_cast<const sweep::Pose*>(view.poses);
        sweep::Images<T> out{static_cast<const T*>(view.values.data), poses, view.mask, view.n, view.height, view.width,
            view.first_order};
        if (pixels || view.values.device == exec_.device() || view.values.device != kHost)
            out.values = ::globule::core::bring<Exec, T>(
                exec_, frames_, {out.values, view.values.device, view.values.stream}, view.n * image);
        else out.values = frames_.reserve(view.n * image);
        if (Exec::on_device) {
            out.poses = upload(poses_, poses, view.n);
            if (view.mask) out.mask = upload(mask_, view.mask, image);
        }
        return out;
    }
    template <class U> const U* upload(Room<U>& room, const U* from, std::size_t n) {
        U* to = room.reserve(n ? n : 1);
        exec_.upload(to, from, n * sizeof(U));
        return to;
    }

    std::uint32_t* wanted_list() {
        std::uint32_t* wanted = wanted_.reserve(grid_.n_blocks() + 1);
        exec_.clear(wanted, (grid_.n_blocks() + 1) * sizeof *wanted);
        return wanted;
    }
    /// Places for the blocks that are wanted, which have been summed up; their bins, `words` a voxel, start at 0.
    void place(std::uint32_t* wanted, int words) {
        std::uint32_t n_new;
        exec_.download(&n_new, wanted + grid_.n_blocks(), sizeof n_new);
        blocks_.keep(n_slots_, n_slots_ + n_new);
        const std::size_t before = n_slots_ * sweep::kVoxels * words, n = std::size_t(n_new) * sweep::kVoxels * words;
        bins_.keep(before, before + n);
        exec_.clear(bins_.data() + before, n * sizeof(std::uint64_t));
        exec_.for_each(
            grid_.n_blocks(), sweep::PlaceBlocks{wanted, std::uint32_t(n_slots_), slots_.data(), blocks_.data()});
        n_slots_ += n_new;
    }
    void touch(const sweep::Images<T>& frames, std::uint32_t* wanted) {
        const sweep::TouchBlocks<T> touch{frames, grid_, slots_.data(), wanted, changed_.data()};
        if constexpr (Exec::on_device) exec_.for_each(rows(frames) * frames.width, sweep::TouchPixels<T>{touch});
        else exec_.for_each(rows(frames), touch);
    }
    T* reserve_values() {
        T* values = values_.reserve(n_slots_ * sweep::kVoxels);
        std::uint64_t* masks = masks_.reserve(grid_.n_blocks());
        exec_.clear(masks, grid_.n_blocks() * sizeof *masks);
        all_changed_ = true;
        return values;
    }
    /// Values and masks from the bins; only of blocks that changed, if `some`.
    void finish(bool some) {
        if (some) values_.keep(n_finished_ * sweep::kVoxels, n_slots_ * sweep::kVoxels);
        else reserve_values();
        const sweep::FinishBlock<T> blocks{
            coding_, blocks_.data(), bins_.data(), some ? changed_.data() : nullptr, values_.data(), masks_.data()};
        exec_.for_each_tile(n_slots_, blocks);
    }

    /// What is to be filled: on the CPU the arrays that are asked for, or what is kept.
    sweep::DenseVolume<T> dense(const FillRequest& r) {
        if (!Exec::on_device) return r.values ? sweep::DenseVolume<T>{static_cast<T*>(r.values), r.radius} : kept();
        return {out_.reserve(grid_.n_voxels()), radius_.reserve(grid_.n_voxels())};
    }
    /// The volume that was filled last, in the backend's memory.
    sweep::DenseVolume<T> kept() { return {out_.data(), radius_.data(), Exec::on_device ? nullptr : tiles_.data()}; }
    void deliver(const FillRequest& r) {
        exec_.mark(3);
        if constexpr (Exec::on_device) {
            if (!r.values) return;
            download({r.values, r.radius}, kept(), grid_);
        }
    }
    sweep::HoleTables bring_tables(const FillRequest& r) {
        const int span = (r.reach + 3) / 4;
        const std::size_t row = 3 * std::size_t(r.reach) * r.reach + 1;
        host_masks_ = sweep::cube_masks(r.reach, span);
        const std::uint64_t* m = host_masks_.data();
        const std::uint32_t* w = r.weights;
        if (Exec::on_device) {
            m = upload(tables_, m, host_masks_.size());
            if (w) w = upload(weights_, w, row * row);
        }
        return {{r.reach, span, m}, w, sweep::HoleWeights(r.kind)};
    }

    /// Blocks with data within `span` blocks, or with a change; each in half of near_.
    const std::uint32_t* spread_near(int span) {
        const std::size_t n = grid_.n_blocks();
        std::uint32_t* a = near_.reserve(3 * n);
        exec_.for_each(n, sweep::HasData{masks_.data(), a});
        return spread(span, a, a + n);
    }
    const std::uint32_t* spread_changes(int span) {
        const std::size_t n = grid_.n_blocks();
        std::uint32_t* a = near_.data() + 2 * n;
        exec_.for_each(n, sweep::Copy<std::uint32_t>{changed_.data(), a});
        return spread(span, a, near_.data());
    }
    std::uint32_t* spread(int span, std::uint32_t* a, std::uint32_t* b) {
        for (int axis = 0; axis < 3; ++axis) {
            const sweep::SpreadNear each{grid_, axis, span, a, b};
            exec_.for_each_tile(std::size_t(grid_.blocks[1]) * grid_.blocks[2], each);
            std::swap(a, b);
        }
        return a;
    }

    void fill_bins(const sweep::HoleTables& tables, const FillRequest& r) {
        using namespace sweep;
        const bool keeps = !r.values, some = keeps && !all_changed_;
        all_changed_ = true;  // should anything fail from here on
        if (!taken_) finish(some);
        const std::uint32_t* near = spread_near(tables.cubes.span);
        const std::uint32_t* dirty = some ? spread_changes(tables.cubes.span) : nullptr;
        if (keeps && !Exec::on_device) add_tiles(near, some);
        const DenseVolume<T> out = dense(r);
        fill_dense({{{grid_, slots_.data(), masks_.data(), values_.data()}, tables}, out, near, dirty});
        keep_between(out, r, dirty);
        if (curves_) exec_.for_each(n_slots_ * kVoxels, LabelCurves<T>{grid_, blocks_.data(), nearness_.data(), out});
        exec_.clear(changed_.data(), grid_.n_blocks() * sizeof(std::uint32_t));
        all_changed_ = taken_ || !keeps;
        n_finished_ = n_slots_;
        deliver(r);
    }
    /// Of what was filled, only what lies between data stays, or the rest is labeled.
    void keep_between(const sweep::DenseVolume<T>& out, const FillRequest& r, const std::uint32_t* dirty = nullptr) {
        using namespace sweep;
        if (r.reach == 0) return;
        Words words{ceil_div(grid_.size[0], kTile), grid_.size[1], grid_.size[2], nullptr};
        words.bits = words_.reserve(words.size());
        const MarkMeasured<T> measured{grid_, words, out};
        exec_.for_each(words.size(), measured);
        exec_.for_each(words.size(), KeepBetween<T>{measured, r.reach, r.extrapolate, dirty});
    }

    void fill_frames(const FramesView& view, const sweep::DenseVolume<T>& out, const FillRequest& r) {
        using namespace sweep;
        finish(false);
        const auto* poses = reinterpret_cast<const sweep::Pose*>(view.poses);
        const Path path(Images<T>{nullptr, poses, view.mask, view.n, view.height, view.width, 0},
            r.max_gap);  // what the host reads
        const Images<T> frames = bring(view);
        const Averaging& a = path.averaging;
        const std::size_t n_rows = std::size_t(view.n) * a.height;
        const Plane* planes = upload(planes_, path.planes.data(), path.planes.size());
        const std::uint8_t* joined = upload(joined_, path.joined.data(), path.joined.size());
        float* spread = r.spread;
        float* contrast = r.contrast;
        if (Exec::on_device && spread) {
            spread = spread_.reserve(grid_.n_voxels());
            contrast = contrast_.reserve(grid_.n_voxels());
        }
        const Bins<T> bins{grid_, slots_.data(), masks_.data(), values_.data()};
        const float right = float(double(view.width) / a.x - 0.5), bottom = float(double(view.height) / a.y - 0.5);
        const auto fill = [&](const auto* pixels, const std::uint8_t* mask) {
            using V = std::remove_const_t<std::remove_pointer_t<decltype(pixels)>>;
            using Fill = FillBetween<T, V, Exec::on_device>;
            exec_.for_each_tile(Fill::n_bricks(grid_), Fill{{pixels, mask, view.n, a.height, a.width, right, bottom},
                                                           planes, joined, bins, out, spread, contrast});
        };
        if (a.any()) {
            float* averaged = averaged_.reserve(n_rows * a.width);
            std::uint8_t* mask = frames.mask ? averaged_mask_.reserve(std::size_t(a.height) * a.width) : nullptr;
            exec_.for_each(n_rows, AverageRows<T>{frames, a, averaged, mask});
            fill(averaged, mask);
        } else {
            fill(frames.values, frames.mask);
        }
        deliver(r);
        if (Exec::on_device && spread) {
            exec_.download(r.spread, spread, grid_.n_voxels() * sizeof(float));
            exec_.download(r.contrast, contrast, grid_.n_voxels() * sizeof(float));
        }
    }
    /// Tiles for what is near data; empty at first.
    void add_tiles(const std::uint32_t* near, bool some) {
        using namespace sweep;
        const int columns = tile_columns(grid_), per_tile = kTile / kBlock;
        const std::size_t rows = std::size_t(grid_.blocks[1]) * grid_.blocks[2], before = some ? n_tiles_ : 0;
        std::uint32_t* tiles = tiles_.reserve(rows * columns);
        if (!some) std::fill_n(tiles, rows * columns, kNone);
        n_tiles_ = before;
        for (std::size_t row = 0; row < rows; ++row)
            for (int x = 0; x < grid_.blocks[0]; ++x) {
                std::uint32_t& place = tiles[row * columns + x / per_tile];
                if (place == kNone && near[row * grid_.blocks[0] + x]) place = std::uint32_t(n_tiles_++);
            }
        const std::size_t used = before * kTileVoxels, n = n_tiles_ * kTileVoxels;
        out_.keep(used, n);
        radius_.keep(used, n);
        set_empty(kept(), used, n);
    }
    void set_empty(const sweep::DenseVolume<T>& out, std::size_t from, std::size_t to) {
        exec_.clear(out.values + from, (to - from) * sizeof(T));
        exec_.for_each(to - from, sweep::Set<std::uint8_t>{out.radius + from, sweep::kFar});
    }
    void fill_dense(const sweep::FillVoxel<T>& each) {
        using namespace sweep;
        if constexpr (Exec::on_device) {
            const int reach = each.filler.tables.cubes.reach;
            if (reach == 0 || reach > FillBlock<T>::kReach)
                return exec_.for_each(grid_.n_blocks() * kVoxels, EachVoxel<FillVoxel<T>>{grid_, each});
            if (!each.dirty) set_empty(each.out, 0, grid_.n_voxels());
            exec_.for_each_tile(grid_.n_blocks(), FillBlock<T>{each});
        } else {
            if (each.filler.tables.cubes.reach == 0 && !each.out.tiles) {
                exec_.for_each_task(std::size_t(grid_.blocks[1]) * grid_.blocks[2], CopyBlockRow<T>{each});
                return;
            }
            if constexpr (!is_real<T>)
                if (each.filler.tables.cubes.reach <= FillTile<T>::kReach) {
                    exec_.for_each_tile(
                        std::size_t(tile_columns(grid_)) * grid_.blocks[1] * grid_.blocks[2], FillTile<T>{each});
                    return;
                }
            exec_.for_each_tile(grid_.n_blocks(), EachVoxel<FillVoxel<T>>{grid_, each});
        }
    }

    /// Points of all frames with keys, sorted; how many.
    std::size_t emit(const sweep::Images<T>& frames, sweep::Keying keying, int bits) {
        using namespace sweep;
        const std::size_t n_rows = rows(frames);
        std::uint32_t* offsets = runs_.reserve(n_rows + 1);
        exec_.clear(offsets, (n_rows + 1) * sizeof *offsets);
        exec_.for_each(n_rows, CountRow<T>{frames, grid_, offsets});
        exec_.exclusive_scan(n_rows + 1, offsets);
        std::uint32_t n;
        exec_.download(&n, offsets + n_rows, sizeof n);
        std::uint64_t* keys = keys_.reserve(2 * std::size_t(n));
        std::uint32_t* pixels = pixels_.reserve(2 * std::size_t(n));
        exec_.for_each(n_rows, EmitPoints<T>{frames, grid_, keying, slots_.data(), offsets, keys, pixels});
        exec_.sort_pairs(n, keys, keys + n, pixels, pixels + n, bits);
        return n;
    }
    sweep::SortedPoints<T> gather_places(const sweep::Images<T>& frames, std::size_t n) {
        float* p = places_.reserve(3 * n + 1);
        const sweep::SortedPoints<T> points{p, p + n, p + 2 * n, point_values_.reserve(n + 1)};
        exec_.for_each(n, sweep::GatherPoints<T>{frames, pixels_.data(), points});
        return points;
    }

    void fill_points(
        const sweep::Images<T>& frames, const sweep::HoleTables& tables, const sweep::DenseVolume<T>& out) {
        using namespace sweep;
        std::uint32_t* wanted = wanted_list();
        touch(frames, wanted);
        exec_.exclusive_scan(grid_.n_blocks() + 1, wanted);
        place(wanted, 0);
        int levels = 0;
        while (1 << levels < std::max({grid_.size[0], grid_.size[1], grid_.size[2]})) ++levels;
        const std::size_t n = emit(frames, Keying::morton, 3 * levels);
        const SortedPoints<T> points = gather_places(frames, n);
        reserve_values();
        const std::size_t n_bins = n_slots_ * kVoxels;
        std::uint32_t* first = runs_.reserve(2 * n_bins + 1);
        exec_.clear(first, 2 * n_bins * sizeof *first);
        exec_.for_each(n, MarkRuns{n, keys_.data(), grid_, false, slots_.data(), first, first + n_bins, masks_.data()});
        const std::uint32_t* near = spread_near(tables.cubes.span);
        const GatherVoxel<T> each{
            {{{grid_, slots_.data(), masks_.data(), nullptr}, tables}, points, first, first + n_bins}, out, near};
        const EachVoxel<GatherVoxel<T>> all{grid_, each};
        if constexpr (Exec::on_device) exec_.for_each(grid_.n_blocks() * kVoxels, all);
        else exec_.for_each_tile(grid_.n_blocks(), all);
    }

    void fill_plain_bins(
        const sweep::Images<T>& frames, const sweep::HoleTables& tables, const sweep::DenseVolume<T>& out) {
        using namespace sweep;
        const std::size_t n = grid_.n_voxels();
        std::uint64_t* bins = bins_.reserve(2 * n);
        exec_.clear(bins, 2 * n * sizeof *bins);
        exec_.for_each(rows(frames), BinPlain<T>{frames, grid_, coding_.scale, bins});
        T* values = values_.reserve(n);
        std::uint8_t* measured = mask_room(n);
        Coding coding = coding_;
        coding.wide = true;
        exec_.for_each(n, FinishPlain<T>{{coding, nullptr, bins, nullptr, nullptr, nullptr}, values, measured});
        exec_.for_each_task(n, FillPlain<T>{grid_, values, measured, tables, out});
    }
    std::uint8_t* mask_room(std::size_t n) { return reinterpret_cast<std::uint8_t*>(near_.reserve(n / 4 + 1)); }

    void fill_plain_points(
        const sweep::Images<T>& frames, const sweep::HoleTables& tables, const sweep::DenseVolume<T>& out) {
        using namespace sweep;
        int bits = 1;
        while (grid_.n_voxels() >> bits) ++bits;
        const std::size_t n = emit(frames, Keying::plain, bits);
        const SortedPoints<T> points = gather_places(frames, n);
        const std::size_t n_bins = grid_.n_voxels();
        std::uint32_t* first = runs_.reserve(2 * n_bins);
        exec_.clear(first, 2 * n_bins * sizeof *first);
        exec_.for_each(n, MarkRuns{n, keys_.data(), grid_, true, nullptr, first, first + n_bins, nullptr});
        exec_.for_each_task(
            n_bins, GatherPlain<T>{grid_, tables.cubes.reach, tables.kind, points, first, first + n_bins, out});
    }

    template <class Out, class Of> void scatter(Out* host, Out empty, const Of& of) {
        Room<Out> room(exec_);
        Out* out = Exec::on_device ? room.reserve(grid_.n_voxels()) : host;
        exec_.for_each(grid_.n_voxels(), sweep::Set<Out>{out, empty});
        exec_.for_each(n_slots_ * sweep::kVoxels, sweep::ScatterMap<Out, Of>{grid_, blocks_.data(), of, out});
        if (Exec::on_device) exec_.download(host, out, grid_.n_voxels() * sizeof(Out));
    }

    Exec& exec_;
    sweep::Grid grid_{};
    sweep::Coding coding_{};
    std::size_t n_slots_ = 0;
    bool taken_ = false;  ///< values came from a median, not from bins
    bool changing_ = false, broken_ = false;
    bool first_ = false, emptied_ = false;  ///< the change found no bins; it failed and there are none again
    bool all_changed_ = true;               ///< nothing of the last finished bins may be used
    std::size_t n_finished_ = 0;            ///< slots that had values then
    std::size_t n_tiles_ = 0;               ///< of the volume that is kept, on the CPU
    std::vector<std::uint64_t> host_masks_;
    Room<T> frames_;
    Room<std::uint8_t> mask_;
    Room<sweep::Pose> poses_;
    Room<std::uint32_t> slots_, wanted_, changed_, blocks_;
    Room<std::uint64_t> bins_, squares_;
    Room<T> values_;
    Room<std::uint64_t> masks_;
    Room<std::uint32_t> near_, tiles_;
    Room<std::uint64_t> tables_;
    Room<std::uint32_t> weights_;
    Room<T> out_;
    Room<std::uint8_t> radius_;
    Room<std::uint64_t> keys_;
    Room<std::uint32_t> pixels_;
    Room<float> places_;
    Room<T> point_values_;
    Room<std::uint32_t> runs_;
    Room<std::uint32_t> nearness_;
    bool curves_ = false;  ///< bins are of curves
    Room<std::uint64_t> words_;
    Room<float> averaged_;
    Room<std::uint8_t> averaged_mask_;
    Room<sweep::Plane> planes_;
    Room<std::uint8_t> joined_;
    Room<float> spread_, contrast_;
};

}  // namespace globule::core
