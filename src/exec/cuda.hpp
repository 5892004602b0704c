// The GPU backend's means: one stream, CUB for sort, scan and reduce, a warp for a tile's group.
#pragma once
#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_reduce.cuh>
#include <cub/device/device_scan.cuh>
#include <cuda_runtime.h>
#include <nvtx3/nvToolsExt.h>
#include <thrust/iterator/counting_iterator.h>

#include <memory>

#include "base/device.hpp"
#include "base/scalar.hpp"
#include "exec/buffer.hpp"
#include "exec/cuda_group.hpp"
#include "exec/cuda_kernels.hpp"
#include "exec/cuda_lent.hpp"
#include "exec/cuda_packet.hpp"
#include "exec/cuda_rounds.hpp"
#include "exec/cuda_staging.hpp"
#include "exec/interrupt.hpp"

namespace globule::core {

class Cuda {
public:
    using Group = CudaGroup;
    using Lanes = CudaLanes;
    using Packet = CudaPacket;
    static constexpr bool on_device = true;
    static constexpr std::size_t wave_size = 1 << 22;  ///< pixels at a time
    using Lent = CudaLent;
    using Borrowed = CudaBorrowed;
    static constexpr std::size_t n_streams = 4;  ///< that work side by side

    explicit Cuda(int device, int, Poll* poll) : Cuda(device, std::make_shared<Interrupt>(poll)) {}
    ~Cuda() {
        const DeviceScope scope(device_);
        cudaStreamSynchronize(stream_);  // copies from and to page-locked memory may be under way
        cudaEventDestroy(done_);
        for (cudaEvent_t& e : marks_) cudaEventDestroy(e);
        cudaStreamDestroy(stream_);
    }
    Interrupt& interrupt() const { return *interrupt_; }

    /// The device is current while it lives, then the caller's is again.
    class DeviceScope {
    public:
        explicit DeviceScope(int device) {
            if (cudaGetDevice(&before_) != cudaSuccess) before_ = device;
            if (before_ != device) check(cudaSetDevice(device));
            else before_ = -1;
        }
        ~DeviceScope() {
            if (before_ >= 0) cudaSetDevice(before_);
        }
        DeviceScope(const DeviceScope&) = delete;
        DeviceScope& operator=(const DeviceScope&) = delete;

    private:
        int before_ = -1;
    };
    int device() const { return device_; }

    /// What follows waits for what the caller gave to its stream.  The default stream waits for ours, and ours for it.
    void wait_for_caller(std::uintptr_t stream) {
        if (stream <= kLegacyStream) return;
        check(cudaEventRecord(done_, reinterpret_cast<cudaStream_t>(stream)));
        check(cudaStreamWaitEvent(stream_, done_));
    }
    /// What the caller gives to its stream from now on waits for what was given to this one.
    void let_caller_wait(std::uintptr_t stream) {
        if (stream <= kLegacyStream) return;
        check(cudaEventRecord(done_, stream_));
        check(cudaStreamWaitEvent(reinterpret_cast<cudaStream_t>(stream), done_));
    }
    /// From another GPU's memory, after what was given to that GPU's stream.
    void copy_peer(void* to, const void* from, const ArrayAt<const void>& where, std::size_t bytes) {
        cudaEvent_t written;
        {
            const DeviceScope other(where.device);
            check(cudaEventCreateWithFlags(&written, cudaEventDisableTiming));
            check(cudaEventRecord(written, reinterpret_cast<cudaStream_t>(where.stream)));
        }
        check(cudaStreamWaitEvent(stream_, written));
        check(cudaMemcpyPeerAsync(to, device_, from, where.device, bytes, stream_));
        check(cudaEventDestroy(written));
        check(cudaEventRecord(done_, stream_));
        const DeviceScope other(where.device);
        check(cudaStreamWaitEvent(reinterpret_cast<cudaStream_t>(where.stream), done_));  // it may write again
    }

    /// From another one's memory, of this or another GPU.
    void copy_from(const Cuda& other, void* to, const void* from, std::size_t bytes) {
        check(cudaMemcpyPeerAsync(to, device_, from, other.device_, bytes, stream_));
    }

