// A packet of rows on the CPU: one SIMD lane a row, so that a functor that walks the lists of many
// particles is written once.  exec/cuda_packet.hpp gives one GPU thread the same face.
#pragma once
#include <cstring>

#include "base/quad.hpp"
#include "base/wide.hpp"

namespace globule::core {

struct CpuPacket {
    static constexpr int width = kWidth;   ///< rows at a time
    static constexpr int stride = kWidth;  ///< rows whose lists are interleaved
    using F = WideF;
    using B = WideB;
    using D = WideD;
    static constexpr int half = kWideD;  ///< rows of float64 at a time

    // Who goes through a row's list: one here, several warps on a GPU (CudaTeam).
    static constexpr std::uint32_t team = 1;
    GB_FN static std::uint32_t member() { return 0; }
    GB_FN static const F& own(const F& v) { return v; }
    template <class... T> GB_FN static bool add_up(T&...) { return true; }

    /// Asks memory for what will be read soon.
    template <class T> GB_FN static void fetch(const T* p) {
        for (std::size_t i = 0; i < sizeof(T); i += 64) __builtin_prefetch(reinterpret_cast<const char*>(p) + i);
    }
    template <class T> GB_FN static const T& read(const T& p) { return p; }
    template <class T, class Fn> GB_FN static void write(T& p, const Fn& fn) { fn(p); }
    GB_FN static F load(const float* p) {
        F r;
        std::memcpy(&r.v, p, sizeof r.v);
        return r;
    }
    GB_FN static void store(float* p, const F& v) { std::memcpy(p, &v.v, sizeof v.v); }
    template <class Index> GB_FN static F gather(const float* p, const Index* index) {
        F r;
#if defined(__AVX512F__)
        if constexpr (sizeof(Index) == 2)
            r.v = (VecF)_mm512_i32gather_ps(_mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i*)index)), p, 4);
        else r.v = (VecF)_mm512_i32gather_ps(_mm512_loadu_si512(index), p, 4);
#else
        for (int i = 0; i < width; ++i) r.v[i] = p[index[i]];
#endif
        return r;
    }
    GB_FN static void scatter(float* p, const std::uint32_t* index, const F& v) {
        for (int i = 0; i < width; ++i) p[index[i]] = v.v[i];
    }
    /// Four values of each lane's item: loads of 16 bytes and a transposition beat four gathers.
    template <class Index> GB_FN static Four<F> gather(const Quad* p, const Index* index) {
#if defined(__AVX512F__)
        const auto four = [&](int i) {
            __m512 r = _mm512_castps128_ps512(_mm_load_ps(&p[index[i]].x));
            r = _mm512_mask_broadcast_f32x4(r, 0x00f0, _mm_load_ps(&p[index[i + 4]].x));
            r = _mm512_mask_broadcast_f32x4(r, 0x0f00, _mm_load_ps(&p[index[i + 8]].x));
            return _mm512_mask_broadcast_f32x4(r, 0xf000, _mm_load_ps(&p[index[i + 12]].x));
        };
        const __m512 a = four(0), b = four(1), c = four(2), d = four(3);
        const __m512 ab = _mm512_unpacklo_ps(a, b), cd = _mm512_unpacklo_ps(c, d);
        const __m512 AB = _mm512_unpackhi_ps(a, b), CD = _mm512_unpackhi_ps(c, d);
        return {(VecF)_mm512_shuffle_ps(ab, cd, 0x44), (VecF)_mm512_shuffle_ps(ab, cd, 0xee),
            (VecF)_mm512_shuffle_ps(AB, CD, 0x44), (VecF)_mm512_shuffle_ps(AB, CD, 0xee)};
#elif defined(__AVX2__)
        const auto two = [&](int i) {
            return _mm256_insertf128_ps(
                _mm256_castps128_ps256(_mm_load_ps(&p[index[i]].x)), _mm_load_ps(&p[index[i + 4]].x), 1);
        };
        const __m256 a = two(0), b = two(1), c = two(2), d = two(3);
        const __m256 ab = _mm256_unpacklo_ps(a, b), cd = _mm256_unpacklo_ps(c, d);
        const __m256 AB = _mm256_unpackhi_ps(a, b), CD = _mm256_unpackhi_ps(c, d);
        return {(VecF)_mm256_shuffle_ps(ab, cd, 0x44), (VecF)_mm256_shuffle_ps(ab, cd, 0xee),
            (VecF)_mm256_shuffle_ps(AB, CD, 0x44), (VecF)_mm256_shuffle_ps(AB, CD, 0xee)};
#else
        Four<F> r;
        for (int i = 0; i < width; ++i) {
            const Quad q = p[index[i]];
            r.x.v[i] = q.x;
            r.y.v[i] = q.y;
            r.z.v[i] = q.z;
            r.w.v[i] = q.w;
        }
        return r;
#endif
    }
    GB_FN static void scatter(Quad* p, const std::uint32_t* index, const Four<F>& v) {
        for (int i = 0; i < width; ++i) p[index[i]] = {v.x.v[i], v.y.v[i], v.z.v[i], v.w.v[i]};
    }

    /// The items of the packet's own rows, which lie side by side.
    GB_FN static void scatter_rows(Quad* p, std::size_t row, const Four<F>& v) {
        for (int i = 0; i < width; ++i) p[row + i] = {v.x.v[i], v.y.v[i], v.z.v[i], v.w.v[i]};
    }

    /// Storage of half the width where the processor converts it; rows of it lie side by side.
