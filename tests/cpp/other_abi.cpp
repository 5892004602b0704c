// A backend library of another version: all that may be asked of it is its number, which comes first.
#include <cstdint>

extern "C" __attribute__((visibility("default"))) const std::uint64_t globule_backend[512] = {1};
