// SPDX-License-Identifier: Apache-2.0
// Stage "temporal": reprojection, and the running means of colour and luminance moments [Schied17, Sec. 4.1, 4.2].
//
// Reads the frame's illumination and guides, and what the frame before left: its guides, the colour after its first
// a-trous level, its moments and history lengths. Writes the new means; variance over time goes along with the colour.
//
// Departures from the paper, beside those of reprojection.h:
// - alpha = max(alpha, 1 / N), N frames of history with this one: the first frames get equal weights, as their mean is
//   the best there is, and with alpha = 0 a still view converges.
// - Moments are kept as mean and variance, not as mean and second moment: the same numbers in exact arithmetic, but the
//   variance is never negative and does not cancel where luminance is large.
// - Taps that weigh less than 1 % together count as none: their colour says less than the 3x3 search does.
// - History that is not a number is not read.
#pragma once

#include "denoise/reprojection.h"

namespace svgf {

template <class Storage, int Signals>
struct Temporal {
    typename Storage::Guides guides;
    typename Storage::Gradients gradients;
    Reprojection<Storage> reprojection;
    typename Storage::Color in_illumination[Signals], hist_color[Signals];
    typename Storage::Moments hist_moments[Signals];
    float alpha, alpha_moments;
    typename Storage::Color out_color[Signals];  // with the variance over time; in_illumination may be the same
    typename Storage::Moments out_moments[Signals];
    int* out_repaired;

    int bytes_per_pixel() const {
        const int history = reprojection.prev_guides ? Signals * (Storage::color_bytes + Storage::moments_bytes) : 0;
        return Storage::guide_bytes + Storage::gradient_bytes + Storage::length_bytes +
               reprojection.bytes_per_pixel() + Signals * (2 * Storage::color_bytes + Storage::moments_bytes) + history;
    }
    // Where demodulate has just written this pixel's guides and colour, which are written again or not at all.
    int bytes_per_pixel_after_demodulate() const {
        return bytes_per_pixel() - Storage::guide_bytes - Storage::gradient_bytes - Signals * 2 * Storage::color_bytes;
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
        read_history(x, y, surface, old, repaired);
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

    SVGF_HD void read_history(int x, int y, Vec4 surface, Mean& old, int& repaired) const {
        typename Reprojection<Storage>::Point point;
        const int pixel = guides.pixel(x, y);
        if (!reprojection.find(x, y, surface, gradients[pixel], guides.object_id(pixel), point, repaired)) return;
        const auto take = [&](int pixel, float weight) { add_tap(pixel, weight, old, repaired); };
        auto taps = reprojection.weigh(point);
        reprojection.visit(point, taps, take);
        if (!taps.are_enough || old.weight >= least_tap_weight) return;
        old = {};  // too much of it is not usable
        taps.are_enough = false;
        reprojection.visit(point, taps, take);
    }

    SVGF_HD void add_tap(int pixel, float weight, Mean& old, int& repaired) const {
        if (!is_usable(pixel)) {
            ++repaired;
            return;
        }
        const float before = old.weight;
        old.weight += weight;
        const float share = weight / old.weight;
        old.length += (reprojection.prev_guides.length(pixel) - old.length) * share;
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
        bool good = in_range(reprojection.prev_guides.length(pixel), 0.0f, 16777216.0f);
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