#if defined(__AVX512F__)
    using Short = std::uint16_t;
    GB_FN static F load(const Short* p) { return (VecF)_mm512_cvtph_ps(_mm256_loadu_si256((const __m256i*)p)); }
    GB_FN static F keep(Short* p, const F& v) {
        const __m256i s = _mm512_cvtps_ph((__m512)v.v, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
        _mm256_storeu_si256((__m256i*)p, s);
        return (VecF)_mm512_cvtph_ps(s);
    }
#elif defined(__F16C__)
    using Short = std::uint16_t;
    GB_FN static F load(const Short* p) { return (VecF)_mm256_cvtph_ps(_mm_loadu_si128((const __m128i*)p)); }
    GB_FN static F keep(Short* p, const F& v) {
        const __m128i s = _mm256_cvtps_ph((__m256)v.v, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
        _mm_storeu_si128((__m128i*)p, s);
        return (VecF)_mm256_cvtph_ps(s);
    }
#else
    using Short = float;
    GB_FN static F keep(Short* p, const F& v) {
        store(p, v);
        return v;
    }
#endif

    static float one(const Short* p) {
#if defined(__F16C__)
        return _cvtsh_ss(*p);
#else
        return *p;
#endif
    }

    /// Where slots of 16 bits count from (sim/neighbors.hpp): the smallest.
    struct Bases {
        std::uint32_t first;
        GB_FN bool are_far() const { return first == ~0u; }
    };
    template <class T> GB_FN static auto gather(const T* p, const Bases& from, const std::uint16_t* slots) {
        return gather(p + from.first, slots);
    }
    /// Writes the slots of a packet's lists, which are in slot order, in 16 bits.
    class ShortSlots {
    public:
        GB_FN ShortSlots(const std::uint32_t* index, const std::uint32_t* counts, std::size_t) {
            for (int i = 0; i < width; ++i) first_ = counts[i] > 0 && index[i] < first_ ? index[i] : first_;
        }
        /// Nobody is the first: the gradient is 0 there.
        GB_FN void add(std::uint16_t* out, const std::uint32_t* index, std::uint32_t nobody) {
            typedef std::uint16_t Shorts __attribute__((vector_size(2 * kWidth)));
            Bits slots;
            std::memcpy(&slots, index, sizeof slots);
            const Bits d = slots == nobody ? Bits{} : slots - first_;
            const Shorts low = __builtin_convertvector(d, Shorts);
            std::memcpy(out, &low, sizeof low);
            bits_ |= d;
        }
        GB_FN void finish(Bases* out) const {
            std::uint32_t all = 0;
            for (int i = 0; i < width; ++i) all |= bits_[i];
            *out = {all >> 16 == 0 ? first_ : ~0u};
        }

    private:
        typedef std::uint32_t Bits __attribute__((vector_size(4 * kWidth)));
        std::uint32_t first_ = ~0u;
        Bits bits_{};
    };

    /// The longest list of the packet's rows.
    GB_FN static std::uint32_t longest(const std::uint32_t* counts) {
        std::uint32_t most = 0;
        for (int i = 0; i < width; ++i) most = counts[i] > most ? counts[i] : most;
        return most;
    }
    /// fn(lane) in every lane.
    template <class Fn> GB_FN static F map(const Fn& fn) {
        F r;
        for (int i = 0; i < width; ++i) r.v[i] = fn(i);
        return r;
    }
    template <class Fn> GB_FN static D map_d(const Fn& fn) {
        D r;
        for (int i = 0; i < half; ++i) r.v[i] = fn(i);
        return r;
    }
    GB_FN static float get(const F& v, int lane) { return v.v[lane]; }
    GB_FN static double get(const D& v, int lane) { return v.v[lane]; }
};

}  // namespace globule::core
