// SPDX-License-Identifier: Apache-2.0
// Stage "temporal" of svgf+: firefly limit, reprojection, running means, and the variance that is left in them.
//
// Reads 3x3 pixels of the public images, demodulated on the way, and what the frame before left: its guides, per signal
// the mean colour and the frames in it, and the variance of a sample. Writes the same of this frame, and with the
// colour the variance of the mean, which drives the filter. Every pixel has a variance from its first frame on, so no
// stage "variance" follows.
//
// Departures from [Schied17]. Measured on whole pictures of 480x270, 16 frames (gallery 10) at 1 sample per pixel, all
// from the fifth on: our own tracer's box of metal and glass and its arcade, a gallery and teapots that Cycles
// rendered, and our own tracer's toys and Sponza; relMSE, FLIP and flicker over those of OIDN 2.5.1:
//
//                              box            arcade         gallery        teapots        toys           Sponza
//   as it is                   1.23 .88 .426  .83 .82 .662   .83 .81 .690   1.02 .82 .421  1.33 .78 .602  1.35 .83 .649
//   no 3x3 mean of new diffus  1.20 .93 .444  .82 .89 .691   .82 .82 .694   1.02 .81 .424  1.32 .78 .604  1.26 .89 .665
//   that for 4 frames, not 2   1.31 .87 .421  .86 .83 .658   .83 .81 .688   1.02 .82 .419  1.34 .79 .601  1.48 .83 .645
//   no structure               1.59 .91 .344  .85 .81 .637   1.23 .75 .669  1.59 .83 .403  2.05 .82 .585  1.52 .85 .633
//   none by history            1.27 .89 .433  .83 .82 .659   .88 .79 .683   1.17 .82 .416  1.45 .79 .598  1.36 .83 .647
//   and history not sharp      1.28 .89 .434  .83 .82 .658   .92 .78 .682   1.29 .82 .416  1.60 .80 .598  1.36 .83 .646
//   no variance of the pixel   1.23 .88 .426  .85 .83 .649   .84 .82 .688   1.02 .82 .417  1.34 .79 .601  1.46 .85 .644
//   one threshold              1.27 .88 .425  .83 .82 .662   .82 .81 .690   1.02 .82 .419  1.33 .79 .602  1.35 .83 .649
//   threshold of change 0.3    1.28 .88 .424  .83 .84 .657   .83 .81 .689   1.02 .83 .419  1.33 .79 .602  1.35 .84 .645
//   no history fix             1.23 .88 .426  .83 .84 .666   .83 .81 .690   1.01 .82 .421  1.33 .78 .602  1.35 .84 .650
//   firefly limit 20           1.08 .98 .418  .90 1.05 .675  .77 .86 .691   .86 .82 .419   1.15 .78 .594  1.38 1.0 .649
//   no firefly limit           1.61 .89 .436  .82 .79 .656   74.5 .81 .697  1.12 .81 .422  1.52 .80 .608  1.39 .78 .646
//   no history clamp           1.61 .86 .436  .83 .81 .665   1.02 .80 .705  1.05 .81 .414  2.49 .78 .586  1.37 .83 .649
//   no temporal gradient       2.80 .95 .345  .83 .84 .655   .88 .79 .685   1.23 .83 .416  1.41 .80 .602  1.35 .84 .643
//
// The limit takes light where few samples find any, as in the arcade. Tables below are of the time when what they weigh
// was chosen: all else has moved on since.
//
// - The filter is driven by the variance of the mean, that of a sample over N, not of a sample: as history grows the
//   filter narrows, and a still view converges to the mean of all its samples.
// - The history is the mean itself, not what the first a-trous level made of it: fed back, a blur would pile up.
// - Variance is that of 3x3 neighbouring samples on the same surface, averaged over frames, not that of one pixel's
//   samples over time: nine times the samples, there from the first frame on, and what moves in a mirror is no noise.
// - History is drawn towards the mean of the 3x3 samples where it is more than `history_clamp` standard deviations away
//   from it, and counts as that much shorter: a lamp switched on, a shadow or a reflection that moves differently from
//   its surface does not lag. The deviation is the averaged one, so that sparse samples do not pass for a change.
// - Temporal gradients without a second trace [Schied18]: the `drift` is a mean over a few frames of how far the mean
//   of the 3x3 samples is from history, in deviations of a sample, and is averaged with eight pixels around every
//   frame. Noise averages out of it, a change adds up. Above `change_threshold` history gives way to the 3x3 samples,
//   at 1.2 times that altogether. The threshold rises with the frames that would be lost: a long history is not given
//   up for what chance does once in as many frames. That of the specular signal is higher, as its deviation, which
//   leaves out structure, is too low for samples that are rarely bright: at 0.2 four in ten of the box's pixels, in
//   which nothing changes, would be taken for changes; of diffuse light it is one in 250. Whole pictures of all frames
//   from the fifth on; relMSE, FLIP and flicker over those of OIDN 2.5.1, of our box of metal and glass, our toys, and
//   Cycles' teapots and gallery:
//
//     one sample's distance, threshold 0.45   1.99 .912 .337   1.40 .768 .575   1.74 .815 .415   1.00 .778 .691
//     the mean of 3x3, threshold 0.3          1.64 .875 .435   1.39 .760 .574   1.69 .820 .415   0.98 .784 .693
//     diffuse light 0.2                       1.55 .870 .430   1.38 .758 .574   1.68 .817 .415   0.98 .784 .693
//     diffuse light 0.15                      1.52 .869 .435   1.37 .757 .574   1.68 .809 .416   0.98 .784 .693
//     0.2, and 0.75 of it where light falls   1.50 .868 .430   1.37 .756 .573   1.68 .810 .416   0.97 .784 .693
//     0.2, and 0.6 of it                      1.49 .869 .434      -    -    -   1.67 .802 .418      -    -    -
//
//   A sun switched on in our arcade shows by 0.96 after five frames where it shines, and by 0.89 of all light (0.96 and
//   0.84 with 0.3); off, by 0.99 and 0.85 (0.98 and 0.78 with one threshold). At 0.15 a thousand noisy frames of a
//   still view come out worse than their mean, by a third.
//
//   Samples are skewed: chance makes them far more, hardly ever far less than they should be, so light that is less
//   than history says is a change already at `fall_share` of the threshold. The share is what energy allows: of gamma
//   distributed light (shape 1/2, 96 frames) 0.11 % is lost with one threshold, 0.17 % so, 0.31 % with 0.6. It goes
//   back to one threshold while history doubles: after 1024 frames a still view of such light has 1.08 times the error
//   of their plain mean (eight seeds, relMSE), and 1.09 times where it does not.
//
// - A sample brighter than `firefly_limit` times what is expected is scaled down to that, before it enters the mean.
//   Expected is what the whole filter made of the pixel a frame ago: its own history would never let a first bright
//   sample in where light is sparse. The limit is relative, so that it holds at any exposure; what is cut is counted.
// - History fix: what has just appeared, and was not seen a frame ago in the 3x3 pixels around, takes the nearest
//   history of its surface, up to `history_fix_radius` away. It counts for no frame, but says how bright a sample may
//   be: without it the neighbours alone do, and where few samples find light they cut most of it. Counted as a frame,
//   it would bring light to where a shadow is now, beside what moves; and for the spread of so few samples, the wider
//   history's is as good as their own. Pixels with at most four frames of history, FLIP and relMSE over those of OIDN
//   2.5.1, of our box of metal and glass (0.9 % of the pixels), our arcade (5 %), and the gallery (3 %); and the light
//   that is left there, over what OIDN leaves:
//
//     without                   1.43 1.96 .936     1.22 1.13 .895     .955 1.17 .969
//     as it is                  1.35 1.97 .951     1.11 1.05 .918     .953 1.17 .971
//     counted as one frame      1.56 2.18 .911     1.11 1.04 .917     .927 1.22 .983
//     its variance alone        1.49 2.15 .925     1.23 1.12 .894     .945 1.18 .972
//
// - Diffuse light begins, for `local_mean_frames`, with the mean of the 3x3 samples: where few samples find light, most
//   pixels would begin with none, and seem to be certain of it. What moves in reflections would be blurred, and borders
//   of shadows are, for as long as these frames are remembered: two are enough.
// - The mean of a moving specular signal is read by Catmull-Rom, where all four pixels saw the surface: read between
//   four pixels frame after frame, reflections of small things fade within a few. Diffuse light has borders, too
//   (Sponza 1.44 -> 1.26), but also noise that a little blur takes off (the arcade's flicker .656 -> .666), and on an
//   H200 reading it so costs another 0.04 ms at 1920x1080.
// - Black reflects nothing, whatever the light: where the albedo is 0 (and so the sample), the neighbours' light stands
//   for it, or history's, and it is no neighbour itself. Else a checkerboard of black and white, in which half of the
//   samples are 0, comes out at half its light: balls on one, by Cycles, relMSE, FLIP and flicker over those of OIDN
//   2.5.1, and the mean over the truth's: .616 1.445 .543 0.61 without, .640 .795 .563 0.86 so.
// - The variance of a specular sample is the least of four second differences: the border of a reflection, along which
//   light does not change, is no noise, neither to be blurred nor to be averaged with what has moved on.
// - Reflections follow their surface. Looked up where the point behind the surface was, at the hit distance (the mean
//   inverse of 3x3 pixels', by the lobe's dominant direction), they gain little: toys 1.40 .776 .575 -> 1.34 .782 .575,
//   arcade unchanged, as what lags is on curved and turning metal. With a wider `specular_history_clamp`, 0.7, the toys
//   have 2.28 by that point and 2.0 by the surface: so the clamp is narrow instead, and hit distances are not read.
// - Each signal has its own history length: reflections lose theirs while the diffuse light beside them keeps it.
// - Where the specular mean of a frame ago differs from pixel to pixel by more than its noise explains, that is
//   structure: a share of it is taken off the variance of the samples. That of a diffuse sample is held to be less than
//   the 3x3 samples say where the pixel's own do not stray from its history: the border of a shadow is there in every
//   frame. Both only where something moves: still, skewed samples would pass for changes again and again, as their
//   deviation is held to be less than it is.
// - What stands still has no limit on its history; what moves is resampled every frame, and keeps `history_frames`.
#pragma once

