// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "core/vec.h"

namespace svgf {

// How far light is followed: svgf.LightPaths. All but `bounces` and `transparent_bounces` only
// count in kernels for Effects::light_path_limits.
struct LightPaths {
    int bounces = 0;  // >= 0; 0 is direct light
    int diffuse_bounces = 1024, glossy_bounces = 1024, transmission_bounces = 1024, transparent_bounces = 1024;
    bool reflective_caustics = true, refractive_caustics = true;
    float clamp_direct = 0, clamp_indirect = 0;  // 0: none
    float filter_glossy = 0;                     // 0: none

    SVGF_HD bool has_clamps() const { return clamp_direct > 0.0f || clamp_indirect > 0.0f; }

    // Light that comes after so many bounces, no brighter than the clamps allow.
    SVGF_HD Vec3 clamped(Vec3 light, int light_bounces) const {
        const float limit = 3.0f * (light_bounces > 1 ? clamp_indirect : clamp_direct);
        const float sum = light.x + light.y + light.z;
        return limit > 0.0f && sum > limit ? light * (limit / sum) : light;
    }
};

}  // namespace svgf
