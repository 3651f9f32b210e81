// SPDX-License-Identifier: Apache-2.0
// Perspective camera: image points to rays and back.
#pragma once

#include "core/vec.h"

namespace svgf {

// Image points are in pixels, (0, 0) at the top left corner of the image, y down.
struct ImagePoint {
    Vec2 point;
    float depth;  // planar; the point means nothing where it is not > 0
};

struct Camera {
    Mat34 to_world;  // rotation and translation; looks along -z, +y up
    float left = -1, right = 1, bottom = -1, top = 1;  // of the image on the plane z = -1
    float near_clip = 0, far_clip = infinity;          // planar distances
    int width = 1, height = 1;                         // pixels

    SVGF_HD Vec3 position() const { return translation(to_world); }

    // Direction through an image point, of planar depth 1 and so not of unit length.
    SVGF_HD Vec3 direction(Vec2 point) const {
        return transform_vector(to_world, {left + (right - left) * (point.x / float(width)),
                                           top + (bottom - top) * (point.y / float(height)), -1.0f});
    }

    // World vector to camera space.
    SVGF_HD Vec3 to_camera(Vec3 v) const { return transform_normal(to_world, v); }

    SVGF_HD ImagePoint project_direction(Vec3 direction) const {
        const Vec3 v = to_camera(direction);
        const float x = v.x / -v.z, y = v.y / -v.z;
        return {{(x - left) / (right - left) * float(width), (y - top) / (bottom - top) * float(height)}, -v.z};
    }
    SVGF_HD ImagePoint project(Vec3 p) const { return project_direction(p - position()); }
};

}  // namespace svgf
