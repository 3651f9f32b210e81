// SPDX-License-Identifier: Apache-2.0
// Bit operations that host and device spell differently, or that the standard library has for the host alone.
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>

#include "core/platform.h"

namespace svgf {

SVGF_HD inline float float_from_bits(std::uint32_t bits) {
    float value;
    std::memcpy(&value, &bits, sizeof(value));
    return value;
}

SVGF_HD inline std::uint32_t bits_of(float value) {
    std::uint32_t bits;
    std::memcpy(&bits, &value, sizeof(bits));
    return bits;
}

// x must not be 0.
SVGF_HD inline int highest_set_bit(std::uint32_t x) {
#if defined(__CUDA_ARCH__)
    return 31 - __clz(int(x));
#else
    return 31 - std::countl_zero(x);
#endif
}

SVGF_HD inline int count_set_bits(std::uint32_t x) {
#if defined(__CUDA_ARCH__)
    return __popc(x);
#else
    return std::popcount(x);
#endif
}

// x must not be 0.
SVGF_HD inline int lowest_set_bit(std::uint32_t x) {
#if defined(__CUDA_ARCH__)
    return __ffs(int(x)) - 1;
#else
    return std::countr_zero(x);
#endif
}

SVGF_HD inline std::uint32_t reverse_bits(std::uint32_t x) {
#if defined(__CUDA_ARCH__)
    return __brev(x);
#else
    x = (x << 16) | (x >> 16);
    x = ((x & 0x00ff00ffu) << 8) | ((x & 0xff00ff00u) >> 8);
    x = ((x & 0x0f0f0f0fu) << 4) | ((x & 0xf0f0f0f0u) >> 4);
    x = ((x & 0x33333333u) << 2) | ((x & 0xccccccccu) >> 2);
    return ((x & 0x55555555u) << 1) | ((x & 0xaaaaaaaau) >> 1);
#endif
}

}  // namespace svgf