#include "denoise/cubic.h"
#include "denoise/demodulate.h"
#include "denoise/denoiser.h"
#include "denoise/reprojection.h"
#include "denoise/tiles.h"

namespace svgf {

// Weight of a frame in the drift, and how far apart the nine pixels are whose drift is averaged.
constexpr float drift_rate = 0.3f;
constexpr int drift_spacing = 3;
// Rise of the threshold whenever history has doubled beyond these frames.
constexpr float threshold_rise = 0.05f, threshold_frames = 16.0f;
// Of the threshold, for light that is less than history says, and its rise.
constexpr float fall_share = 0.75f, fall_share_rise = 0.0625f;
// In place of a luminance: the albedo is black, and says nothing about the light.
constexpr float unknown_light = -1.0f;
// Light that has just come counts for this much of the neighbours' mean without the brightest.
constexpr float neighbour_share = 0.1f;
// Frames in the mean up to which the 3x3 samples' mean takes a sample's place.
constexpr float local_mean_frames = 2.0f;
// Of a specular sample's variance: what the 3x3 samples say whatever their structure; the rest is the least of four
// second differences, over 6 and by what makes the least of four noisy ones as large as the noise.
constexpr float noise_structure_share = 0.06f, second_difference_scale = 2.5f / 6.0f;
// Of a diffuse sample's variance, what the 3x3 samples say whatever the pixel's own does, and from how many frames on.
constexpr float neighbours_variance_share = 0.3f, own_variance_frames = 2.0f;
// Of how history differs around a place, what is taken off a specular sample's variance.
constexpr float history_structure_share = 0.7f;
// Where nothing changes: frames beyond which the filter narrows faster than the noise falls.
constexpr float narrowing_frames = 32.0f;
// Of the specular mean's variance: how many times it is more uncertain after one frame than it seems.
constexpr float young_specular = 3.0f;

template <class Storage, int Signals>
struct TemporalPlus : Tiles {
    using Tiles::height, Tiles::width;
    static constexpr int blocks = 6 - Signals, fetches = 1;  // fastest on an H200

