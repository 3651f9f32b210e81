// SPDX-License-Identifier: Apache-2.0
// Stage "demodulate": radiance over albedo, so that the filter never blurs what the textures draw [Schied17, Sec. 4].
//
// Reads the public images, each of them once; writes the guides and one illumination per signal. All that later stages
// read is finite and non-negative because of what happens here. svgf+ has it done by temporal, which needs the
// illumination of 3x3 pixels: it is never stored.
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

// The albedos of a signal, [H, W, 3], which are summed; null: not given.
struct Albedo {
    const float* images[2] = {};

    struct Texel {
        Vec3 values[2];
    };
    int bytes_per_pixel() const { return (images[0] ? 12 : 0) + (images[1] ? 12 : 0); }

    SVGF_HD Texel fetch(int pixel) const {
        Texel texel;
        if (images[0]) texel.values[0] = load3(images[0], pixel);
        if (images[1]) texel.values[1] = load3(images[1], pixel);
        return texel;
    }
    // The signal's divisor: 1 without any albedo.
    SVGF_HD Vec3 unpack(const Texel& texel, int& repaired) const {
        if (!images[0] && !images[1]) return {1.0f, 1.0f, 1.0f};
        Vec3 sum;
        if (images[0]) sum = repair(texel.values[0], repaired);
        if (images[1]) sum += repair(texel.values[1], repaired);
        return {fast_max(sum.x, albedo_floor), fast_max(sum.y, albedo_floor), fast_max(sum.z, albedo_floor)};
    }
    // Nothing that falls on it is seen.
    SVGF_HD bool is_black(const Texel& texel) const {
        int counted_elsewhere = 0;
        const Vec3 divisor = unpack(texel, counted_elsewhere);
        return fast_max(divisor.x, fast_max(divisor.y, divisor.z)) <= albedo_floor;
    }
    SVGF_HD Vec3 at(int pixel, int& repaired) const { return unpack(fetch(pixel), repaired); }
};

// What the public images say of a pixel.
template <int Signals>
struct NoisyFrame {
    int width, height;
    const float* in_signal[Signals];
    Albedo in_albedo[Signals];
    const float* in_normal;
    const float* in_depth;
    const float* in_depth_gradient;
    const int32_t* in_object_id;
    const float* in_roughness = nullptr;  // null: of a mirror

    int bytes_per_pixel() const {
        int bytes = 12 + 4 + (in_depth_gradient ? 8 : 0) + (in_object_id ? 4 : 0) + (in_roughness ? 4 : 0);
        for (int s = 0; s < Signals; ++s) bytes += 12 + in_albedo[s].bytes_per_pixel();
        return bytes;
    }

    // As given.
    struct Signal {
        Vec3 radiance;
        Albedo::Texel albedo;
    };
    struct Surface {
        Vec3 normal;
        float depth;
        int32_t object_id;
    };
    SVGF_HD Signal fetch_signal(int s, int pixel) const {
        return {load3(in_signal[s], pixel), in_albedo[s].fetch(pixel)};
    }
    SVGF_HD Surface fetch_surface(int pixel) const {
        const float depth = in_depth[pixel];
        return {load3(in_normal, pixel), depth, in_object_id ? in_object_id[pixel] : depth >= background_depth ? 0 : 1};
    }

    SVGF_HD Vec3 illumination(int s, const Signal& signal, int& repaired) const {
        const Vec3 albedo = in_albedo[s].unpack(signal.albedo, repaired), radiance = signal.radiance;
        return repair({radiance.x * fast_reciprocal(albedo.x), radiance.y * fast_reciprocal(albedo.y),
                       radiance.z * fast_reciprocal(albedo.z)},
                      repaired);
    }

    SVGF_HD Vec3 illumination(int s, int pixel, int& repaired) const {
        return illumination(s, fetch_signal(s, pixel), repaired);
    }

