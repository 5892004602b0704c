// The CPU backend's means: OpenMP loops, a stable radix sort, a scan.  Nothing here depends on the
// number of threads but the time it takes.  A loop that was stopped throws Cancelled when all threads have left it.
#pragma once
#include <omp.h>
#ifdef __linux__
#include <sys/mman.h>
#include <unistd.h>
#endif

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <memory>
#include <new>
#include <vector>

#include "base/device.hpp"
#include "base/scalar.hpp"
#include "exec/cpu_group.hpp"
#include "exec/cpu_packet.hpp"
#include "exec/interrupt.hpp"
#include "exec/lent.hpp"

namespace globule::core {

/// What threads of a loop throw, such as a lack of memory: no exception may leave the loop, so the first waits for its
/// end.
class Thrown {
public:
    template <class Fn> void guard(const Fn& fn) noexcept {
        try {
            fn();
        } catch (...) {
            if (!came_.exchange(true)) first_ = std::current_exception();
        }
    }
    bool came() const { return came_.load(std::memory_order_relaxed); }
    void rethrow() const {
        if (first_) std::rethrow_exception(first_);
    }

private:
    std::atomic<bool> came_{false};
    std::exception_ptr first_;
};

class Cpu {
public:
    using Group = CpuGroup;
    using Lanes = CpuLanes;
    using Packet = CpuPacket;
    static constexpr bool on_device = false;
    static constexpr std::size_t wave_size = 1 << 17;  ///< pixels at a time
    static constexpr std::size_t n_streams = 1;        ///< that work side by side

    Cpu(int, int threads, Poll* poll) : Cpu(threads, std::make_shared<Interrupt>(poll)) {}
    Interrupt& interrupt() const { return *interrupt_; }

    /// Host memory has no device to be set and no streams to wait for.
    struct DeviceScope {
        explicit DeviceScope(int) {}
    };
    int device() const { return kHost; }
    void wait_for_caller(std::uintptr_t) {}
    void let_caller_wait(std::uintptr_t) {}
    void copy_peer(void* to, const void* from, const AnyArray&, std::size_t bytes) { std::memcpy(to, from, bytes); }

    /// From another one's memory.
    void copy_from(const Cpu&, void* to, const void* from, std::size_t bytes) { copy(to, from, bytes); }

    /// Large arrays lie in large pages, where the system has them: a page of 4 KiB costs as much as filling it.
    void* allocate(std::size_t bytes) {
        const std::size_t unit = bytes < kLargePage ? 64 : kLargePage;
        void* p = std::aligned_alloc(unit, ceil_div(bytes, unit) * unit);
        if (!p) throw std::bad_alloc();
#ifdef __linux__
        if (unit == kLargePage) madvise(p, ceil_div(bytes, unit) * unit, MADV_HUGEPAGE);
#endif
        return p;
    }
    void release(void* p) { std::free(p); }
    /// Whole pages of an array that nobody reads again go back to the system; what is read there later is 0.
    void give_up(const void* p, std::size_t bytes) {
#ifdef __linux__
        const std::size_t page = std::size_t(sysconf(_SC_PAGESIZE));
        const std::size_t begin = ceil_div(reinterpret_cast<std::size_t>(p), page) * page,
                          end = (reinterpret_cast<std::size_t>(p) + bytes) / page * page;
        if (begin < end) madvise(reinterpret_cast<void*>(begin), end - begin, MADV_DONTNEED);
#endif
    }
    /// More room, perhaps at another place, with what was there. Of large arrays the system moves pages, not bytes.
    void* extend(void* p, std::size_t, std::size_t bytes) {
        void* moved = std::realloc(p, bytes);
        if (!moved) throw std::bad_alloc();
        return moved;
    }
    void upload(void* to, const void* from, std::size_t bytes) {
        if (bytes) std::memcpy(to, from, bytes);  // of nothing there may be no address
    }
    void download(void* to, const void* from, std::size_t bytes) { upload(to, from, bytes); }
    /// To memory that the device writes by itself; here there is none.
    void download_direct(void* to, const void* from, std::size_t bytes) { upload(to, from, bytes); }
    void copy(void* to, const void* from, std::size_t bytes) {
        constexpr std::size_t part = 1 << 18;
#pragma omp parallel for schedule(static) num_threads(threads_) if (bytes > 4 * part)
        for (std::size_t at = 0; at < bytes; at += part)
            std::memcpy(static_cast<char*>(to) + at, static_cast<const char*>(from) + at, min(part, bytes - at));
    }
    void clear(void* p, std::size_t bytes) {
        constexpr std::size_t part = 1 << 18;
        if (bytes <= part) {
            if (bytes) std::memset(p, 0, bytes);
            return;
        }
#pragma omp parallel for schedule(static) num_threads(threads_)
        for (std::size_t at = 0; at < bytes; at += part)
            std::memset(static_cast<char*>(p) + at, 0, min(part, bytes - at));
    }
    void synchronize() {}
    /// Another stream of the same device, and what is given to it from now on waits for another's work so far.
    std::shared_ptr<Cpu> sibling() const { return std::shared_ptr<Cpu>(new Cpu(threads_, interrupt_)); }
    /// What threads of this process lend each other (exec/lent.hpp).
    class Lent {
    public:
        char* reserve(std::size_t bytes, int) {
            room_.resize(bytes);
            return room_.data();
        }
        LentPlace place() const { return {getpid(), kHost, 0, room_.data(), {}}; }

