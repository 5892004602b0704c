// The PLUS-exact reconstruction over any Exec.
#pragma once
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "exec/buffer.hpp"
#include "sweep/plus_fill.hpp"
#include "backends/reconstructor.hpp"
#include "pipeline/arrays.hpp"

namespace globule::core {

template <class Exec> class Plus {
public:
    explicit Plus(Exec& exec)
        : exec_(exec),
          images_(exec),
          values_(exec),
          filled_(exec),
          acc_(exec),
          poses_(exec),
          sources_(exec),
          masks_(exec),
          importance_(exec),
          origin_(exec),
          words_(exec),
          near_(exec),
          weights_(exec) {}

    void run(PlusRequest& r) {
        if (r.type == ScalarType::u8) run_as<std::uint8_t>(r);
        else if (r.type == ScalarType::u16) run_as<std::uint16_t>(r);
        else run_as<float>(r);
    }

private:
    template <class T> void run_as(PlusRequest& r) {
        using namespace plus;
        const std::size_t image = std::size_t(r.height) * r.width;
        const Grid grid{{r.size[0], r.size[1], r.size[2]}};
        Slices slices{};
        slices.n_images = r.n_frames;
        slices.height = r.height;
        slices.width = r.width;
        slices.rejects = r.rejects;
        slices.rejection = r.rejection;
        slices.slack = 0.02 + (r.width + r.height) * 0x1p-15;
        slices.poses = bring(poses_, poses(r).data(), r.n_frames);
        slices.sources = bring(sources_, r.sources, r.n_masks * image);
        slices.mask_of_image = bring(masks_, r.mask_of_frame, r.n_frames);
        slices.importance = r.importance ? bring(importance_, r.importance, image) : nullptr;
        const T* frames = static_cast<const T*>(r.frames.data);
        frames = reinterpret_cast<const T*>(::globule::core::bring<Exec, char>(exec_, images_,
            {static_cast<const char*>(r.frames.data), r.frames.device, r.frames.stream},
            r.n_frames * image * sizeof(T)));

        exec_.mark(0);
        T* values = reinterpret_cast<T*>(values_.reserve(grid.size() * sizeof(T)));
        std::uint16_t* acc = acc_.reserve(grid.size());
        exec_.clear(values, grid.size() * sizeof(T));
        exec_.clear(acc, grid.size() * sizeof(std::uint16_t));
        if (Optimization(r.optimization) == Optimization::full) insert<T, Fixed>(r, slices, frames, grid, values, acc);
        else insert<T, double>(r, slices, frames, grid, values, acc);
        exec_.mark(1);
        T* result = values;
        std::uint8_t* origin = Exec::on_device ? origin_.reserve(grid.size()) : r.origin;
        if (r.fill_holes && !r.fillers.empty()) result = fill(r, grid, values, acc, origin);
        else exec_.for_each(grid.size(), MarkMeasured{acc, origin});
        exec_.mark(2);
        exec_.download(r.values, result, grid.size() * sizeof(T));
        exec_.download(r.accumulator, acc, grid.size() * sizeof(std::uint16_t));
        if (Exec::on_device) exec_.download(r.origin, origin, grid.size());
        r.insert_seconds = exec_.elapsed(0, 1);
        r.fill_seconds = exec_.elapsed(1, 2);
    }

    template <class T, class F>
    void insert(const PlusRequest& r, const plus::Slices& slices, const T* frames, const plus::Grid& grid, T* values,
        std::uint16_t* acc) {
        using namespace plus;
        InsertBrick<T, F> task{slices, frames, grid, Exec::on_device ? 4 : 32, {}, Interpolation(r.interpolation),
            Optimization(r.optimization), Compounding(r.compounding), values, acc};
        std::size_t n = 1;
        for (int k = 0; k < 3; ++k) n *= task.n_bricks[k] = ceil_div(grid.n[k], task.edge);
        exec_.for_each_task(n, task);
    }

    template <class T>
    T* fill(
        const PlusRequest& r, const plus::Grid& grid, const T* values, const std::uint16_t* acc, std::uint8_t* origin) {
        using namespace plus;
        if (r.fillers.size() > kMaxFillers) throw Refused("HoleFilling: expected at most 16 elements");
        const int n_words = ceil_div(grid.n[0], 64);
        const std::size_t n = std::size_t(n_words) * grid.n[1] * grid.n[2];
        std::uint64_t* words = words_.reserve(n);
        std::uint64_t* near = near_.reserve(2 * n);
        T* out = reinterpret_cast<T*>(filled_.reserve(grid.size() * sizeof(T)));
        FillRow<T> task{
            {grid, values, acc}, {words, n_words, grid.n[1], grid.n[2]}, near, int(r.fillers.size()), {}, out, origin};

        std::vector<float> weights;
        for (const PlusRequest::Filler& f : r.fillers)
            weights.insert(weights.end(), f.weights.begin(), f.weights.end());
        const float* room = bring(weights_, weights.data(), weights.size());
        int reach = 0;
        for (std::size_t i = 0; i < r.fillers.size(); ++i) {
            const PlusRequest::Filler& f = r.fillers[i];
            task.fillers[i] = {FillerType(f.type), f.size, f.n_sticks, f.least_ratio, room};
            room += f.weights.size();
            reach = max(reach, task.fillers[i].reach());
        }
        exec_.for_each(n, MarkOccupied{grid, n_words, acc, words});
        MarkNear mark{task.known, reach, 0, near};
        exec_.for_each(n, mark);
        mark.rows.words = near;
        mark.out = near + n;
        mark.axis = 1;
        exec_.for_each(n, mark);
        mark.rows.words = near + n;
        mark.out = near;
        mark.axis = 2;
        exec_.for_each(n, mark);
        exec_.for_each_task(n, task);
        return out;
    }

    /// Image coordinates of a voxel: the inverse of the columns x, y and x cross y.
    static std::vector<plus::ImagePose> poses(const PlusRequest& r) {
        std::vector<plus::ImagePose> all(r.n_frames);
        for (int f = 0; f < r.n_frames; ++f) {
            const double* m = r.voxel_from_image + 12 * f;
            plus::ImagePose& pose = all[f];
            for (int k = 0; k < 3; ++k) {
                pose.x[k] = m[4 * k];
                pose.y[k] = m[4 * k + 1];
                pose.origin[k] = m[4 * k + 3];
            }
            const double *x = pose.x, *y = pose.y, *o = pose.origin;
            auto cross = [](const double* a, const double* b, double* c) {
                for (int k = 0; k < 3; ++k) c[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
            };
            double n[3], rows[3][3];
            cross(x, y, n);
            cross(y, n, rows[0]);
            cross(n, x, rows[1]);
            std::copy(n, n + 3, rows[2]);
            const double det = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
            for (int i = 0; i < 3; ++i) {
                pose.image_from_voxel[i][3] = pose.inverse_scale[i] = 0;
                for (int k = 0; k < 3; ++k) {
                    const double v = pose.image_from_voxel[i][k] = rows[i][k] / det;
                    pose.image_from_voxel[i][3] -= v * o[k];
                    pose.inverse_scale[i] += std::abs(v);
                }
            }
        }
        return all;
    }

    template <class T> const T* bring(Buffer<T, Exec>& room, const T* host, std::size_t n) {
        if constexpr (!Exec::on_device && !std::is_same_v<T, plus::ImagePose>) return host;
        T* to = room.reserve(n ? n : 1);
        exec_.upload(to, host, n * sizeof(T));
        exec_.synchronize();
        return to;
    }

    Exec& exec_;
    Buffer<char, Exec> images_, values_, filled_;
    Buffer<std::uint16_t, Exec> acc_;
    Buffer<plus::ImagePose, Exec> poses_;
    Buffer<std::int32_t, Exec> sources_;
    Buffer<std::uint32_t, Exec> masks_;
    Buffer<std::uint8_t, Exec> importance_, origin_;
    Buffer<std::uint64_t, Exec> words_, near_;
    Buffer<float, Exec> weights_;
};

}  // namespace globule::core
