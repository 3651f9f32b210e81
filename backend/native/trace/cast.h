// SPDX-License-Identifier: Apache-2.0
// Stages "closest" and "occluded": rays that the caller brings, against the scene.
#pragma once

#include "device/launch_shape.h"
#include "trace/intersect.h"

namespace svgf {

// As the caller lays them out.
struct GivenRay {
    Vec3 origin, direction;
    float t_min, t_max;

    SVGF_HD Ray ray() const { return {origin, direction, max(t_min, 0.0f), t_max}; }
};
static_assert(sizeof(GivenRay) == 8 * sizeof(float));

struct ClosestStage {
    static constexpr LaunchShape launch_shape{8, 16, trace_blocks};

    SceneView scene;
    int width;
    const GivenRay* in_ray;
    float* out_distance;  // in lengths of the direction; infinity where nothing is hit
    std::int32_t* out_instance;
    std::int32_t* out_triangle;

    SVGF_HD void operator()(int x, int y) const {
        const int i = y * width + x;
        const Hit hit = find_closest_hit(scene, in_ray[i].ray());
        out_distance[i] = hit.t;
        out_instance[i] = hit.instance;
        out_triangle[i] = hit.triangle;
    }
};

struct OccludedStage {
    static constexpr LaunchShape launch_shape{8, 16, trace_blocks};

    SceneView scene;
    int width;
    const GivenRay* in_ray;
    std::int32_t* out_occluded;  // 0 or 1

    SVGF_HD void operator()(int x, int y) const {
        const int i = y * width + x;
        out_occluded[i] = is_occluded(scene, in_ray[i].ray()) ? 1 : 0;
    }
};

}  // namespace svgf
