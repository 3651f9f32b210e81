// SPDX-License-Identifier: Apache-2.0
// Stage "modulate": the filtered signals times their albedos, summed, plus what shines by itself [Schied17, Sec. 4].
// Reads the public albedos and emission again, and repairs them as demodulate does. svgf+ has it done by antialias, which
// needs the radiance of 3x3 pixels: it is never stored.
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
    float* out_color;           // [H, W, 3]
    float* out_variance;        // [H, W] of luminance, signals taken as independent
    float* out_history_length;  // [H, W] frames; null: temporal has written it
    int* out_repaired;

    struct Texel {
        typename Storage::Color::Texel color[Signals];
        Albedo::Texel albedo[Signals];
        Vec3 emission;
    };

    int bytes_per_pixel() const { return read_bytes_per_pixel() + 12 + 4 + (out_history_length ? 8 : 0); }
    int read_bytes_per_pixel() const {
        int bytes = in_emission ? 12 : 0;
        for (int s = 0; s < Signals; ++s) bytes += in_albedo[s].bytes_per_pixel() + Storage::color_bytes;
        return bytes;
    }

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y);
        int repaired = 0;
        float variance;
        const Vec3 color = radiance(fetch(pixel), variance, repaired);
        out_color[3 * pixel] = color.x;
        out_color[3 * pixel + 1] = color.y;
        out_color[3 * pixel + 2] = color.z;
        out_variance[pixel] = variance;
        if (out_history_length) out_history_length[pixel] = history_length(pixel);
        count(out_repaired, repaired);
    }

    SVGF_HD Texel fetch(int pixel) const {
        Texel texel;
        for (int s = 0; s < Signals; ++s) {
            texel.color[s] = in_color[s].fetch(pixel);
            texel.albedo[s] = in_albedo[s].fetch(pixel);
        }
        if (in_emission) texel.emission = load3(in_emission, pixel);
        return texel;
    }
    SVGF_HD Vec3 radiance(const Texel& texel, float& variance, int& repaired) const {
        int repaired_before = 0;  // demodulate has counted the albedos
        Vec3 sum = repair(texel.emission, repaired);
        variance = 0.0f;
        for (int s = 0; s < Signals; ++s) {
            const Vec3 albedo = in_albedo[s].unpack(texel.albedo[s], repaired_before);
            const Vec4 c = in_color[s].unpack(texel.color[s]);
            sum += c.xyz() * albedo;
            variance += c.w * square(luminance(albedo));
        }
        variance = fast_min(variance, largest_float);
        return sum;
    }

private:
    SVGF_HD float history_length(int pixel) const {
        if constexpr (requires { guides.length(pixel); })
            if (has_length) return guides.length(pixel);
        return is_surface(guides.depth(pixel)) ? 1.0f : 0.0f;
    }
};

}  // namespace svgf
