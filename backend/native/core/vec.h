// SPDX-License-Identifier: Apache-2.0
// Small vectors and affine transforms, the same on host and device.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>

#include "core/approximate.h"
#include "core/platform.h"

namespace svgf {

constexpr float pi = 3.14159265358979323846f;
constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr float largest_float = std::numeric_limits<float>::max();

struct Vec2 {
    float x = 0, y = 0;
};

struct Vec3 {
    float x = 0, y = 0, z = 0;

    SVGF_HD float operator[](int i) const { return i == 0 ? x : i == 1 ? y : z; }
};

struct alignas(16) Vec4 {
    float x = 0, y = 0, z = 0, w = 0;

    SVGF_HD Vec3 xyz() const { return {x, y, z}; }
};

SVGF_HD inline Vec2 operator+(Vec2 a, Vec2 b) { return {a.x + b.x, a.y + b.y}; }
SVGF_HD inline Vec2 operator-(Vec2 a, Vec2 b) { return {a.x - b.x, a.y - b.y}; }
SVGF_HD inline Vec2 operator*(Vec2 a, float s) { return {a.x * s, a.y * s}; }
SVGF_HD inline Vec2 operator*(float s, Vec2 a) { return a * s; }

SVGF_HD inline Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
SVGF_HD inline Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
SVGF_HD inline Vec3 operator*(Vec3 a, Vec3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
SVGF_HD inline Vec3 operator/(Vec3 a, Vec3 b) { return {a.x / b.x, a.y / b.y, a.z / b.z}; }
SVGF_HD inline Vec3 operator*(Vec3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
SVGF_HD inline Vec3 operator*(float s, Vec3 a) { return a * s; }
SVGF_HD inline Vec3 operator/(Vec3 a, float s) { return a * (1.0f / s); }
SVGF_HD inline Vec3 operator-(Vec3 a) { return {-a.x, -a.y, -a.z}; }
SVGF_HD inline Vec3& operator+=(Vec3& a, Vec3 b) { return a = a + b; }
SVGF_HD inline Vec3& operator*=(Vec3& a, Vec3 b) { return a = a * b; }
SVGF_HD inline Vec3& operator*=(Vec3& a, float s) { return a = a * s; }
SVGF_HD inline Vec3 operator+(Vec3 a, float s) { return {a.x + s, a.y + s, a.z + s}; }
SVGF_HD inline Vec3 operator-(float s, Vec3 a) { return {s - a.x, s - a.y, s - a.z}; }

SVGF_HD inline Vec4 operator+(Vec4 a, Vec4 b) { return {a.x + b.x, a.y + b.y, a.z + b.z, a.w + b.w}; }
SVGF_HD inline Vec4 operator*(Vec4 a, float s) { return {a.x * s, a.y * s, a.z * s, a.w * s}; }

// Where a is NaN these return b, so a NaN on the left never spreads.
SVGF_HD inline float min(float a, float b) { return a < b ? a : b; }
SVGF_HD inline float max(float a, float b) { return a > b ? a : b; }
SVGF_HD inline int min(int a, int b) { return a < b ? a : b; }
SVGF_HD inline int max(int a, int b) { return a > b ? a : b; }
SVGF_HD inline float clamp(float x, float low, float high) { return min(max(x, low), high); }
SVGF_HD inline int clamp(int x, int low, int high) { return min(max(x, low), high); }
SVGF_HD inline float saturate(float x) { return clamp(x, 0.0f, 1.0f); }
SVGF_HD inline float square(float x) { return x * x; }
SVGF_HD inline float lerp(float a, float b, float t) { return a + (b - a) * t; }

SVGF_HD inline Vec3 min(Vec3 a, Vec3 b) { return {min(a.x, b.x), min(a.y, b.y), min(a.z, b.z)}; }
SVGF_HD inline Vec3 max(Vec3 a, Vec3 b) { return {max(a.x, b.x), max(a.y, b.y), max(a.z, b.z)}; }
SVGF_HD inline Vec3 max(Vec3 a, float s) { return {max(a.x, s), max(a.y, s), max(a.z, s)}; }
SVGF_HD inline float max_component(Vec3 a) { return max(a.x, max(a.y, a.z)); }
SVGF_HD inline float min_component(Vec3 a) { return min(a.x, min(a.y, a.z)); }
SVGF_HD inline Vec3 abs(Vec3 a) { return {std::fabs(a.x), std::fabs(a.y), std::fabs(a.z)}; }
SVGF_HD inline Vec3 lerp(Vec3 a, Vec3 b, float t) { return a + (b - a) * t; }

// a*b + c: in one rounding on the device, where two would be two instructions. For what need not have the same bits on
// host and device. Kernels are compiled without contraction, so that nothing else is fused: what the compiler fuses
// depends on the code around it, and the same path would have other bits in another kernel.
SVGF_HD inline float multiply_add(float a, float b, float c) {
#if defined(__CUDA_ARCH__)
    return __fmaf_rn(a, b, c);
#else
    return a * b + c;
#endif
}

SVGF_HD inline Vec3 multiply_add(Vec3 a, float b, Vec3 c) {
    return {multiply_add(a.x, b, c.x), multiply_add(a.y, b, c.y), multiply_add(a.z, b, c.z)};
}

SVGF_HD inline float dot(Vec2 a, Vec2 b) { return multiply_add(a.y, b.y, a.x * b.x); }
SVGF_HD inline float dot(Vec3 a, Vec3 b) { return multiply_add(a.z, b.z, multiply_add(a.y, b.y, a.x * b.x)); }
SVGF_HD inline Vec3 cross(Vec3 a, Vec3 b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
SVGF_HD inline float length(Vec3 a) { return fast_sqrt(dot(a, a)); }

// a*b - c*d, right to about one rounding; the sign is always that of the exact result. The device has fused
// multiply-adds but slow doubles, the host may have it the other way round.
SVGF_HD inline float difference_of_products(float a, float b, float c, float d) {
#if defined(__CUDA_ARCH__)
    const float cd = c * d;
    return fmaf(a, b, -cd) + fmaf(-c, d, cd);
#else
    return float(double(a) * b - double(c) * d);
#endif
}

// cross(a, b) without cancellation, for the normals of needles.
SVGF_HD inline Vec3 accurate_cross(Vec3 a, Vec3 b) {
    return {difference_of_products(a.y, b.z, a.z, b.y), difference_of_products(a.z, b.x, a.x, b.z),
            difference_of_products(a.x, b.y, a.y, b.x)};
}

// The zero vector stays zero, and so does what is too short for its square: callers test for it, nothing turns to NaN.
SVGF_HD inline Vec3 normalize(Vec3 a) {
    const float squared = dot(a, a);
    return squared >= std::numeric_limits<float>::min() ? a * fast_reciprocal_sqrt(squared) : Vec3{};
}

// Rec.709.
SVGF_HD inline float luminance(Vec3 c) { return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z; }

SVGF_HD inline bool is_finite(float x) { return std::fabs(x) <= largest_float; }
SVGF_HD inline bool is_finite(Vec3 a) { return is_finite(a.x) && is_finite(a.y) && is_finite(a.z); }

// Affine transform, row-major [R | t], as svgf.Scene holds it.
struct Mat34 {
    Vec4 row[3];
};

SVGF_HD inline Vec3 transform_vector(const Mat34& m, Vec3 v) {
    return {dot(m.row[0].xyz(), v), dot(m.row[1].xyz(), v), dot(m.row[2].xyz(), v)};
}
SVGF_HD inline Vec3 transform_point(const Mat34& m, Vec3 p) {
    return {dot(m.row[0].xyz(), p) + m.row[0].w, dot(m.row[1].xyz(), p) + m.row[1].w,
            dot(m.row[2].xyz(), p) + m.row[2].w};
}
// Normals go by the inverse transpose; the caller passes the inverse.
SVGF_HD inline Vec3 transform_normal(const Mat34& inverse, Vec3 n) {
    return {inverse.row[0].x * n.x + inverse.row[1].x * n.y + inverse.row[2].x * n.z,
            inverse.row[0].y * n.x + inverse.row[1].y * n.y + inverse.row[2].y * n.z,
            inverse.row[0].z * n.x + inverse.row[1].z * n.y + inverse.row[2].z * n.z};
}
SVGF_HD inline Vec3 translation(const Mat34& m) { return {m.row[0].w, m.row[1].w, m.row[2].w}; }

}  // namespace svgf
