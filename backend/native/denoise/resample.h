// SPDX-License-Identifier: Apache-2.0
// Stage "resample": the history of one image size as that of another, so that a view goes on where its window or its
// resolution changes. Each pixel takes the nearest one's, whole: surfaces must not mix. Where pixels become smaller,
// their share of the frames is theirs, so that what is blurred gives way to new frames the sooner.
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
        const int from = in.guides.pixel(nearest(x, out.guides.width, in.guides.width),
                                         nearest(y, out.guides.height, in.guides.height));
        const int to = out.guides.pixel(x, y);
        out.guides.store(to, in.guides, from);
        for (int s = 0; s < Signals; ++s) {
            out.color[s].texels[to] = in.color[s].texels[from];
            auto moments = in.moments[s][from];
            if constexpr (!Storage::holds_any_bits) moments.x = fewer(moments.x);
            out.moments[s].store(to, moments);
        }
        if constexpr (Storage::holds_any_bits) {
            out.guides.store_length(to, fewer(in.guides.length(from)));
        } else if (in.resolved.texels) {
            const Vec4 color = in.resolved[from];
            out.resolved.store(to, {color.x, color.y, color.z, square(fewer(std::sqrt(color.w)))});
        }
    }

private:
    SVGF_HD static int nearest(int place, int count, int old_count) {
        return int((2 * int64_t(place) + 1) * old_count / (2 * int64_t(count)));
    }
    // One is left of any.
    SVGF_HD float fewer(float frames) const { return max(frames * frames_share, min(frames, 1.0f)); }
};

}  // namespace svgf