    struct Tile {
        Vec4 surface[places];         // normal, depth
        Vec4 color[Signals][places];  // illumination, luminance
        float light[Signals][places];  // the luminance again, for when it alone is read; or unknown_light
        int32_t object_id[places];    // 0: no surface
    };
    struct Texel {
        typename NoisyFrame<Signals>::Surface surface;
        typename NoisyFrame<Signals>::Signal signal[Signals];
        bool is_inside, is_own;  // of the image, of the tile
    };

    NoisyFrame<Signals> frame;
    Reprojection<Storage> reprojection;
    typename Storage::Color hist_color[Signals];  // in the variance's place the squared luminance after the filter
    typename Storage::Moments hist_moments[Signals];
    float history_frames, firefly_limit;
    // See local_mean_frames, noise_structure_share and neighbours_variance_share.
    float young_frames, structure_share, neighbours_share;
    int history_fix_radius;
    bool is_unchanged = false, is_specular[Signals], has_reflections[Signals];
    bool has_mean_drift, has_catmull_rom;  // see PlusStep
    float history_clamp[Signals], change_threshold[Signals];  // standard deviations
    float variance_scale[Signals];  // squared share of sigma_luminance that the signal is filtered with
    typename Storage::Guides out_guides;
    typename Storage::Gradients out_gradients;
    typename Storage::Color out_color[Signals];  // with the variance of the mean
    typename Storage::Moments out_moments[Signals];
    float* out_history_length;  // [H, W] frames, of the signal that has the fewest
    int* out_repaired;
    FireflyCount* out_fireflies;
    float* out_suppressed_light;  // [H, W] see DenoiseDiagnostics; null: nobody asks

