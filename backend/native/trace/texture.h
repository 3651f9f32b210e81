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

SVGF_HD inline Vec4 expand_texel(std::uint32_t texel) {  // to 0..255
    return {float(texel & 0xffu), float((texel >> 8) & 0xffu), float((texel >> 16) & 0xffu), float(texel >> 24)};
}

// RGBA as stored, at what wrap_texel returned; 0 where the image does not cover it.
SVGF_HD inline Vec4 load_texel(const TextureView& texture, int x, int y) {
    if (x < 0 || y < 0) return {};
    const int i = y * texture.width + x;
    return texture.bytes ? expand_texel(texture.bytes[i]) * (1.0f / 255.0f) : texture.floats[i];
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

// Where a lookup lies among the texels: between columns `left` and left + 1, rows `below` and below + 1.
struct TexelPoint {
    int left, below;
    float x_share, y_share;

    // uv: (0, 0) is the image's bottom left corner.
    SVGF_HD TexelPoint(const TextureView& texture, Vec2 uv) {
        const float x = reduce_coordinate(uv.x, texture.extension) * float(texture.width) - 0.5f;
        const float y = reduce_coordinate(uv.y, texture.extension) * float(texture.height) - 0.5f;
        left = int(std::floor(x));
        below = int(std::floor(y));
        x_share = x - std::floor(x);
        y_share = y - std::floor(y);
    }
};

// Place and weight of column or row number `index` of an image; 0 and 0 where the image does not cover it.
SVGF_HD inline void weigh_line(const TextureView& texture, int size, int first, float share, int index, int& place,
                               float& weight) {
    place = wrap_texel(first + index, size, texture.extension);
    weight = place < 0 ? 0.0f : texel_weight(texture.interpolation, share, index);
    place = max(place, 0);
}

// RGBA, as stored. Two by two texels at once, four times for cubic: all are read before the first is waited for.
SVGF_HD inline Vec4 filter_texture(const TextureView& texture, Vec2 uv) {
    const TexelPoint point(texture, uv);
    const bool is_cubic = texture.interpolation == Interpolation::cubic;
    Vec4 sum;
    SVGF_NO_UNROLL
    for (int quad = 0; quad < (is_cubic ? 4 : 1); ++quad) {
        const int i = is_cubic ? 2 * (quad & 1) - 1 : 0, j = is_cubic ? 2 * (quad >> 1) - 1 : 0;
        int column[2], row[2], place[4];
        float across[2], along[2], weight[4];
        for (int k = 0; k < 2; ++k) {
            weigh_line(texture, texture.width, point.left, point.x_share, i + k, column[k], across[k]);
            weigh_line(texture, texture.height, point.below, point.y_share, j + k, row[k], along[k]);
        }
        for (int k = 0; k < 4; ++k) {
            place[k] = row[k >> 1] * texture.width + column[k & 1];
            weight[k] = across[k & 1] * along[k >> 1];
        }
        const auto add = [&](Vec4 texel, float share) {
            sum = {multiply_add(texel.x, share, sum.x), multiply_add(texel.y, share, sum.y),
                   multiply_add(texel.z, share, sum.z), multiply_add(texel.w, share, sum.w)};
        };
        if (texture.bytes) {
            std::uint32_t texel[4];
            for (int k = 0; k < 4; ++k) texel[k] = texture.bytes[place[k]];
            for (int k = 0; k < 4; ++k) add(expand_texel(texel[k]), weight[k] * (1.0f / 255.0f));
        } else {
            Vec4 texel[4];
            for (int k = 0; k < 4; ++k) texel[k] = texture.floats[place[k]];
            for (int k = 0; k < 4; ++k) add(texel[k], weight[k]);
        }
    }
    return sum;
}

// One channel of the same, and alpha. One texel after the other: rays read it on their way, and have few registers
// left.
SVGF_HD inline Vec2 filter_channel(const TextureView& texture, Vec2 uv, std::int32_t channel) {
    const TexelPoint point(texture, uv);
    const bool is_cubic = texture.interpolation == Interpolation::cubic;
    Vec2 sum;
    const auto add = [&](int column, int row, float weight) {
        if (column < 0 || row < 0) return;
        const int place = row * texture.width + column;
        if (texture.bytes) {
            const std::uint32_t texel = texture.bytes[place];
            sum = sum + Vec2{float((texel >> (8 * channel)) & 0xffu), float(texel >> 24)} * (weight * (1.0f / 255.0f));
        } else {
            const float* const texel = &texture.floats[place].x;
            sum = sum + Vec2{texel[channel], texel[3]} * weight;
        }
    };
    SVGF_NO_UNROLL
    for (int quad = 0; quad < (is_cubic ? 4 : 1); ++quad) {
        const int i = is_cubic ? 2 * (quad & 1) - 1 : 0, j = is_cubic ? 2 * (quad >> 1) - 1 : 0;
        const float west = texel_weight(texture.interpolation, point.x_share, i);
        const float east = texel_weight(texture.interpolation, point.x_share, i + 1);
        const int west_column = wrap_texel(point.left + i, texture.width, texture.extension);
        const int east_column = wrap_texel(point.left + i + 1, texture.width, texture.extension);
        for (int k = 0; k < 2; ++k) {
            const int row = wrap_texel(point.below + j + k, texture.height, texture.extension);
            const float along = texel_weight(texture.interpolation, point.y_share, j + k);
            add(west_column, row, west * along);
            add(east_column, row, east * along);
        }
    }
    return sum;
}

// RGBA, linear.
SVGF_HD inline Vec4 sample_texture(const TextureView& texture, Vec2 uv) {
    Vec4 stored = filter_texture(texture, uv);
    if (texture.associated_alpha && stored.w > 0.0f) {
        const float scale = fast_reciprocal(stored.w);
        stored = {stored.x * scale, stored.y * scale, stored.z * scale, stored.w};
    }
    if (!texture.srgb) return stored;
    return {srgb_to_linear(stored.x), srgb_to_linear(stored.y), srgb_to_linear(stored.z), stored.w};
}

SVGF_HD inline float channel_of(Vec4 texel, std::int32_t channel) {
    return channel <= 0 ? texel.x : channel == 1 ? texel.y : channel == 2 ? texel.z : texel.w;
}

// One channel of it.
SVGF_HD inline float sample_channel(const TextureView& texture, Vec2 uv, std::int32_t channel) {
    channel = clamp(channel, 0, 3);
    const Vec2 stored = filter_channel(texture, uv, channel);
    if (channel == 3) return stored.y;
    const float value =
        texture.associated_alpha && stored.y > 0.0f ? stored.x * fast_reciprocal(stored.y) : stored.x;
    return texture.srgb ? srgb_to_linear(value) : value;
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
