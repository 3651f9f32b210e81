// SPDX-License-Identifier: Apache-2.0
// Random numbers, and the maps from the unit square to disk, hemisphere, cone and triangle.
//
// The numbers are a function of (pixel, seed, sample, pair), in integers, so every device draws the same ones. Each
// pair of dimensions of each pixel is a 2D Sobol sequence, shuffled and scrambled on its own [Burley20]: within a
// pixel the samples of one pair are stratified, between pairs and pixels they are independent.
//
// Points stratified over the screen as well [Ahmed20] were measured and left out: scrambled anew in each frame, or in
// 8x8 tiles of which each pixel stays stratified over time. In one frame the means of 4x4 pixels have 8 to 36 % less
// variance, but svgf+ makes little of it (our scenes, 480x270): FLIP -1.6 to +1.7 % at frame 16, relative MSE -1.2 to
// +1.8 % and flicker -0.3 to -3.8 % over frames 5 to 16. The first kind gains most, and ruins still views: after 16
// samples a pixel's squared error is 3 to 90 times that of these points, for analytic integrands.
#pragma once

#include "core/approximate.h"
#include "core/bits.h"
#include "core/vec.h"

namespace svgf {

SVGF_HD inline std::uint32_t mix_bits(std::uint32_t x) {
    x ^= x >> 16;
    x *= 0x7feb352du;
    x ^= x >> 15;
    x *= 0x846ca68bu;
    return x ^ (x >> 16);
}

// Nested uniform scrambling: each bit is flipped by a hash of the bits above it [Burley20, Section 3.2]. Both numbers
// with their bits reversed.
SVGF_HD inline std::uint32_t owen_scramble_reversed(std::uint32_t x, std::uint32_t seed) {
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16) | 1u;
    x ^= x * 0x05526c56u;
    return x ^ (x * 0x53a22864u);
}
SVGF_HD inline std::uint32_t owen_scramble(std::uint32_t x, std::uint32_t seed) {
    return reverse_bits(owen_scramble_reversed(reverse_bits(x), seed));
}

// The second Sobol dimension of the index whose reversed bits (the first dimension) are given. Its generator matrix is
// Pascal's triangle modulo 2, which factors into one masked shift per bit of the bit number.
SVGF_HD inline std::uint32_t sobol_second_dimension(std::uint32_t reversed_index) {
    std::uint32_t x = reversed_index;
    x ^= x << 16;
    x ^= (x & 0x00ff00ffu) << 8;
    x ^= (x & 0x0f0f0f0fu) << 4;
    x ^= (x & 0x33333333u) << 2;
    return x ^ ((x & 0x55555555u) << 1);
}

// 24 bits: exact in a float, and below 1.
SVGF_HD inline float unit_float(std::uint32_t bits) { return float(std::int32_t(bits >> 8)) * (1.0f / 16777216.0f); }

// Names of the pairs. Those of a path's vertex follow each other, four apart; vertex 0 is the first hit. Those of the
// surfaces that rays meet are far from all others.
enum class SamplePair : std::uint32_t {
    pixel = 0,
    direction = 1,
    lobe_and_roulette = 2,
    light_point = 3,
    light = 4,
    surface = 1u << 16,
    lens = 1u << 17,
    shadow = 1u << 18,
};

// All random numbers of one sample of one pixel.
struct Sampler {
    std::uint32_t pixel_key, sample;

    // pixel: its number, row by row.
    SVGF_HD Sampler(int pixel, std::uint32_t seed, std::uint32_t sample)
        : pixel_key(mix_bits(std::uint32_t(pixel) ^ mix_bits(seed))), sample(sample) {}

    SVGF_HD Vec2 pair(SamplePair name, int vertex = 0) const {
        const std::uint32_t key = key_of(name, vertex);
        const std::uint32_t first = owen_scramble_reversed(reverse_bits(sample), key);
        const std::uint32_t second = sobol_second_dimension(first);
        return {unit_float(owen_scramble(first, mix_bits(key ^ 0xa511e9b3u))),
                unit_float(owen_scramble(second, mix_bits(key ^ 0x63d83595u)))};
    }

    // The first number of a pair that each triangle of each instance has for itself, in whatever order a ray meets them.
    SVGF_HD float at_triangle(SamplePair name, int vertex, std::int32_t instance, std::int32_t triangle) const {
        const std::uint32_t surface = mix_bits(mix_bits(std::uint32_t(instance)) + std::uint32_t(triangle));
        const std::uint32_t key = mix_bits(key_of(name, vertex) ^ surface);
        const std::uint32_t first = owen_scramble_reversed(reverse_bits(sample), key);
        return unit_float(owen_scramble(first, mix_bits(key ^ 0xa511e9b3u)));
    }

    SVGF_HD std::uint32_t key_of(SamplePair name, int vertex) const {
        const std::uint32_t dimension = std::uint32_t(name) + 4u * std::uint32_t(vertex);
        return mix_bits(pixel_key + 0x9e3779b9u * (dimension + 1u));
    }
};