    int bytes_per_pixel() const {
        const int signal = Signals * (Storage::color_bytes + Storage::moments_bytes);
        return frame.bytes_per_pixel() + reprojection.bytes_per_pixel() + (reprojection.prev_guides ? 2 : 1) * signal +
               Storage::guide_bytes + Storage::gradient_bytes + 4;
    }

    SVGF_HD Texel fetch(int tile_column, int tile_row, int place) const {
        const int x = Tiles::x(tile_column, place), y = Tiles::y(tile_row, place);
        const int pixel = out_guides.nearest_pixel(x, y);
        Texel texel;
        texel.surface = frame.fetch_surface(pixel);
        for (int s = 0; s < Signals; ++s) texel.signal[s] = frame.fetch_signal(s, pixel);
        texel.is_inside = out_guides.contains(x, y);
        texel.is_own = owns(tile_column, tile_row, x, y);
        return texel;
    }
    SVGF_HD void put(Tile& tile, int place, const Texel& texel) const {
        int repaired = 0;
        int32_t id;
        tile.surface[place] = frame.surface(texel.surface, id, repaired);
        tile.object_id[place] = texel.is_inside ? id : 0;
        for (int s = 0; s < Signals; ++s) {
            const Vec3 c = frame.illumination(s, texel.signal[s], repaired);
            const float light = luminance(c);
            tile.color[s][place] = {c.x, c.y, c.z, light};
            const bool is_unknown = !(light > 0.0f) && frame.in_albedo[s].is_black(texel.signal[s].albedo);
            tile.light[s][place] = is_unknown ? unknown_light : light;
        }
        if (texel.is_own) count(out_repaired, repaired);
    }
    struct Own {};
    SVGF_HD Own fetch_own(int, int, int, int) const { return {}; }

    SVGF_HD void operator()(const Tile& tile, Own, int tile_column, int tile_row, int thread_x, int thread_y) const {
        SVGF_NO_UNROLL
        for (int row = thread_y; row < rows; row += threads_y) {
            const int x = tile_column * columns + thread_x, y = tile_row * rows + row;
            if (out_guides.contains(x, y)) filter(tile, place(thread_x, row), x, y);
        }
    }

private:
    // What history says of a signal, a weighted mean of its taps.
    struct History {
        bool found = false;
        Vec3 color;
        float frames = 0.0f, variance = 0.0f, filtered_light = 0.0f, drift = 0.0f;
        float structure = 0.0f;  // variance of luminance around the place, over what its noise explains
    };

    // One bit for each of the pixels around, in the order of Tiles::neighbour: it shows the same surface.
    struct Neighbours {
        uint32_t mask = 0;
        int count = 0;

        SVGF_HD bool has(int n) const { return mask >> n & 1u; }
    };

