// Memory that others of this host may read: the same process's objects, and another one's where the memory is a GPU's.
#pragma once
#include <unistd.h>

#include <array>
#include <cstdint>

#include "base/device.hpp"

namespace globule::core {

/// Where such memory is, for who is to read it; plain bytes, which may go to another process.
struct LentPlace {
    std::int64_t process = 0;
    std::int32_t device = kHost;
    std::int32_t has_handle = 0;
    const char* address = nullptr;  ///< in its own process
    std::array<char, 64> handle{};  ///< of a GPU's memory, for other processes
    bool is_here() const { return process == std::int64_t(getpid()); }
};

}  // namespace globule::core