    /// From the device's pool, which keeps some of what is released: asking the driver for the memory of a
    /// large volume takes as long as filling it.  The default stream waits for all others, and they for it.
    void* allocate(std::size_t bytes) {
        interrupt_->check();
        void* p = nullptr;
        check(cudaMallocAsync(&p, bytes, nullptr));
        return p;
    }
    void release(void* p) {
        if (!p) return;
        const DeviceScope scope(device_);
        cudaFreeAsync(p, nullptr);
    }
    /// More room, with the first `used` bytes of what was there.
    void* extend(void* p, std::size_t used, std::size_t bytes) {
        void* moved = allocate(bytes);
        check(cudaMemcpyAsync(moved, p, used, cudaMemcpyDeviceToDevice, stream_));
        release(p);
        return moved;
    }
    void upload(void* to, const void* from, std::size_t bytes) { staging_.upload(to, from, bytes, stream_); }
    /// The same; arrived(n) is called whenever the first n bytes may be used by what is asked for then.
    template <class Arrived> void upload(void* to, const void* from, std::size_t bytes, Arrived& arrived) {
        staging_.upload(to, from, bytes, stream_, arrived);
    }
    void download(void* to, const void* from, std::size_t bytes) {
        interrupt_->check();
        staging_.download(to, from, bytes, stream_);
    }
    void download(void* to, const void* from, std::size_t bytes, void* to2, const void* from2, std::size_t bytes2) {
        staging_.download(to, from, bytes, to2, from2, bytes2, stream_);
    }
    /// To page-locked memory, which the device writes by itself.
    void download_direct(void* to, const void* from, std::size_t bytes) {
        check(cudaMemcpyAsync(to, from, bytes, cudaMemcpyDeviceToHost, stream_));
        check(cudaStreamSynchronize(stream_));
    }
    void copy(void* to, const void* from, std::size_t bytes) {
        check(cudaMemcpyAsync(to, from, bytes, cudaMemcpyDeviceToDevice, stream_));
    }
    void clear(void* p, std::size_t bytes) { check(cudaMemsetAsync(p, 0, bytes, stream_)); }
    void synchronize() { check(cudaStreamSynchronize(stream_)); }
    /// Another stream of the same device, and what is given to it from now on waits for another's work so far, or up to
    /// a mark. urgent: its work goes before that of other streams.
    std::shared_ptr<Cuda> sibling(bool urgent = false) const {
        return std::shared_ptr<Cuda>(new Cuda(device_, interrupt_, urgent));
    }
    /// One that may be used beside this, by another thread; nothing stops it.
    std::shared_ptr<Cuda> reader() const {
        return std::shared_ptr<Cuda>(new Cuda(device_, std::make_shared<Interrupt>()));
    }
    void follow(Cuda& other, int mark) { check(cudaStreamWaitEvent(stream_, other.marks_[mark])); }
    void follow(Cuda& other) {
        check(cudaEventRecord(other.done_, other.stream_));
        check(cudaStreamWaitEvent(stream_, other.done_));
    }
    std::uint64_t free_bytes() const {
        std::size_t free = 0, total = 0;
        std::uint64_t reserved = 0, used = 0;
        check(cudaMemGetInfo(&free, &total));
        check(cudaMemPoolGetAttribute(pool_, cudaMemPoolAttrReservedMemCurrent, &reserved));
        check(cudaMemPoolGetAttribute(pool_, cudaMemPoolAttrUsedMemCurrent, &used));
        return free + reserved - used;
    }

    void mark(int i) { check(cudaEventRecord(marks_[i], stream_)); }
    double elapsed(int from, int to) {
        float ms = 0;
        check(cudaEventSynchronize(marks_[to]));
        check(cudaEventElapsedTime(&ms, marks_[from], marks_[to]));
        return ms * 1e-3;
    }

