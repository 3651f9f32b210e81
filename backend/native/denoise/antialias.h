// SPDX-License-Identifier: Apache-2.0
// Stage "antialias" of svgf+: resolves over time what lies within a pixel, and lets a still view converge to the truth.
//
// Reads 3x3 pixels of the denoised frame and what it wrote a frame ago: the resolved colour, and the frames in it.
// Where a sample's place in its pixel is random, albedo and silhouettes change from frame to frame, whatever the filter
// makes of the illumination: their mean over time is what the pixel shows. History is clipped to the mean and deviation
// of the 3x3 pixels [Salvi16], so that what no longer belongs there is gone at once. It follows the nearest of the 3x3
// surfaces [Karis14], so that silhouettes move with what stands in front. No object is compared: a pixel may show
// several, and sky.
//
// Colours are averaged after c / (w + max(c)) [Karis14], w the geometric mean of the 3x3 pixels' brightness: a bright
// sample does not flicker where it is rare, at any exposure. What stands still is averaged as it is: no light is lost.
//
// What stands still goes on, after `still_frames`, with the plain mean of the noisy frames: the denoised one was the
// best there was; from then on it is one sample of many, and weighs less and less. Light that changes ends this:
// temporal says so, or the denoised frame, against which the mean is tested with a wider box.
#pragma once

#include "denoise/demodulate.h"

namespace svgf {

// Box in standard deviations of the 3x3 pixels: of the moving, and of the still picture. That of the still picture has
// room for as many of the noisy mean's own.
// One of nine numbers is at most 2.83 of their deviations from their mean, so what stays the same is never clipped.
constexpr float moving_box = 1.0f, still_box = 4.0f;
constexpr float still_frames = 24.0f;
// Weight of a noisy frame, over 1 / frames. Above 1 what the filter blurred is forgotten faster than by 1 / frames, at
// 4 % more variance than the plain mean has.
constexpr float still_rate = 1.25f;
// Of brightness: what the denoised frame may be off by before the mean of a still picture is given up.
constexpr float still_margin = 0.02f;

template <class Storage, int Signals>
struct Antialias {
    typename Storage::Guides guides;
    typename Storage::Color in_color, hist_color;  // rgb and frames in the deviation's place
    bool has_history;
    const float* in_motion;
    int motion_channels;
    const float* in_signal[Signals];
    const float* in_albedo[Signals][2];
    typename Storage::Moments in_moments[Signals];  // of temporal
    const float* in_emission;
    float antialias_frames;
    typename Storage::Color out_history;
    float* out_color;  // [H, W, 3]

    int bytes_per_pixel() const {
        return (has_history ? 3 : 2) * Storage::color_bytes + 4 + (in_motion ? 4 * motion_channels : 0) + 12;
    }

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y);
        const Vec3 own = in_color[pixel].xyz();
        Box box;
        int front = pixel;
        look_around(x, y, box, front);

        const Vec3 motion = motion_of(front);
        const float px = float(x) + motion.x, py = float(y) + motion.y;
        History history;
        if (has_history && px >= 0.0f && py >= 0.0f && px <= float(guides.width - 1) && py <= float(guides.height - 1))
            history = read_history(px, py, box);
        if (history.frames < 0.5f) {
            write(pixel, own, 1.0f);
            return;
        }
        const Vec3 own_motion = motion_of(pixel);
        const bool still = motion.x == 0.0f && motion.y == 0.0f && own_motion.x == 0.0f && own_motion.y == 0.0f;
        const bool settled = still && history.frames > still_frames - 0.5f;
        const Vec3 past = history.mapped, offset = past - box.mean;
        float margin = 0.0f;
        if (settled) {
            const float deviation = fast_sqrt(noise(pixel) / history.frames);
            margin = still_margin + still_box * deviation / (box.white + max_component(own) + 1e-30f);
        }
        const Vec3 extent = (still ? still_box : moving_box) * box.deviation + Vec3{margin, margin, margin};
        const float excess = max_component(abs(offset) / max(extent, 1e-30f));
        const bool light_changed = still && has_changed(pixel);
        if (settled && excess <= 1.0f && !light_changed) {
            const float frames = next_count(history.frames, pixel, bits_of(history.color.x));
            write(pixel, history.color + (noisy(pixel) - history.color) * (still_rate / frames), frames);
            return;
        }
        const float kept = settled || light_changed ? 0.0f : history.frames;  // then a still picture starts afresh
        const float frames = still ? kept + 1.0f : min(kept + 1.0f, antialias_frames);
        // Where there is no deviation at all, nothing of what is outside is left.
        const Vec3 clipped = excess > 1e12f ? box.mean : excess > 1.0f ? box.mean + offset / excess : past;
        if (still) {
            const Vec3 before = excess > 1.0f ? box.unmap(clipped) : history.color;
            write(pixel, before + (own - before) / frames, frames);
        } else {
            write(pixel, box.unmap(clipped + (box.map(own) - clipped) / frames), frames);
        }
    }

