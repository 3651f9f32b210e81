// SPDX-License-Identifier: Apache-2.0
// Stage "resample": the history of one image size as that of another, so that a view goes on where its window or its
// resolution changes. Each pixel takes the nearest one's. Where pixels become smaller, their share of the frames is
// theirs, so that what is blurred gives way to new frames the sooner. Where they become larger, colours are means over
// the pixel, of the nearest one's object: surfaces must not mix, and one pixel's noise would be a block. The resolved
// picture counts for few frames, so that denoised ones follow: noisy ones would show in pixels that are larger.
#pragma once

#include "denoise/storage.h"

namespace svgf {

// What of a history this stage reads and writes.
template <class Storage, int Signals>
struct HistoryImages {
    typename Storage::Guides guides;
    typename Storage::Color color[Signals];
    typename Storage::Moments moments[Signals];
    typename Storage::Color resolved;  // svgf+: rgb and frames in the deviation's place; null: there is none
};

template <class Storage, int Signals>
struct Resample {
    HistoryImages<Storage, Signals> in, out;
    float frames_share;  // of the old pixel's frames, at most 1

    int bytes_per_pixel() const {
        return 2 * (Storage::guide_bytes + Signals * (Storage::color_bytes + Storage::moments_bytes) +
                    (in.resolved.texels ? Storage::color_bytes : 0));
    }

    SVGF_HD void operator()(int x, int y) const {
        const int from = pixel(x, y, 0, 1, 0, 1);
        const int to = out.guides.pixel(x, y);
        const int columns = samples(out.guides.width, in.guides.width);
        const int rows = samples(out.guides.height, in.guides.height);
        const bool is_larger = columns > 1 || rows > 1;
        out.guides.store(to, in.guides, from);
        for (int s = 0; s < Signals; ++s) {
            out.color[s].texels[to] = in.color[s].texels[from];
            if (is_larger) out.color[s].store(to, mean(in.color[s], x, y, from, columns, rows));
            auto moments = in.moments[s][from];
            if constexpr (!Storage::holds_any_bits) moments.x = fewer(moments.x);
            out.moments[s].store(to, moments);
        }
        if constexpr (Storage::holds_any_bits) {
            out.guides.store_length(to, fewer(in.guides.length(from)));
        } else if (in.resolved.texels) {
            Vec4 color = mean(in.resolved, x, y, from, columns, rows);
            color.w = in.resolved[from].w;
            const float frames = min(fewer(std::sqrt(color.w)), most_resolved_frames);
            out.resolved.store(to, {color.x, color.y, color.z, square(frames)});
        }
    }

private:
    static constexpr int most_samples = 4;  // along an axis
    static constexpr float most_resolved_frames = 8.0f;

    // Of a pixel's old ones, along an axis.
    SVGF_HD static int samples(int count, int old_count) { return clamp(old_count / count, 1, most_samples); }
    // Where the sample i of `samples` lies.
    SVGF_HD static int place(int of, int i, int samples, int count, int old_count) {
        return int((2 * (int64_t(of) * samples + i) + 1) * old_count / (2 * int64_t(count) * samples));
    }
    SVGF_HD int pixel(int x, int y, int i, int columns, int j, int rows) const {
        return in.guides.pixel(place(x, i, columns, out.guides.width, in.guides.width),
                               place(y, j, rows, out.guides.height, in.guides.height));
    }

    // Of colour, and of the root of what is stored with it.
    template <class Color>
    SVGF_HD Vec4 mean(const Color& color, int x, int y, int nearest, int columns, int rows) const {
        Vec4 sum = color[nearest];
        sum.w = std::sqrt(sum.w);
        int count = 1;
        for (int j = 0; j < rows; ++j)
            for (int i = 0; i < columns; ++i) {
                const int tap = pixel(x, y, i, columns, j, rows);
                if (tap == nearest || in.guides.object_id(tap) != in.guides.object_id(nearest)) continue;
                const Vec4 c = color[tap];
                sum = {sum.x + c.x, sum.y + c.y, sum.z + c.z, sum.w + std::sqrt(c.w)};
                ++count;
            }
        const float share = 1.0f / float(count);
        return {sum.x * share, sum.y * share, sum.z * share, square(sum.w * share)};
    }
    // One is left of any.
    SVGF_HD float fewer(float frames) const { return max(frames * frames_share, min(frames, 1.0f)); }
};

}  // namespace svgf
