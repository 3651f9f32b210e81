// SPDX-License-Identifier: Apache-2.0
// What enters a mesh, the same where it is built and where it is refitted.
#pragma once

#include "scene/flat_scene.h"

namespace svgf {

// Products of three coordinates stay finite in float.
constexpr float largest_coordinate = 1e12f;

// Whether rays can hit a triangle: it has an area, and coordinates that are finite and not beyond largest_coordinate.
SVGF_HD inline bool is_hittable(Vec3 a, Vec3 b, Vec3 c) {
    const auto fits = [](Vec3 p) { return is_finite(p) && max_component(abs(p)) <= largest_coordinate; };
    if (!fits(a) || !fits(b) || !fits(c)) return false;
    return max_component(abs(accurate_cross(b - a, c - a))) >= std::numeric_limits<float>::min();
}

// All zero if one of them cannot be used.
SVGF_HD inline CornerNormals checked_normals(const Vec3* corners) {
    CornerNormals result;
    for (int k = 0; k < 3; ++k) {
        if (!is_finite(corners[k]) || dot(corners[k], corners[k]) == 0.0f) return {};
        result.corner[k] = corners[k];
    }
    return result;
}

// Zero, which stands for the triangle's own, where it is no tangent.
SVGF_HD inline CornerTangents checked_tangents(const Vec4* corners) {
    CornerTangents result;
    for (int k = 0; k < 3; ++k) {
        if (!is_finite(corners[k].xyz()) || !is_finite(corners[k].w)) return {};
        result.corner[k] = corners[k];
    }
    return result;
}

}  // namespace svgf
