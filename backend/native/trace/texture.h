// SPDX-License-Identifier: Apache-2.0
// Image lookups as Cycles does them: 8-bit sRGB texels are interpolated first and decoded after.
#pragma once

#include "core/vec.h"
#include "scene/flat_scene.h"

namespace svgf {

SVGF_HD inline float srgb_to_linear(float c) {  // IEC 61966-2-1
    return c <= 0.04045f ? c / 12.92f : std::pow((c + 0.055f) / 1.055f, 2.4f);
}

// Texel index within [0, size) for one that is less than a period outside, or -1 for one that the image does not cover.
SVGF_HD inline int wrap_texel(int i, int size, Extension extension) {
    switch (extension) {
        case Extension::repeat:
            return i < 0 ? i + size : i >= size ? i - size : i;
        case Extension::mirror:
            i = i < 0 ? -1 - i : i;
            i = i >= 2 * size ? i - 2 * size : i;
            return i < size ? i : 2 * size - 1 - i;
        case Extension::extend:
            return clamp(i, 0, size - 1);
        case Extension::clip:
            break;
    }
    return i >= 0 && i < size ? i : -1;
}

// A coordinate in a unit square brought near to it, where the extension repeats: texel numbers then fit an int, and
// lose no precision. Coordinates that are not finite count as 0.
SVGF_HD inline float reduce_coordinate(float u, Extension extension) {
    if (!is_finite(u)) return 0.0f;
    if (extension == Extension::repeat) return u - std::floor(u);
    if (extension == Extension::mirror) return u - 2.0f * std::floor(u * 0.5f);
    return clamp(u, -1.0f, 2.0f);
}

SVGF_HD inline Vec3 load_texel(const TextureView& texture, int x, int y) {
    x = wrap_texel(x, texture.width, texture.extension);
    y = wrap_texel(y, texture.height, texture.extension);
    if (x < 0 || y < 0) return {};
    const int i = y * texture.width + x;
    if (!texture.bytes) return texture.floats[i].xyz();
    const std::uint32_t texel = texture.bytes[i];
    return Vec3{float(texel & 0xffu), float((texel >> 8) & 0xffu), float((texel >> 16) & 0xffu)} * (1.0f / 255.0f);
}

// Linear colour at uv, (0, 0) being the image's bottom left corner.
SVGF_HD inline Vec3 sample_texture(const TextureView& texture, Vec2 uv) {
    const float x = reduce_coordinate(uv.x, texture.extension) * float(texture.width);
    const float y = reduce_coordinate(uv.y, texture.extension) * float(texture.height);
    Vec3 color;
    if (texture.interpolation == Interpolation::closest) {
        color = load_texel(texture, int(std::floor(x)), int(std::floor(y)));
    } else {
        const float left = std::floor(x - 0.5f), below = std::floor(y - 0.5f);
        const float right_share = x - 0.5f - left, upper_share = y - 0.5f - below;
        const int i = int(left), j = int(below);
        const Vec3 lower = lerp(load_texel(texture, i, j), load_texel(texture, i + 1, j), right_share);
        const Vec3 upper = lerp(load_texel(texture, i, j + 1), load_texel(texture, i + 1, j + 1), right_share);
        color = lerp(lower, upper, upper_share);
    }
    return texture.srgb ? Vec3{srgb_to_linear(color.x), srgb_to_linear(color.y), srgb_to_linear(color.z)} : color;
}

}  // namespace svgf
