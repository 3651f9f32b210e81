// SPDX-License-Identifier: Apache-2.0
// Where a surface was in the frame before, and which of history's pixels saw it [Schied17, Sec. 4.1]. Shared by the
// temporal stages; each of them says what it takes from an accepted tap.
//
// The depth test continues the plane through the old pixel to the reprojected point and compares it with the expected
// previous depth (2.5D motion): the depths themselves differ when the camera moves forward or the plane is seen at a
// grazing angle, and good history would be dropped. Half a pixel of the plane's slope is forgiven, as surfaces are
// curved.
#pragma once

#include "denoise/guides.h"

namespace svgf {

// Bilinear taps that weigh less than this together say less than the 3x3 pixels around the nearest one.
constexpr float least_tap_weight = 0.01f;
// Share of depth that the test forgives if motion does not say the expected previous depth.
constexpr float unknown_depth_tolerance = 0.1f;

template <class Storage>
struct Reprojection {
    typename Storage::Guides guides, prev_guides;  // prev_guides false: no history
    const float* in_motion = nullptr;              // null: nothing moved
    int motion_channels = 0;
    float depth_tolerance = 0.0f, normal_tolerance = 0.0f;

    struct Point {
        float x, y;  // pixels, 0 = centre of the first one
        float expected_depth;
        float tolerance;  // depth
        Vec3 normal;
        int32_t object_id;
    };

    int bytes_per_pixel() const {
        return Storage::guide_bytes + (in_motion ? 4 * motion_channels : 0) + (prev_guides ? Storage::guide_bytes : 0);
    }

    // False if it was outside the frame, nowhere known, or there is no history. surface: the pixel's normal and depth.
    SVGF_HD bool find(int x, int y, Vec4 surface, Point& point, int& repaired) const {
        if (!prev_guides) return false;
        const int pixel = guides.pixel(x, y);
        Vec3 motion;
        float tolerance = depth_tolerance;
        if (in_motion) {
            const float* m = in_motion + size_t(pixel) * motion_channels;
            motion = {m[0], m[1], motion_channels == 3 ? m[2] : 0.0f};
            if (motion_channels != 3) tolerance = max(tolerance, unknown_depth_tolerance);
            if (!is_finite(motion)) {
                ++repaired;
                return false;
            }
        }
        point.x = float(x) + motion.x;
        point.y = float(y) + motion.y;
        if (!(is_between(point.x, guides.width) && is_between(point.y, guides.height))) return false;
        point.expected_depth = surface.w + motion.z;
        point.tolerance = tolerance * std::fabs(point.expected_depth);
        point.normal = surface.xyz();
        point.object_id = guides.object_id(pixel);
        return true;
    }

    // take(pixel, weight) for every bilinear tap that saw the same surface.
    template <class Take>
    SVGF_HD void visit_bilinear(const Point& point, const Take& take) const {
        const int left = int(std::floor(point.x)), top = int(std::floor(point.y));
        const float fx = point.x - float(left), fy = point.y - float(top);
        for (int j = 0; j < 2; ++j)
            for (int i = 0; i < 2; ++i) {
                const float share = (i ? fx : 1.0f - fx) * (j ? fy : 1.0f - fy);
                if (share > 0.0f && accepts(left + i, top + j, point))
                    take(prev_guides.pixel(left + i, top + j), share);
            }
    }

    // take(pixel, 1) for every one of the 3x3 pixels around the nearest one that saw the same surface.
    template <class Take>
    SVGF_HD void visit_neighbours(const Point& point, const Take& take) const {
        const int x = int(std::floor(point.x + 0.5f)), y = int(std::floor(point.y + 0.5f));
        for (int j = -1; j <= 1; ++j)
            for (int i = -1; i <= 1; ++i)
                if (accepts(x + i, y + j, point)) take(prev_guides.pixel(x + i, y + j), 1.0f);
    }

private:
    // A bilinear tap can lie inside the frame. Also keeps huge motion from overflowing the integers.
    SVGF_HD static bool is_between(float position, int size) { return position > -1.0f && position < float(size); }

    SVGF_HD bool accepts(int x, int y, const Point& point) const {
        if (!prev_guides.contains(x, y)) return false;
        const int pixel = prev_guides.pixel(x, y);
        if (prev_guides.object_id(pixel) != point.object_id) return false;
        const Vec4 tap = prev_guides.normal_depth(pixel);
        if (!(dot(tap.xyz(), point.normal) >= normal_tolerance)) return false;
        const Vec2 slope = prev_guides.gradient(pixel);
        const float plane = tap.w + slope.x * (point.x - float(x)) + slope.y * (point.y - float(y));
        const float allowed = point.tolerance + 0.5f * (std::fabs(slope.x) + std::fabs(slope.y));
        return std::fabs(plane - point.expected_depth) <= allowed;
    }
};

}  // namespace svgf