    /// While it lives, a profiler shows what is asked for under this name.
    class Stage {
    public:
        explicit Stage(const char* name) { nvtxRangePushA(name); }
        ~Stage() { nvtxRangePop(); }
        Stage(const Stage&) = delete;
        Stage& operator=(const Stage&) = delete;
    };
    /// A value of the device's that is asked for now and looked at later, without waiting.
    template <class T> class Answer {
    public:
        Answer() = default;
        ~Answer() {
            if (room_) cudaFreeHost(room_);
            if (there_) cudaEventDestroy(there_);
        }
        Answer(const Answer&) = delete;
        Answer& operator=(const Answer&) = delete;
        void ask(Cuda& exec, const T* from) {
            if (!room_) check(cudaHostAlloc(reinterpret_cast<void**>(&room_), sizeof(T), cudaHostAllocPortable));
            if (!there_) check(cudaEventCreateWithFlags(&there_, cudaEventDisableTiming));
            check(cudaMemcpyAsync(room_, from, sizeof(T), cudaMemcpyDeviceToHost, exec.stream_));
            check(cudaEventRecord(there_, exec.stream_));
            asked_ = true;
        }
        /// What was asked for last; waits for no more than that.
        const T& wait() const {
            check(cudaEventSynchronize(there_));
            return *room_;
        }
        /// Null while it is on its way.
        const T* look() const { return asked_ && cudaEventQuery(there_) == cudaSuccess ? room_ : nullptr; }

    private:
        T* room_ = nullptr;
        cudaEvent_t there_ = nullptr;
        bool asked_ = false;
    };
    /// The time that some work takes.
    class Timer {
    public:
        Timer() {
            check(cudaEventCreate(&begin_));
            check(cudaEventCreate(&end_));
        }
        ~Timer() {
            cudaEventDestroy(begin_);
            cudaEventDestroy(end_);
        }
        Timer(const Timer&) = delete;
        Timer& operator=(const Timer&) = delete;
        void begin(Cuda& exec) { check(cudaEventRecord(begin_, exec.stream_)); }
        void end(Cuda& exec) { check(cudaEventRecord(end_, exec.stream_)); }
        /// Waits for the end.
        double seconds() const {
            float ms = 0;
            check(cudaEventSynchronize(end_));
            check(cudaEventElapsedTime(&ms, begin_, end_));
            return ms * 1e-3;
        }
        /// What is given to exec from now on finds the work done.
        void let_follow(Cuda& exec) const { check(cudaStreamWaitEvent(exec.stream_, end_)); }

    private:
        cudaEvent_t begin_ = nullptr, end_ = nullptr;
    };

    template <class Functor> void for_each(std::size_t n, const Functor& functor) {
        interrupt_->check();
        if (n == 0) return;
        const unsigned threads = n < 4096 ? 32 : 256;
        launch(run_each<Functor>, ceil_div<std::size_t>(n, threads), threads, n, functor);
    }
    template <class Functor> void for_each_task(std::size_t n, const Functor& functor) {
        interrupt_->check();
        if (n == 0) return;
        constexpr unsigned threads = 64;
        launch(run_each<Functor>, ceil_div<std::size_t>(n, threads), threads, n, functor);
    }
    template <class Functor> void for_each_tile(std::size_t n, const Functor& functor) {
        interrupt_->check();
        if (n == 0) return;
        constexpr int warps = warps_per_block<Functor>();
        launch(run_tiles<Functor>, ceil_div<std::size_t>(n, warps), 32 * warps, n, functor);
    }

    template <class Functor> void for_each_uneven(std::size_t n, const Functor& functor) {
        interrupt_->check();
        if (n == 0) return;
        launch(run_uneven<Functor>, ceil_div<std::size_t>(n, 128), 128, n, functor);
    }
    template <class Functor> void for_each_sparse(std::size_t n, const Functor& functor) {
        interrupt_->check();
        if (n == 0) return;
        launch(run_sparse<Functor>, ceil_div<std::size_t>(n, 4 * kSparse), 128, n, functor);
    }
    template <class Walk> void for_each_walk(std::size_t n, const Walk& walk) {
        interrupt_->check();
        if (n == 0) return;
        unsigned long long* next = next_.reserve(1);
        clear(next, sizeof *next);
        const unsigned blocks = unsigned(min<std::size_t>(ceil_div<std::size_t>(n, 128), kWalkBlocks * n_processors_));
        launch(run_walks<Walk>, blocks, 128, n, next, walk);
    }
    template <class Functor> void for_each_tile_of(const std::uint32_t* n, const Functor& functor) {
        interrupt_->check();
        launch(run_tiles_of<Functor>, 16 * n_processors_, 32 * kWarpsPerBlock, n, functor);
    }

    /// One thread a row.
    template <class Functor> void for_each_packet(std::size_t n, const Functor& functor) {
        interrupt_->check();
        if (n == 0) return;
        launch(run_packets<Functor>, ceil_div<std::size_t>(n, 128), 128, n, functor);
    }

    /// The same for functors that know teams: few rows are shared by several warps.
    template <class Functor> void for_each_packet_team(std::size_t n, const Functor& functor) {
        constexpr int kTeam = 4;
        constexpr std::size_t kFull = 1 << 16;  ///< rows that keep a GPU busy by themselves
        if (n == 0 || n >= kFull) return for_each_packet(n, functor);
        interrupt_->check();
        launch(run_teams<kTeam, Functor>, ceil_div<std::size_t>(n, 32), 32 * kTeam, n, functor);
    }