    private:
        std::vector<char> room_;
    };
    struct Borrowed {
        const char* reach(std::size_t, const LentPlace& place, int) {
            return place.is_here() && place.device == kHost ? place.address : nullptr;
        }
    };
    /// One that may be used beside this, by another thread; nothing stops it.
    std::shared_ptr<Cpu> reader() const {
        return std::shared_ptr<Cpu>(new Cpu(threads_, std::make_shared<Interrupt>()));
    }
    void follow(Cpu&, int = 0) {}
    /// Memory that may still be taken; 0: not known here.
    std::uint64_t free_bytes() const { return 0; }
    /// Time marks, so that a stage's duration can be asked for afterwards.
    void mark(int i) { marks_[i] = now(); }
    double elapsed(int from, int to) const { return marks_[to] - marks_[from]; }
    /// Named for a GPU's profiler.
    struct Stage {
        explicit Stage(const char*) {}
    };
    /// A value of the device's that is asked for now and looked at later, without waiting.
    template <class T> class Answer {
    public:
        void ask(Cpu&, const T* from) { value_ = *from; }
        const T* look() const { return &value_; }
        const T& wait() const { return value_; }

    private:
        T value_{};
    };
    /// The time that some work takes.
    class Timer {
    public:
        void begin(Cpu&) { begin_ = now(); }
        void end(Cpu&) { end_ = now(); }
        double seconds() const { return end_ - begin_; }
        /// What is given to exec from now on finds the work done.
        void let_follow(Cpu&) const {}

    private:
        double begin_ = 0.0, end_ = 0.0;
    };
    static double now() {
        return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
    }

    template <class Functor> void for_each(std::size_t n, const Functor& functor) {
#pragma omp parallel for schedule(static) num_threads(threads_) if (n > 2048)
        for (std::size_t i = 0; i < n; ++i) functor(i);
        interrupt_->check();
    }

    /// Rows in packets of SIMD lanes; the last packet's lanes go past n, into padding.
    template <class Functor> void for_each_packet(std::size_t n, const Functor& functor) {
#pragma omp parallel for schedule(static) num_threads(threads_) if (n > 256)
        for (std::size_t i = 0; i < n; i += Packet::width) functor.template run<Packet>(i);
        interrupt_->check();
    }

    template <class Functor> void for_each_packet_team(std::size_t n, const Functor& functor) {
        for_each_packet(n, functor);
    }

    /// All rounds of an iteration at once: not here.
    template <class Rounds> bool for_rounds(std::size_t, bool, const Rounds&) { return false; }

