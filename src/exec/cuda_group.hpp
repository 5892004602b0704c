// A group of lanes on the GPU: a warp.  The same face as exec/cpu_group.hpp.
#pragma once
#include "base/quad.hpp"
#include "base/vec.hpp"
#include "exec/warp_teams.hpp"

namespace globule::core {

struct CudaGroup {
    static constexpr int width = 32;
    static constexpr int vectors = 1;
    static constexpr int list_capacity = 416, ellipsoid_capacity = 224;
    static constexpr int stack_capacity = 224;
    using F = float;
    using B = bool;
    using U = std::uint32_t;
    static constexpr unsigned all = 0xffffffffu;

    __device__ int lane() const { return threadIdx.x & 31; }
    __device__ B first_lanes(int n) const { return lane() < n; }
    __device__ B only(int which) const { return lane() == which; }
    __device__ B none() const { return false; }

    template <class T> __device__ static T get(const T& v, int) { return v; }
    template <class T> __device__ static void put(T& v, int, T x) { v = x; }
    template <class T> __device__ static T pick(const T& v, int lane) { return __shfl_sync(all, v, lane); }

    __device__ bool any(B m) const { return __any_sync(all, m); }
    __device__ int count(B m) const { return __popc(__ballot_sync(all, m)); }
    __device__ int first_from(B m, int from) const {
        const unsigned set = __ballot_sync(all, m), later = set & ~0u << from;
        return later ? __ffs(later) - 1 : __ffs(set) - 1;
    }
    __device__ float smallest(float v) const {
        for (int s = 16; s; s >>= 1) v = fminf(v, __shfl_xor_sync(all, v, s));
        return v;
    }
    __device__ float sum(float v) const {
        for (int s = 16; s; s >>= 1) v += __shfl_xor_sync(all, v, s);
        return v;
    }
    __device__ float largest(float v) const { return -smallest(-v); }
    __device__ std::uint32_t largest(std::uint32_t v) const {
#if __CUDA_ARCH__ >= 800
        return __reduce_max_sync(all, v);
#else
        for (int s = 16; s; s >>= 1) v = max(v, __shfl_xor_sync(all, v, s));
        return v;
#endif
    }
    /// Bits shifted up by one; the lowest is set where v is below 0.
    __device__ U shift_in_sign(U bits, float v) const { return __funnelshift_l(__float_as_uint(v), bits, 1); }
    __device__ F load_run(const float* p) const { return p[lane()]; }
    __device__ U load_run(const std::uint32_t* p) const { return p[lane()]; }
    __device__ void store_run(F v, float* p) const { p[lane()] = v; }
    __device__ Four<F> gather(const Quad* p, const std::uint32_t* run) const {
        const float4 q = reinterpret_cast<const float4*>(p)[run[lane()]];
        return {q.x, q.y, q.z, q.w};
    }
    __device__ U numbers(std::uint32_t first) const { return first + lane(); }
    __device__ B differ(const std::uint32_t* run, std::uint32_t v) const { return run[lane()] != v; }
    __device__ B before(const std::uint32_t* run, std::uint32_t v) const { return run[lane()] < v; }
    template <class T> __device__ void keep(B m, T v, T* to) const {
        const unsigned set = __ballot_sync(all, m);
        if (m) to[__popc(set & ((1u << lane()) - 1))] = v;
    }

    template <int n> struct List {
        float4 item[n];
        __device__ Vec3<float> point(int i) const { return {item[i].x, item[i].y, item[i].z}; }
        __device__ std::uint32_t number(int i) const { return __float_as_uint(item[i].w); }
        __device__ void set(int i, const Vec3<float>& p, std::uint32_t k) {
            item[i] = {p.x, p.y, p.z, __uint_as_float(k)};
        }
        __device__ Vec3<float> points(const CudaGroup& g, int i) const {
            const float4 v = item[i + g.lane()];
            return {v.x, v.y, v.z};
        }
        /// The set lanes' points side by side, from place i on.
        __device__ void keep(const CudaGroup& g, bool m, const Vec3<float>& p, int i) {
            const unsigned set = __ballot_sync(all, m);
            if (m) item[i + __popc(set & ((1u << g.lane()) - 1))] = {p.x, p.y, p.z, 0.0f};
        }
    };

