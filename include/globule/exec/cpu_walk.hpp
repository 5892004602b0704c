// Walks on the CPU: a chunk of items goes on to where each next has work, then teams of SIMD lanes take
// those places one after the other.  What a place needs has reached the cache by then.
#pragma once
#include <memory>

#include "globule/base/wide.hpp"

namespace globule {

/// A SIMD register as teams of four lanes, each with an item of its own: all lanes of a team hold what is
/// the item's, and share out what belongs to it.
struct CpuTeams {
    static constexpr int size = 4;
    static constexpr int n = kWidth / size;
    using F = WideF;
    using B = WideB;

    static B lanes_of(int team) {
        B m;
        for (int i = 0; i < kWidth; ++i) m.v[i] = i / size == team ? -1 : 0;
        return m;
    }
    static unsigned bits_of(const B& m, int team) { return bits(m) >> size * team & 1; }
    static float get(const F& v, int team) { return v.v[size * team]; }
    /// Four floats for each team.
    static F load(const float* const* p, int at) {
#if defined(__AVX512F__)
        __m512 r = _mm512_castps128_ps512(_mm_load_ps(p[0] + at));
        r = _mm512_mask_broadcast_f32x4(r, 0x00f0, _mm_load_ps(p[1] + at));
        r = _mm512_mask_broadcast_f32x4(r, 0x0f00, _mm_load_ps(p[2] + at));
        return (VecF)_mm512_mask_broadcast_f32x4(r, 0xf000, _mm_load_ps(p[3] + at));
#elif defined(__AVX2__)
        return (VecF)_mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(p[0] + at)), _mm_load_ps(p[1] + at), 1);
#else
        F r;
        std::memcpy(&r.v, p[0] + at, sizeof r.v);
        return r;
#endif
    }
    /// Sums over each team, known to all of its lanes.
    static F sum(F v) {
#if defined(__AVX512F__)
        v += F((VecF)_mm512_permute_ps((__m512)v.v, 0xb1));
        return v + F((VecF)_mm512_permute_ps((__m512)v.v, 0x4e));
#elif defined(__AVX2__)
        v += F((VecF)_mm256_permute_ps((__m256)v.v, 0xb1));
        return v + F((VecF)_mm256_permute_ps((__m256)v.v, 0x4e));
#else
        const float all = (v.v[0] + v.v[1]) + (v.v[2] + v.v[3]);
        return F(all);
#endif
    }
    /// fn(lane) in every lane.
    template <class Fn>
    static F map(const Fn& fn) {
        F r;
        for (int i = 0; i < kWidth; ++i) r.v[i] = fn(i);
        return r;
    }
    static void prefetch(const void* p) { __builtin_prefetch(p); }
};

/// begin(i, state); to_place(state, place) while that is true, then pass(...) for all that have one; then end(state).
template <class Walk>
class CpuWalks {
public:
    static constexpr std::uint32_t chunk = 256;  ///< items; their states stay in the cache

    void operator()(const Walk& walk, std::size_t first, std::size_t last) {
        std::uint32_t n_on = 0;
        for (std::size_t i = first; i < last; ++i) {
            states_[n_on] = {};
            if (walk.begin(i, states_[n_on])) on_[n_on] = n_on, ++n_on;
        }
        while (n_on) {
            std::uint32_t kept = 0;
            for (std::uint32_t k = 0; k < n_on; ++k) {
                const std::uint32_t r = on_[k];
                if (walk.template to_place<CpuTeams>(states_[r], places_[kept])) on_[kept++] = r;
                else walk.end(states_[r]);
            }
            n_on = kept;
            walk.template pass<CpuTeams>(states_, on_, places_, n_on);
        }
    }

private:
    typename Walk::State states_[chunk];
    typename Walk::Place places_[chunk];
    std::uint32_t on_[chunk];
};

}  // namespace globule
