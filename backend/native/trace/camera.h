// SPDX-License-Identifier: Apache-2.0
// Cameras: image points to rays and back.
#pragma once

#include "core/approximate.h"
#include "core/sampling.h"
#include "core/vec.h"
#include "trace/intersect.h"

namespace svgf {

// Image points are in pixels, (0, 0) at the top left corner of the image, y down.
struct ImagePoint {
    Vec2 point;
    float depth;  // planar; the point means nothing where it is not > 0
};

// The opening of a thin lens.
struct Aperture {
    float radius = 0, focus_distance = 1;  // planar
    float blades = 0;                      // corners; less than 3: round
    float rotation = 0;
    float inverse_ratio = 1;  // width over height

    // A point on the lens.
    SVGF_HD Vec2 sample(Vec2 u) const {
        const Vec2 p = blades < 3.0f ? sample_unit_disk(u) : sample_polygon(u);
        return Vec2{p.x * inverse_ratio, p.y} * radius;
    }

private:
    // Uniform in the regular polygon with corners on the unit circle: one of its triangles, then a point in it.
    SVGF_HD Vec2 sample_polygon(Vec2 u) const {
        const float corner = std::floor(u.x * blades);
        const Vec2 share = sample_triangle({u.x * blades - corner, u.y});
        const float half_angle = pi / blades, middle = rotation + 2.0f * half_angle * corner;
        const Vec2 p{(share.x + share.y) * std::cos(half_angle), (share.x - share.y) * std::sin(half_angle)};
        const float cosine = std::cos(middle), sine = std::sin(middle);
        return {p.x * cosine - p.y * sine, p.x * sine + p.y * cosine};
    }
};

struct Camera {
    Mat34 to_world;  // rotation and translation; looks along -z, +y up
    float left = -1, right = 1, bottom = -1, top = 1;  // of the image on the plane z = -1
    float near_clip = 0, far_clip = infinity;          // planar distances
    bool is_orthographic = false;                      // rays are parallel, and the window in metres
    Aperture aperture;
    int width = 1, height = 1;  // pixels

    SVGF_HD Vec3 position() const { return translation(to_world); }

    // The window's plane at an image point.
    SVGF_HD Vec2 on_window(Vec2 point) const {
        return {left + (right - left) * (point.x / float(width)), top + (bottom - top) * (point.y / float(height))};
    }

    // Camera-space direction through an image point, of planar depth 1 and so not of unit length.
    SVGF_HD Vec3 local_direction(Vec2 point) const {
        if (is_orthographic) return {0, 0, -1};
        const Vec2 p = on_window(point);
        return {p.x, p.y, -1.0f};
    }

    // The ray through an image point from the middle of the lens. Its direction has planar depth 1, so its t is planar
    // and so are the clips.
    SVGF_HD Ray ray(Vec2 point) const {
        Vec3 origin = position();
        if (is_orthographic) {
            const Vec2 p = on_window(point);
            origin = transform_point(to_world, {p.x, p.y, 0.0f});
        }
        return {origin, transform_vector(to_world, local_direction(point)), near_clip, far_clip, ray_kind::camera};
    }

    // The same from another point of the lens: all of them meet at the focus distance.
    SVGF_HD Ray ray_through_lens(Vec2 point, Vec2 u) const {
        Ray result = ray(point);
        const Vec2 lens = aperture.sample(u);
        const Vec3 shift = transform_vector(to_world, {lens.x, lens.y, 0.0f});
        result.origin += shift;
        result.direction += shift * (-1.0f / aperture.focus_distance);
        return result;
    }

    // World vectors from the window's plane at an image point to that at the next one to the right, and below.
    SVGF_HD Vec3 step_x() const { return transform_vector(to_world, {(right - left) / float(width), 0.0f, 0.0f}); }
    SVGF_HD Vec3 step_y() const { return transform_vector(to_world, {0.0f, (bottom - top) / float(height), 0.0f}); }

    // World vector to camera space.
    SVGF_HD Vec3 to_camera(Vec3 v) const { return transform_normal(to_world, v); }

    SVGF_HD ImagePoint project_direction(Vec3 direction) const {
        const Vec3 v = to_camera(direction);
        if (is_orthographic) return {{0, 0}, -v.z};  // the same for all pixels
        return to_image(v.x / -v.z, v.y / -v.z, -v.z);
    }
    SVGF_HD ImagePoint project(Vec3 p) const {
        const Vec3 v = to_camera(p - position());
        if (is_orthographic) return to_image(v.x, v.y, -v.z);
        return to_image(v.x / -v.z, v.y / -v.z, -v.z);
    }

    // Derivatives by the image point's x and y of the depth at which its ray meets a plane; depth: where it does now.
    // The ray o + s d meets n (x - p) = 0 at s = n (p - o) / n d. Of a perspective camera only d changes,
    // ds = -s (n dd) / (n d); of an orthographic one only o, ds = -(n do) / (n d).
    SVGF_HD Vec2 depth_gradient(Vec2 point, float depth, Vec3 normal) const {
        const Vec3 n = to_camera(normal);
        const float scale = fast_quotient(is_orthographic ? -1.0f : -depth, dot(n, local_direction(point)));
        return {n.x * ((right - left) / float(width)) * scale, n.y * ((bottom - top) / float(height)) * scale};
    }

private:
    SVGF_HD ImagePoint to_image(float x, float y, float depth) const {
        return {{(x - left) / (right - left) * float(width), (y - top) / (bottom - top) * float(height)}, depth};
    }
};

}  // namespace svgf