private:
    // The 3x3 pixels' mean and deviation, after map.
    struct Box {
        float white = 0.0f;
        Vec3 mean, deviation;

        SVGF_HD Vec3 map(Vec3 c) const { return c / (white + max_component(c) + 1e-30f); }
        SVGF_HD Vec3 unmap(Vec3 c) const { return max(c, 0.0f) * (white / max(1.0f - max_component(c), 1e-4f)); }
    };
    struct History {
        Vec3 color, mapped;
        float frames = 0.0f;
    };

    SVGF_HD void look_around(int x, int y, Box& box, int& front) const {
        Vec3 colors[9];
        int n = 0;
        float most = 0.0f;
        for (int j = -1; j <= 1; ++j)
            for (int i = -1; i <= 1; ++i) {
                if (!guides.contains(x + i, y + j)) continue;
                const int tap = guides.pixel(x + i, y + j);
                colors[n++] = in_color[tap].xyz();
                most = max(most, max_component(colors[n - 1]));
                if (guides.depth(tap) < guides.depth(front)) front = tap;
            }
        const float scale = 1.0f / float(n);
        float logarithms = 0.0f;
        for (int k = 0; k < n; ++k) logarithms += fast_log2(max_component(colors[k]) + 1e-3f * most + 1e-30f);
        box.white = fast_exp2(scale * logarithms);
        for (int k = 0; k < n; ++k) box.mean += scale * box.map(colors[k]);
        Vec3 squares;
        for (int k = 0; k < n; ++k) {
            const Vec3 difference = box.map(colors[k]) - box.mean;
            squares += scale * (difference * difference);
        }
        box.deviation = {fast_sqrt(squares.x), fast_sqrt(squares.y), fast_sqrt(squares.z)};
    }

    // A motion that is no number leads nowhere; temporal has counted it.
    SVGF_HD Vec3 motion_of(int pixel) const {
        if (!in_motion) return {};
        const float* m = in_motion + size_t(pixel) * motion_channels;
        return is_finite(m[0]) && is_finite(m[1]) ? Vec3{m[0], m[1], 0.0f} : Vec3{-infinity, -infinity, 0.0f};
    }

    // Bilinear, inside the frame.
    SVGF_HD History read_history(float px, float py, const Box& box) const {
        const int left = int(px), top = int(py);
        const float fx = px - float(left), fy = py - float(top);
        History history;
        for (int j = 0; j < 2; ++j)
            for (int i = 0; i < 2; ++i) {
                const float share = (i ? fx : 1.0f - fx) * (j ? fy : 1.0f - fy);
                if (!(share > 0.0f)) continue;
                const Vec4 tap = hist_color[guides.pixel(left + i, top + j)];
                history.color += share * tap.xyz();
                history.mapped += share * box.map(tap.xyz());
                history.frames += share * fast_sqrt(tap.w);
            }
        return history;
    }

    SVGF_HD Vec3 noisy(int pixel) const {
        int repaired_before = 0;
        Vec3 color;
        if (in_emission) color = repair(load3(in_emission, pixel), repaired_before);
        for (int s = 0; s < Signals; ++s) color += repair(load3(in_signal[s], pixel), repaired_before);
        return color;
    }

    SVGF_HD bool has_changed(int pixel) const {
        bool changed = false;
        for (int s = 0; s < Signals; ++s) changed = changed || in_moments[s].has_changed(pixel);
        return changed;
    }

    // Variance of the noisy frame's luminance, signals taken as independent.
    SVGF_HD float noise(int pixel) const {
        int repaired_before = 0;
        float variance = 0.0f;
        for (int s = 0; s < Signals; ++s)
            variance += in_moments[s][pixel].y * square(luminance(signal_albedo(in_albedo[s], pixel, repaired_before)));
        return variance;
    }

    // n + 1. Counts are kept in 9 bits: above 512 they go up by their spacing, with the odds that make it one on
    // average.
    SVGF_HD static float next_count(float n, int pixel, uint32_t salt) {
        if (n < 511.5f) return n + 1.0f;
        const float spacing = n < 1023.5f ? 2.0f : n < 2047.5f ? 4.0f : n < 4095.5f ? 8.0f : 0.0f;
        const uint32_t hash = (uint32_t(pixel) * 0x9e3779b1u ^ salt) * 0x85ebca6bu >> 16;
        return float(hash) * (1.0f / 65536.0f) * spacing < 1.0f ? n + spacing : max(n, 1.0f);
    }

    SVGF_HD void write(int pixel, Vec3 color, float frames) const {
        out_history.store(pixel, {color.x, color.y, color.z, square(frames)});
        out_color[3 * pixel] = color.x;
        out_color[3 * pixel + 1] = color.y;
        out_color[3 * pixel + 2] = color.z;
    }
};

}  // namespace svgf
