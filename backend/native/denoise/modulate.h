// SPDX-License-Identifier: Apache-2.0
// Stage "modulate": the filtered signals times their albedos, summed, plus what shines by itself [Schied17, Sec. 4].
// Reads the public albedos and emission again, and repairs them as demodulate does. svgf+ has it done by antialias,
// which needs the radiance of 3x3 pixels: it is never stored.
#pragma once

#include "denoise/demodulate.h"

namespace svgf {

template <class Storage, int Signals>
struct Modulate {
    typename Storage::Color in_color[Signals];
    Albedo in_albedo[Signals];
    const float* in_emission;
    typename Storage::Guides guides;
    bool has_length;            // false: no temporal mean, the frame stands alone
    typename Storage::Color out_filtered_light[Signals];  // svgf+: see temporal_plus.h; null: not wanted
    float* out_color;           // [H, W, 3]
    float* out_variance;        // [H, W] of luminance, signals taken as independent
    float* out_history_length;  // [H, W] frames; null: temporal has written it
    int* out_repaired;

    struct Texel {
        typename Storage::Color::Texel color[Signals], history[Signals];
        Albedo::Texel albedo[Signals];
        Vec3 emission;
    };
    struct Radiance {
        Vec3 color;
        float variance = 0.0f, filtered_light[Signals];  // of luminance
        int repaired = 0;
    };

    int bytes_per_pixel() const { return bytes_per_pixel_but_color() + 12; }
    int bytes_per_pixel_but_color() const {
        int bytes = (in_emission ? 12 : 0) + 4 + (out_history_length ? 8 : 0);
        for (int s = 0; s < Signals; ++s)
            bytes += in_albedo[s].bytes_per_pixel() + (out_filtered_light[s].texels ? 3 : 1) * Storage::color_bytes;
        return bytes;
    }

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y);
        const Texel texel = fetch(pixel);
        const Radiance radiance = unpack(texel);
        out_color[3 * pixel] = radiance.color.x;
        out_color[3 * pixel + 1] = radiance.color.y;
        out_color[3 * pixel + 2] = radiance.color.z;
        write_all_but_color(pixel, texel, radiance);
    }

    SVGF_HD Texel fetch(int pixel) const {
        Texel texel;
        for (int s = 0; s < Signals; ++s) {
            texel.color[s] = in_color[s].fetch(pixel);
            texel.albedo[s] = in_albedo[s].fetch(pixel);
            if (out_filtered_light[s].texels) texel.history[s] = out_filtered_light[s].fetch(pixel);
        }
        if (in_emission) texel.emission = load3(in_emission, pixel);
        return texel;
    }
    SVGF_HD Radiance unpack(const Texel& texel) const {
        int repaired_before = 0;  // demodulate has counted the albedos
        Radiance sum;
        sum.color = repair(texel.emission, sum.repaired);
        for (int s = 0; s < Signals; ++s) {
            const Vec3 albedo = in_albedo[s].unpack(texel.albedo[s], repaired_before);
            const Vec4 c = in_color[s].unpack(texel.color[s]);
            sum.color += c.xyz() * albedo;
            sum.variance += c.w * square(luminance(albedo));
            sum.filtered_light[s] = luminance(c.xyz());
        }
        return sum;
    }
    SVGF_HD void write_all_but_color(int pixel, const Texel& texel, const Radiance& radiance) const {
        for (int s = 0; s < Signals; ++s)
            if (out_filtered_light[s].texels)
                out_filtered_light[s].store_variance(pixel, texel.history[s], square(radiance.filtered_light[s]));
        out_variance[pixel] = fast_min(radiance.variance, largest_float);
        if (out_history_length) out_history_length[pixel] = history_length(pixel);
        count(out_repaired, radiance.repaired);
    }

private:
    SVGF_HD float history_length(int pixel) const {
        if constexpr (requires { guides.length(pixel); })
            if (has_length) return guides.length(pixel);
        return is_surface(guides.depth(pixel)) ? 1.0f : 0.0f;
    }
};

}  // namespace svgf
