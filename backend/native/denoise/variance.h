// SPDX-License-Identifier: Apache-2.0
// Stage "variance": where history is too short to tell the variance of luminance, take it from 7x7 pixels
// [Schied17, Sec. 4.2]. Elsewhere temporal has written it already, and this stage only looks at the history length.
//
// The taps are weighed by depth and normal [Schied17, Eq. 3, 4]. Their moments are merged about the common mean
// [Chan83]: the estimate is the variance of all samples in them, over time and over pixels, and is never negative.
#pragma once

#include "denoise/method.h"

namespace svgf {

template <class Method, int Signals>
struct Variance {
    using Storage = typename Method::Storage;
    static constexpr int radius = 3;

    typename Storage::Guides guides;
    typename Storage::Gradients gradients;
    typename Storage::Moments in_moments[Signals];
    float sigma_depth, sigma_normal;
    int spatial_variance_frames;
    typename Storage::Color out_color[Signals];  // the variance alone is written

    int bytes_per_pixel() const { return Storage::length_bytes; }  // once history is long enough

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y);
        if (guides.length(pixel) >= float(spatial_variance_frames)) return;
        const Vec4 p = guides.normal_depth(pixel);
        if (!is_surface(p.w)) return;
        const EdgeWeight<typename Method::Normal> edge(p, gradients[pixel], sigma_depth, sigma_normal);
        float weight = 0.0f, mean[Signals] = {}, squares[Signals] = {};
        for (int dy = -radius; dy <= radius; ++dy)
            for (int dx = -radius; dx <= radius; ++dx) {
                if (!guides.contains(x + dx, y + dy)) continue;
                const int tap = guides.pixel(x + dx, y + dy);
                const Vec4 q = guides.normal_depth(tap);
                if (!is_surface(q.w)) continue;
                const float w = tap == pixel ? 1.0f : fast_exp2(edge(q, edge.depth_scale(dx, dy, 1.0f)));
                if (!(w > 0.0f)) continue;
                const float before = weight;
                weight += w;
                const float share = w / weight;
                for (int s = 0; s < Signals; ++s) {
                    const Vec2 moments = in_moments[s][tap];
                    const float difference = moments.x - mean[s];
                    mean[s] += difference * share;
                    squares[s] += w * moments.y + before * share * difference * difference;
                }
            }
        for (int s = 0; s < Signals; ++s) out_color[s].store_variance(pixel, squares[s] / weight);
    }
};

}  // namespace svgf
