// SPDX-License-Identifier: Apache-2.0
// Stage "antialias" of svgf+: resolves over time what lies within a pixel, and lets a still view converge to the truth.
//
// Reads 3x3 pixels of the filtered signals, modulated on the way, and what it wrote a frame ago: the resolved colour,
// and the frames in it.
// Where a sample's place in its pixel is random, albedo and silhouettes change from frame to frame, whatever the filter
// makes of the illumination: their mean over time is what the pixel shows. History is clipped to the mean and deviation
// of the 3x3 pixels [Salvi16], so that what no longer belongs there is gone at once. It follows the nearest of the 3x3
// surfaces [Karis14], so that silhouettes move with what stands in front. No object is compared: a pixel may show
// several, and sky.
//
// Colours are averaged after c / (w + max(c)) [Karis14], w the geometric mean of the 3x3 pixels' brightness, times 12
// where something moves: fireflies that are left do not flicker, at any exposure, and what is not that bright keeps its
// light. What stands still is averaged as it is. History of what moves is read by Catmull-Rom, as a mean of four
// pixels, frame after frame, would blur it; after c / (w + max(c)) again, with a quarter of that w: a third of a pixel
// of a lamp is thirty times the light of the wall beside it, and such errors stay for frames. Measured on whole
// pictures of 480x270 at 1 sample per pixel, from the fifth frame on: our own tracer's arcade and Sponza, and Cycles'
// gallery and teapots; relMSE, FLIP and flicker over those of OIDN 2.5.1:
//
//                       arcade         gallery        teapots        Sponza
//   as it is            .83 .82 .662   .83 .81 .690   1.02 .82 .421  1.35 .83 .649
//   w times 16          .84 .82 .661   .84 .81 .690   1.08 .81 .421  1.37 .83 .649
//   w times 1           .83 .95 .725   .75 .85 .703   .85 .84 .434   1.21 .93 .686
//   linear              .94 .80 .666   .87 .81 .691   2.82 .81 .427  1.52 .81 .655
//   read with all of w  .86 .82 .662   .83 .81 .689   1.27 .81 .421  1.39 .82 .648
//   over 3.5 frames     .83 .82 .672   .82 .81 .691   1.00 .81 .424  1.34 .82 .665
//
// Bright things that move lose light by it, and what flickers: of the truth's mean, 0.910 is left of the gallery, 0.973
// of the arcade, 0.980 of the teapots (by OIDN 0.952, 0.994, 0.992).
//
// The pixel's own sample is never outside of the box: what is thinner than a pixel, a wire, would fade.
// Outside the frame the 3x3 pixels are those of its border.
//
// What stands still goes on, after `hand_over_frames`, with the plain mean of the noisy frames: the denoised one was
// the best there was; from then on it is one sample of many, and weighs less and less. Light that changes ends this:
// temporal says so, or the denoised frame, against which the mean is tested with a wider box.
// Where it is known that nothing changes, nothing is tested: a rare sample in a pixel of several surfaces is no change.
// And the mean goes over from denoised to noisy frames as far as the noise that is left in it is hardly seen; where
// there is structure, which hides noise, and where several surfaces in a pixel mislead the filter, with the frames.
// A noisy frame moves the mean by no more than `largest_step` of brightness: a rare bright sample would be a speck for
// as long as it outshines all others. That limit rises with the frames, so that the mean goes to that of all light.
// While someone changes something in a view, what stands still waits with this, and is a mean of denoised frames alone:
// a bright sample would be a speck, and what is still a moment later is at rest, where noise is looked after.
// Measured on our own tracer's box of metal and glass and its arcade, 160x90, 48, 128 and 256 frames that stand still
// against 4096 samples; relMSE, and what a display shows of noise: root mean square of values above a blur of 2 pixels,
// on flat parts. The denoised frame has 0.0115 and 0.0195 of it after 24 frames:
//
//                            box 48        128           256           arcade 48     128           256
//   from frame 24 to 80      .0111 .0151   .0117 .0219   .0071 .0183   .0262 .0197   .0110 .0235   .0055 .0185
//   by the noise left        .0136 .0191   .0122 .0184   .0098 .0168   .0249 .0179   .0146 .0172   .0084 .0160
//   and steps limited        .0110 .0140   .0094 .0127   .0070 .0105   .0243 .0175   .0140 .0166   .0080 .0154
//   and structure by frames  .0093 .0139   .0046 .0124   .0029 .0102   .0210 .0173   .0089 .0165   .0054 .0149
//   plain mean               .0379 .0366   .0141 .0249   .0073 .0188   .0283 .0442   .0103 .0265   .0052 .0189
#pragma once

#include "denoise/cubic.h"
#include "denoise/modulate.h"
#include "denoise/tiles.h"

