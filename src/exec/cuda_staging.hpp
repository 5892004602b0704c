// Copies between ordinary host memory and the device.  Large ones: some threads fill or empty page-locked parts
// while the device copies others, which is several times as fast as leaving it to the driver.  Small ones go through
// a page-locked room too, since the driver waits for the device before it takes anything from ordinary memory.
#pragma once
#include <algorithm>
#include <bit>
#include <cstring>
#include <iterator>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "base/scalar.hpp"
#include "exec/copy_crew.hpp"
#include "exec/cuda_check.hpp"

namespace globule::core {

/// Page-locked rooms of one size that copies take turns in, with the events that say when each is free again.
struct CopyRooms {
    static constexpr std::size_t kRoom = 1 << 20, kRooms = 16;

    char* room(std::size_t k) const { return memory + k % kRooms * kRoom; }
    bool is_done(std::size_t k) const {
        const cudaError_t status = cudaEventQuery(done[k % kRooms]);
        if (status != cudaErrorNotReady) check(status);
        return status == cudaSuccess;
    }
    void wait_for_all() const {
        for (cudaEvent_t e : done) check(cudaEventSynchronize(e));
    }

    CopyRooms(void* pinned, int its_device) : memory(static_cast<char*>(pinned)), device(its_device) {}
    CopyRooms(const CopyRooms&) = delete;
    CopyRooms& operator=(const CopyRooms&) = delete;
    ~CopyRooms() {
        for (cudaEvent_t e : done)
            if (e) cudaEventDestroy(e);
        if (ready) cudaEventDestroy(ready);
        if (copies) cudaStreamDestroy(copies);
        cudaFreeHost(memory);
    }

    char* memory;
    int device;            ///< of the events and the stream
    std::size_t last = 0;  ///< event that was recorded last
    cudaEvent_t done[kRooms] = {};
    cudaEvent_t ready = nullptr;  ///< what the caller's stream did before an upload
    cudaStream_t copies = nullptr;
};

/// Rooms are held for one copy and kept for the next, whoever makes it: locking takes longer than most copies, and so
/// there are as many as copies at one time.
class SharedRooms {
public:
    struct GiveBack {
        void operator()(CopyRooms* rooms) const {
            SharedRooms& all = instance();
            const std::lock_guard lock(all.mutex_);
            all.free_.push_back(rooms);
        }
    };
    using Lease = std::unique_ptr<CopyRooms, GiveBack>;

    /// Null where there is no page-locked memory to be had.
    static Lease take() {
        int device = 0;
        check(cudaGetDevice(&device));
        SharedRooms& all = instance();
        {
            const std::lock_guard lock(all.mutex_);
            for (auto it = all.free_.rbegin(); it != all.free_.rend(); ++it)
                if ((*it)->device == device) {
                    Lease found(*it);
                    all.free_.erase(std::next(it).base());
                    return found;
                }
        }
        void* memory = nullptr;
        if (cudaHostAlloc(&memory, CopyRooms::kRooms * CopyRooms::kRoom, cudaHostAllocPortable) != cudaSuccess) {
            cudaGetLastError();
            return nullptr;
        }
        auto made = std::make_unique<CopyRooms>(memory, device);
        for (cudaEvent_t& e : made->done) check(cudaEventCreateWithFlags(&e, cudaEventDisableTiming));
        check(cudaEventCreateWithFlags(&made->ready, cudaEventDisableTiming));
        check(cudaStreamCreateWithFlags(&made->copies, cudaStreamNonBlocking));
        return Lease(made.release());
    }

private:
    /// Never destroyed: the driver may be gone before static objects are.
    static SharedRooms& instance() {
        static SharedRooms* all = new SharedRooms;
        return *all;
    }
    std::mutex mutex_;
    std::vector<CopyRooms*> free_;
};

/// Page-locked memory of any size for images on their way to the caller, who keeps it for as long as he likes.  What
/// comes back waits for the next of about its size; when too much is out, the caller uses memory of his own.
class PinnedImages {
public:
    /// Null where there is none to be had.
    static void* take(std::size_t bytes) {
        bytes = room_for(bytes);
        PinnedImages& all = instance();
        const std::lock_guard lock(all.mutex_);
        for (auto it = all.free_.begin(); it != all.free_.end(); ++it)
            if (it->second == bytes) {
                void* room = it->first;
                all.free_.erase(it);
                return room;
            }
        while (all.bytes_ + bytes > kMost && !all.free_.empty()) {
            cudaFreeHost(all.free_.back().first);
            all.bytes_ -= all.free_.back().second;
            all.free_.pop_back();
        }
        if (all.bytes_ + bytes > kMost) return nullptr;
        void* room = nullptr;
        if (cudaHostAlloc(&room, bytes, cudaHostAllocPortable) != cudaSuccess) {
            cudaGetLastError();
            return nullptr;
        }
        all.bytes_ += bytes;
        return room;
    }
    static void give_back(void* room, std::size_t bytes) {
        PinnedImages& all = instance();
        const std::lock_guard lock(all.mutex_);
        all.free_.emplace_back(room, room_for(bytes));
    }

private:
    static constexpr std::size_t kMost = 512u << 20, kLeast = 64 << 10;
    /// Images of many sizes share rooms of few, a quarter larger at most.
    static std::size_t room_for(std::size_t bytes) {
        const std::size_t step = std::max(kLeast, std::bit_floor(bytes) / 4);
        return ceil_div(bytes, step) * step;
    }
    /// Never destroyed: the driver may be gone before static objects are.
    static PinnedImages& instance() {
        static PinnedImages* all = new PinnedImages;
        return *all;
    }
    std::mutex mutex_;
    std::vector<std::pair<void*, std::size_t>> free_;
    std::size_t bytes_ = 0;  ///< all that was taken from the system
};

/// What has to be copied between host and device, cut so that it fits a room.
struct StagedPart {
    char* host;
    char* device;
    std::size_t bytes;
};

class Staging {
public:
    Staging() = default;
    Staging(const Staging&) = delete;
    Staging& operator=(const Staging&) = delete;
    ~Staging() {
        if (small_) cudaFreeHost(small_);
    }

