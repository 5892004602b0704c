// Large copies between ordinary host memory and the device: some threads fill or empty page-locked parts
// while the device copies others, which is several times as fast as leaving it to the driver.
#pragma once
#include <omp.h>

#include <cstring>

#include "globule/base/scalar.hpp"
#include "globule/exec/cuda_check.hpp"

namespace globule {

class Staging {
public:
    Staging() = default;
    Staging(const Staging&) = delete;
    Staging& operator=(const Staging&) = delete;
    ~Staging() {
        if (!parts_) return;
        for (cudaEvent_t e : done_) cudaEventDestroy(e);
        cudaFreeHost(parts_);
    }

    /// Host memory may be reused when this returns.
    void upload(void* to, const void* from, std::size_t bytes, cudaStream_t stream) {
        if (bytes < kWorth || !ready()) return check(cudaMemcpyAsync(to, from, bytes, cudaMemcpyHostToDevice, stream));
        for (std::size_t at = 0, k = 0; at < bytes; at += kPart, k = (k + 1) % kParts) {
            const std::size_t n = least(kPart, bytes - at);
            check(cudaEventSynchronize(done_[k]));
            copy(part(k), static_cast<const char*>(from) + at, n);
            check(cudaMemcpyAsync(static_cast<char*>(to) + at, part(k), n, cudaMemcpyHostToDevice, stream));
            check(cudaEventRecord(done_[k], stream));
        }
    }
    /// Complete when this returns.
    void download(void* to, const void* from, std::size_t bytes, cudaStream_t stream) {
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

private:
    static constexpr std::size_t kPart = 2 << 20, kParts = 4, kWorth = 8 << 20;
    static constexpr int kThreads = 4;

    char* part(std::size_t k) const { return parts_ + k * kPart; }
    /// False where there is no page-locked memory to be had.
    bool ready() {
        if (parts_) return true;
        if (cudaHostAlloc(reinterpret_cast<void**>(&parts_), kParts * kPart, cudaHostAllocDefault) != cudaSuccess) {
            cudaGetLastError();
            parts_ = nullptr;
            return false;
        }
        for (cudaEvent_t& e : done_) check(cudaEventCreateWithFlags(&e, cudaEventDisableTiming));
        return true;
    }
    static void copy(char* to, const char* from, std::size_t n) {
        const int threads = least(kThreads, omp_get_num_procs());
        const std::size_t share = ceil_div<std::size_t>(n, threads);
#pragma omp parallel for num_threads(threads) schedule(static, 1)
        for (int t = 0; t < threads; ++t)
            if (share * t < n) std::memcpy(to + share * t, from + share * t, least(share, n - share * t));
    }

    char* parts_ = nullptr;
    cudaEvent_t done_[kParts] = {};
};

}  // namespace globule
