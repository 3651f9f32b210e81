// SPDX-License-Identifier: Apache-2.0
// Stage "temporal" of svgf+: firefly limit, reprojection, running means, and the variance that is left in them.
//
// Reads 3x3 pixels of the frame's illumination and what the frame before left: its guides, per signal the mean colour
// and the frames in it, and the variance of a sample. Writes the same of this frame, and with the colour the variance
// of the mean, which drives the filter. Every pixel has a variance from its first frame on, so no stage "variance"
// follows.
//
// Departures from [Schied17]. Measured on two 1-spp sequences of Cycles, a box with chrome and glass and a gallery;
// relMSE, FLIP of each with svgf, with svgf+, and with a step of svgf+ off:
//
//   svgf                                0.0581 0.0581    22.2   0.1153
//   svgf+                               0.0218 0.0546    0.0671 0.1125
//   no firefly limit                    0.0378 0.0543    1.28   0.1043
//   no history clamp                    0.0208 0.0557    0.0770 0.1154
//   no specular sharpness               0.0328 0.0562    0.0925 0.1102
//   no temporal gradient                the same: no light changes there; a lamp that goes out then lags for good
//
// - The filter is driven by the variance of the mean, that of a sample over N, not of a sample: as history grows the
//   filter narrows, and a still view converges to the mean of all its samples.
// - The history is the mean itself, not what the first a-trous level made of it: fed back, a blur would pile up.
// - Variance is that of 3x3 neighbouring samples on the same surface, averaged over frames, not that of one pixel's
//   samples over time: nine times the samples, there from the first frame on, and what moves in a mirror is no noise.
// - History is drawn towards the mean of the 3x3 samples where it is more than `history_clamp` standard deviations away
//   from it, and counts as that much shorter: a lamp switched on, a shadow or a reflection that moves differently from
//   its surface does not lag. The deviation is the averaged one, so that sparse samples do not pass for a change.
// - Temporal gradients without a second trace [Schied18]: the `drift` is a mean over a few frames of how far samples
//   are from their history, in deviations, and is averaged with eight pixels around every frame. Noise averages out of
//   it, a change adds up. Above `change_threshold` history gives way to the 3x3 samples, at 1.2 times that altogether.
//   The threshold rises with the frames that would be lost: a long history is not given up for what chance does once in
//   as many frames.
// - A sample brighter than `firefly_limit` times what is expected is scaled down to that, before it enters the mean.
//   Expected is what the whole filter made of the pixel a frame ago: its own history would never let a first bright
//   sample in where light is sparse. The limit is relative, so that it holds at any exposure; what is cut is counted.
// - Each signal has its own history length: reflections lose theirs while the diffuse light beside them keeps it.
// - What stands still has no limit on its history; what moves is resampled every frame, and keeps `history_frames`.
#pragma once

#include "denoise/denoiser.h"
#include "denoise/reprojection.h"

namespace svgf {

// Weight of a frame in the drift, and how far apart the nine pixels are whose drift is averaged.
constexpr float drift_rate = 0.3f;
constexpr int drift_spacing = 3;
// Rise of the threshold whenever history has doubled beyond these frames.
constexpr float threshold_rise = 0.1f, threshold_frames = 16.0f;
// Light that has just come counts for this much of the neighbours' mean without the brightest.
constexpr float neighbour_share = 0.1f;

template <class Storage, int Signals>
struct TemporalPlus {
    Reprojection<Storage> reprojection;
    typename Storage::Color in_illumination[Signals];
    typename Storage::Color hist_color[Signals];  // in the variance's place the squared luminance after the filter
    typename Storage::Moments hist_moments[Signals];
    float history_frames, firefly_limit, change_threshold;
    float history_clamp[Signals];   // standard deviations
    float variance_scale[Signals];  // squared share of sigma_luminance that the signal is filtered with
    typename Storage::Color out_color[Signals];  // with the variance of the mean
    typename Storage::Moments out_moments[Signals];
    int* out_repaired;
    FireflyCount* out_fireflies;