    /// Host memory may be reused when this returns. Calls arrived(bytes) whenever more of it is on its way: work given
    /// to the stream then finds so much of it there. Copies have a stream of their own, not to wait for that work.
    template <class Arrived>
    void upload(void* to, const void* from, std::size_t bytes, cudaStream_t stream, Arrived& arrived) {
        if (char* room = small_room(bytes, stream)) {
            std::memcpy(room, from, bytes);
            check(cudaMemcpyAsync(to, room, bytes, cudaMemcpyHostToDevice, stream));
            return arrived(bytes);
        }
        const SharedRooms::Lease rooms = SharedRooms::take();
        if (!rooms) {
            check(cudaMemcpyAsync(to, from, bytes, cudaMemcpyHostToDevice, stream));
            check(cudaStreamSynchronize(stream));  // from page-locked memory the driver copies when it gets there
            return arrived(bytes);
        }
        if (bytes < kWorth) {
            const std::size_t k = (rooms->last + 1) % kRooms;
            check(cudaEventSynchronize(rooms->done[k]));
            std::memcpy(rooms->room(k), from, bytes);
            check(cudaMemcpyAsync(to, rooms->room(k), bytes, cudaMemcpyHostToDevice, stream));
            check(cudaEventRecord(rooms->done[rooms->last = k], stream));
            return arrived(bytes);
        }
        std::vector<StagedPart> parts;
        add_parts(parts, const_cast<void*>(from), to, bytes);
        rooms->wait_for_all();
        check(cudaEventRecord(rooms->ready, stream));
        check(cudaStreamWaitEvent(rooms->copies, rooms->ready));
        CopyCrew crew(parts.size(), kRoom);
        std::size_t sent = 0, there = 0;
        crew.run([](int, int) {},
            [&](std::size_t k, std::size_t first, std::size_t end) {
                if (first < parts[k].bytes)
                    std::memcpy(rooms->room(k) + first, parts[k].host + first, min(end, parts[k].bytes) - first);
            },
            [&] {
                while (crew.limit() < parts.size() &&
                       (crew.limit() < kRooms || (crew.limit() < sent + kRooms && rooms->is_done(crew.limit()))))
                    crew.allow_next();
                if (crew.is_copied(sent)) {
                    const StagedPart& part = parts[sent];
                    check(cudaMemcpyAsync(
                        part.device, rooms->room(sent), part.bytes, cudaMemcpyHostToDevice, rooms->copies));
                    check(cudaEventRecord(rooms->done[rooms->last = sent++ % kRooms], rooms->copies));
                    check(cudaStreamWaitEvent(stream, rooms->done[rooms->last]));
                    arrived(there += part.bytes);
                }
                return sent == parts.size();
            });
    }
    void upload(void* to, const void* from, std::size_t bytes, cudaStream_t stream) {
        Nothing nothing;
        upload(to, from, bytes, stream, nothing);
    }

