// GB_FN marks a function that runs on host and device; the only decoration a kernel needs.
#pragma once
#include <cstddef>
#include <cstdint>

#if defined(__CUDACC__)
#define GB_FN __host__ __device__ __forceinline__
#define GB_ROLLED _Pragma("unroll 1")  // keep a loop a loop: registers matter more
#else
#define GB_ROLLED
#define GB_FN inline __attribute__((always_inline))
#endif
