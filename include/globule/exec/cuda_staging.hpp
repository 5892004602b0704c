// Copies between ordinary host memory and the device.  Large ones: some threads fill or empty page-locked parts
// while the device copies others, which is several times as fast as leaving it to the driver.  Small ones go through
// a page-locked room too, since the driver waits for the device before it takes anything from ordinary memory.
#pragma once
#include <omp.h>

#include <cstring>
#include <mutex>
#include <vector>

#include "globule/base/scalar.hpp"
#include "globule/exec/cuda_check.hpp"

namespace globule {

/// Page-locked rooms of one size, kept for the next that needs one: locking takes longer than most copies.
class LockedRooms {
public:
    /// Null where there is none to be had.
    static char* take(std::size_t bytes) {
        LockedRooms& all = instance();
        const std::lock_guard lock(all.mutex_);
        if (!all.free_.empty()) {
            char* room = all.free_.back();
            all.free_.pop_back();
            return room;
        }
        void* room = nullptr;
        if (cudaHostAlloc(&room, bytes, cudaHostAllocPortable) == cudaSuccess) return static_cast<char*>(room);
        cudaGetLastError();
        return nullptr;
    }
    static void give_back(char* room) {
        LockedRooms& all = instance();
        const std::lock_guard lock(all.mutex_);
        all.free_.push_back(room);
    }

private:
    /// Never destroyed: the driver may be gone before static objects are.
    static LockedRooms& instance() {
        static LockedRooms* all = new LockedRooms;
        return *all;
    }
    std::mutex mutex_;
    std::vector<char*> free_;
};

class Staging {
public:
    Staging() = default;
    Staging(const Staging&) = delete;
    Staging& operator=(const Staging&) = delete;
    ~Staging() {
        if (small_) cudaFreeHost(small_);
        if (!parts_) return;
        for (cudaEvent_t e : done_) {
            cudaEventSynchronize(e);
            cudaEventDestroy(e);
        }
        LockedRooms::give_back(parts_);
    }

    /// Host memory may be reused when this returns.
    void upload(void* to, const void* from, std::size_t bytes, cudaStream_t stream) {
        if (char* room = small_room(bytes, stream)) {
            std::memcpy(room, from, bytes);
            return check(cudaMemcpyAsync(to, room, bytes, cudaMemcpyHostToDevice, stream));
        }
        if (bytes < kWorth || !ready()) return check(cudaMemcpyAsync(to, from, bytes, cudaMemcpyHostToDevice, stream));
        for (std::size_t at = 0; at < bytes; at += kPart, next_ = (next_ + 1) % kParts) {
            const std::size_t n = least(kPart, bytes - at);
            check(cudaEventSynchronize(done_[next_]));
            copy(part(next_), static_cast<const char*>(from) + at, n);
            check(cudaMemcpyAsync(static_cast<char*>(to) + at, part(next_), n, cudaMemcpyHostToDevice, stream));
            check(cudaEventRecord(done_[next_], stream));
        }
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
        if (bytes < kWorth || !ready()) {
            check(cudaMemcpyAsync(to, from, bytes, cudaMemcpyDeviceToHost, stream));
            return check(cudaStreamSynchronize(stream));
        }
        const std::size_t n_parts = ceil_div(bytes, kPart);
        for (std::size_t i = 0; i < n_parts + kParts - 1; ++i) {
            if (i >= kParts - 1) {  // out with the oldest
                const std::size_t j = i - (kParts - 1), at = j * kPart;
                check(cudaEventSynchronize(done_[j % kParts]));
                copy(static_cast<char*>(to) + at, part(j % kParts), least(kPart, bytes - at));
            }
            if (i >= n_parts) continue;
            const std::size_t at = i * kPart;
            check(cudaMemcpyAsync(part(i % kParts), static_cast<const char*>(from) + at, least(kPart, bytes - at), cudaMemcpyDeviceToHost, stream));
            check(cudaEventRecord(done_[i % kParts], stream));
        }
    }

    /// Lets the system give the pages of new host memory, while the device is busy.
    static void touch(void* p, std::size_t bytes) {
        constexpr std::size_t page = 4096;
#pragma omp parallel for num_threads(n_threads()) schedule(static)
        for (std::size_t at = 0; at < bytes; at += page) static_cast<volatile char*>(p)[at] = 0;
    }

private:
    static constexpr std::size_t kPart = 4 << 20, kParts = 4, kWorth = 512 << 10;
    static constexpr int kThreads = 8;
    static constexpr std::size_t kSmall = 16 << 10, kSmallRoom = 64 << 10;

    /// Page-locked room for few bytes, free until the stream has been waited for; null where bytes are many.
    char* small_room(std::size_t bytes, cudaStream_t stream) {
        if (bytes == 0 || bytes > kSmall) return nullptr;
        if (!small_ && cudaHostAlloc(reinterpret_cast<void**>(&small_), kSmallRoom, cudaHostAllocPortable) != cudaSuccess) {
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
    char* part(std::size_t k) const { return parts_ + k * kPart; }
    /// False where there is no page-locked memory to be had.
    bool ready() {
        if (parts_) return true;
        parts_ = LockedRooms::take(kParts * kPart);
        if (!parts_) return false;
        for (cudaEvent_t& e : done_) check(cudaEventCreateWithFlags(&e, cudaEventDisableTiming));
        return true;
    }
    static int n_threads() { return least(kThreads, omp_get_num_procs()); }
    static void copy(char* to, const char* from, std::size_t n) {
        const int threads = n_threads();
        const std::size_t share = ceil_div<std::size_t>(n, threads);
#pragma omp parallel for num_threads(threads) schedule(static, 1)
        for (int t = 0; t < threads; ++t)
            if (share * t < n) std::memcpy(to + share * t, from + share * t, least(share, n - share * t));
    }

    char* parts_ = nullptr;
    char* small_ = nullptr;
    std::size_t small_used_ = 0;
    std::size_t next_ = 0;
    cudaEvent_t done_[kParts] = {};
};

}  // namespace globule
