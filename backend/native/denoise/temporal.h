// SPDX-License-Identifier: Apache-2.0
// Stage "temporal": reprojection, and the running means of colour and luminance moments [Schied17, Sec. 4.1, 4.2].
//
// Reads the frame's illumination and guides, and what the frame before left: its guides, the colour after its first
// a-trous level, its moments and history lengths. Writes the new means; variance over time goes along with the colour.
//
// Departures from the paper:
// - Depth test: the plane through the old pixel, continued to the reprojected point, against the expected previous
//   depth (2.5D motion). The depths themselves differ when the camera moves forward or the plane is seen at a grazing
//   angle, and the test would drop good history there. Half a pixel of the plane's slope is forgiven, as surfaces are
//   curved.
// - alpha = max(alpha, 1 / N), N frames of history with this one: the first frames get equal weights, as their mean is
//   the best there is, and with alpha = 0 a still view converges.
// - Moments are kept as mean and variance, not as mean and second moment: the same numbers in exact arithmetic, but the
//   variance is never negative and does not cancel where luminance is large.
// - Taps that weigh less than 1 % together count as none: their colour says less than the 3x3 search does.
// - History that is not a number is not read.
#pragma once

#include "denoise/guides.h"

namespace svgf {

constexpr float least_tap_weight = 0.01f;
// Share of depth that the test forgives if motion does not say the expected previous depth.
constexpr float unknown_depth_tolerance = 0.1f;

template <class Storage, int Signals>
struct Temporal {
    using Guides = typename Storage::Guides;

    Guides guides;
    Guides prev_guides;  // false: no history
    const float* in_motion;  // null: nothing moved
    int motion_channels;
    typename Storage::Color in_illumination[Signals], hist_color[Signals];
    typename Storage::Moments hist_moments[Signals];
    float alpha, alpha_moments, depth_tolerance, normal_tolerance;
    typename Storage::Color out_color[Signals];  // with the variance over time; in_illumination may be the same
    typename Storage::Moments out_moments[Signals];
    int* out_repaired;

    int bytes_per_pixel() const {
        const int history = Signals * (Storage::color_bytes + Storage::moments_bytes) + Storage::guide_bytes;
        return Storage::guide_bytes + Signals * (2 * Storage::color_bytes + Storage::moments_bytes) +
               (in_motion ? 4 * motion_channels : 0) + (prev_guides ? history : 0);
    }
    // Where demodulate has just written this pixel's guides and colour, which are written again or not at all.
    int bytes_per_pixel_after_demodulate() const {
        return bytes_per_pixel() - Storage::guide_bytes - Signals * 2 * Storage::color_bytes;
    }

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y);
        Mean old;
        const Vec4 surface = guides.normal_depth(pixel);
        if (!is_surface(surface.w)) {
            for (int s = 0; s < Signals; ++s) {
                out_color[s].store(pixel, in_illumination[s][pixel]);
                out_moments[s].store(pixel, {});
            }
            guides.store_length(pixel, 0.0f);
            return;
        }
        int repaired = 0;
        if (prev_guides) read_history(x, y, surface, old, repaired);
        count(out_repaired, repaired);

        const float length = old.length + 1.0f;
        const float a = max(alpha, 1.0f / length), a_moments = max(alpha_moments, 1.0f / length);
        for (int s = 0; s < Signals; ++s) {
            const Vec3 color = in_illumination[s][pixel].xyz();
            const Vec3 mean = (1.0f - a) * old.color[s] + a * color;
            const float light = luminance(color), old_variance = old.weight > 0.0f ? old.squares[s] / old.weight : 0.0f;
            const Vec2 moments = {(1.0f - a_moments) * old.mean[s] + a_moments * light,
                                  (1.0f - a_moments) * (old_variance + a_moments * square(light - old.mean[s]))};
            out_color[s].store(pixel, {mean.x, mean.y, mean.z, moments.y});
            out_moments[s].store(pixel, moments);
        }
        guides.store_length(pixel, length);
    }

