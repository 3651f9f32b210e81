// SPDX-License-Identifier: Apache-2.0
// Functions as fast as the device can. On the GPU each is a single instruction; their errors, by the PTX manual: exp2
// and 1/sqrt(x) 2^-22 relative, log2 2^-22 absolute between 1/2 and 2 and relative elsewhere, 1/x and sqrt 2^-23
// relative.
// Denormals count as 0. The host's are correctly rounded or nearly so.
//
// Shading divides and takes roots by these: exact ones are many instructions each, and those few that a kernel must get
// right to the bit are written as / and std::sqrt. They are spelled out, not asked of the compiler by an option, so that
// every kernel that covers a scene gives the same bits: what the compiler makes of approximate quotients depends on the
// code around them.
#pragma once

#include <cmath>

#include "core/platform.h"

namespace svgf {

SVGF_HD inline float fast_exp2(float x) {
#if defined(__CUDA_ARCH__)
    float y;
    asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
#else
    return std::exp2(x);
#endif
}

// Of 0: minus infinity.
SVGF_HD inline float fast_log2(float x) {
#if defined(__CUDA_ARCH__)
    float y;
    asm("lg2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
#else
    return std::log2(x);
#endif
}

SVGF_HD inline float fast_reciprocal(float x) {
#if defined(__CUDA_ARCH__)
    float y;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
#else
    return 1.0f / x;
#endif
}

// Where |b| is in [2^-126, 2^126]; of smaller ones infinity, of larger ones 0. On the host as exact as a quotient is.
SVGF_HD inline float fast_quotient(float a, float b) {
#if defined(__CUDA_ARCH__)
    return a * fast_reciprocal(b);
#else
    return a / b;
#endif
}

SVGF_HD inline float fast_reciprocal_sqrt(float x) {
#if defined(__CUDA_ARCH__)
    float y;
    asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
#else
    return 1.0f / std::sqrt(x);
#endif
}

SVGF_HD inline float fast_sqrt(float x) {
#if defined(__CUDA_ARCH__)
    float y;
    asm("sqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
#else
    return std::sqrt(x);
#endif
}

// Of numbers: if one is NaN, either may come back.
SVGF_HD inline float fast_min(float a, float b) {
#if defined(__CUDA_ARCH__)
    return fminf(a, b);
#else
    return a < b ? a : b;
#endif
}
SVGF_HD inline float fast_max(float a, float b) {
#if defined(__CUDA_ARCH__)
    return fmaxf(a, b);
#else
    return a > b ? a : b;
#endif
}

}  // namespace svgf
