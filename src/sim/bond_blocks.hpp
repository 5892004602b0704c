// From compressed rows of bonds to the interleaved blocks that functors read.
#pragma once
#include <algorithm>
#include <stdexcept>

#include "backends/status.hpp"
#include "backends/tissue.hpp"

namespace globule::core {

/// On the host: rows of 32 particles' k-th bonds; shorter rows end with bonds of no length.
struct BondBlocks {
    std::vector<std::uint32_t> first, other;
    std::vector<float> length, stiffness;
    std::vector<std::uint8_t> vessel;  ///< none yet

    /// `before`: particles of other bodies (whole blocks) and their entries.
    BondBlocks(const TissueArrays& in, std::uint32_t before, std::uint32_t entries_before) {
        using tissue::kBlock;
        const std::uint32_t n_blocks = (in.n + kBlock - 1) / kBlock;
        first.assign(n_blocks + 1, entries_before);
        for (std::uint32_t b = 0; b < n_blocks; ++b) {
            std::uint64_t widest = 0;
            for (std::uint32_t t = b * kBlock; t < std::min(in.n, (b + 1) * kBlock); ++t)
                widest = std::max(widest, in.offsets[t + 1] - in.offsets[t]);
            const std::uint64_t end = first[b] + widest * kBlock;
            if (end > 0xffffffffull) throw Refused("bonds: expected fewer than 2^31 bonds");
            first[b + 1] = std::uint32_t(end);
        }
        const std::size_t n_entries = first[n_blocks] - entries_before;
        other.resize(n_entries);
        length.assign(n_entries, 0.0f);
        stiffness.assign(n_entries, 0.0f);
        vessel.assign(n_entries, 0);
        for (std::uint32_t b = 0; b < n_blocks; ++b)
            for (std::uint32_t e = first[b]; e < first[b + 1]; ++e)
                other[e - entries_before] = before + std::min(in.n - 1, b * kBlock + (e - first[b]) % kBlock);
        for (std::uint32_t t = 0; t < in.n; ++t)
            for (std::uint64_t i = in.offsets[t]; i < in.offsets[t + 1]; ++i) {
                const std::size_t e =
                    first[t / kBlock] - entries_before + std::size_t(i - in.offsets[t]) * kBlock + t % kBlock;
                other[e] = before + in.other[i];
                length[e] = in.length[i];
                stiffness[e] = in.stiffness[i];
            }
    }
};

}  // namespace globule::core
