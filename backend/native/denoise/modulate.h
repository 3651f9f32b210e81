// SPDX-License-Identifier: Apache-2.0
// Stage "modulate": the filtered signals times their albedos, summed, plus what shines by itself [Schied17, Sec. 4].
// Reads the public albedos and emission again, and repairs them as demodulate does.
#pragma once

#include "denoise/demodulate.h"

namespace svgf {

template <class Storage, int Signals>
struct Modulate {
    typename Storage::Color in_color[Signals];  // as a sink of the last level of "atrous": not read
    const float* in_albedo[Signals][2];
    const float* in_emission;
    typename Storage::Guides guides;
    bool has_length;  // false: no temporal mean, the frame stands alone
    float* out_color;           // [H, W, 3]; null: to out_unresolved, for "antialias"
    typename Storage::Color out_unresolved;
    typename Storage::Color out_filtered_light[Signals];  // svgf+: see temporal_plus.h; null: not wanted
    float* out_variance;        // [H, W] of luminance, signals taken as independent
    float* out_history_length;  // [H, W] frames; null: temporal has written it
    int* out_repaired;

    int bytes_per_pixel() const { return sink_bytes_per_pixel() + Signals * Storage::color_bytes; }
    int sink_bytes_per_pixel() const {
        int bytes = (in_emission ? 12 : 0) + (out_color ? 12 : Storage::color_bytes) + 4 + (out_history_length ? 8 : 0);
        for (int s = 0; s < Signals; ++s) bytes += (in_albedo[s][0] ? 12 : 0) + (in_albedo[s][1] ? 12 : 0);
        return bytes;
    }

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y);
        Vec4 filtered[Signals];
        for (int s = 0; s < Signals; ++s) filtered[s] = in_color[s][pixel];
        (*this)(pixel, filtered);
    }

    SVGF_HD void operator()(int pixel, const Vec4 (&filtered)[Signals]) const {
        int repaired = 0, repaired_before = 0;  // demodulate has counted the albedos
        Vec3 color;
        float variance = 0.0f;
        if (in_emission) color = repair(load3(in_emission, pixel), repaired);
        for (int s = 0; s < Signals; ++s) {
            const Vec3 albedo = signal_albedo(in_albedo[s], pixel, repaired_before);
            const Vec4 c = filtered[s];
            color += c.xyz() * albedo;
            variance += c.w * square(luminance(albedo));
            if (out_filtered_light[s].texels) out_filtered_light[s].store_variance(pixel, square(luminance(c.xyz())));
        }
        if (out_color) {
            out_color[3 * pixel] = color.x;
            out_color[3 * pixel + 1] = color.y;
            out_color[3 * pixel + 2] = color.z;
        } else {
            out_unresolved.store(pixel, {color.x, color.y, color.z, 0.0f});
        }
        out_variance[pixel] = min(variance, largest_float);
        if (out_history_length) out_history_length[pixel] = history_length(pixel);
        count(out_repaired, repaired);
    }

private:
    SVGF_HD float history_length(int pixel) const {
        if constexpr (requires { guides.length(pixel); })
            if (has_length) return guides.length(pixel);
        return is_surface(guides.depth(pixel)) ? 1.0f : 0.0f;
    }
};

}  // namespace svgf
