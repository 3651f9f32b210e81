// SPDX-License-Identifier: Apache-2.0
// Numbers in few bits, the same on host and device. What each encoding keeps stands beside it; tests hold them to that.
#pragma once

#include <cstdint>

#include "core/approximate.h"
#include "core/bits.h"
#include "core/vec.h"

namespace svgf {

// A float >= 0 with 7 bits of exponent and `mantissa` bits of mantissa: 0 and 2^-62 to 2^65, wider than half, good to
// 2^-(mantissa + 1). Smaller ones become 0, larger ones the largest. noise in [0, 1): 1/2 rounds to nearest, a random
// one makes the expected value that of the float.
template <int mantissa>
SVGF_HD inline uint32_t encode_positive(float value, float noise = 0.5f) {
    constexpr int shift = 23 - mantissa;
    constexpr uint32_t bias = 64u << 23, largest = (1u << (7 + mantissa)) - 1;
    const uint32_t bits = bits_of(value) + uint32_t(noise * float(1 << shift));
    if (!(value > 0.0f) || bits < bias + (1u << 23)) return 0;
    const uint32_t code = (bits - bias) >> shift;
    return code < largest ? code : largest;
}
template <int mantissa>
SVGF_HD inline float decode_positive(uint32_t code) {
    return float_from_bits(code << (23 - mantissa)) * 18446744073709551616.0f;  // 2^64
}

// Colour >= 0 and a standard deviation in 8 bytes. The channels share the exponent of the largest one: each is good to
// 2^-15 of it, 16 times better than half, so that a long running mean does not get stuck. Up to 2^63.
struct alignas(8) PackedColor {
    uint32_t low = 0, high = 0;  // r 14, g 14, exponent 4 | b 14, deviation 15, exponent 3; from the lowest bit
};

SVGF_HD inline PackedColor encode_color(Vec3 color, float deviation) {
    const float most = max_component(color);
    // 2^exponent is the first power of two that 16383.5 / 16384 of no channel reaches.
    int exponent = int(bits_of(most * (1.0f + 1.0f / 16384.0f)) >> 23) - 126;
    exponent = clamp(exponent, -63, 64);
    const float scale = float_from_bits(uint32_t(127 + 14 - exponent) << 23);
    const uint32_t r = uint32_t(color.x * scale + 0.5f), g = uint32_t(color.y * scale + 0.5f),
                   b = uint32_t(color.z * scale + 0.5f), e = uint32_t(exponent + 63);
    return {r | g << 14 | e << 28, b | encode_positive<8>(deviation) << 14 | (e >> 4) << 29};
}

SVGF_HD inline Vec3 decode_color(PackedColor packed) {
    const uint32_t e = packed.low >> 28 | (packed.high >> 29) << 4;
    const float scale = float_from_bits((e + 127 - 14 - 63) << 23);
    return Vec3{float(packed.low & 0x3fffu), float(packed.low >> 14 & 0x3fffu), float(packed.high & 0x3fffu)} * scale;
}
SVGF_HD inline float decode_deviation(PackedColor packed) { return decode_positive<8>(packed.high >> 14 & 0x7fffu); }

// Unit vectors on an octahedron [Cigolle14], 2 x `bits`: 12 are good to 8e-4 rad. The zero vector comes back as +z.
template <int bits>
SVGF_HD inline uint32_t encode_normal(Vec3 n) {
    constexpr float one = float((1 << (bits - 1)) - 1);
    const float scale = 1.0f / max(std::fabs(n.x) + std::fabs(n.y) + std::fabs(n.z), 1e-30f);
    float u = n.x * scale, v = n.y * scale;
    if (n.z < 0.0f) {
        const float folded_u = (1.0f - std::fabs(v)) * (u < 0.0f ? -1.0f : 1.0f);
        v = (1.0f - std::fabs(u)) * (v < 0.0f ? -1.0f : 1.0f);
        u = folded_u;
    }
    return uint32_t(u * one + (one + 0.5f)) | uint32_t(v * one + (one + 0.5f)) << bits;
}
template <int bits>
SVGF_HD inline Vec3 decode_normal(uint32_t packed) {
    constexpr uint32_t mask = (1u << bits) - 1;
    constexpr float one = float((1 << (bits - 1)) - 1);
    float u = float(packed & mask) * (1.0f / one) - 1.0f, v = float(packed >> bits & mask) * (1.0f / one) - 1.0f;
    const float z = 1.0f - std::fabs(u) - std::fabs(v), fold = max(-z, 0.0f);
    u += u < 0.0f ? fold : -fold;
    v += v < 0.0f ? fold : -fold;
    return Vec3{u, v, z} * fast_reciprocal_sqrt(u * u + v * v + z * z);
}

}  // namespace svgf
