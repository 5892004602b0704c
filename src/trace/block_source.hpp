// The field along a ray in one cell, from the blocks that hold the cell's particles.  On the CPU the SIMD lanes
// share out a block; on the GPU a block is one particle, and the lanes of a team share out the blocks.
#pragma once
#include "trace/cells.hpp"
#include "trace/march.hpp"

namespace globule::core {

/// A cell's particles along a ray: p0 + t d, relative to the cell's center, scaled.
template <class Lanes, class Kernel, bool PerParticle> struct BlockSource {
    using F = typename Lanes::F;
    static constexpr int kFloats = Lanes::width * block_stride(PerParticle, Kernel::stretched);
    const float* blocks;  ///< of all cells
    std::uint32_t first;  ///< of this one's
    int n_blocks;
    Kernel kernel;
    float3 p0, d;

    /// f and slope at t, and with Bounds the bounds of f'' over the window from there.
    template <bool Bounds> GB_FN Along<float> at(float t, const Limits<float>& lim) const {
        Along<F> sum{F(0.0f), F(0.0f), F(0.0f), F(0.0f)};
        add_blocks<Bounds>(sum, 0, 1, point(t), lim);
        return finished<Bounds>({Lanes::sum(sum.f), Lanes::sum(sum.slope), Bounds ? Lanes::sum(sum.rise) : 0.0f,
            Bounds ? Lanes::sum(sum.fall) : 0.0f});
    }
    GB_FN float3 point(float t) const { return {p0.x + t * d.x, p0.y + t * d.y, p0.z + t * d.z}; }
    GB_FN const float* block(int j) const { return blocks + std::size_t(first + j) * kFloats; }
    /// Adds every `stride`th block from the `begin`th on, as seen from a point of the ray.
    template <bool Bounds>
    GB_FN void add_blocks(Along<F>& sum, int begin, int stride, const float3& at, const Limits<float>& lim) const {
        const Vec3<F> p{F(at.x), F(at.y), F(at.z)}, along{F(d.x), F(d.y), F(d.z)};
        const Limits<F> wide{F(lim.tau), F(lim.window), F(lim.error), F(lim.least_step), F(lim.sign)};
        const float* from = block(begin);
        for (int j = begin; j < n_blocks; j += stride, from += stride * kFloats)
            add_block<Bounds>(sum, from, p, along, wide);
    }
    /// As add_blocks of `begin` and of `begin` + 4, every eighth, each in a sum of its own, and then the two.
    template <bool Bounds>
    GB_FN void add_pairs(Along<F>& sum, int begin, const float3& at, const Limits<float>& lim) const {
        const Vec3<F> p{F(at.x), F(at.y), F(at.z)}, along{F(d.x), F(d.y), F(d.z)};
        const Limits<F> wide{F(lim.tau), F(lim.window), F(lim.error), F(lim.least_step), F(lim.sign)};
        Along<F> other{F(0.0f), F(0.0f), F(0.0f), F(0.0f)};
        const float* from = block(begin);
        for (int j = begin; j < n_blocks; j += 8, from += 8 * kFloats) {
            add_block<Bounds>(sum, from, p, along, wide);
            add_block<Bounds>(other, from + 4 * kFloats, p, along, wide);
        }
        sum = {sum.f + other.f, sum.slope + other.slope, sum.rise + other.rise, sum.fall + other.fall};
    }
    template <bool Bounds>
    GB_FN void add_block(
        Along<F>& sum, const float* from, const Vec3<F>& p, const Vec3<F>& along, const Limits<F>& wide) const {
        Vec3<F> q;
        Lanes::load(from, q.x, q.y, q.z);
        if constexpr (Kernel::stretched) {
            const Stretched of(from);
            add_ellipsoid<Bounds, true>(sum, kernel, of.form, of.weight, p - q, along, wide);
        } else if constexpr (PerParticle)
            add<true, Bounds, true>(sum, kernel, p - q, along, Lanes::load(from + 4 * Lanes::width),
                Lanes::load(from + 5 * Lanes::width), wide);
        else add<false, Bounds, true>(sum, kernel, p - q, along, F(1.0f), F(1.0f), wide);
    }
    /// Of a block's particles.
    struct Stretched {
        F weight;
        Sym3<F> form;  ///< the square of its matrix
        GB_FN explicit Stretched(const float* block) {
            F a[4], b[4];
            Lanes::load_four(block + 4 * Lanes::width, a);
            Lanes::load_four(block + 8 * Lanes::width, b);
            weight = a[1];
            form = {a[2], a[3], b[0], b[1], b[2], b[3]};
        }
    };
    template <bool Bounds> GB_FN Along<float> finished(Along<float> total) const {
        total.slope *= 2.0f;
        if constexpr (!PerParticle && Bounds) total.fall *= max(8.0f, kernel.max_fall());  // as in ListSource
        return total;
    }
    /// Largest 1 / support.
    GB_FN float sharpest() const {
        if constexpr (!PerParticle) return 1.0f;
        float most_i2 = 0.0f;
        for (int j = 0; j < n_blocks; ++j)
            most_i2 = max(most_i2, Lanes::largest(Lanes::load(block(j) + 4 * Lanes::width)));
        return sqrt(most_i2);
    }
};

}  // namespace globule::core