    /// As for_each, for items of very different length.
    template <class Functor> void for_each_uneven(std::size_t n, const Functor& functor) {
        constexpr std::size_t chunk = 256;
        Thrown thrown;
#pragma omp parallel num_threads(threads_) if (n > chunk)
        {
#pragma omp for schedule(dynamic)
            for (std::size_t c = 0; c < ceil_div(n, chunk); ++c) {
                if (interrupt_->stopped() || thrown.came()) continue;
                thrown.guard([&] {
                    for (std::size_t i = c * chunk; i < std::min(n, (c + 1) * chunk); ++i) functor(i);
                });
                poll();
            }
        }
        thrown.rethrow();
        interrupt_->check();
    }

    /// Few pieces of much and uneven work each; dealt out as threads become free.
    template <class Functor> void for_each_task(std::size_t n, const Functor& functor) {
        Thrown thrown;
#pragma omp parallel num_threads(threads_)
        {
#pragma omp for schedule(dynamic, 1)
            for (std::size_t i = 0; i < n; ++i) {
                if (interrupt_->stopped() || thrown.came()) continue;
                thrown.guard([&] { functor(i); });
                poll();
            }
        }
        thrown.rethrow();
        interrupt_->check();
    }

    /// Items that take a number of steps known to none beforehand: begin(i, state), where that is true
    /// advance(state, true) while it is true, then end(state).
    template <class Walk> void for_each_walk(std::size_t n, const Walk& walk) { for_each_uneven(n, Steps<Walk>{walk}); }

    template <class Functor> void for_each_sparse(std::size_t n, const Functor& functor) {
        for_each_uneven(n, functor);
    }

    /// One group of lanes a tile, as many tiles as *n says.
    template <class Functor> void for_each_tile_of(const std::uint32_t* n, const Functor& functor) {
        for_each_tile(*n, functor);
    }

    /// One group of lanes a tile; tiles are dealt out as threads become free.
    template <class Functor> void for_each_tile(std::size_t n, const Functor& functor) {
        using Scratch = typename Functor::template Scratch<Group>;
        Thrown thrown;
#pragma omp parallel num_threads(threads_)
        {
            std::unique_ptr<Scratch> scratch;
            thrown.guard([&] { scratch = std::make_unique<Scratch>(); });
            Group group;
#pragma omp for schedule(dynamic, 4)
            for (std::size_t i = 0; i < n; ++i) {
                if (interrupt_->stopped() || thrown.came()) continue;
                thrown.guard([&] { functor(group, *scratch, i); });
                if (i % 4 == 3) poll();  // a look at the clock takes as long as a small tile
            }
        }
        thrown.rethrow();
        interrupt_->check();
    }

    /// out[0] = combine over map(0) ... map(n - 1); combine must not depend on the order.
    template <class T, class Map, class Combine>
    void reduce(std::size_t n, const Map& map, const Combine& combine, const T& identity, T* out) {
        std::vector<T> partial(threads_, identity);
#pragma omp parallel num_threads(threads_)
        {
            T mine = identity;
#pragma omp for schedule(static)
            for (std::size_t i = 0; i < n; ++i) mine = combine(mine, map(i));
            partial[omp_get_thread_num()] = mine;
        }
        T all = identity;
        for (const T& p : partial) all = combine(all, p);
        *out = all;
        interrupt_->check();
    }

    /// As reduce, for a combine such as a sum of floats: parts of fixed size, combined in order.
    template <class T, class Map, class Combine>
    void reduce_in_order(std::size_t n, const Map& map, const Combine& combine, const T& identity, T* out) {
        constexpr std::size_t part = 1024;
        const std::size_t n_parts = ceil_div(n, part);
        std::vector<T> partial(n_parts, identity);
#pragma omp parallel for schedule(static) num_threads(threads_) if (n > 4 * part)
        for (std::size_t p = 0; p < n_parts; ++p) {
            T mine = identity;
            for (std::size_t i = p * part; i < std::min(n, (p + 1) * part); ++i) mine = combine(mine, map(i));
            partial[p] = mine;
        }
        T all = identity;
        for (const T& p : partial) all = combine(all, p);
        *out = all;
        interrupt_->check();
    }
    /// And `then`, unless it is over.
    template <class T, class Map, class Combine, class Then>
    void reduce_in_order(
        std::size_t n, const Map& map, const Combine& combine, const T& identity, T* out, const Then& then) {
        if (then.is_over()) return;
        reduce_in_order(n, map, combine, identity, out);
        then(0);
    }

