// SPDX-License-Identifier: Apache-2.0
// What differs between the compilers that read this source. Nothing else in native/ names a compiler or a vendor.
#pragma once

#if defined(__CUDACC__)
#define SVGF_HD __host__ __device__
#else
#define SVGF_HD
#endif

// For what is called from several places of a large kernel: its instructions must fit the instruction cache.
#if defined(__CUDACC__)
#define SVGF_NOINLINE __noinline__
#else
#define SVGF_NOINLINE
#endif

// For what is called from the innermost loops, whose registers a call would spill.
#if defined(__GNUC__)
#define SVGF_ALWAYS_INLINE __attribute__((always_inline))
#else
#define SVGF_ALWAYS_INLINE
#endif

#if defined(__CUDA_ARCH__)
#define SVGF_UNROLL _Pragma("unroll")
#define SVGF_NO_UNROLL _Pragma("unroll 1")
#else
#define SVGF_UNROLL
#define SVGF_NO_UNROLL
#endif