    static constexpr int run_width = 8;
    static constexpr int n_runs = 4;
    using Runs = std::uint32_t;
    /// Each lane holds the run that it will look at.
    template <class Entry> struct Entries {
        Entry mine;
        bool valid;
    };
    template <class Entry> __device__ Entries<Entry> take(const Entry* stack, int n) const {
        const int r = lane() / run_width;
        return {r < n ? stack[r] : Entry{}, r < n};
    }
    template <class Entry> __device__ B lay_out(const Entries<Entry>& e, int, Runs& runs) const {
        const int c = lane() % run_width;
        const bool present = e.valid && c < int(e.mine.count());
        runs = present ? e.mine.first() + c : 0;
        return present;
    }
    template <class T> __device__ T load(const T* p, const Runs& runs) const { return __ldg(p + runs); }
    __device__ static std::uint32_t index(const Runs& runs, int) { return runs; }
    __device__ B is_leaf(const U& meta) const { return meta >> 31; }

    template <class Fn> __device__ void each(B m, const Fn& fn) const {
        for (unsigned set = __ballot_sync(all, m); set; set &= set - 1) fn(__ffs(set) - 1);
    }
    template <class Fn> __device__ void per_lane(B m, const Fn& fn) const {
        if (m) fn(lane());
        __syncwarp();
    }
    template <class Fn> __device__ static void for_lanes(const Fn& fn) { fn(0); }
    __device__ int lane_number(int) const { return lane(); }
    using LaneOf = std::uint8_t[width];
    /// part(p, d, sign, first, stride, sum) adds every stride-th item from the first on to a ray's sum.  Where no more
    /// than half of the lanes are active, two to eight of them share out each active lane's ray.
    template <bool Bounds, class Sum, class Part>
    __device__ void share_rays(LaneOf& lane_of, B active, const Vec3<float>& p, const Vec3<float>& d, float sign,
        Sum& sum, const Part& part) const {
        const RanksInWarp rays(active);
        if (rays.n > width / 2) return part(p, d, sign, 0, 1, sum);
        const WarpTeams teams{rays.n > 8 ? 1 : rays.n > 4 ? 2 : 3, 0};
        if (active) lane_of[rays.rank] = std::uint8_t(lane());
        __syncwarp();
        const bool busy = teams.ray() < rays.n;
        const int from = busy ? lane_of[teams.ray()] : 0;
        const Vec3<float> of_p = teams.pick(p, from), of_d = teams.pick(d, from);
        const float of_sign = pick(sign, from);
        if (busy) part(of_p, of_d, of_sign, teams.member(), teams.size(), sum);
        __syncwarp();
        sum = teams.template total<Bounds>(sum, rays.rank);
    }
    __device__ std::uint32_t set_of(B m) const { return __ballot_sync(all, m); }
    template <class Fn> __device__ F map(const Fn& fn) const { return fn(lane()); }
    template <class Fn> __device__ std::uint32_t from_first(const Fn& fn) const {
        std::uint32_t v = 0;
        if (lane() == 0) v = fn();
        return __shfl_sync(all, v, 0);
    }
    template <class Write> __device__ int append(B m, int n, const Write& write) const {
        const unsigned set = __ballot_sync(all, m);
        if (m) write(lane(), n + __popc(set & ((1u << lane()) - 1)));
        return n + __popc(set);
    }
    template <class Fn> __device__ void share(int n, const Fn& fn) const {
        for (int j = lane(); j < n; j += width) fn(j);
        __syncwarp();
    }
    __device__ double total(double mine) const {
        for (int s = 16; s; s >>= 1) mine += __shfl_xor_sync(all, mine, s);
        return mine;
    }
    __device__ double least(double mine) const {
        for (int s = 16; s; s >>= 1) mine = min(mine, __shfl_xor_sync(all, mine, s));
        return mine;
    }
    __device__ bool is_first() const { return lane() == 0; }
    __device__ void sync() const { __syncwarp(); }
};

/// How one ray's thread goes through a block of particles: one at a time.
struct CudaLanes {
    static constexpr int width = 1;
    using F = float;
    GB_FN static F load(const float* p) { return *p; }
    GB_FN static void load(const float* block, F& x, F& y, F& z) {
        const float4 v = *reinterpret_cast<const float4*>(block);
        x = v.x;
        y = v.y;
        z = v.z;
    }
    GB_FN static void load_four(const float* from, F* to) {
        const float4 v = *reinterpret_cast<const float4*>(from);
        to[0] = v.x;
        to[1] = v.y;
        to[2] = v.z;
        to[3] = v.w;
    }
    GB_FN static std::uint32_t slot(const float* block, int) {
        return reinterpret_cast<const std::uint32_t*>(block)[3];
    }
    __device__ static void store(float* block, float x, float y, float z, std::uint32_t slot) {
        *reinterpret_cast<float4*>(block) = {x, y, z, __uint_as_float(slot)};
    }
    GB_FN static float sum(float v) { return v; }
    GB_FN static float largest(float v) { return v; }
    template <class Fn> GB_FN static float map(const Fn& fn) { return fn(0); }