    int bytes_per_pixel() const {
        const int history = reprojection.prev_guides ? Signals * (Storage::color_bytes + Storage::moments_bytes) : 0;
        return reprojection.bytes_per_pixel() + Signals * (2 * Storage::color_bytes + Storage::moments_bytes) + history;
    }

    SVGF_HD void operator()(int x, int y) const {
        const auto& guides = reprojection.guides;
        const int pixel = guides.pixel(x, y);
        const Vec4 surface = guides.normal_depth(pixel);
        if (!is_surface(surface.w)) {
            for (int s = 0; s < Signals; ++s) {
                const Vec3 color = in_illumination[s][pixel].xyz();
                out_color[s].store(pixel, {color.x, color.y, color.z, 0.0f});
                out_moments[s].store(pixel, {});
            }
            guides.store_length(pixel, 0.0f);
            return;
        }
        int repaired = 0;
        bool moves = false;
        Mean old;
        read_history(x, y, surface, old, moves, repaired);
        count(out_repaired, repaired);

        Neighbours near;
        find_neighbours(x, y, surface, near);
        float shortest = largest_float;
        for (int s = 0; s < Signals; ++s) shortest = min(shortest, accumulate(s, pixel, near, old, moves));
        guides.store_length(pixel, shortest);
    }

private:
    // Weighted mean of history taps.
    struct Mean {
        float weight = 0.0f;
        Vec3 color[Signals];
        float frames[Signals] = {}, variance[Signals] = {}, filtered_light[Signals] = {}, drift[Signals] = {};
    };

    // The pixels around that show the same surface.
    struct Neighbours {
        int count = 0;
        Vec3 color[Signals][8];
    };

    SVGF_HD void read_history(int x, int y, Vec4 surface, Mean& old, bool& moves, int& repaired) const {
        typename Reprojection<Storage>::Point point;
        if (!reprojection.find(x, y, surface, point, repaired)) return;
        moves = point.x != float(x) || point.y != float(y);
        const auto take = [&](int pixel, float weight) {
            old.weight += weight;
            const float share = weight / old.weight;
            for (int s = 0; s < Signals; ++s) {
                const Vec4 moments = hist_moments[s][pixel];
                const Vec4 color = hist_color[s][pixel];
                old.color[s] += (color.xyz() - old.color[s]) * share;
                old.filtered_light[s] += (fast_sqrt(color.w) - old.filtered_light[s]) * share;
                old.frames[s] += (moments.x - old.frames[s]) * share;
                old.variance[s] += (moments.y - old.variance[s]) * share;
            }
        };
        reprojection.visit_bilinear(point, take);
        if (!(old.weight >= least_tap_weight)) {
            old = {};  // too little found
            reprojection.visit_neighbours(point, take);
        }
        if (old.weight > 0.0f) read_drift(int(std::floor(point.x + 0.5f)), int(std::floor(point.y + 0.5f)), old);
    }

    // Of nine pixels, whatever they show.
    SVGF_HD void read_drift(int x, int y, Mean& old) const {
        const auto& guides = reprojection.guides;
        for (int j = -1; j <= 1; ++j)
            for (int i = -1; i <= 1; ++i) {
                const int tap = guides.pixel(clamp(x + i * drift_spacing, 0, guides.width - 1),
                                             clamp(y + j * drift_spacing, 0, guides.height - 1));
                for (int s = 0; s < Signals; ++s) old.drift[s] += hist_moments[s].drift(tap) * (1.0f / 9.0f);
            }
    }

    SVGF_HD void find_neighbours(int x, int y, Vec4 surface, Neighbours& near) const {
        const auto& guides = reprojection.guides;
        const int32_t id = guides.object_id(guides.pixel(x, y));
        for (int j = -1; j <= 1; ++j)
            for (int i = -1; i <= 1; ++i) {
                if ((i == 0 && j == 0) || !guides.contains(x + i, y + j)) continue;
                const int tap = guides.pixel(x + i, y + j);
                if (guides.object_id(tap) != id) continue;
                if (!(dot(guides.normal_depth(tap).xyz(), surface.xyz()) >= reprojection.normal_tolerance)) continue;
                for (int s = 0; s < Signals; ++s) near.color[s][near.count] = in_illumination[s][tap].xyz();
                ++near.count;
            }
    }