private:
    // Weighted mean of history taps; luminance moments are merged about their common mean [Chan83].
    struct Mean {
        float weight = 0.0f, length = 0.0f;
        Vec3 color[Signals];
        float mean[Signals] = {}, squares[Signals] = {};
    };

    // Where the surface of this pixel was in the frame before.
    struct Reprojection {
        float x, y;             // pixels, 0 = centre of the first one
        float expected_depth;
        float tolerance;        // depth
        Vec3 normal;
        int32_t object_id;
    };

    SVGF_HD void read_history(int x, int y, Vec4 surface, Mean& old, int& repaired) const {
        const int pixel = guides.pixel(x, y);
        Vec3 motion;
        float tolerance = depth_tolerance;
        if (in_motion) {
            const float* m = in_motion + size_t(pixel) * motion_channels;
            motion = {m[0], m[1], motion_channels == 3 ? m[2] : 0.0f};
            if (motion_channels != 3) tolerance = max(tolerance, unknown_depth_tolerance);
            if (!is_finite(motion)) {
                ++repaired;
                return;
            }
        }
        Reprojection point;
        point.x = float(x) + motion.x;
        point.y = float(y) + motion.y;
        if (!(is_between(point.x, guides.width) && is_between(point.y, guides.height))) return;
        point.expected_depth = surface.w + motion.z;
        point.tolerance = tolerance * std::fabs(point.expected_depth);
        point.normal = surface.xyz();
        point.object_id = guides.object_id(pixel);

        const int left = int(std::floor(point.x)), top = int(std::floor(point.y));
        const float fx = point.x - float(left), fy = point.y - float(top);
        for (int j = 0; j < 2; ++j)
            for (int i = 0; i < 2; ++i) {
                const float share = (i ? fx : 1.0f - fx) * (j ? fy : 1.0f - fy);
                if (share > 0.0f) add_tap(left + i, top + j, share, point, old, repaired);
            }
        if (old.weight >= least_tap_weight) return;
        // Too little found: any of the 3x3 pixels around the nearest one will do.
        old = {};
        const int nearest_x = int(std::floor(point.x + 0.5f)), nearest_y = int(std::floor(point.y + 0.5f));
        for (int j = -1; j <= 1; ++j)
            for (int i = -1; i <= 1; ++i) add_tap(nearest_x + i, nearest_y + j, 1.0f, point, old, repaired);
    }

    // A bilinear tap can lie inside the frame. Also keeps huge motion from overflowing the integers.
    SVGF_HD static bool is_between(float position, int size) { return position > -1.0f && position < float(size); }

    // Adds history's pixel (x, y) if it saw the same surface.
    SVGF_HD void add_tap(int x, int y, float weight, const Reprojection& point, Mean& old, int& repaired) const {
        if (!prev_guides.contains(x, y)) return;
        const int pixel = prev_guides.pixel(x, y);
        if (prev_guides.object_id(pixel) != point.object_id) return;
        const Vec4 tap = prev_guides.normal_depth(pixel);
        if (!(dot(tap.xyz(), point.normal) >= normal_tolerance)) return;
        const Vec2 slope = prev_guides.gradient(pixel);
        const float plane = tap.w + slope.x * (point.x - float(x)) + slope.y * (point.y - float(y));
        const float allowed = point.tolerance + 0.5f * (std::fabs(slope.x) + std::fabs(slope.y));
        if (!(std::fabs(plane - point.expected_depth) <= allowed)) return;
        if (!is_usable(pixel)) {
            ++repaired;
            return;
        }
        const float before = old.weight;
        old.weight += weight;
        const float share = weight / old.weight;
        old.length += (prev_guides.length(pixel) - old.length) * share;
        for (int s = 0; s < Signals; ++s) {
            old.color[s] += (hist_color[s][pixel].xyz() - old.color[s]) * share;
            const Vec2 moments = hist_moments[s][pixel];
            const float difference = moments.x - old.mean[s];
            old.mean[s] += difference * share;
            old.squares[s] += weight * moments.y + before * share * difference * difference;
        }
    }

    // What is stored is numbers that an accumulation can have left there.
    SVGF_HD bool is_usable(int pixel) const {
        if constexpr (!Storage::holds_any_bits) return true;
        bool good = in_range(prev_guides.length(pixel), 0.0f, 16777216.0f);
        for (int s = 0; s < Signals; ++s) {
            const Vec4 color = hist_color[s][pixel];
            const Vec2 moments = hist_moments[s][pixel];
            const float largest = 2.0f * largest_radiance;
            good = good && in_range(color.x, 0.0f, largest) && in_range(color.y, 0.0f, largest) &&
                   in_range(color.z, 0.0f, largest) && in_range(moments.x, 0.0f, largest) &&
                   in_range(moments.y, 0.0f, largest * largest);
        }
        return good;
    }
};

}  // namespace svgf
