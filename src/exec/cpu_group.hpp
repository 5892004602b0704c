// A group of lanes on the CPU: one thread working on `vectors` SIMD registers of `width` lanes.
// exec/cuda_group.hpp gives a warp the same face, so that what works on a tile is written once.
#pragma once
#include "base/quad.hpp"
#include "base/vec.hpp"
#include "base/wide.hpp"
#include "exec/cpu_packet.hpp"

namespace globule::core {

struct CpuGroup {
    static constexpr int width = kWidth;
    static constexpr int vectors = 64 / kWidth;
    static constexpr int list_capacity = 2048, ellipsoid_capacity = 2048;
    static constexpr int stack_capacity = 512;
    using F = WideF;
    using B = WideB;
    struct U { std::uint32_t v[kWidth]; };
    B first_lanes(int n) const {
        static constexpr std::int32_t numbers[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
        VecI lane;
        std::memcpy(&lane, numbers, sizeof lane);
        return {lane < VecI{} + n};
    }
    B only(int lane) const {
        B m = none();
        m.v[lane] = -1;
        return m;
    }
    B none() const { return {VecI{}}; }

    static float get(const F& v, int lane) { return v.v[lane]; }
    static std::uint32_t get(const U& v, int lane) { return v.v[lane]; }
    static bool get(const B& v, int lane) { return v.v[lane] != 0; }
    static void put(F& v, int lane, float x) { v.v[lane] = x; }
    static void put(U& v, int lane, std::uint32_t x) { v.v[lane] = x; }
    static void put(B& v, int lane, bool x) { v.v[lane] = x ? -1 : 0; }
    /// The lane's value, known to all lanes.
    static float pick(const F& v, int lane) { return v.v[lane]; }
    static std::uint32_t pick(const U& v, int lane) { return v.v[lane]; }

    bool any(const B& m) const { return globule::core::any(m); }
    int count(const B& m) const { return __builtin_popcount(bits(m)); }
    /// The first set lane at or after `from`, else the first; -1: none.
    int first_from(const B& m, int from) const {
        const unsigned set = bits(m), later = set & ~0u << from;
        return later ? __builtin_ctz(later) : set ? __builtin_ctz(set) : -1;
    }
    float smallest(const F& v) const {
        float r = v.v[0];
        for (int i = 1; i < width; ++i) r = v.v[i] < r ? v.v[i] : r;
        return r;
    }
    float sum(const F& v) const {
        float r = 0.0f;
        for (int i = 0; i < width; ++i) r += v.v[i];
        return r;
    }
    float largest(const F& v) const { return -smallest(-v); }

    /// Consecutive floats; memory past the run is readable (buffers are padded).
    F load_run(const float* p) const {
        F r;
        std::memcpy(&r.v, p, sizeof r.v);
        return r;
    }
    U load_run(const std::uint32_t* p) const {
        U r;
        std::memcpy(r.v, p, sizeof r.v);
        return r;
    }
    void store_run(const F& v, float* p) const { std::memcpy(p, &v.v, sizeof v.v); }
    /// Each lane's item; its number is in a run.
    Four<F> gather(const Quad* p, const std::uint32_t* run) const { return CpuPacket::gather(p, run); }
    /// first, first + 1 ...
    U numbers(std::uint32_t first) const {
        U r;
        for (int i = 0; i < width; ++i) r.v[i] = first + i;
        return r;
    }
    /// Which items of a run are not v.
    B differ(const std::uint32_t* run, std::uint32_t v) const {
        VecI items;
        std::memcpy(&items, run, sizeof items);
        return {items != VecI{} + std::int32_t(v)};
    }
    /// Which items of a run are less than v.
    B before(const std::uint32_t* run, std::uint32_t v) const {
        typedef std::uint32_t Items __attribute__((vector_size(4 * width)));
        Items items;
        std::memcpy(&items, run, sizeof items);
        return {items < Items{} + v};
    }
    /// The set lanes' values side by side; a whole group's worth of memory may be written.
    template <class V, class T> void keep(const B& m, const V& v, T* to) const {
#if defined(__AVX512F__)
        __m512i all;
        std::memcpy(&all, &v, sizeof all);
        _mm512_storeu_si512(to, _mm512_maskz_compress_epi32(__mmask16(bits(m)), all));
#else
        for (unsigned set = bits(m); set; set &= set - 1) *to++ = v.v[__builtin_ctz(set)];
#endif
    }

    /// Three floats and a number for each of n items, read one at a time or a group's worth.
    template <int n> struct List {
        float x[n], y[n], z[n];
        std::uint32_t id[n];
        Vec3<float> point(int i) const { return {x[i], y[i], z[i]}; }
        std::uint32_t number(int i) const { return id[i]; }
        void set(int i, const Vec3<float>& p, std::uint32_t k) {
            x[i] = p.x;
            y[i] = p.y;
            z[i] = p.z;
            id[i] = k;
        }
        Vec3<F> points(const CpuGroup& g, int i) const {
            return {g.load_run(x + i), g.load_run(y + i), g.load_run(z + i)};
        }
        /// The set lanes' points side by side, from place i on; a whole group's worth of memory may be written.
        void keep(const CpuGroup& g, const B& m, const Vec3<F>& p, int i) {
            g.keep(m, p.x, x + i);
            g.keep(m, p.y, y + i);
            g.keep(m, p.z, z + i);
        }
    };

    struct LaneOf {};
    /// As on the GPU, each lane with its own ray alone.
    template <bool, class Sum, class Part>
    static void share_rays(
        LaneOf&, const B&, const Vec3<F>& p, const Vec3<F>& d, const F& sign, Sum& sum, const Part& part) {
        part(p, d, sign, 0, 1, sum);
    }

    /// Runs of up to 8 siblings side by side in the lanes.
    static constexpr int run_width = width < 8 ? width : 8;
    static constexpr int n_runs = width / run_width;
    struct Runs { std::uint32_t first[n_runs]; };
    template <class Entry> struct Entries {
        Entry run[n_runs];
        int n;
    };
    template <class Entry> Entries<Entry> take(const Entry* stack, int n) const {
        Entries<Entry> e{};
        for (int r = 0; r < n; ++r) e.run[r] = stack[r];
        e.n = n;
        return e;
    }
    /// Lays the taken runs out; part p of a run that is wider than the group begins at p run_width.
    /// Returns the lanes that hold a node.
    template <class Entry> B lay_out(const Entries<Entry>& e, int part, Runs& runs) const {
        B lanes = none();
        for (int r = 0; r < n_runs; ++r) {
            const int count = r < e.n ? int(e.run[r].count()) - part * run_width : 0;
            runs.first[r] = e.run[r].first() + part * run_width;
            for (int i = 0; i < run_width; ++i) lanes.v[r * run_width + i] = i < count ? -1 : 0;
        }
        return lanes;
    }
    F load(const float* p, const Runs& runs) const {
        float v[width];
        for (int r = 0; r < n_runs; ++r) std::memcpy(v + r * run_width, p + runs.first[r], 4 * run_width);
        return load_run(v);
    }
    U load(const std::uint32_t* p, const Runs& runs) const {
        U u;
        for (int r = 0; r < n_runs; ++r) std::memcpy(u.v + r * run_width, p + runs.first[r], 4 * run_width);
        return u;
    }
    static std::uint32_t index(const Runs& runs, int lane) { return runs.first[lane / run_width] + lane % run_width; }
    B is_leaf(const U& meta) const {
        B m;
        std::memcpy(&m.v, meta.v, sizeof m.v);
        return {m.v >> 31};
    }

    /// fn(lane) for each set lane, one after the other, all lanes taking part.
    template <class Fn> void each(const B& m, const Fn& fn) const {
        for (unsigned set = bits(m); set; set &= set - 1) fn(__builtin_ctz(set));
    }
    /// fn(lane) for each set lane, every lane for itself.
    template <class Fn> void per_lane(const B& m, const Fn& fn) const { each(m, fn); }

    /// fn(lane) for all lanes.
    template <class Fn> static void for_lanes(const Fn& fn) {
        for (int i = 0; i < width; ++i) fn(i);
    }

    static int lane_number(int lane) { return lane; }
    /// The set lanes, one bit each.
    std::uint32_t set_of(const B& m) const { return bits(m); }
    /// fn(lane) in every lane.
    template <class Fn> F map(const Fn& fn) const {
        F r;
        for (int i = 0; i < width; ++i) r.v[i] = fn(i);
        return r;
    }
    /// fn() called once, its result known to all lanes.
    template <class Fn> auto from_first(const Fn& fn) const { return fn(); }

    /// write(lane, place) for each set lane, places counting up from n; returns the new n.
    template <class Write> int append(const B& m, int n, const Write& write) const {
        for (unsigned set = bits(m); set; set &= set - 1) write(__builtin_ctz(set), n++);
        return n;
    }
    /// fn(j) for j < n, shared out among the lanes, and the sum of what the lanes hold.
    template <class Fn> void share(int n, const Fn& fn) const {
        for (int j = 0; j < n; ++j) fn(j);
    }
    double total(double mine) const { return mine; }
    double least(double mine) const { return mine; }
    bool is_first() const { return true; }
    void sync() const {}
};

/// How one ray's thread goes through a block of particles: a SIMD register's worth at a time.
struct CpuLanes {
    static constexpr int width = kWidth;
    using F = WideF;
    static F load(const float* p) {
        F r;
        std::memcpy(&r.v, p, sizeof r.v);
        return r;
    }
    static void load(const float* block, F& x, F& y, F& z) {
        x = load(block);
        y = load(block + width);
        z = load(block + 2 * width);
    }
    static void load_four(const float* from, F* to) {
        for (int k = 0; k < 4; ++k) to[k] = load(from + k * width);
    }
    static std::uint32_t slot(const float* block, int lane) {
        std::uint32_t id;
        std::memcpy(&id, block + 3 * width + lane, 4);
        return id;
    }
    static void store(float* block, float x, float y, float z, std::uint32_t slot) {
        block[0] = x;
        block[width] = y;
        block[2 * width] = z;
        std::memcpy(block + 3 * width, &slot, 4);
    }
    static float sum(const F& v) {
        typedef float Four __attribute__((vector_size(16)));
        Four part[width / 4], all;
        std::memcpy(part, &v.v, sizeof part);
        all = part[0];
        for (int i = 1; i < width / 4; ++i) all += part[i];
        return (all[0] + all[2]) + (all[1] + all[3]);
    }
    static float largest(const F& v) {
        float r = v.v[0];
        for (int i = 1; i < width; ++i) r = v.v[i] > r ? v.v[i] : r;
        return r;
    }
    /// fn(lane) in every lane.
    template <class Fn> static F map(const Fn& fn) {
        F r;
        for (int i = 0; i < width; ++i) r.v[i] = fn(i);
        return r;
    }

