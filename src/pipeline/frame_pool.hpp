// The memory of frames, which goes round: a frame that nobody holds any more gives its images to the next one.
#pragma once
#include <algorithm>
#include <memory>
#include <mutex>
#include <vector>

#include "pipeline/gather.hpp"

namespace globule::core {

template <class Exec> class FramePool {
public:
    explicit FramePool(std::shared_ptr<Exec> exec)
        : exec_(std::move(exec)), reader_(exec_->reader()), room_(*reader_), answer_(*reader_) {
        free_.reserve(kKept);
    }

    std::unique_ptr<FrameImages<Exec>> take() {
        {
            const std::lock_guard lock(mutex_);
            if (free_.size() >= kInTurn || (!free_.empty() && !Exec::on_device)) {  // the one that was let go first
                std::unique_ptr<FrameImages<Exec>> images = std::move(free_.front());
                free_.erase(free_.begin());
                return images;
            }
        }
        return std::make_unique<FrameImages<Exec>>(*exec_);
    }
    void give_back(std::unique_ptr<FrameImages<Exec>> images) {
        const std::lock_guard lock(mutex_);
        if (keeps_ && free_.size() < kKept) free_.push_back(std::move(images));
    }
    /// Whether images wait for the next frame, or their memory goes back when they are let go.
    void keep(bool keeps) {
        const std::lock_guard lock(mutex_);
        keeps_ = keeps;
        if (!keeps) free_.clear();
    }

    /// Frame::lend and Frame::take.
    LentPlace lend(const FrameImages<Exec>& frame, unsigned images) {
        const std::lock_guard lock(reading_);
        frame.timer.let_follow(*reader_);
        return gatherer_.lend(*reader_, frame, images);
    }
    bool take(
        const FrameImages<Exec>& frame, unsigned images, const std::vector<LentPlace>& places, const Share* dealt) {
        const std::lock_guard lock(reading_);
        frame.timer.let_follow(*reader_);
        return gatherer_.take(*reader_, frame, images, places, dealt);
    }
    /// Copies an image of a finished frame out, beside whatever the scene is doing.
    void read(const FrameImages<Exec>& images, Image image, const ArrayAt<void>& out) {
        const std::lock_guard lock(reading_);
        images.timer.let_follow(*reader_);
        const std::size_t n = images.rays.n;
        switch (image) {
            case Image::depth:
                return copy(out, images.hits().t, n * sizeof(float));
            case Image::normal:
                return copy(out, images.hits().normal, 3 * n * sizeof(float));
            case Image::albedo:
                return copy(out, images.hits().albedo, 3 * n * sizeof(float));
            case Image::color:
                return copy(out, images.color(), 3 * n * sizeof(float));
            case Image::picture:
                return copy(out, images.picture(), 3 * n);
            case Image::position: {
                float* p = room_.reserve(3 * n);
                reader_->for_each(n, HitPositions{images.rays, images.hits().t, p});
                return copy(out, p, 3 * n * sizeof(float));
            }
            case Image::layer: {
                if (!images.plain) return copy(out, images.layer(), n);
                std::uint8_t* zeros = answer_.reserve(n);
                reader_->clear(zeros, n);
                return copy(out, zeros, n);
            }
        }
    }

private:
    void copy(const ArrayAt<void>& out, const void* from, std::size_t bytes) {
        if (out.device == kHost) return reader_->download(out.data, from, bytes);
        if (out.device == kPinned) return reader_->download_direct(out.data, from, bytes);
        reader_->wait_for_caller(out.stream);
        reader_->copy(out.data, from, bytes);
        reader_->let_caller_wait(out.stream);
        reader_->synchronize();  // the images may go to another frame as soon as this one is let go
    }

    static constexpr std::size_t kKept = 4;    ///< that wait for their turn
    static constexpr std::size_t kInTurn = 2;  ///< a device may still be at work for those that were let go last

    std::shared_ptr<Exec> exec_, reader_;
    std::mutex mutex_, reading_;
    bool keeps_ = true;
    std::vector<std::unique_ptr<FrameImages<Exec>>> free_;
    Buffer<float, Exec> room_;
    Buffer<std::uint8_t, Exec> answer_;
    FrameGatherer<Exec> gatherer_;
};

/// A frame as it leaves the scene: its images stay until it is let go.
template <class Exec> class FinishedFrame final : public Frame {
public:
    FinishedFrame(std::shared_ptr<FramePool<Exec>> pool, int device)
        : pool_(std::move(pool)), images_(pool_->take()), device_(device) {}
    ~FinishedFrame() override { pool_->give_back(std::move(images_)); }

    int device() const noexcept override { return device_; }
    void read(Image image, const ArrayAt<void>& out) override { pool_->read(*images_, image, out); }
    double trace_seconds() override { return images_->timer.seconds(); }
    LentPlace lend(unsigned images) override { return pool_->lend(*images_, images); }
    bool take(unsigned images, const std::vector<LentPlace>& places, const Share* dealt) override {
        return pool_->take(*images_, images, places, dealt);
    }
    int passes() override { return images_->n_passes; }
    FrameImages<Exec>& images() const { return *images_; }

private:
    std::shared_ptr<FramePool<Exec>> pool_;
    std::unique_ptr<FrameImages<Exec>> images_;
    int device_;
};

}  // namespace globule::core
