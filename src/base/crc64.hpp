// The 64-bit cyclic redundancy check of OpenIGTLink: polynomial of ECMA-182, highest bit first, no initial or final
// inversion.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>

namespace globule::core {

/// Sixteen bytes a step (Kounavis & Berry 2005, "slicing"): table[k] is the check of a byte with k zero bytes behind
/// it.
inline std::uint64_t crc64(const std::uint8_t* data, std::size_t n, std::uint64_t crc = 0) {
    using Tables = std::array<std::array<std::uint64_t, 256>, 16>;
    static const Tables tables = [] {
        Tables t{};
        for (std::uint64_t byte = 0; byte < 256; ++byte) {
            std::uint64_t c = byte << 56;
            for (int bit = 0; bit < 8; ++bit) c = (c << 1) ^ (c >> 63 ? 0x42F0E1EBA9EA3693ull : 0);
            t[0][byte] = c;
        }
        for (int k = 1; k < 16; ++k)
            for (int byte = 0; byte < 256; ++byte) t[k][byte] = (t[k - 1][byte] << 8) ^ t[0][t[k - 1][byte] >> 56];
        return t;
    }();
    for (; n >= 16; n -= 16, data += 16) {
        std::uint64_t next = 0;
        for (int i = 0; i < 8; ++i) next ^= tables[15 - i][data[i] ^ std::uint8_t(crc >> (56 - 8 * i))];
        for (int i = 8; i < 16; ++i) next ^= tables[15 - i][data[i]];
        crc = next;
    }
    for (; n > 0; --n, ++data) crc = (crc << 8) ^ tables[0][*data ^ std::uint8_t(crc >> 56)];
    return crc;
}

}  // namespace globule::core