    /// Complete when this returns.
    void download(void* to, const void* from, std::size_t bytes, cudaStream_t stream) {
        if (char* room = small_room(bytes, stream)) {
            check(cudaMemcpyAsync(room, from, bytes, cudaMemcpyDeviceToHost, stream));
            check(cudaStreamSynchronize(stream));
            std::memcpy(to, room, bytes);
            small_used_ = 0;
            return;
        }
        std::vector<StagedPart> parts;
        add_parts(parts, to, const_cast<void*>(from), bytes);
        if (bytes >= kWorth && download(parts, stream)) return;
        check(cudaMemcpyAsync(to, from, bytes, cudaMemcpyDeviceToHost, stream));
        check(cudaStreamSynchronize(stream));
    }
    /// Two arrays, both or none of which are large.
    void download(void* to, const void* from, std::size_t bytes, void* to2, const void* from2, std::size_t bytes2,
        cudaStream_t stream) {
        std::vector<StagedPart> parts;
        add_parts(parts, to, const_cast<void*>(from), bytes);
        add_parts(parts, to2, const_cast<void*>(from2), bytes2);
        if (min(bytes, bytes2) >= kWorth && download(parts, stream)) return;
        download(to, from, bytes, stream);
        download(to2, from2, bytes2, stream);
    }

private:
    static constexpr std::size_t kRoom = CopyRooms::kRoom, kRooms = CopyRooms::kRooms, kWorth = 512 << 10, kPage = 4096;
    static constexpr std::size_t kSmall = 16 << 10, kSmallRoom = 64 << 10;
    struct Nothing {
        void operator()(std::size_t) const {}
    };

    static void add_parts(std::vector<StagedPart>& parts, void* host, void* device, std::size_t bytes) {
        for (std::size_t at = 0; at < bytes; at += kRoom)
            parts.push_back({static_cast<char*>(host) + at, static_cast<char*>(device) + at, min(kRoom, bytes - at)});
    }
    /// False where there is no page-locked memory to be had.
    static bool download(const std::vector<StagedPart>& parts, cudaStream_t stream) {
        const SharedRooms::Lease rooms = SharedRooms::take();
        if (!rooms) return false;
        rooms->wait_for_all();
        CopyCrew crew(parts.size(), kRoom);
        std::size_t asked = 0, out = 0;
        // The system gives the pages of new host memory while the device is busy.
        crew.run(
            [&](int thread, int threads) {
                for (std::size_t k = thread; k < parts.size(); k += threads)
                    for (std::size_t at = 0; at < parts[k].bytes; at += kPage)
                        static_cast<volatile char*>(parts[k].host)[at] = 0;
            },
            [&](std::size_t k, std::size_t first, std::size_t end) {
                if (first < parts[k].bytes)
                    std::memcpy(parts[k].host + first, rooms->room(k) + first, min(end, parts[k].bytes) - first);
            },
            [&] {
                while (out < asked && crew.is_copied(out)) ++out;
                for (; asked < parts.size() && asked < out + kRooms; ++asked) {
                    check(cudaMemcpyAsync(
                        rooms->room(asked), parts[asked].device, parts[asked].bytes, cudaMemcpyDeviceToHost, stream));
                    check(cudaEventRecord(rooms->done[rooms->last = asked % kRooms], stream));
                }
                while (crew.limit() < asked && rooms->is_done(crew.limit())) crew.allow_next();
                return out == parts.size();
            });
        return true;
    }

    /// Page-locked room for few bytes, free until the stream has been waited for; null where bytes are many.
    char* small_room(std::size_t bytes, cudaStream_t stream) {
        if (bytes == 0 || bytes > kSmall) return nullptr;
        if (!small_ &&
            cudaHostAlloc(reinterpret_cast<void**>(&small_), kSmallRoom, cudaHostAllocPortable) != cudaSuccess) {
            cudaGetLastError();
            small_ = nullptr;
            return nullptr;
        }
        if (small_used_ + bytes > kSmallRoom) {
            check(cudaStreamSynchronize(stream));
            small_used_ = 0;
        }
        char* room = small_ + small_used_;
        small_used_ += ceil_div<std::size_t>(bytes, 64) * 64;
        return room;
    }
    char* small_ = nullptr;
    std::size_t small_used_ = 0;
};

}  // namespace globule::core