namespace svgf {

// Box in standard deviations of the 3x3 pixels: of the moving, and of the still picture. That of the still picture has
// room for as many of the noisy mean's own.
// One of nine numbers is at most 2.83 of their deviations from their mean, so what stays the same is never clipped.
constexpr float moving_box = 1.0f, still_box = 4.0f;
// Of the geometric mean of brightness, where something moves: where the average begins to compress.
constexpr float moving_white = 12.0f;
// Of that, where history is read between pixels.
constexpr float interpolation_white = 0.25f;
constexpr float hand_over_frames = 24.0f;
// Deviation of the mean of noisy frames, over brightness: up to it they are taken as they are, none of them at twice as
// much. The most that one of them moves that mean, over brightness.
constexpr float visible_noise = 0.1f, largest_step = 0.05f;
// Deviation of the 3x3 pixels, after map, from which structure hides noise; and the frames that the mean takes there.
constexpr float masking_contrast = 0.05f, blend_frames = 56.0f;
// Weight of a noisy frame, over 1 / frames. Above 1 what the filter blurred is forgotten faster than by 1 / frames, at
// 4 % more variance than the plain mean has; after so many frames next to nothing of it is left to forget, but where
// noisy frames come in as little as is seen.
constexpr float still_rate = 1.25f, blend_rate = 2.0f, forgetting_frames = 256.0f;
// Of brightness: what the denoised frame may be off by before the mean of a still picture is given up.
constexpr float still_margin = 0.02f;
// Of the brightest of the 3x3 pixels, as a logarithm to the base 2: what darker ones count for in the geometric mean.
constexpr float black_log2 = -10.0f;

template <class Storage, int Signals>
struct Antialias : Tiles {
    using Tiles::height, Tiles::width;
    static constexpr int blocks = 4, fetches = Signals == 1 ? 3 : 1;  // fastest on an H200

    struct Tile {
        Vec4 color[places];  // rgb, brightness
        float depth[places], log_brightness[places];
    };
    struct Texel {
        typename Modulate<Storage, Signals>::Texel filtered;
        float depth;
        int own_pixel;  // -1 in the margin
    };

    NoisyFrame<Signals> frame;
    Modulate<Storage, Signals> modulate;
    typename Storage::Guides guides;
    typename Storage::Color hist_color;  // rgb and frames in the deviation's place
    bool has_history = false, is_unchanged = false, is_interactive = false;
    const float* in_motion;
    int motion_channels;
    typename Storage::Moments in_moments[Signals];  // of temporal
    const float* in_emission;
    float antialias_frames, still_frames;  // still_frames: see hand_over_frames
    bool is_catmull_rom;  // see PlusStep
    typename Storage::Color out_history;
    float* out_color;  // [H, W, 3]

    int bytes_per_pixel() const {
        return modulate.bytes_per_pixel_but_color() + Storage::guide_bytes +
               (has_history ? 2 : 1) * Storage::color_bytes + (in_motion ? 4 * motion_channels : 0) + 12;
    }

    SVGF_HD Texel fetch(int tile_column, int tile_row, int place) const {
        const int x = Tiles::x(tile_column, place), y = Tiles::y(tile_row, place);
        const int pixel = guides.nearest_pixel(x, y);
        return {modulate.fetch(pixel), guides.depth(pixel), owns(tile_column, tile_row, x, y) ? pixel : -1};
    }
    SVGF_HD void put(Tile& tile, int place, const Texel& texel) const {
        const auto radiance = modulate.unpack(texel.filtered);
        if (texel.own_pixel >= 0) modulate.write_all_but_color(texel.own_pixel, texel.filtered, radiance);
        tile.color[place] = with_brightness(radiance.color);
        tile.depth[place] = texel.depth;
        tile.log_brightness[place] = fast_log2(tile.color[place].w);
    }
    struct Own {};
    SVGF_HD Own fetch_own(int, int, int, int) const { return {}; }

    SVGF_HD void operator()(const Tile& tile, Own, int tile_column, int tile_row, int thread_x, int thread_y) const {
        SVGF_NO_UNROLL
        for (int row = thread_y; row < rows; row += threads_y) {
            const int x = tile_column * columns + thread_x, y = tile_row * rows + row;
            if (guides.contains(x, y)) resolve(tile, place(thread_x, row), x, y);
        }
    }

private:
    SVGF_HD static float brightness(Vec3 c) { return fast_max(c.x, fast_max(c.y, c.z)); }
    SVGF_HD static Vec4 with_brightness(Vec3 c) { return {c.x, c.y, c.z, brightness(c) + 1e-30f}; }

    // A colour with its brightness to [0, 1), and back.
    SVGF_HD static Vec3 compress(Vec4 c, float white) { return c.xyz() * fast_reciprocal(white + c.w); }
    SVGF_HD static Vec3 expand(Vec3 c, float white) {
        return max(c, 0.0f) * (white * fast_reciprocal(fast_max(1.0f - brightness(c), 1e-4f)));
    }