    template <class T> void exclusive_scan(std::size_t n, T* values) {
        std::vector<T> sums(threads_ + 1, T(0));
        const std::size_t part = ceil_div<std::size_t>(n, threads_);
#pragma omp parallel for num_threads(threads_) schedule(static, 1)
        for (int t = 0; t < threads_; ++t) {
            T sum = 0;
            for (std::size_t i = t * part; i < std::min(n, (t + 1) * part); ++i) sum += values[i];
            sums[t + 1] = sum;
        }
        for (int t = 0; t < threads_; ++t) sums[t + 1] += sums[t];
#pragma omp parallel for num_threads(threads_) schedule(static, 1)
        for (int t = 0; t < threads_; ++t) {
            T sum = sums[t];
            for (std::size_t i = t * part; i < std::min(n, (t + 1) * part); ++i) {
                const T v = values[i];
                values[i] = sum;
                sum += v;
            }
        }
        interrupt_->check();
    }

    /// Stable least-significant-digit radix sort by the low `bits`; the result ends in keys, values.
    template <class Key>
    void sort_pairs(
        std::size_t n, Key* keys, Key* keys_spare, std::uint32_t* values, std::uint32_t* values_spare, int bits) {
        constexpr int digit_bits = 8, digits = 1 << digit_bits;
        const std::size_t part = ceil_div<std::size_t>(n, threads_);
        std::vector<std::size_t> offsets(std::size_t(threads_) * digits);
        Key *from = keys, *to = keys_spare;
        std::uint32_t *vfrom = values, *vto = values_spare;
        for (int shift = 0; shift < bits; shift += digit_bits) {
            std::fill(offsets.begin(), offsets.end(), 0);
#pragma omp parallel for num_threads(threads_) schedule(static, 1)
            for (int t = 0; t < threads_; ++t) {
                std::size_t count[digits] = {};
                for (std::size_t i = t * part; i < std::min(n, (t + 1) * part); ++i)
                    ++count[(from[i] >> shift) & (digits - 1)];
                std::copy(count, count + digits, &offsets[std::size_t(t) * digits]);
            }
            std::size_t sum = 0, largest = 0;
            for (int d = 0; d < digits; ++d) {
                const std::size_t before = sum;
                for (int t = 0; t < threads_; ++t) {
                    std::size_t& o = offsets[std::size_t(t) * digits + d];
                    const std::size_t c = o;
                    o = sum;
                    sum += c;
                }
                largest = std::max(largest, sum - before);
            }
            interrupt_->check();
            if (largest == n) continue;  // all share this digit
#pragma omp parallel for num_threads(threads_) schedule(static, 1)
            for (int t = 0; t < threads_; ++t) {
                std::size_t* o = &offsets[std::size_t(t) * digits];
                for (std::size_t i = t * part; i < std::min(n, (t + 1) * part); ++i) {
                    const std::size_t at = o[(from[i] >> shift) & (digits - 1)]++;
                    to[at] = from[i];
                    vto[at] = vfrom[i];
                }
            }
            std::swap(from, to);
            std::swap(vfrom, vto);
        }
        if (from != keys) {
            std::memcpy(keys, from, n * sizeof(Key));
            std::memcpy(values, vfrom, n * sizeof(std::uint32_t));
        }
    }

private:
    template <class Walk> struct Steps {
        const Walk& walk;
        void operator()(std::size_t i) const {
            typename Walk::State state{};
            if (!walk.begin(i, state)) return;
            while (walk.advance(state, true)) {}
            walk.end(state);
        }
    };
    void poll() {
        if (omp_get_thread_num() == 0) interrupt_->poll();
    }

    Cpu(int threads, std::shared_ptr<Interrupt> interrupt)
        : threads_(threads > 0 ? threads : omp_get_max_threads()), interrupt_(std::move(interrupt)) {}

    static constexpr std::size_t kLargePage = 2 << 20;

    int threads_;
    std::shared_ptr<Interrupt> interrupt_;
    double marks_[16] = {};
};

}  // namespace globule::core