// The pairs of a path's vertex, from `direction` to `light`. The host draws all four at once, in lanes; the device each
// where it is used, to have its registers for other things.
class VertexSampler {
public:
#if defined(__CUDA_ARCH__)
    SVGF_HD VertexSampler(const Sampler& sampler, int vertex) : sampler_(sampler), vertex_(vertex) {}
    SVGF_HD Vec2 pair(SamplePair name) const { return sampler_.pair(name, vertex_); }

private:
    const Sampler& sampler_;
    int vertex_;
#else
    SVGF_HD VertexSampler(const Sampler& sampler, int vertex) {
        // Numbers 0 to 3 are first ones, 4 to 7 second ones.
        const std::uint32_t reversed_sample = reverse_bits(sampler.sample);
        std::uint32_t key[2 * pairs], value[2 * pairs];
        for (std::uint32_t i = 0; i < pairs; ++i) {
            const std::uint32_t pair_key = sampler.key_of(SamplePair(first_pair + i), vertex);
            key[i] = pair_key ^ 0xa511e9b3u;
            key[pairs + i] = pair_key ^ 0x63d83595u;
            value[i] = owen_scramble_reversed(reversed_sample, pair_key);
            value[pairs + i] = sobol_second_dimension(value[i]);
        }
        for (std::uint32_t i = 0; i < 2 * pairs; ++i)
            number_[i] = unit_float(owen_scramble(value[i], mix_bits(key[i])));
    }
    SVGF_HD Vec2 pair(SamplePair name) const {
        const std::uint32_t i = std::uint32_t(name) - first_pair;
        return {number_[i], number_[pairs + i]};
    }

private:
    static constexpr std::uint32_t first_pair = std::uint32_t(SamplePair::direction), pairs = 4;
    float number_[2 * pairs];
#endif
};

// Orthonormal frame around a unit vector [Duff17].
struct Frame {
    Vec3 x, y, z;

    SVGF_HD explicit Frame(Vec3 axis) : z(axis) {
        const float sign = std::copysign(1.0f, axis.z);
        const float a = -fast_reciprocal(sign + axis.z);
        const float b = axis.x * axis.y * a;
        x = {1.0f + sign * axis.x * axis.x * a, sign * b, -sign * axis.x};
        y = {b, sign + axis.y * axis.y * a, -axis.y};
    }

    SVGF_HD Vec3 to_world(Vec3 v) const { return x * v.x + y * v.y + z * v.z; }
    SVGF_HD Vec3 to_local(Vec3 v) const { return {dot(x, v), dot(y, v), dot(z, v)}; }
};

// Cosine and sine of an angle in half turns. The device is spared the reduction of angles of any size, which is much code.
SVGF_HD inline Vec2 point_on_circle(float half_turns) {
#if defined(__CUDA_ARCH__)
    Vec2 point;
    sincospif(half_turns, &point.y, &point.x);
    return point;
#else
    return {std::cos(pi * half_turns), std::sin(pi * half_turns)};
#endif
}

// Concentric map, area preserving [Shirley97].
SVGF_HD inline Vec2 sample_unit_disk(Vec2 u) {
    const float a = 2.0f * u.x - 1.0f, b = 2.0f * u.y - 1.0f;
    if (a == 0.0f && b == 0.0f) return {};
    const bool wide = std::fabs(a) > std::fabs(b);
    const float radius = wide ? a : b;
    return point_on_circle(wide ? 0.25f * fast_quotient(b, a) : 0.5f - 0.25f * fast_quotient(a, b)) * radius;
}

// Density cos / pi, around +z.
SVGF_HD inline Vec3 sample_cosine_hemisphere(Vec2 u) {
    const Vec2 d = sample_unit_disk(u);
    return {d.x, d.y, fast_sqrt(max(0.0f, 1.0f - dot(d, d)))};
}

// Uniform directions around +z within the cone of the given 1 - cosine; 2 is the whole sphere. Works with 1 - cos
// throughout, so that a cone as narrow as the sun's keeps its precision.
SVGF_HD inline Vec3 sample_cone(Vec2 u, float one_minus_cosine) {
    const float height = u.x * one_minus_cosine;
    const float radius = fast_sqrt(max(0.0f, height * (2.0f - height)));
    const Vec2 around = point_on_circle(2.0f * u.y) * radius;
    return {around.x, around.y, 1.0f - height};
}

// Weights of the two edges for a uniform point on a triangle: vertex + edge1 * x + edge2 * y.
SVGF_HD inline Vec2 sample_triangle(Vec2 u) {
    const float root = fast_sqrt(u.x);
    return {root * (1.0f - u.y), root * u.y};
}

// Weight of a technique with density `own` against one with density `other` [Veach97, Section 9.2.4], exponent 2. The
// ratio is squared, not the densities: those overflow.
SVGF_HD inline float power_heuristic(float own, float other) {
    if (!(own > 0.0f)) return 0.0f;
    const float ratio = fast_quotient(other, own);
    return fast_reciprocal(1.0f + ratio * ratio);
}

}  // namespace svgf