    SVGF_HD void filter(const Tile& tile, int place, int x, int y) const {
        const int pixel = out_guides.pixel(x, y);
        const Vec4 surface = tile.surface[place];
        const int32_t id = tile.object_id[place];
        out_guides.store(pixel, surface, id);
        if (id == 0) {
            for (int s = 0; s < Signals; ++s) {
                const Vec4 color = tile.color[s][place];
                out_color[s].store(pixel, {color.x, color.y, color.z, 0.0f});
                out_moments[s].store(pixel, {});
            }
            out_gradients.store(pixel, {});
            out_history_length[pixel] = 0.0f;
            return;
        }
        int repaired = 0;
        const Vec2 gradient = frame.gradient(x, y, id, repaired);
        out_gradients.store(pixel, gradient, frame.gloss(pixel, repaired));
        typename Reprojection<Storage>::Point point;
        const int32_t stored_id = out_guides.stored_id(id);
        const bool reaches = reprojection.find(x, y, surface, gradient, stored_id, point, repaired);
        const bool moves = reaches && (point.x != float(x) || point.y != float(y));
        const auto taps = reaches ? reprojection.weigh(point) : typename Reprojection<Storage>::Taps{};

        const Neighbours near = find_neighbours(tile, place, surface, id);
        float shortest = largest_float;
        SVGF_UNROLL
        for (int s = 0; s < Signals; ++s) {
            History old;
            if (reaches) read_history(s, point, taps, moves, old);
            shortest = fast_min(shortest, accumulate(s, pixel, tile, place, near, old, moves));
        }
        out_history_length[pixel] = shortest;
        count(out_repaired, repaired);
    }

    SVGF_HD Neighbours find_neighbours(const Tile& tile, int place, Vec4 surface, int32_t id) const {
        Neighbours near;
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n) {
            const int tap = place + neighbour(n);
            const bool same = tile.object_id[tap] == id &&
                              dot(tile.surface[tap].xyz(), surface.xyz()) >= reprojection.normal_tolerance;
            near.mask |= uint32_t(same) << n;
        }
        near.count = count_set_bits(near.mask);
        return near;
    }

    // point: where the signal was a frame ago; taps: the pixels there that saw the surface.
    SVGF_HD void read_history(int s, const typename Reprojection<Storage>::Point& point,
                              const typename Reprojection<Storage>::Taps& taps, bool moves, History& old) const {
        float total = 0.0f;
        const auto take = [&](int pixel, float weight) {
            const Vec4 moments = hist_moments[s][pixel];
            const Vec4 color = hist_color[s][pixel];
            total += weight;
            old.color += weight * color.xyz();
            old.filtered_light += weight * fast_sqrt(color.w);
            old.frames += weight * moments.x;
            old.variance += weight * moments.y;
        };
        const bool is_far = reprojection.visit(point, taps, take, history_fix_radius) > 1;
        if (!(total > 0.0f)) return;
        old.found = true;
        const float scale = fast_reciprocal(total);
        old.color *= scale;
        old.filtered_light *= scale;
        old.frames *= is_far ? 0.0f : scale;
        old.variance *= scale;
        old.drift = mean_drift(s, int(std::floor(point.x + 0.5f)), int(std::floor(point.y + 0.5f)));
        if (has_catmull_rom && is_specular[s] && moves && taps.are_all) read_sharply(s, point, old);
    }

    // The mean colour by Catmull-Rom, never beyond the inner four pixels, and how history differs there.
    SVGF_HD void read_sharply(int s, const typename Reprojection<Storage>::Point& point, History& old) const {
        const int left = int(std::floor(point.x)), top = int(std::floor(point.y));
        const Cubic columns(point.x - float(left)), rows(point.y - float(top));
        const float around = luminance(old.color);  // what is squared is small
        Vec3 color, least = {largest_float, largest_float, largest_float}, most = -1.0f * least;
        float total = 0.0f, sum = 0.0f, squares = 0.0f;
        SVGF_UNROLL
        for (int j = 0; j < 4; ++j)
            SVGF_UNROLL
            for (int i = 0; i < 4; ++i) {
                if (is_cubic_corner(i, j)) continue;
                const Vec3 tap = hist_color[s][out_guides.nearest_pixel(left + i - 1, top + j - 1)].xyz();
                const float share = columns.weight[i] * rows.weight[j], offset = luminance(tap) - around;
                total += share;
                color += share * tap;
                sum += offset;
                squares += square(offset);
                if (is_cubic_side(i) || is_cubic_side(j)) continue;
                least = min(least, tap);
                most = max(most, tap);
            }
        old.color = min(max(color * fast_reciprocal(total), least), most);
        constexpr float share = 1.0f / float(cubic_taps);
        const float spread = squares * share - square(sum * share);
        old.structure = fast_max(spread - old.variance * fast_reciprocal(fast_max(old.frames, 1.0f)), 0.0f);
    }

