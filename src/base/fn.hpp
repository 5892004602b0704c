// GB_FN marks a function that runs on host and device; GB_FN_APART one that a processor calls, since it is long for how
// seldom it runs, or runs from many places; GB_UNROLL a loop whose body is to be written out for each turn.
#pragma once
#include <cstddef>
#include <cstdint>

#if defined(__CUDACC__)
#define GB_FN __host__ __device__ __forceinline__
#define GB_FN_APART GB_FN
#define GB_UNROLL _Pragma("unroll")
#else
#define GB_FN inline __attribute__((always_inline))
#define GB_FN_APART inline __attribute__((noinline))
#define GB_UNROLL _Pragma("GCC unroll 8")
#endif