    // The 3x3 pixels' mean and deviation, after map.
    struct Box {
        float white = 0.0f;
        Vec3 mean, deviation;

        SVGF_HD Vec3 map(Vec4 c) const { return compress(c, white); }
        SVGF_HD Vec3 unmap(Vec3 c) const { return expand(c, white); }
    };
    struct History {
        Vec3 color;   // of the pixel itself, where nothing moves
        Vec3 mapped;
        float frames = 0.0f;
    };
    SVGF_HD void resolve(const Tile& tile, int place, int x, int y) const {
        const int pixel = guides.pixel(x, y);
        const Vec4 center = tile.color[place];
        const Vec3 own = center.xyz();
        const Vec3 motion = motion_of(front(tile, place, x, y));
        const float px = float(x) + motion.x, py = float(y) + motion.y;
        if (!has_history || !(px >= 0.0f && py >= 0.0f && px <= float(guides.width - 1) &&
                              py <= float(guides.height - 1))) {
            write(pixel, own, 1.0f);
            return;
        }
        const Vec3 own_motion = motion_of(pixel);
        const bool still = motion.x == 0.0f && motion.y == 0.0f && own_motion.x == 0.0f && own_motion.y == 0.0f;
        const Box box = look_around(tile, place, still ? 1.0f : moving_white);
        const History history = read_history(px, py, box);
        if (history.frames < 0.5f) {
            write(pixel, own, 1.0f);
            return;
        }
        const bool settled = still && history.frames > still_frames - 0.5f;
        const Vec3 past = history.mapped, offset = past - box.mean;
        float margin = 0.0f, deviation = 0.0f;  // of the mean of noisy frames
        if (settled) {
            deviation = fast_sqrt(noise(pixel) / history.frames);
            margin = still_margin + still_box * deviation / (box.white + center.w);
        }
        const Vec3 mapped = box.map(center);
        const Vec3 extent = still ? still_box * box.deviation + Vec3{margin, margin, margin}
                                  : max(moving_box * box.deviation, abs(mapped - box.mean));
        const Vec3 room = max(extent, 1e-30f);
        const bool is_tested = !(still && is_unchanged);
        const float distance = fast_max(fast_max(std::fabs(offset.x) * fast_reciprocal(room.x),
                                                 std::fabs(offset.y) * fast_reciprocal(room.y)),
                                        std::fabs(offset.z) * fast_reciprocal(room.z));
        const float excess = is_tested ? distance : 0.0f;
        const bool light_changed = is_tested && still && has_changed(pixel);
        if (settled && excess <= 1.0f && !light_changed) {
            const bool waits = is_interactive && !is_unchanged;
            const float frames = waits ? history.frames : next_count(history.frames, pixel, bits_of(history.color.x));
            const float left = deviation * fast_reciprocal(box.white);
            const float unseen = clamp(2.0f - left * (1.0f / visible_noise), 0.0f, 1.0f);
            const float contrast = fast_max(box.deviation.x, fast_max(box.deviation.y, box.deviation.z));
            const float masked = clamp(contrast * (1.0f / masking_contrast) - 1.0f, 0.0f, 1.0f) *
                                 clamp((history.frames - still_frames) * (1.0f / blend_frames), 0.0f, 1.0f);
            const float share = is_unchanged ? fast_max(unseen, masked) : waits ? 0.0f : 1.0f;
            const Vec3 sample = own + (noisy(pixel) - own) * share;
            const bool forgets = is_unchanged || history.frames < forgetting_frames;
            const float least_rate = forgets ? still_rate : 1.0f;
            const float rate = blend_rate + (least_rate - blend_rate) * share;
            Vec3 step = (sample - history.color) * (rate / frames);
            const float most = largest_step * fast_max(box.white, center.w);
            if (is_unchanged) step *= most * fast_reciprocal(fast_max(brightness(step), most));
            write(pixel, history.color + step, frames);
            return;
        }
        const float kept = settled || light_changed ? 0.0f : history.frames;  // then a still picture starts afresh
        const float frames = still ? kept + 1.0f : fast_min(kept + 1.0f, antialias_frames);
        const float share = fast_reciprocal(frames);
        // Where there is no deviation at all, nothing of what is outside is left.
        const Vec3 clipped =
            excess > 1e12f ? box.mean : excess > 1.0f ? box.mean + offset * fast_reciprocal(excess) : past;
        if (still) {
            const Vec3 before = excess > 1.0f ? box.unmap(clipped) : history.color;
            write(pixel, before + (own - before) * share, frames);
        } else {
            write(pixel, box.unmap(clipped + (mapped - clipped) * share), frames);
        }
    }

