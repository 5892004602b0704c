// Large copies by several threads, while another waits for a device on the other side of them.
#pragma once
#include <omp.h>

#include <atomic>
#include <cstdint>
#include <exception>
#include <memory>
#include <thread>

#include "base/scalar.hpp"

namespace globule::core {

/// Copies parts in small pieces by some threads that stay together until all is done, because waking them takes
/// longer than a piece. The first of them serves the device in between, and says how far the others may go.
class CopyCrew {
public:
    CopyCrew(std::size_t n_parts, std::size_t part_bytes)
        : n_(n_parts), pieces_(part_bytes / kPiece), copied_(new std::atomic<std::uint32_t>[n_parts] {}) {}

    std::size_t limit() const { return limit_.load(std::memory_order_relaxed); }
    void allow_next() { limit_.fetch_add(1, std::memory_order_release); }
    bool is_copied(std::size_t part) const { return copied_[part].load(std::memory_order_acquire) == pieces_; }

    /// prepare(thread, threads) once on each, before all else; copy(part, from, to) bytes of a part; serve() until it
    /// says that all is done.
    template <class Prepare, class Copy, class Serve>
    void run(const Prepare& prepare, const Copy& copy, const Serve& serve) {
        std::exception_ptr error;
#pragma omp parallel num_threads(min(kThreads, omp_get_num_procs()))
        {
            const int thread = omp_get_thread_num(), threads = omp_get_num_threads();
            prepare(thread, threads);
            int idle = 0;
#pragma omp barrier
            if (thread == 0) {
                try {
                    while (!serve())
                        if (threads > 2 || !copy_one(copy)) rest(idle);
                } catch (...) {
                    error = std::current_exception();
                    next_ = n_ * pieces_;
                }
            } else {
                while (next_.load(std::memory_order_relaxed) < n_ * pieces_)
                    if (!copy_one(copy)) rest(idle);
            }
        }
        if (error) std::rethrow_exception(error);
    }

private:
    static constexpr int kThreads = 8;
    static constexpr std::size_t kPiece = 128 << 10;

    template <class Copy> bool copy_one(const Copy& copy) {
        std::size_t i = next_.load(std::memory_order_relaxed);
        do {
            if (i >= n_ * pieces_ || i / pieces_ >= limit_.load(std::memory_order_acquire)) return false;
        } while (!next_.compare_exchange_weak(i, i + 1, std::memory_order_relaxed));
        const std::size_t part = i / pieces_, at = i % pieces_ * kPiece;
        copy(part, at, at + kPiece);
        copied_[part].fetch_add(1, std::memory_order_release);
        return true;
    }
    /// Others may need the core, but asking for that costs more than a short wait.
    static void rest(int& idle) {
        if (++idle % 4096 == 0) std::this_thread::yield();
    }

    std::size_t n_, pieces_;
    std::atomic<std::size_t> next_{0}, limit_{0};
    std::unique_ptr<std::atomic<std::uint32_t>[]> copied_;
};

}  // namespace globule::core