    // Of nine pixels, whatever they show.
    SVGF_HD float mean_drift(int s, int x, int y) const {
        int columns[3], sum = 0;
        SVGF_UNROLL
        for (int i = 0; i < 3; ++i) columns[i] = clamp(x + (i - 1) * drift_spacing, 0, out_guides.width - 1);
        SVGF_UNROLL
        for (int j = 0; j < 3; ++j) {
            const int row = out_guides.pixel(0, clamp(y + (j - 1) * drift_spacing, 0, out_guides.height - 1));
            SVGF_UNROLL
            for (int i = 0; i < 3; ++i) sum += hist_moments[s].drift_steps(row + columns[i]);
        }
        return float(sum) * (Storage::Moments::drift_step / 9.0f);
    }

    // Brings the sample into the mean of a signal. Returns the frames that are in the mean.
    SVGF_HD float accumulate(int s, int pixel, const Tile& tile, int place, Neighbours near, const History& old,
                             bool moves) const {
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n)
            near.mask &= ~(uint32_t(tile.light[s][place + neighbour(n)] == unknown_light) << n);
        near.count = count_set_bits(near.mask);
        const bool is_known = tile.light[s][place] != unknown_light;
        const Vec4 own = is_known ? tile.color[s][place] : guess(tile, s, place, near, old);
        float lights[neighbours], sum = 0.0f, most = 0.0f;
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n) {
            lights[n] = near.has(n) ? tile.light[s][place + neighbour(n)] : 0.0f;
            sum += lights[n];
            most = fast_max(most, lights[n]);
        }
        const float limit = firefly_limit * expected_light(old, near.count, sum - most, own.w);
        if (own.w > limit) count_firefly(pixel, own.w - limit);

        // The 3x3 samples' luminance: mean and variance.
        const float own_light = fast_min(own.w, limit);
        float local_light = own_light;
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n) local_light += fast_min(lights[n], limit);
        local_light *= fast_reciprocal(float(near.count + 1));
        float squares = square(own_light - local_light);
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n)
            squares += near.has(n) ? square(fast_min(lights[n], limit) - local_light) : 0.0f;
        // A pixel without neighbours is as uncertain as it is bright.
        float spread = near.count > 0 ? squares * fast_reciprocal(float(near.count)) : square(own_light);
        if (is_specular[s]) {
            spread = noise_without_structure(spread, own_light, lights, limit, near);
            spread = fast_max(spread - history_structure_share * old.structure, structure_share * spread);
        } else if (moves && old.frames >= own_variance_frames) {
            const float own = square(own_light - luminance(old.color));
            const float unbiased = own * (old.frames * fast_reciprocal(old.frames + 1.0f));
            spread = fast_min(spread, neighbours_share * spread + unbiased);
        }

        // Light that has changed. kept: share of history that is not replaced by the 3x3 samples' mean.
        const float doublings = fast_max(fast_log2(fast_max(old.frames, 1.0f) * (1.0f / threshold_frames)), 0.0f);
        const float rise_threshold = change_threshold[s] + threshold_rise * doublings;
        const float fall_threshold = fast_min(fall_share + fall_share_rise * doublings, 1.0f) * rise_threshold;
        const float threshold = old.drift < 0.0f ? fall_threshold : rise_threshold;
        float kept = clamp(6.0f - 5.0f * std::fabs(old.drift) * fast_reciprocal(threshold), 0.0f, 1.0f);
        const bool changed = kept < 1.0f;
        float frames = old.frames * kept + 1.0f;
        if (moves) frames = fast_min(frames, history_frames);
        const float variance = old.variance + (spread - old.variance) * fast_reciprocal(frames);
        float drift = 0.0f;
        if (old.found) {
            const float offset = (luminance(old.color) - local_light) * kept;  // of history, which it leaves of it
            const float deviation = fast_sqrt(fast_max(variance, old.variance));
            const float own_offset = has_mean_drift ? offset : offset + local_light - own_light;
            const float residual = -own_offset * fast_reciprocal(deviation + 1e-3f * local_light + 1e-30f);
            drift = old.drift + (clamp(residual, -4.0f, 4.0f) - old.drift) * drift_rate;
            const float distance = std::fabs(offset);
            const float allowed = history_clamp[s] * fast_sqrt(variance) + 1e-4f * local_light;
            if (distance > allowed) {
                const float share = allowed * fast_reciprocal(distance);
                frames = fast_max(old.frames * kept * share, fast_min(old.frames, 1.0f)) + 1.0f;
                if (moves) frames = fast_min(frames, history_frames);
                kept *= share;
            }
        }
        Vec3 sample = limited(own, limit);
        Vec3 history = old.color;
        const bool is_young = !has_reflections[s] && frames <= young_frames;
        if (kept < 1.0f || is_young) {
            const Vec3 local = local_color(tile, s, place, near, limit, sample);
            history = local + (history - local) * kept;
            if (is_young) sample = local;
        }
        const float share = fast_reciprocal(frames);
        const Vec3 mean = history + (sample - history) * share;
        float uncertain = is_unchanged ? fast_min(narrowing_frames * share, 1.0f) : 1.0f;
        if (is_specular[s]) uncertain *= 1.0f + young_specular * share;
        out_color[s].store(pixel, {mean.x, mean.y, mean.z, variance_scale[s] * uncertain * variance * share});
        out_moments[s].store(pixel, {frames, variance, drift, changed ? 1.0f : 0.0f});
        return frames;
    }

    // Along the border of a reflection light does not change: the second difference in that direction is noise alone.
    SVGF_HD float noise_without_structure(float spread, float own_light, const float (&lights)[neighbours], float limit,
                                          Neighbours near) const {
        float least = largest_float;
        SVGF_UNROLL
        for (int n = 0; n < neighbours / 2; ++n) {
            const int opposite = neighbours - 1 - n;
            if (!near.has(n) || !near.has(opposite)) continue;
            const float sides = fast_min(lights[n], limit) + fast_min(lights[opposite], limit);
            least = fast_min(least, square(2.0f * own_light - sides));
        }
        const float noise = fast_min(spread, second_difference_scale * least);
        return noise + structure_share * (spread - noise);
    }

    // Light that black does not show: the neighbours', or else history's. With its luminance.
    SVGF_HD Vec4 guess(const Tile& tile, int s, int place, Neighbours near, const History& old) const {
        Vec3 sum;
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n)
            if (near.has(n)) sum += tile.color[s][place + neighbour(n)].xyz();
        const Vec3 light = near.count > 0 ? sum * fast_reciprocal(float(near.count)) : old.color;
        return {light.x, light.y, light.z, luminance(light)};
    }

    // Mean of the 3x3 samples.
    SVGF_HD Vec3 local_color(const Tile& tile, int s, int place, Neighbours near, float limit, Vec3 sample) const {
        SVGF_UNROLL
        for (int n = 0; n < neighbours; ++n)
            if (near.has(n)) sample += limited(tile.color[s][place + neighbour(n)], limit);
        return sample * fast_reciprocal(float(near.count + 1));
    }

    // Luminance of a sample by what the filter made of history, and by the neighbours; without either, its own. others:
    // the neighbours' luminances but the largest, summed.
    SVGF_HD static float expected_light(const History& old, int count, float others, float own) {
        const float local = count > 1 ? fast_max(others, 0.0f) * fast_reciprocal(float(count - 1)) : own;
        if (!old.found) return local;
        return fast_max(old.filtered_light, count > 1 ? neighbour_share * local : 0.0f);
    }

    // color: rgb and luminance.
    SVGF_HD static Vec3 limited(Vec4 color, float limit) {
        return color.w > limit ? color.xyz() * (limit * fast_reciprocal(color.w)) : color.xyz();
    }

    SVGF_HD void count_firefly(int pixel, float light) const {
        if (out_suppressed_light) out_suppressed_light[pixel] += light;
        count(&out_fireflies->samples, 1ull);
        count(&out_fireflies->light, static_cast<unsigned long long>(fast_min(light, 1e12f) * float(light_units)));
    }
};

}  // namespace svgf