    // Pixel of the nearest of the 3x3 surfaces; of several the own one or else the first.
    SVGF_HD int front(const Tile& tile, int place, int x, int y) const {
        float nearest = tile.depth[place];
        int offset = 0;
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n) {
            const float depth = tile.depth[place + neighbour(n)];
            if (depth >= nearest) continue;
            nearest = depth;
            offset = neighbour(n);
        }
        // From a place in the tile to the pixel, which is inside: outside it is its border's depth that is there.
        const int row = (offset + width + 1) / width - 1, column = offset - row * width;
        return guides.nearest_pixel(x + column, y + row);
    }

    // white: of the geometric mean of brightness, where map begins to compress.
    SVGF_HD Box look_around(const Tile& tile, int place, float white) const {
        constexpr float share = 1.0f / 9.0f;
        Box box;
        float most = tile.log_brightness[place], logarithms = 0.0f;
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n) most = fast_max(most, tile.log_brightness[place + neighbour(n)]);
        const float least = most + black_log2;
        logarithms = fast_max(tile.log_brightness[place], least);
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n) logarithms += fast_max(tile.log_brightness[place + neighbour(n)], least);
        box.white = white * fast_exp2(share * logarithms);
        Vec3 mapped[neighbours + 1];
        mapped[neighbours] = box.map(tile.color[place]);
        box.mean = mapped[neighbours];
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n) {
            mapped[n] = box.map(tile.color[place + neighbour(n)]);
            box.mean += mapped[n];
        }
        box.mean *= share;
        Vec3 squares;
        SVGF_UNROLL
        for (int n = 0; n <= neighbours; ++n) {
            const Vec3 difference = mapped[n] - box.mean;
            squares += difference * difference;
        }
        squares *= share;
        box.deviation = {fast_sqrt(squares.x), fast_sqrt(squares.y), fast_sqrt(squares.z)};
        return box;
    }

    // A motion that is no number leads nowhere; temporal has counted it.
    SVGF_HD Vec3 motion_of(int pixel) const {
        if (!in_motion) return {};
        const float* m = in_motion + size_t(pixel) * motion_channels;
        return is_finite(m[0]) && is_finite(m[1]) ? Vec3{m[0], m[1], 0.0f} : Vec3{-infinity, -infinity, 0.0f};
    }

    // Inside the frame.
    SVGF_HD History read_history(float px, float py, const Box& box) const {
        const int left = int(px), top = int(py);
        if (px == float(left) && py == float(top)) {
            const Vec4 own = hist_color[guides.pixel(left, top)];
            return {own.xyz(), box.map(with_brightness(own.xyz())), fast_sqrt(own.w)};
        }
        const Cubic columns(px - float(left)), rows(py - float(top));
        return is_catmull_rom ? read_between<true>(left, top, columns, rows, box)
                              : read_between<false>(left, top, columns, rows, box);
    }

    // Never beyond the inner four pixels.
    template <bool IsCatmullRom>
    SVGF_HD History read_between(int left, int top, const Cubic& columns, const Cubic& rows, const Box& box) const {
        History history;
        Vec3 sum, least = {largest_float, largest_float, largest_float}, most = -1.0f * least;
        float total = 0.0f;
        const float white = interpolation_white * box.white;
        // Without a branch the reads of several taps are under way together.
        SVGF_UNROLL
        for (int j = 0; j < 4; ++j)
            SVGF_UNROLL
            for (int i = 0; i < 4; ++i) {
                const bool is_inner = !is_cubic_side(i) && !is_cubic_side(j);
                if (IsCatmullRom ? is_cubic_corner(i, j) : !is_inner) continue;
                const float linear = columns.linear[i] * rows.linear[j];
                const float share = IsCatmullRom ? columns.weight[i] * rows.weight[j] : linear;
                const Vec4 tap = hist_color[guides.nearest_pixel(left + i - 1, top + j - 1)];
                const Vec3 compressed = compress(with_brightness(tap.xyz()), white);
                total += share;
                sum += share * compressed;
                if (!is_inner) continue;
                least = min(least, compressed);
                most = max(most, compressed);
                history.frames += linear * fast_sqrt(tap.w);
            }
        const Vec3 between = min(max(sum * fast_reciprocal(total), least), most);
        history.mapped = box.map(with_brightness(expand(between, white)));
        return history;
    }

    SVGF_HD Vec3 noisy(int pixel) const {
        int repaired_before = 0;
        Vec3 color;
        if (in_emission) color = repair(load3(in_emission, pixel), repaired_before);
        for (int s = 0; s < Signals; ++s) color += repair(load3(frame.in_signal[s], pixel), repaired_before);
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
        for (int s = 0; s < Signals; ++s) {
            const Vec3 albedo = frame.in_albedo[s].at(pixel, repaired_before);
            variance += in_moments[s][pixel].y * square(luminance(albedo));
        }
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