    // Float64, as CpuLanes has it.
    using D = double;
    static constexpr int part = 1;
    using Slots = std::uint32_t;
    GB_FN static Slots slots(const float* block, int, int) { return slot(block, 0); }
    GB_FN static D gather(const float* p, Slots s, std::size_t stride = 1, int k = 0) { return p[stride * s + k]; }
    GB_FN static D counted(Slots, D v) { return v; }
    GB_FN static double sum(double v) { return v; }
    template <class Fn> GB_FN static void where_positive(Slots s, D v, const Fn& fn) {
        if (v > 0.0) fn(s, v);
    }

    static constexpr unsigned all = 0xffffffffu;
    static constexpr int list_unit = 8;      ///< blocks of a list come by so many
    static constexpr int cells_at_once = 2;  ///< that a ray passes before the others get their turn

    /// Field of each active lane's source at its own t: teams of 4 lanes take one ray at a time, of 8 where no more
    /// than four rays are left, so that all lanes work in a warp of few active rays or with lists of different length.
    template <class Source, class Limits>
    __device__ static auto evaluate(const Source& source, float t, const Limits& lim, bool active, bool bounds) {
        return __any_sync(all, active && bounds) ? by_teams<true>(source, t, lim, active)
                                                 : by_teams<false>(source, t, lim, active);
    }

private:
    /// Whatever the team, a ray's particles are added up in eight parts, and these in the same order.
    template <bool Bounds, class Source, class Limits>
    __device__ static auto by_teams(const Source& source, float t, const Limits& lim, bool active) {
        const RanksInWarp rays(active);
        const float3 point = source.point(t);
        __shared__ std::uint8_t lanes[128];
        std::uint8_t* lane_of = lanes + (threadIdx.x & 96);
        if (active) lane_of[rays.rank] = std::uint8_t(threadIdx.x & 31);
        __syncwarp();
        using Sum = decltype(source.template at<Bounds>(t, lim));
        Sum result{0.0f, 0.0f, 0.0f, 0.0f};
        for (WarpTeams teams{0, 0}; teams.first < rays.n; teams.first += teams.n_teams()) {
            teams.log_size = rays.n - teams.first > 4 ? 2 : 3;
            const bool busy = teams.ray() < rays.n;  // else the team has a list of no length
            const int from = busy ? lane_of[teams.ray()] : 0;
            Source of = source;
            of.first = __shfl_sync(all, source.first, from);
            of.n_blocks = busy * __shfl_sync(all, source.n_blocks, from);
            of.d = teams.pick(source.d, from);
            const float3 of_point = teams.pick(point, from);
            Limits of_lim = lim;
            if (Bounds) of_lim.window = __shfl_sync(all, lim.window, from);
            of_lim.sign = __shfl_sync(all, lim.sign, from);
            Sum sum{0.0f, 0.0f, 0.0f, 0.0f};
            if (teams.size() == 4) of.template add_pairs<Bounds>(sum, teams.member(), of_point, of_lim);
            else of.template add_blocks<Bounds>(sum, teams.member(), 8, of_point, of_lim);
            __syncwarp();
            sum = teams.template total<Bounds>(sum, rays.rank);
            if (teams.holds(rays.rank)) result = source.template finished<Bounds>(sum);
        }
        __syncwarp();
        return result;
    }
};

}  // namespace globule::core
