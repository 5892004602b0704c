// Particles of tissue with bonds between some of them.
#pragma once
#include <utility>
#include <vector>

#include "exec/cpu.hpp"
#include "random.hpp"
#include "sim/blade.hpp"

namespace tissue = core::tissue;

/// Bonds as kernels read them: each at both of its ends, those of 32 particles interleaved.
struct Tissue {
    std::uint32_t n;
    std::vector<core::Quad> at, velocity;  ///< w: inverse mass, times the most that bonds add up to in `at`
    std::vector<std::uint32_t> first{0}, other;
    std::vector<float> length, stiffness;
    std::vector<std::uint8_t> scarred, hold, phase;

    Tissue(const std::vector<float3>& points, const std::vector<std::pair<std::uint32_t, std::uint32_t>>& pairs,
        float k = 1.0f, float mass = 1.0f)
        : n(std::uint32_t(points.size())), scarred(n), hold(n), phase(n) {
        std::vector<std::vector<std::uint32_t>> of(n);
        for (const auto& [a, b] : pairs) of[a].push_back(b), of[b].push_back(a);
        for (std::uint32_t block = 0; block < n; block += tissue::kBlock) {
            std::size_t most = 0;
            for (std::uint32_t t = block; t < std::min(n, block + tissue::kBlock); ++t)
                most = std::max(most, of[t].size());
            other.resize(first.back() + most * tissue::kBlock);
            length.resize(other.size());
            for (std::uint32_t t = block; t < std::min(n, block + tissue::kBlock); ++t)
                for (std::size_t i = 0; i < of[t].size(); ++i) {
                    const std::size_t e = first.back() + t % tissue::kBlock + i * tissue::kBlock;
                    other[e] = of[t][i];
                    length[e] = core::length(points[t] - points[of[t][i]]);
                }
            first.push_back(std::uint32_t(other.size()));
        }
        stiffness.assign(other.size(), k);
        for (std::uint32_t t = 0; t < n; ++t) {
            at.push_back({points[t].x, points[t].y, points[t].z, float(of[t].size()) / mass});
            velocity.push_back({0, 0, 0, 1 / mass});
        }
    }
    tissue::Bonds bonds() {
        return {n, first.data(), other.data(), length.data(), stiffness.data(), nullptr, scarred.data(), nullptr};
    }
    /// fn(particle, entry) for each bond, at its lesser end.
    template <class Fn> void each(const Fn& fn) {
        const tissue::Bonds b = bonds();
        for (std::uint32_t t = 0; t < n; ++t)
            for (std::uint32_t e = b.begin(t); e < b.end(t); e += tissue::kBlock)
                if (length[e] != 0.0f && other[e] > t) fn(t, e);
    }
    /// Substeps of springs alone.
    void run(int steps, float dt, const float3& gravity = {0, 0, 0}, const tissue::Materials& materials = {},
        float contact = 0, const tissue::Shapes& shapes = {}, const tissue::Motions& motions = {}) {
        core::Cpu cpu(core::kHost, 1, nullptr);
        const std::vector<float3> acceleration(n, gravity);
        std::vector<core::Quad> next(at);
        cpu.for_each(n, tissue::Predict{at.data(), velocity.data(), acceleration.data(), hold.data(), motions, dt});
        for (int i = 0; i < steps; ++i) {
            cpu.for_each_packet(n,
                tissue::Relax<true>{bonds(), at.data(), next.data(), velocity.data(), acceleration.data(), hold.data(),
                    phase.data(), nullptr, materials, motions, shapes, {}, {}, dt, contact, true, true, i + 1 < steps});
            std::swap(at, next);
        }
    }
};
