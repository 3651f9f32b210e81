// SPDX-License-Identifier: Apache-2.0
// Stage "demodulate": radiance over albedo, so that the filter never blurs what the textures draw [Schied17, Sec. 4].
//
// Reads the public images, each of them once; writes the guides and one illumination per signal. All that later stages
// read is finite and non-negative because of what happens here.
//
// Departures from the paper:
// - Divides by max(albedo, 1e-3), and modulate multiplies by the same: a black texel stays black and loses no light.
// - Values that are no numbers, or out of range, are repaired and counted: one NaN would otherwise spread over the
//   65-pixel footprint and stay in the history for good.
// - The depth gradient is that of the hit plane, not of finite differences, which are wrong beside silhouettes. Only
//   without one it is the smaller of the two one-sided differences within the object.
#pragma once

#include "denoise/guides.h"

namespace svgf {

// Below this albedo the division would turn noise into fireflies.
constexpr float albedo_floor = 1e-3f;

// The divisor of a signal: the sum of its albedos, 1 without any.
SVGF_HD inline Vec3 signal_albedo(const float* const albedo[2], int pixel, int& repaired) {
    if (!albedo[0] && !albedo[1]) return {1.0f, 1.0f, 1.0f};
    Vec3 sum;
    if (albedo[0]) sum += repair(load3(albedo[0], pixel), repaired);
    if (albedo[1]) sum += repair(load3(albedo[1], pixel), repaired);
    return max(sum, albedo_floor);
}

template <class Storage, int Signals>
struct Demodulate {
    int width, height;
    const float* in_signal[Signals];
    const float* in_albedo[Signals][2];
    const float* in_normal;
    const float* in_depth;
    const float* in_depth_gradient;
    const int32_t* in_object_id;
    typename Storage::Color out_illumination[Signals];  // variance: 0
    typename Storage::Guides out_guides;
    int* out_repaired;

    int bytes_per_pixel() const {
        int bytes = Storage::guide_bytes + 12 + 4 + (in_depth_gradient ? 8 : 0) + (in_object_id ? 4 : 0);
        for (int s = 0; s < Signals; ++s)
            bytes += 12 + (in_albedo[s][0] ? 12 : 0) + (in_albedo[s][1] ? 12 : 0) + Storage::color_bytes;
        return bytes;
    }

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = y * width + x;
        int repaired = 0;
        for (int s = 0; s < Signals; ++s) {
            const Vec3 albedo = signal_albedo(in_albedo[s], pixel, repaired);
            const Vec3 c = repair(load3(in_signal[s], pixel) / albedo, repaired);
            out_illumination[s].store(pixel, {c.x, c.y, c.z, 0.0f});
        }
        write_guides(x, y, repaired);
        count(out_repaired, repaired);
    }

private:
    SVGF_HD void write_guides(int x, int y, int& repaired) const {
        const int pixel = y * width + x;
        Vec4 normal_depth = {0.0f, 0.0f, 0.0f, background_depth};
        Vec2 gradient;
        const int32_t id = surface_id(x, y);
        if (id != 0) {
            const Vec3 normal = normalize(load3(in_normal, pixel));
            normal_depth = {normal.x, normal.y, normal.z, in_depth[pixel]};
            gradient = in_depth_gradient ? given_gradient(pixel, repaired) : gradient_from_differences(x, y, id);
        } else if (named_id(pixel) != 0 && !is_good(pixel)) {
            ++repaired;
        }
        out_guides.store(pixel, normal_depth, gradient, id);
    }

    SVGF_HD int32_t named_id(int pixel) const {
        return in_object_id ? in_object_id[pixel] : (in_depth[pixel] >= background_depth ? 0 : 1);
    }

    // Depth and normal are numbers. A surface without them is taken for background: nothing can be said about its
    // neighbours.
    SVGF_HD bool is_good(int pixel) const {
        const Vec3 normal = abs(load3(in_normal, pixel));
        return in_range(in_depth[pixel], 0.0f, largest_radiance) && normal.x <= largest_radiance &&
               normal.y <= largest_radiance && normal.z <= largest_radiance;
    }

    SVGF_HD int32_t surface_id(int x, int y) const {
        const int pixel = y * width + x;
        const int32_t id = named_id(pixel);
        return id != 0 && is_good(pixel) && in_depth[pixel] < background_depth ? id : 0;
    }

    SVGF_HD Vec2 given_gradient(int pixel, int& repaired) const {
        return {given_gradient(in_depth_gradient[2 * pixel], repaired),
                given_gradient(in_depth_gradient[2 * pixel + 1], repaired)};
    }
    SVGF_HD static float given_gradient(float value, int& repaired) {
        if (is_finite(value)) return clamp(value, -largest_gradient, largest_gradient);
        ++repaired;
        return 0.0f;
    }

    SVGF_HD Vec2 gradient_from_differences(int x, int y, int32_t id) const {
        return {slope(x, y, 1, 0, id), slope(x, y, 0, 1, id)};
    }
    SVGF_HD float slope(int x, int y, int dx, int dy, int32_t id) const {
        float best = infinity;
        for (int sign = 1; sign >= -1; sign -= 2) {
            const int qx = x + sign * dx, qy = y + sign * dy;
            if (qx < 0 || qx >= width || qy < 0 || qy >= height || surface_id(qx, qy) != id) continue;
            const float difference = (in_depth[qy * width + qx] - in_depth[y * width + x]) * float(sign);
            if (std::fabs(difference) < std::fabs(best)) best = difference;
        }
        return is_finite(best) ? clamp(best, -largest_gradient, largest_gradient) : 0.0f;
    }
};

}  // namespace svgf
