// A group of lanes on the CPU: one thread working on `vectors` SIMD registers of `width` lanes.
// exec/cuda_group.hpp gives a warp the same face, so that a tile kernel is written once.
#pragma once
#include "globule/base/vec.hpp"
#include "globule/base/wide.hpp"

namespace globule {

struct CpuGroup {
    static constexpr int width = kWidth;
    static constexpr int vectors = 64 / kWidth;
    static constexpr int list_capacity = 2048;
    static constexpr int stack_capacity = 512;
    using F = WideF;
    using B = WideB;
    struct U {
        std::uint32_t v[kWidth];
    };

    /// 0, 1, 2 ... across the lanes.
    F ramp() const {
        F r;
        for (int i = 0; i < width; ++i) r.v[i] = float(i);
        return r;
    }
    B first_lanes(int n) const { return ramp() < F(float(n)); }
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

    bool any(const B& m) const { return globule::any(m); }
    int count(const B& m) const {
        int n = 0;
        for (int i = 0; i < width; ++i) n -= m.v[i];
        return n;
    }
    float smallest(const F& v) const {
        float r = v.v[0];
        for (int i = 1; i < width; ++i) r = v.v[i] < r ? v.v[i] : r;
        return r;
    }
    float largest(const F& v) const { return -smallest(-v); }

    /// Consecutive floats; memory past the run is readable (buffers are padded).
    F load_run(const float* p) const {
        F r;
        std::memcpy(&r.v, p, sizeof r.v);
        return r;
    }

    /// fn(lane) for each set lane, one after the other, all lanes taking part.
    template <class Fn>
    void each(const B& m, const Fn& fn) const {
        for (int i = 0; i < width; ++i)
            if (m.v[i]) fn(i);
    }
    /// fn(lane) for each set lane, every lane for itself.
    template <class Fn>
    void per_lane(const B& m, const Fn& fn) const { each(m, fn); }

    /// write(lane, place) for each set lane, places counting up from n; returns the new n.
    template <class Write>
    int append(const B& m, int n, const Write& write) const {
        for (int i = 0; i < width; ++i)
            if (m.v[i]) write(i, n++);
        return n;
    }
    void sync() const {}
};

}  // namespace globule