    /// All rounds of an iteration at once, where they are few rows; false: that is for the caller.
    template <class Rounds> bool for_rounds(std::size_t n, bool leads, const Rounds& rounds) {
        constexpr std::size_t kFew = 1 << 14;  ///< more rows take longer than what lies between launches
        using Sum = typename Rounds::Sum;
        static_assert(sizeof(Sum) % sizeof(double) == 0);
        if (n == 0 || n > kFew) return false;
        interrupt_->check();
        if (can_overlap_ && n <= 32 * kClusterGroups * kClusterBlocks) {
            const auto kernel = run_rounds<true, Rounds>;
            static const bool fits = cluster_fits(kernel, kClusterBlocks, 32 * kRoundTeam * kClusterGroups);
            const std::size_t groups = ceil_div<std::size_t>(n, 32 * kClusterBlocks),
                              blocks = ceil_div<std::size_t>(n, 32 * groups);
            if (fits) {
                launch_as(cudaLaunchAttributeClusterDimension, kernel, blocks, unsigned(32 * kRoundTeam * groups), n,
                    leads, rounds, nullptr, nullptr);
                return true;
            }
        }
        const auto kernel = run_rounds<false, Rounds>;
        const std::size_t blocks = ceil_div<std::size_t>(n, 32);
        int at_once = 0;
        check(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&at_once, kernel, 32 * kRoundTeam, 0));
        if (blocks > std::size_t(at_once) * n_processors_) return false;
        Sum* parts = reinterpret_cast<Sum*>(parts_.reserve(blocks * sizeof(Sum)));
        launch_as(cudaLaunchAttributeCooperative, kernel, blocks, 32 * kRoundTeam, n, leads, rounds, parts,
            met_.reserve_zero(1));
        return true;
    }

    /// CUB combines in an order that is the same from run to run.
    template <class T, class Map, class Combine>
    void reduce_in_order(std::size_t n, const Map& map, const Combine& combine, const T& identity, T* out) {
        reduce(n, map, combine, identity, out);
    }
    /// And `then`, unless it is over.
    template <class T, class Map, class Combine, class Then>
    void reduce_in_order(
        std::size_t n, const Map& map, const Combine& combine, const T& identity, T* out, const Then& then) {
        interrupt_->check();
        const std::size_t blocks = max<std::size_t>(ceil_div<std::size_t>(n, kSumItems), 1);
        if (!arrived_.data()) clear(arrived_.reserve(1), sizeof(unsigned));
        T* parts = reinterpret_cast<T*>(parts_.reserve(blocks * sizeof(T)));
        launch(run_sum<T, Map, Combine, Then>, blocks, kSumThreads, n, map, combine, identity, parts, arrived_.data(),
            out, then);
    }
    template <class T, class Map, class Combine>
    void reduce(std::size_t n, const Map& map, const Combine& combine, const T& identity, T* out) {
        with_temporary([&](void* room, std::size_t& bytes) {
            return cub::DeviceReduce::TransformReduce(
                room, bytes, thrust::counting_iterator<std::size_t>(0), out, n, combine, map, identity, stream_);
        });
    }
    template <class T> void exclusive_scan(std::size_t n, T* values) {
        with_temporary([&](void* room, std::size_t& bytes) {
            return cub::DeviceScan::ExclusiveSum(room, bytes, values, values, n, stream_);
        });
    }
    template <class Key>
    void sort_pairs(
        std::size_t n, Key* keys, Key* keys_spare, std::uint32_t* values, std::uint32_t* values_spare, int bits) {
        interrupt_->check();
        if (n == 0) return;
        cub::DoubleBuffer<Key> k(keys, keys_spare);
        cub::DoubleBuffer<std::uint32_t> v(values, values_spare);
        with_temporary([&](void* room, std::size_t& bytes) {
            return cub::DeviceRadixSort::SortPairs(room, bytes, k, v, n, 0, bits, stream_);
        });
        if (k.Current() != keys)
            check(cudaMemcpyAsync(keys, k.Current(), n * sizeof(Key), cudaMemcpyDeviceToDevice, stream_));
        if (v.Current() != values)
            check(cudaMemcpyAsync(values, v.Current(), n * sizeof(std::uint32_t), cudaMemcpyDeviceToDevice, stream_));
    }

private:
    Cuda(int device, std::shared_ptr<Interrupt> interrupt, bool urgent = false)
        : device_(device),
          interrupt_(std::move(interrupt)),
          temporary_(*this),
          next_(*this),
          parts_(*this),
          arrived_(*this),
          met_(*this) {
        const DeviceScope scope(device_);
        check(cudaDeviceGetAttribute(&n_processors_, cudaDevAttrMultiProcessorCount, device_));
        can_overlap_ = can_overlap();
        set_pool();
        int least_priority = 0, greatest_priority = 0;
        check(cudaDeviceGetStreamPriorityRange(&least_priority, &greatest_priority));
        // Ordered with the default stream of other libraries.
        check(cudaStreamCreateWithPriority(&stream_, cudaStreamDefault, urgent ? greatest_priority : least_priority));
        for (cudaEvent_t& e : marks_) check(cudaEventCreate(&e));
        check(cudaEventCreateWithFlags(&done_, cudaEventDisableTiming));
    }

