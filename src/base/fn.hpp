// GB_FN marks a function that runs on host and device; the only decoration a kernel needs.
#pragma once
#include <cstddef>
#include <cstdint>

#if defined(__CUDACC__)
#define GB_FN __host__ __device__ __forceinline__
#else
#define GB_FN inline __attribute__((always_inline))
#endif