    // Float64: a block's particles in parts of half as many lanes.
    using D = WideD;
    static constexpr int part = kWideD;
    /// Those of a part, of which the first n count.
    struct Slots {
        VecH slot;  ///< past n: the first one again
        VecL counts;
    };
    static Slots slots(const float* block, int first, int n) {
        VecH number, slot;
        VecL place;
        for (int i = 0; i < part; ++i) number[i] = place[i] = i;
        std::memcpy(&slot, block + 3 * width + first, sizeof slot);
        return {number < n ? slot : slot[0] - VecH{}, place < n};
    }
    /// p[stride slot + k].
    static D gather(const float* p, const Slots& s, std::size_t stride = 1, int k = 0) {
        D r;
#if defined(__AVX512F__)
        if (stride == 1) {
            r.v = (VecD)_mm512_cvtps_pd(_mm256_i32gather_ps(p, (__m256i)s.slot, 4));
            return r;
        }
#endif
        for (int i = 0; i < part; ++i) r.v[i] = p[stride * std::uint32_t(s.slot[i]) + k];
        return r;
    }
    /// v, and 0 for those that do not count.
    static D counted(const Slots& s, const D& v) { return select(WideBD{s.counts}, v, D(0.0)); }
    static double sum(const D& v) {
        double r = v.v[0];
        for (int i = 1; i < part; ++i) r += v.v[i];
        return r;
    }
    /// fn(slot, v) where v > 0.
    template <class Fn> static void where_positive(const Slots& s, const D& v, const Fn& fn) {
        for (unsigned set = bits(v > D(0.0)); set; set &= set - 1) {
            const int i = __builtin_ctz(set);
            fn(std::uint32_t(s.slot[i]), v.v[i]);
        }
    }

    static constexpr int list_unit = 1;  ///< blocks of a list come by so many
    /// Cells that a ray passes between two looks at the others; it is alone here.
    static constexpr int cells_at_once = 1 << 20;
    template <class Source, class Limits>
    static auto evaluate(const Source& source, float t, const Limits& lim, bool active, bool bounds) {
        if (!active) return decltype(source.template at<true>(t, lim)){};
        return bounds ? source.template at<true>(t, lim) : source.template at<false>(t, lim);
    }
};

}  // namespace globule::core
