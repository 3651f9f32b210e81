// SPDX-License-Identifier: Apache-2.0
// Where a surface was in the frame before, and which of history's pixels saw it [Schied17, Sec. 4.1]. Shared by the
// temporal stages; each of them says what it takes from an accepted tap.
//
// The depth test continues the surface's plane from the reprojected point, where it has its expected previous depth
// (2.5D motion), to the old pixel: the depths themselves differ when the camera moves forward or the plane is seen at a
// grazing angle, and good history would be dropped. Half a pixel of the plane's slope is forgiven, as surfaces are
// curved. The slope is this frame's: that of the frame before differs by less than is forgiven, and need not be kept.
#pragma once

#include "denoise/guides.h"

namespace svgf {

// Bilinear taps that weigh less than this together say less than the 3x3 pixels around the nearest one.
constexpr float least_tap_weight = 0.01f;
// Share of depth that the test forgives if motion does not say the expected previous depth.
constexpr float unknown_depth_tolerance = 0.1f;

template <class Storage>
struct Reprojection {
    typename Storage::Guides prev_guides;  // false: no history
    const float* in_motion = nullptr;              // null: nothing moved
    int motion_channels = 0;
    float depth_tolerance = 0.0f, normal_tolerance = 0.0f;
    bool tests_taps = true, interpolates = true;  // see PlusStep

    struct Point {
        float x = 0.0f, y = 0.0f;  // pixels, 0 = centre of the first one
        float expected_depth = 0.0f;
        Vec2 slope;              // of depth, per pixel
        float tolerance = 0.0f;  // of depth
        Vec3 normal;
        int32_t object_id = 0;  // as stored
    };

    int bytes_per_pixel() const {
        return (in_motion ? 4 * motion_channels : 0) + (prev_guides ? Storage::guide_bytes : 0);
    }

    // False if it was outside the frame, nowhere known, or there is no history. surface: the pixel's normal and depth.
    // slope: of its depth per pixel.
    SVGF_HD bool find(int x, int y, Vec4 surface, Vec2 slope, int32_t stored_id, Point& point, int& repaired) const {
        if (!prev_guides) return false;
        const int pixel = prev_guides.pixel(x, y);
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
        if (!(is_between(point.x, prev_guides.width) && is_between(point.y, prev_guides.height))) return false;
        point.expected_depth = surface.w + motion.z;
        point.slope = slope;
        point.tolerance =
            tolerance * std::fabs(point.expected_depth) + 0.5f * (std::fabs(slope.x) + std::fabs(slope.y));
        point.normal = surface.xyz();
        point.object_id = stored_id;
        return true;
    }

    // Of the four bilinear taps around a point, in rows: the weight, 0 where it did not see the surface. are_all: none
    // of them saw another.
    struct Taps {
        float weight[4] = {};
        bool are_enough = false, are_all = false;
    };
    SVGF_HD Taps weigh(const Point& point) const {
        const int left = int(std::floor(point.x)), top = int(std::floor(point.y));
        float fx = point.x - float(left), fy = point.y - float(top);
        if (!interpolates) {
            fx = std::floor(fx + 0.5f);
            fy = std::floor(fy + 0.5f);
        }
        Taps taps;
        taps.are_all = interpolates;
        float total = 0.0f;
        SVGF_UNROLL
        for (int k = 0; k < 4; ++k) {
            const int i = k % 2, j = k / 2;
            const float share = (i ? fx : 1.0f - fx) * (j ? fy : 1.0f - fy);
            const bool accepted = accepts(left + i, top + j, point);
            taps.weight[k] = accepted ? share : 0.0f;
            taps.are_all = taps.are_all && accepted;
            total += taps.weight[k];
        }
        taps.are_enough = total >= least_tap_weight;
        return taps;
    }

    // take(pixel, weight) for every tap that saw the surface, and perhaps with weight 0 for others; where they are not
    // enough, take(pixel, 1) for those of the 3x3 pixels around the nearest one that did; where none did and `radius`
    // is larger than 1, for those of 3x3 pixels 2, 4, 8 ... apart, up to that. Returns how far apart they are; 0: the
    // taps.
    template <class Take>
    SVGF_HD int visit(const Point& point, const Taps& taps, const Take& take, int radius = 1) const {
        if (taps.are_enough) {
            const int left = int(std::floor(point.x)), top = int(std::floor(point.y));
            SVGF_UNROLL
            for (int k = 0; k < 4; ++k)  // where any bits are a number, a weight of 0 is cheaper than a branch
                if (!Storage::holds_any_bits || taps.weight[k] > 0.0f)
                    take(prev_guides.nearest_pixel(left + k % 2, top + k / 2), taps.weight[k]);
            return 0;
        }
        const int x = int(std::floor(point.x + 0.5f)), y = int(std::floor(point.y + 0.5f));
        SVGF_NO_UNROLL
        for (int spacing = 1; spacing <= radius; spacing *= 2) {
            bool found = false;
            SVGF_NO_UNROLL
            for (int k = 0; k < 9; ++k) {
                const int column = x + (k % 3 - 1) * spacing, row = y + (k / 3 - 1) * spacing;
                if (!accepts(column, row, point)) continue;
                take(prev_guides.pixel(column, row), 1.0f);
                found = true;
            }
            if (found) return spacing;
        }
        return radius;
    }

    // A surface with the one that a pixel of the frame before saw.
    struct Comparison {
        bool same_object;
        float cosine;       // between the normals
        float depth_error;  // of the surface's plane, continued to the pixel
    };
    // Outside of the frame it is with the nearest pixel inside.
    SVGF_HD Comparison compare(int x, int y, const Point& point) const {
        int32_t object_id;
        const Vec4 tap = prev_guides.read(prev_guides.nearest_pixel(x, y), object_id);
        const float plane =
            point.expected_depth + point.slope.x * (float(x) - point.x) + point.slope.y * (float(y) - point.y);
        return {object_id == point.object_id, dot(tap.xyz(), point.normal), tap.w - plane};
    }

private:
    // A bilinear tap can lie inside the frame. Also keeps huge motion from overflowing the integers.
    SVGF_HD static bool is_between(float position, int size) { return position > -1.0f && position < float(size); }

    SVGF_HD bool accepts(int x, int y, const Point& point) const {
        // Without a branch the reads of several taps are under way together.
        const Comparison tap = compare(x, y, point);
        const int is_same = int(tap.same_object) & int(tap.cosine >= normal_tolerance) &
                            int(std::fabs(tap.depth_error) <= point.tolerance);
        return bool(int(prev_guides.contains(x, y)) & (is_same | int(!tests_taps)));
    }
};

}  // namespace svgf
