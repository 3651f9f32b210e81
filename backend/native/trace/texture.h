// SPDX-License-Identifier: Apache-2.0
// Image lookups as Cycles does them: texels are interpolated as they are stored; then colours are divided by alpha
// where they are stored times it, and decoded where they are sRGB.
#pragma once

#include "core/approximate.h"
#include "core/load.h"
#include "core/vec.h"
#include "scene/flat_scene.h"

namespace svgf {

SVGF_HD inline float srgb_to_linear(float c) {  // IEC 61966-2-1
    return c <= 0.04045f ? c * (1.0f / 12.92f) : fast_exp2(2.4f * fast_log2((c + 0.055f) * (1.0f / 1.055f)));
}

// Texel index within [0, size), or -1 for one that the image does not cover. i: where the extension repeats, within its
// period or two beyond.
SVGF_HD inline int wrap_texel(int i, int size, Extension extension) {
    if (extension == Extension::extend) return clamp(i, 0, size - 1);
    if (extension == Extension::clip) return i >= 0 && i < size ? i : -1;
    const int period = extension == Extension::mirror ? 2 * size : size;
    // Clamped for images of one texel, which are all the same.
    i = clamp(i < 0 ? i + period : i >= period ? i - period : i, 0, period - 1);
    return i < size ? i : period - 1 - i;
}

// A coordinate in a unit square brought near to it, where the extension repeats: texel numbers then fit an int, and
// lose no precision. Coordinates that are not finite count as 0.
SVGF_HD inline float reduce_coordinate(float u, Extension extension) {
    if (!is_finite(u)) return 0.0f;
    if (extension == Extension::repeat) return u - std::floor(u);
    if (extension == Extension::mirror) return u - 2.0f * std::floor(u * 0.5f);
    return clamp(u, -2.0f, 3.0f);
}

// RGBA as stored, at what wrap_texel returned; 0 where the image does not cover it.
SVGF_HD inline Vec4 load_texel(const TextureView& texture, int x, int y) {
    if (x < 0 || y < 0) return {};
    const int i = y * texture.width + x;
    if (!texture.bytes) return texture.floats[i];
    const std::uint32_t texel = texture.bytes[i];
    return Vec4{float(texel & 0xffu), float((texel >> 8) & 0xffu), float((texel >> 16) & 0xffu), float(texel >> 24)} *
           (1.0f / 255.0f);
}

// Weight of texel `index`, 0 being the last one with its centre before the point, and share the part of the way from
// there to the next that the point has gone.
SVGF_HD inline float texel_weight(Interpolation interpolation, float share, int index) {
    if (interpolation == Interpolation::closest) return (share >= 0.5f) == (index == 1) ? 1.0f : 0.0f;
    const float distance = std::fabs(share - float(index));
    if (interpolation == Interpolation::linear) return 1.0f - distance;
    // Cubic B-spline.
    if (distance < 1.0f) return 2.0f / 3.0f - distance * distance * (1.0f - 0.5f * distance);
    const float rest = 2.0f - distance;
    return rest * rest * rest * (1.0f / 6.0f);
}

// RGBA, as stored but for alpha in colours, at uv, (0, 0) being the image's bottom left corner. Two by two texels at
// once, four times for cubic.
SVGF_HD inline Vec4 filter_texture(const TextureView& texture, Vec2 uv) {
    const float x = reduce_coordinate(uv.x, texture.extension) * float(texture.width) - 0.5f;
    const float y = reduce_coordinate(uv.y, texture.extension) * float(texture.height) - 0.5f;
    const float left = std::floor(x), below = std::floor(y);
    const float x_share = x - left, y_share = y - below;
    const bool is_cubic = texture.interpolation == Interpolation::cubic;
    Vec4 sum;
    SVGF_NO_UNROLL
    for (int quad = 0; quad < (is_cubic ? 4 : 1); ++quad) {
        const int i = is_cubic ? 2 * (quad & 1) - 1 : 0, j = is_cubic ? 2 * (quad >> 1) - 1 : 0;
        const float west = texel_weight(texture.interpolation, x_share, i);
        const float east = texel_weight(texture.interpolation, x_share, i + 1);
        const int west_column = wrap_texel(int(left) + i, texture.width, texture.extension);
        const int east_column = wrap_texel(int(left) + i + 1, texture.width, texture.extension);
        for (int row = 0; row < 2; ++row) {
            const int line = wrap_texel(int(below) + j + row, texture.height, texture.extension);
            const float weight = texel_weight(texture.interpolation, y_share, j + row);
            sum += load_texel(texture, west_column, line) * (west * weight);
            sum += load_texel(texture, east_column, line) * (east * weight);
        }
    }
    if (texture.associated_alpha && sum.w > 0.0f) {
        const float scale = fast_reciprocal(sum.w);
        sum = {sum.x * scale, sum.y * scale, sum.z * scale, sum.w};
    }
    return sum;
}

// RGBA, linear.
SVGF_HD inline Vec4 sample_texture(const TextureView& texture, Vec2 uv) {
    const Vec4 stored = filter_texture(texture, uv);
    if (!texture.srgb) return stored;
    return {srgb_to_linear(stored.x), srgb_to_linear(stored.y), srgb_to_linear(stored.z), stored.w};
}

SVGF_HD inline float channel_of(Vec4 texel, std::int32_t channel) {
    return channel <= 0 ? texel.x : channel == 1 ? texel.y : channel == 2 ? texel.z : texel.w;
}

// One channel of it.
SVGF_HD inline float sample_channel(const TextureView& texture, Vec2 uv, std::int32_t channel) {
    const float stored = channel_of(filter_texture(texture, uv), channel);
    return texture.srgb && channel < 3 ? srgb_to_linear(stored) : stored;
}

// Sends for the texels at uv. It pays to do so for all maps of a surface before the first one is read: in Sponza, whose
// textures are far larger than the caches of a core, a CPU would wait for them a seventh of the time.
SVGF_HD inline void prefetch_texture(const TextureView& texture, Vec2 uv) {
    const auto texel = [](float u, int size, Extension extension) {
        return clamp(int(reduce_coordinate(u, extension) * float(size) - 0.5f), 0, size - 1);
    };
    const int x = texel(uv.x, texture.width, texture.extension), y = texel(uv.y, texture.height, texture.extension);
    for (int line = y; line < min(y + 2, texture.height); ++line) {
        const int i = line * texture.width + x;
        prefetch(texture.bytes ? static_cast<const void*>(texture.bytes + i) : texture.floats + i);
    }
}

}  // namespace svgf