    // Brings the sample into the mean of a signal. Returns the frames that are in it.
    SVGF_HD float accumulate(int s, int pixel, const Neighbours& near, const Mean& old, bool moves) const {
        Vec3 sample = in_illumination[s][pixel].xyz();
        const bool has_history = old.weight > 0.0f;
        const float limit = firefly_limit * expected_light(s, near, old, luminance(sample));
        sample = limited(sample, limit, true);

        Vec3 local = sample;
        float light = luminance(sample), squares = 0.0f;
        const float own_light = light;
        for (int n = 0; n < near.count; ++n) local += limited(near.color[s][n], limit, false);
        local = local / float(near.count + 1);
        const float local_light = luminance(local);
        squares = square(own_light - local_light);
        for (int n = 0; n < near.count; ++n)
            squares += square(luminance(limited(near.color[s][n], limit, false)) - local_light);
        // A pixel without neighbours is as uncertain as it is bright.
        const float spread = near.count > 0 ? squares / float(near.count) : square(own_light);

        // Light that has changed.
        const float doublings = max(fast_log2(max(old.frames[s], 1.0f) * (1.0f / threshold_frames)), 0.0f);
        const float threshold = change_threshold * (1.0f + threshold_rise * doublings);
        const float kept_of_change = clamp(6.0f - 5.0f * std::fabs(old.drift[s]) / threshold, 0.0f, 1.0f);
        Vec3 history = local + (old.color[s] - local) * kept_of_change;
        const float old_frames = old.frames[s] * kept_of_change;

        float frames = old_frames + 1.0f;
        if (moves) frames = min(frames, history_frames);
        const float variance = old.variance[s] + (spread - old.variance[s]) / frames;
        float drift = 0.0f;
        if (has_history) {
            const float deviation = fast_sqrt(max(variance, old.variance[s]));
            const float residual = (own_light - luminance(history)) / (deviation + 1e-3f * local_light + 1e-30f);
            drift = old.drift[s] + (clamp(residual, -4.0f, 4.0f) - old.drift[s]) * drift_rate;
            const float distance = std::fabs(luminance(history) - local_light);
            const float allowed = history_clamp[s] * fast_sqrt(variance) + 1e-4f * local_light;
            if (distance > allowed) {
                const float kept = allowed / distance;
                history = local + (history - local) * kept;
                frames = max(old_frames * kept, 1.0f) + 1.0f;
                if (moves) frames = min(frames, history_frames);
            }
        }
        const Vec3 mean = history + (sample - history) / frames;
        out_color[s].store(pixel, {mean.x, mean.y, mean.z, variance_scale[s] * variance / frames});
        out_moments[s].store(pixel, {frames, variance, drift, kept_of_change < 1.0f ? 1.0f : 0.0f});
        return frames;
    }

    // Luminance of a sample by what the filter made of history, and by the neighbours; without either, its own.
    SVGF_HD float expected_light(int s, const Neighbours& near, const Mean& old, float own) const {
        float sum = 0.0f, most = 0.0f;
        for (int n = 0; n < near.count; ++n) {
            const float light = luminance(near.color[s][n]);
            sum += light;
            most = max(most, light);
        }
        const float local = near.count > 1 ? max(sum - most, 0.0f) / float(near.count - 1) : own;
        return old.weight > 0.0f ? max(old.filtered_light[s], near.count > 1 ? neighbour_share * local : 0.0f) : local;
    }

    SVGF_HD Vec3 limited(Vec3 color, float limit, bool counts) const {
        const float light = luminance(color);
        if (!(light > limit)) return color;
        if (counts) {
            count(&out_fireflies->samples, 1ull);
            const float cut = min(light - limit, 1e12f) * float(light_units);
            count(&out_fireflies->light, static_cast<unsigned long long>(cut));
        }
        return color * (limit / light);
    }
};

}  // namespace svgf
