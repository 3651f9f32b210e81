// SPDX-License-Identifier: Apache-2.0
// Stage "variance": where history is too short to tell the variance of luminance, take it from 7x7 pixels
// [Schied17, Sec. 4.2]. Elsewhere temporal has written it already, and this stage only looks at the history length.
//
// The taps are weighed by depth and normal [Schied17, Eq. 3, 4]. Their moments are merged about the common mean
// [Chan83]: the estimate is the variance of all samples in them, over time and over pixels, and is never negative.
#pragma once

#include "denoise/guides.h"

namespace svgf {

template <int Signals>
struct Variance {
    static constexpr int radius = 3;

    Guides guides;
    const Vec2* in_moments[Signals];
    const float* in_length;
    float sigma_depth, sigma_normal;
    int spatial_variance_frames;
    Vec4* out_color[Signals];  // w alone is written

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y);
        if (in_length[pixel] >= float(spatial_variance_frames)) return;
        const Vec4 p = guides.normal_depth[pixel];
        if (!is_surface(p)) return;
        const Vec2 gradient = guides.gradient[pixel];
        float weight = 0.0f, mean[Signals] = {}, squares[Signals] = {};
        for (int dy = -radius; dy <= radius; ++dy)
            for (int dx = -radius; dx <= radius; ++dx) {
                if (!guides.contains(x + dx, y + dy)) continue;
                const int tap = guides.pixel(x + dx, y + dy);
                float w_log = 0.0f;
                if (tap != pixel && !edge_weight_log(p, guides.normal_depth[tap], gradient, dx, dy, sigma_depth,
                                                     sigma_normal, w_log))
                    continue;
                const float w = std::exp(w_log), before = weight;
                if (!(w > 0.0f)) continue;
                weight += w;
                const float share = w / weight;
                for (int s = 0; s < Signals; ++s) {
                    const Vec2 moments = in_moments[s][tap];
                    const float difference = moments.x - mean[s];
                    mean[s] += difference * share;
                    squares[s] += w * moments.y + before * share * difference * difference;
                }
            }
        for (int s = 0; s < Signals; ++s) out_color[s][pixel].w = squares[s] / weight;
    }
};

}  // namespace svgf