    /// A kernel starts while the one before it ends, where it waits for that by itself: a microsecond less between two.
    template <class... Parameters, class... Arguments>
    void launch(void (*kernel)(Parameters...), std::size_t blocks, unsigned threads, const Arguments&... arguments) {
        launch_as(can_overlap_ ? cudaLaunchAttributeProgrammaticStreamSerialization : cudaLaunchAttributeIgnore, kernel,
            blocks, threads, arguments...);
    }
    template <class... Parameters, class... Arguments>
    void launch_as(cudaLaunchAttributeID how, void (*kernel)(Parameters...), std::size_t blocks, unsigned threads,
        const Arguments&... arguments) {
        cudaLaunchAttribute attribute{};
        attribute.id = how;
        if (how == cudaLaunchAttributeCooperative) attribute.val.cooperative = 1;
        else if (how == cudaLaunchAttributeClusterDimension) attribute.val.clusterDim = {unsigned(blocks), 1, 1};
        else attribute.val.programmaticStreamSerializationAllowed = 1;
        cudaLaunchConfig_t config{};
        config.gridDim = unsigned(blocks);
        config.blockDim = threads;
        config.stream = stream_;
        config.attrs = &attribute;
        config.numAttrs = how == cudaLaunchAttributeIgnore ? 0 : 1;
        check(cudaLaunchKernelEx(&config, kernel, arguments...));
    }
    /// Whether wait_for_last_kernel does: code for older GPUs, translated for a new one, does not.
    static bool can_overlap() {
        cudaFuncAttributes code;
        check(cudaFuncGetAttributes(&code, run_nothing<>));
        return code.ptxVersion >= 90;
    }

    void set_pool() {
        check(cudaDeviceGetDefaultMemPool(&pool_, device_));
        std::uint64_t kept = 0;
        check(cudaMemPoolGetAttribute(pool_, cudaMemPoolAttrReleaseThreshold, &kept));
        if (kept) return;
        std::size_t free = 0, total = 0;
        check(cudaMemGetInfo(&free, &total));
        kept = total / kPoolShare;
        check(cudaMemPoolSetAttribute(pool_, cudaMemPoolAttrReleaseThreshold, &kept));
    }
    template <class Call> void with_temporary(const Call& call) {
        // Room is mostly there already; asking CUB how much it takes costs as much as starting its kernels.
        std::size_t bytes = temporary_.capacity();
        if (bytes) {
            const cudaError_t error = call(temporary_.data(), bytes);
            if (error != cudaErrorInvalidValue) return check(error);
        }
        check(call(nullptr, bytes));
        void* room = temporary_.reserve(bytes ? bytes : 1);
        check(call(room, bytes));
    }

    static constexpr std::uintptr_t kLegacyStream = 1;  ///< as 0: the default stream
    static constexpr std::uint64_t kPoolShare = 16;     ///< of the device's memory that released memory may keep

    int device_;
    std::shared_ptr<Interrupt> interrupt_;
    int n_processors_ = 1;
    bool can_overlap_ = false;
    cudaMemPool_t pool_ = nullptr;
    cudaStream_t stream_ = nullptr;
    cudaEvent_t marks_[16] = {};
    cudaEvent_t done_ = nullptr;
    Staging staging_;
    Buffer<char, Cuda> temporary_;
    Buffer<unsigned long long, Cuda> next_;
    Buffer<char, Cuda> parts_;
    Buffer<unsigned, Cuda> arrived_, met_;
};

}  // namespace globule::core
