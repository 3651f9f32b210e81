// SPDX-License-Identifier: Apache-2.0
// Numbers in few bits, the same on host and device. What each encoding keeps stands beside it; tests hold them to that.
#pragma once

#include <cstdint>

#include "core/approximate.h"
#include "core/bits.h"
#include "core/vec.h"

namespace svgf {

// A float >= 0 with 7 bits of exponent and `mantissa` bits of mantissa: 0 and 2^-62 to 2^65, wider than half, good to
// 2^-(mantissa + 1). Smaller ones become 0, larger ones the largest.
template <int mantissa>
SVGF_HD inline uint32_t encode_positive(float value) {
    constexpr int shift = 23 - mantissa;
    constexpr uint32_t bias = 64u << 23, largest = (1u << (7 + mantissa)) - 1;
    const uint32_t code = (bits_of(value) + (1u << (shift - 1)) - bias) >> shift;
    return value >= 0x1p-62f ? (code < largest ? code : largest) : 0;
}
template <int mantissa>
SVGF_HD inline float decode_positive(uint32_t code) {
    return float_from_bits(code << (23 - mantissa)) * 18446744073709551616.0f;  // 2^64
}

// Colour >= 0 and a standard deviation in 8 bytes. The channels share the exponent of the largest one: each is good to
// 2^-15 of it, 16 times better than half, so that a long running mean does not get stuck. Up to 2^63.
struct alignas(8) PackedColor {
    uint32_t low = 0, high = 0;  // from the lowest bit: r 14, g 14, b 14, exponent 7, deviation 15
};

SVGF_HD inline PackedColor encode_color(Vec3 color, float deviation) {
    const float most = fast_max(color.x, fast_max(color.y, color.z));
    // 2^(e - 63) is the first power of two that 16383.5 / 16384 of no channel reaches.
    const uint32_t e = uint32_t(clamp(int(bits_of(most * (1.0f + 1.0f / 16384.0f)) >> 23) - 63, 0, 127));
    const float scale = float_from_bits((127 + 14 + 63 - e) << 23);
    // Added to 2^23 a number below 2^14 stands, rounded, in the lowest bits.
    const uint32_t r = bits_of(color.x * scale + 0x1p23f) & 0x3fffu, g = bits_of(color.y * scale + 0x1p23f) & 0x3fffu,
                   b = bits_of(color.z * scale + 0x1p23f) & 0x3fffu;
    return {r | g << 14 | b << 28, b >> 4 | e << 10 | encode_positive<8>(deviation) << 17};
}

SVGF_HD inline Vec3 decode_color(PackedColor packed) {
    const float scale = float_from_bits((packed.high << 13 & 0x3f800000u) + ((127u - 14 - 63) << 23));
    const uint32_t b = (packed.low >> 28 | packed.high << 4) & 0x3fffu;
    return Vec3{float(packed.low & 0x3fffu), float(packed.low >> 14 & 0x3fffu), float(b)} * scale;
}
SVGF_HD inline float decode_deviation(PackedColor packed) { return decode_positive<8>(packed.high >> 17); }

// Unit vectors on an octahedron [Cigolle14], 2 x `bits`: 12 are good to 8e-4 rad. The zero vector comes back as +z.
template <int bits>
SVGF_HD inline uint32_t encode_normal(Vec3 n) {
    constexpr float one = float((1 << (bits - 1)) - 1);
    const float scale = fast_reciprocal(fast_max(std::fabs(n.x) + std::fabs(n.y) + std::fabs(n.z), 1e-30f));
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
    const float z = 1.0f - std::fabs(u) - std::fabs(v), fold = fast_max(-z, 0.0f);
    u -= std::copysign(fold, u);
    v -= std::copysign(fold, v);
    return Vec3{u, v, z} * fast_reciprocal_sqrt(u * u + v * v + z * z);
}

}  // namespace svgf