    // Normal and depth; the object id, 0 where there is no surface.
    SVGF_HD Vec4 surface(int x, int y, int32_t& object_id, int& repaired) const {
        return surface(fetch_surface(y * width + x), object_id, repaired);
    }
    SVGF_HD static Vec4 surface(const Surface& given, int32_t& object_id, int& repaired) {
        const Vec3 normal = given.normal;
        const float depth = given.depth;
        object_id = given.object_id;
        const bool good = is_good(normal, depth);
        if (object_id != 0 && !good) ++repaired;
        if (!good || !is_surface(depth)) object_id = 0;
        if (object_id == 0) return {0.0f, 0.0f, 0.0f, background_depth};
        const float scale = fast_reciprocal_sqrt(max(dot(normal, normal), 1e-36f));
        return {normal.x * scale, normal.y * scale, normal.z * scale, depth};
    }

    // Of depth, per pixel of a surface.
    SVGF_HD Vec2 gradient(int x, int y, int32_t object_id, int& repaired) const {
        if (!in_depth_gradient) return {slope(x, y, 1, 0, object_id), slope(x, y, 0, 1, object_id)};
        const int pixel = y * width + x;
        return {given_gradient(in_depth_gradient[2 * pixel], repaired),
                given_gradient(in_depth_gradient[2 * pixel + 1], repaired)};
    }

    // Of the specular signal, see guides.h. What is no roughness counts as a mirror's.
    SVGF_HD float gloss(int pixel, int& repaired) const {
        if (!in_roughness) return 1.0f;
        const float roughness = in_roughness[pixel];
        if (in_range(roughness, 0.0f, 1.0f)) return gloss_of(roughness);
        ++repaired;
        return 1.0f;
    }

private:
    // Depth and normal are numbers. A surface without them is taken for background: nothing can be said about its
    // neighbours.
    SVGF_HD static bool is_good(Vec3 normal, float depth) {
        return in_range(depth, 0.0f, largest_radiance) && std::fabs(normal.x) <= largest_radiance &&
               std::fabs(normal.y) <= largest_radiance && std::fabs(normal.z) <= largest_radiance;
    }

    SVGF_HD static float given_gradient(float value, int& repaired) {
        if (is_finite(value)) return clamp(value, -largest_gradient, largest_gradient);
        ++repaired;
        return 0.0f;
    }

    SVGF_HD float slope(int x, int y, int dx, int dy, int32_t id) const {
        float best = infinity;
        for (int sign = 1; sign >= -1; sign -= 2) {
            const int qx = x + sign * dx, qy = y + sign * dy;
            if (qx < 0 || qx >= width || qy < 0 || qy >= height) continue;
            int32_t other_id;
            int counted_elsewhere = 0;
            surface(qx, qy, other_id, counted_elsewhere);
            if (other_id != id) continue;
            const float difference = (in_depth[qy * width + qx] - in_depth[y * width + x]) * float(sign);
            if (std::fabs(difference) < std::fabs(best)) best = difference;
        }
        return is_finite(best) ? clamp(best, -largest_gradient, largest_gradient) : 0.0f;
    }
};

template <class Storage, int Signals>
struct Demodulate {
    NoisyFrame<Signals> frame;
    typename Storage::Color out_illumination[Signals];  // variance: 0
    typename Storage::Guides out_guides;
    typename Storage::Gradients out_gradients;
    int* out_repaired;

    int bytes_per_pixel() const {
        return frame.bytes_per_pixel() + Storage::guide_bytes + Storage::gradient_bytes +
               Signals * Storage::color_bytes;
    }

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = out_guides.pixel(x, y);
        int repaired = 0;
        for (int s = 0; s < Signals; ++s) {
            const Vec3 c = frame.illumination(s, pixel, repaired);
            out_illumination[s].store(pixel, {c.x, c.y, c.z, 0.0f});
        }
        int32_t id;
        const Vec4 surface = frame.surface(x, y, id, repaired);
        out_guides.store(pixel, surface, id);
        out_gradients.store(pixel, id != 0 ? frame.gradient(x, y, id, repaired) : Vec2{});
        count(out_repaired, repaired);
    }
};

}  // namespace svgf
