// SPDX-License-Identifier: Apache-2.0
// What is good in the inputs and what is repaired, and the weights by which pixels of one surface are told from others.
#pragma once

#include <atomic>
#include <cstdint>

#include "core/approximate.h"
#include "core/vec.h"
#include "denoise/storage.h"

namespace svgf {

// Public convention of the G-buffer: no surface at this depth or beyond.
constexpr float background_depth = 1e10f;
// Radiance over albedo outside [0, largest_radiance] is no radiance; its square still fits a float.
constexpr float largest_radiance = 1e18f;
// Steepest depth gradient (per pixel) that a G-buffer holds.
constexpr float largest_gradient = 1e10f;
// Share of depth that [Schied17, Eq. 3] forgives where the gradient vanishes. The paper's epsilon is absolute;
// curvature and rounding grow with depth, and a scene may be of any scale.
constexpr float depth_epsilon = 1e-3f;

SVGF_HD inline bool in_range(float value, float low, float high) { return value >= low && value <= high; }

// Adds to a counter that all pixels share. Repairs are rare, so contention is no matter.
SVGF_HD inline void count(int* counter, int amount) {
    if (amount == 0) return;
#if defined(__CUDA_ARCH__)
    atomicAdd(counter, amount);
#else
    std::atomic_ref<int>(*counter).fetch_add(amount, std::memory_order_relaxed);
#endif
}

SVGF_HD inline void count(unsigned long long* counter, unsigned long long amount) {
#if defined(__CUDA_ARCH__)
    atomicAdd(counter, amount);
#else
    std::atomic_ref<unsigned long long>(*counter).fetch_add(amount, std::memory_order_relaxed);
#endif
}

// Values outside [0, largest_radiance], NaN and infinities become 0.
SVGF_HD inline float repair(float value, int& repaired) {
    if (in_range(value, 0.0f, largest_radiance)) return value;
    ++repaired;
    return 0.0f;
}
SVGF_HD inline Vec3 repair(Vec3 value, int& repaired) {
    // Mostly all is well, and told by two tests: a NaN makes the sum one.
    const float least = fast_min(value.x, fast_min(value.y, value.z)), sum = value.x + value.y + value.z;
    if (least >= 0.0f && sum <= largest_radiance) return value;
    return {repair(value.x, repaired), repair(value.y, repaired), repair(value.z, repaired)};
}

SVGF_HD inline Vec3 load3(const float* image, int pixel) {
    return {image[3 * pixel], image[3 * pixel + 1], image[3 * pixel + 2]};
}

// How sharp reflections are: 1 show edges, as a mirror's do, 0 are as smooth as diffuse light. Between these
// roughnesses it falls, in thirds.
constexpr float mirror_roughness = 0.1f, matte_roughness = 0.4f;

SVGF_HD inline float gloss_of(float roughness) {
    const float gloss = saturate((matte_roughness - roughness) * (1.0f / (matte_roughness - mirror_roughness)));
    return std::floor(gloss * float(gloss_steps) + 0.5f) * (1.0f / float(gloss_steps));
}

SVGF_HD inline bool is_surface(float depth) { return depth < background_depth; }

constexpr float log2_e = 1.44269504088896341f, ln_2 = 0.693147180559945309f;

// w_z and w_n of a pixel's taps [Schied17, Eq. 3, 4] as logarithms to the base 2, so that a signal's w_l joins them
// under one exponential. A tap whose depth is infinity weighs 0. Normal is how w_n follows from the cosine between the
// normals:
//
//   CosinePower   cosine^sigma, the paper's
//   CosineLobe    exp(sigma (cosine - 1)), the same to second order where it is not small, and three multiply-adds
struct CosinePower {
    Vec3 normal;
    float sigma = 0.0f;

    CosinePower() = default;
    SVGF_HD CosinePower(Vec3 normal, float sigma) : normal(normal), sigma(sigma) {}
    SVGF_HD float operator()(Vec3 tap, float kernel_log2) const {
        return sigma * fast_log2(max(dot(normal, tap), 0.0f)) + kernel_log2;
    }
};

struct CosineLobe {
    Vec3 scaled_normal;
    float offset = 0.0f;

    CosineLobe() = default;
    SVGF_HD CosineLobe(Vec3 normal, float sigma) : scaled_normal(normal * (sigma * log2_e)), offset(-sigma * log2_e) {}
    SVGF_HD float operator()(Vec3 tap, float kernel_log2) const {
        return scaled_normal.x * tap.x +
               (scaled_normal.y * tap.y + (scaled_normal.z * tap.z + (offset + kernel_log2)));
    }
};

template <class Normal>
struct EdgeWeight {
    Normal normal;
    float depth = 0.0f, tolerance = 0.0f;
    Vec2 slope;

    EdgeWeight() = default;
    SVGF_HD EdgeWeight(Vec4 normal_depth, Vec2 gradient, float sigma_depth, float sigma_normal)
        : normal(normal_depth.xyz(), sigma_normal), depth(normal_depth.w),
          tolerance((depth_epsilon * depth + 1e-30f) * ln_2), slope((sigma_depth * ln_2) * gradient) {}

    // Of depth differences to taps (i, j) steps away; the same for (-i, -j).
    SVGF_HD float depth_scale(int i, int j, float step) const {
        const float x = float(i) * (slope.x * step), y = float(j) * (slope.y * step);
        return fast_reciprocal((i == 0 ? std::fabs(y) : j == 0 ? std::fabs(x) : std::fabs(x + y)) + tolerance);
    }
    // kernel_log2: of the tap's place in the kernel.
    SVGF_HD float operator()(Vec4 tap, float depth_scale, float kernel_log2 = 0.0f) const {
        return normal(tap.xyz(), kernel_log2) - std::fabs(tap.w - depth) * depth_scale;
    }
};

}  // namespace svgf
