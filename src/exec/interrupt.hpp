// How long work is stopped: by Ctrl-C, which a callback tells, or by a call from another thread.
#pragma once
#include <atomic>
#include <chrono>

#include "globule/poll.hpp"

namespace globule::core {

/// Thrown where work stops; what it was making is half made then.
struct Cancelled {};

/// One a backend object; its helpers on other streams share it.
class Interrupt {
public:
    explicit Interrupt(Poll* poll = nullptr) : poll_(poll) {}

    /// An entry begins: what was asked before it does not count.
    void clear() {
        stop_.store(false, std::memory_order_relaxed);
        if (poll_) next_ = Clock::now() + pause();  // short calls never ask
    }
    /// From any thread: the entry that is running is to stop.
    void request() { stop_.store(true, std::memory_order_relaxed); }

    /// For the loops of worker threads.
    bool stopped() const { return stop_.load(std::memory_order_relaxed) && !held_; }
    /// Between two pieces of work, on the thread that made the call.
    void poll() {
        if (!poll_ || held_) return;
        const auto now = Clock::now();
        if (now < next_) return;
        next_ = now + pause();
        if (poll_->stop()) request();
    }
    /// Where nothing is half made; throws Cancelled.
    void check() {
        poll();
        if (stopped()) throw Cancelled{};
    }

    /// While it lives, nothing stops: for what cannot be made again from what the caller still has.
    class Hold {
    public:
        explicit Hold(Interrupt& interrupt) : interrupt_(interrupt) { ++interrupt_.held_; }
        ~Hold() { --interrupt_.held_; }
        Hold(const Hold&) = delete;
        Hold& operator=(const Hold&) = delete;

    private:
        Interrupt& interrupt_;
    };

private:
    using Clock = std::chrono::steady_clock;
    std::chrono::milliseconds pause() const {
        return std::chrono::milliseconds(poll_->pause_ms.load(std::memory_order_relaxed));
    }

    Poll* poll_;
    int held_ = 0;
    std::atomic<bool> stop_{false};
    Clock::time_point next_{};
};

}  // namespace globule::core
