// SPDX-License-Identifier: Apache-2.0
// What differs between the compilers that read this source. Nothing else in native/ names a compiler or a vendor.
#pragma once

#if defined(__CUDACC__)
#define SVGF_HD __host__ __device__
#else
#define SVGF_HD
#endif

#if defined(__CUDA_ARCH__)
#define SVGF_UNROLL _Pragma("unroll")
#else
#define SVGF_UNROLL
#endif
