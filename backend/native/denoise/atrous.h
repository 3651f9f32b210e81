// SPDX-License-Identifier: Apache-2.0
// Stage "atrous": one level of the edge-avoiding a-trous wavelet transform, 5x5 taps 2^level pixels apart.
// Atrous is the filter of [Schied17], driven by variance; EdgeAvoiding that of [Dammertz10].
//
// Departures from [Schied17]:
// - Epsilon of Eq. 3 grows with depth, see depth_epsilon (guides.h).
// - Taps outside the frame and on the background are left out and the weights renormalised, in the 3x3 prefilter of the
//   variance too: reading them as 0 would under-estimate it along every border.
// - The centre weighs h(0)^2 whatever its normal, so that the sum of weights is never 0.
// From [Dammertz10], of which the text and the listing at its end disagree: weights are Gaussians of squared distances,
// as in the listing; sigma_rt is halved at each level, as in the text. Positions are compared in camera space, where
// distances are those of world space and coordinates stay small.
#pragma once

#include "denoise/guides.h"

namespace svgf {

// B3 spline [Dammertz10] by distance from the centre, and a 3x3 Gaussian, per axis.
SVGF_HD inline float b3_spline(int distance) { return distance == 0 ? 0.375f : distance == 1 ? 0.25f : 0.0625f; }
SVGF_HD inline float gaussian(int distance) { return distance == 0 ? 0.5f : 0.25f; }

// [Schied17, Eq. 5] epsilon, radiance; only keeps 0 / 0 away.
constexpr float luminance_epsilon = 1e-10f;

template <int Signals>
struct Atrous {
    Guides guides;
    int level;
    float sigma_depth, sigma_normal, sigma_luminance;
    const Vec4* in_color[Signals];  // rgb, variance
    Vec4* out_color[Signals];

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y), step = 1 << level;
        const Vec4 p = guides.normal_depth[pixel];
        if (!is_surface(p)) {
            for (int s = 0; s < Signals; ++s) {
                const Vec3 c = in_color[s][pixel].xyz();
                out_color[s][pixel] = {c.x, c.y, c.z, 0.0f};
            }
            return;
        }
        const Vec2 gradient = guides.gradient[pixel];
        float light[Signals], light_scale[Signals];
        Vec4 sum[Signals];
        float weight[Signals];
        prefilter_variance(x, y, light_scale);
        for (int s = 0; s < Signals; ++s) {
            const Vec4 center = in_color[s][pixel];
            const float w = b3_spline(0) * b3_spline(0);
            light[s] = luminance(center.xyz());
            light_scale[s] = 1.0f / (sigma_luminance * std::sqrt(light_scale[s]) + luminance_epsilon);
            weight[s] = w;
            sum[s] = {w * center.x, w * center.y, w * center.z, w * w * center.w};
        }
        for (int j = -2; j <= 2; ++j)
            for (int i = -2; i <= 2; ++i) {
                const int dx = i * step, dy = j * step;
                if ((i == 0 && j == 0) || !guides.contains(x + dx, y + dy)) continue;
                const int tap = guides.pixel(x + dx, y + dy);
                float w_log;
                if (!edge_weight_log(p, guides.normal_depth[tap], gradient, dx, dy, sigma_depth, sigma_normal, w_log))
                    continue;
                const float h = b3_spline(i < 0 ? -i : i) * b3_spline(j < 0 ? -j : j);
                for (int s = 0; s < Signals; ++s) {
                    const Vec4 c = in_color[s][tap];
                    const float w =
                        h * std::exp(w_log - std::fabs(luminance(c.xyz()) - light[s]) * light_scale[s]);
                    weight[s] += w;
                    sum[s] += Vec4{w * c.x, w * c.y, w * c.z, w * w * c.w};  // [Schied17, Eq. 1, 2]
                }
            }
        for (int s = 0; s < Signals; ++s) {
            const float scale = 1.0f / weight[s];
            out_color[s][pixel] = {sum[s].x * scale, sum[s].y * scale, sum[s].z * scale, sum[s].w * scale * scale};
        }
    }

private:
    // g_3x3(Var) [Schied17, Eq. 5].
    SVGF_HD void prefilter_variance(int x, int y, float (&variance)[Signals]) const {
        float weight = 0.0f;
        for (int s = 0; s < Signals; ++s) variance[s] = 0.0f;
        for (int dy = -1; dy <= 1; ++dy)
            for (int dx = -1; dx <= 1; ++dx) {
                if (!guides.contains(x + dx, y + dy)) continue;
                const int tap = guides.pixel(x + dx, y + dy);
                if (!is_surface(guides.normal_depth[tap])) continue;
                const float w = gaussian(dx) * gaussian(dy);
                weight += w;
                for (int s = 0; s < Signals; ++s) variance[s] += w * in_color[s][tap].w;
            }
        for (int s = 0; s < Signals; ++s) variance[s] /= weight;
    }
};

template <int Signals>
struct EdgeAvoiding {
    Guides guides;
    Vec4 window;  // left, right, bottom, top of the image one unit ahead of the camera
    int level;
    float sigma_color, sigma_normal, sigma_position;  // sigma_color: of level 0
    const Vec4* in_color[Signals];
    Vec4* out_color[Signals];

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y), step = 1 << level;
        const Vec4 p = guides.normal_depth[pixel];
        Vec3 sum[Signals];
        float weight[Signals] = {};
        if (!is_surface(p)) {
            for (int s = 0; s < Signals; ++s) out_color[s][pixel] = in_color[s][pixel];
            return;
        }
        const Vec3 position = camera_position(x, y, p.w);
        const float color_scale = -square(float(step) / sigma_color);
        const float normal_scale = -1.0f / square(sigma_normal * float(step));
        const float position_scale = -1.0f / square(sigma_position);
        for (int j = -2; j <= 2; ++j)
            for (int i = -2; i <= 2; ++i) {
                const int qx = x + i * step, qy = y + j * step;
                if (!guides.contains(qx, qy)) continue;
                const int tap = guides.pixel(qx, qy);
                const Vec4 q = guides.normal_depth[tap];
                if (!is_surface(q)) continue;
                const Vec3 normal_difference = p.xyz() - q.xyz();
                const Vec3 position_difference = position - camera_position(qx, qy, q.w);
                const float w_log = normal_scale * dot(normal_difference, normal_difference) +
                                    position_scale * dot(position_difference, position_difference);
                const float h = b3_spline(i < 0 ? -i : i) * b3_spline(j < 0 ? -j : j);
                for (int s = 0; s < Signals; ++s) {
                    const Vec3 c = in_color[s][tap].xyz(), difference = in_color[s][pixel].xyz() - c;
                    const float w = h * std::exp(w_log + color_scale * dot(difference, difference));
                    weight[s] += w;
                    sum[s] += w * c;
                }
            }
        for (int s = 0; s < Signals; ++s) {
            const Vec3 c = sum[s] / weight[s];
            out_color[s][pixel] = {c.x, c.y, c.z, 0.0f};
        }
    }

private:
    SVGF_HD Vec3 camera_position(int x, int y, float depth) const {
        const float u = window.x + (window.y - window.x) * (float(x) + 0.5f) / float(guides.width);
        const float v = window.w + (window.z - window.w) * (float(y) + 0.5f) / float(guides.height);
        return {u * depth, v * depth, -depth};
    }
};

}  // namespace svgf
