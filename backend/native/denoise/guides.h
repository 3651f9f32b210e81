// SPDX-License-Identifier: Apache-2.0
// What the stages know of the surfaces behind the pixels, repaired, and the edge weights that follow from it.
//
// Guides are three images, so that each stage loads only what it needs: normal and depth together (one 16-byte load per
// filter tap), the gradient (centre pixel only, or history taps) and the object id (temporal only). Where there is no
// surface, depth is `background_depth`, the object id 0 and the rest 0: such a pixel takes part in nothing.
#pragma once

#include <atomic>
#include <cstdint>

#include "core/vec.h"

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

// Values outside [0, largest_radiance], NaN and infinities become 0.
SVGF_HD inline float repair(float value, int& repaired) {
    if (in_range(value, 0.0f, largest_radiance)) return value;
    ++repaired;
    return 0.0f;
}
SVGF_HD inline Vec3 repair(Vec3 value, int& repaired) {
    return {repair(value.x, repaired), repair(value.y, repaired), repair(value.z, repaired)};
}

SVGF_HD inline Vec3 load3(const float* image, int pixel) {
    return {image[3 * pixel], image[3 * pixel + 1], image[3 * pixel + 2]};
}

struct Guides {
    const Vec4* normal_depth = nullptr;
    const Vec2* gradient = nullptr;
    const int32_t* object_id = nullptr;
    int width = 0, height = 0;

    SVGF_HD bool contains(int x, int y) const { return x >= 0 && x < width && y >= 0 && y < height; }
    SVGF_HD int pixel(int x, int y) const { return y * width + x; }
};

SVGF_HD inline bool is_surface(Vec4 normal_depth) { return normal_depth.w < background_depth; }

// Natural logarithm of w_z w_n for the tap q = p + (dx, dy) [Schied17, Eq. 3, 4], so that a signal's w_l joins it under
// one exponential. False if the weight is 0.
SVGF_HD inline bool edge_weight_log(Vec4 p, Vec4 q, Vec2 gradient, int dx, int dy, float sigma_depth,
                                    float sigma_normal, float& weight_log) {
    if (!is_surface(q)) return false;
    const float cosine = dot(p.xyz(), q.xyz());
    if (!(cosine > 0.0f)) return false;
    const float explained = std::fabs(gradient.x * float(dx) + gradient.y * float(dy));
    weight_log = sigma_normal * std::log(cosine) -
                 std::fabs(p.w - q.w) / (sigma_depth * explained + depth_epsilon * p.w + 1e-30f);
    return true;
}

}  // namespace svgf
