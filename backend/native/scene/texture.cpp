// SPDX-License-Identifier: Apache-2.0
#include "scene/texture.h"

#include <algorithm>
#include <vector>

namespace svgf {
namespace {

TextureView checked_view(std::size_t values, int width, int height, int interpolation, int extension,
                         bool associated_alpha) {
    if (width < 1 || height < 1) throw InputError("A texture must have at least one pixel.");
    if (values != 4 * std::size_t(width) * std::size_t(height)) throw InputError("A texture must be [H, W, 4].");
    // Texel numbers and twice the width, for mirroring, are int.
    if (std::size_t(width) * std::size_t(height) >= (std::size_t(1) << 30))
        throw InputError("A texture may have at most 2^30 pixels.");
    if (interpolation < 0 || interpolation > int(Interpolation::cubic))
        throw InputError("Unknown texture interpolation.");
    if (extension < 0 || extension > int(Extension::mirror)) throw InputError("Unknown texture extension.");
    TextureView view;
    view.width = width;
    view.height = height;
    view.interpolation = Interpolation(interpolation);
    view.extension = Extension(extension);
    view.associated_alpha = associated_alpha;
    return view;
}

}  // namespace

Texture::Texture(Device& device, std::span<const std::uint8_t> pixels, int width, int height, bool srgb,
                 int interpolation, int extension, bool associated_alpha)
    : view_(checked_view(pixels.size(), width, height, interpolation, extension, associated_alpha)) {
    std::vector<std::uint32_t> texels(pixels.size() / 4);
    for (std::size_t i = 0; i < texels.size(); ++i)
        texels[i] = std::uint32_t(pixels[4 * i]) | std::uint32_t(pixels[4 * i + 1]) << 8 |
                    std::uint32_t(pixels[4 * i + 2]) << 16 | std::uint32_t(pixels[4 * i + 3]) << 24;
    std::uint8_t low[4] = {255, 255, 255, 255}, high[4] = {0, 0, 0, 0};
    for (std::size_t i = 0; i < pixels.size(); i += 4)
        for (std::size_t channel = 0; channel < 4; ++channel) {
            low[channel] = std::min(low[channel], pixels[i + channel]);
            high[channel] = std::max(high[channel], pixels[i + channel]);
        }
    const auto stored = [](const std::uint8_t (&c)[4]) {
        return Vec4{float(c[0]), float(c[1]), float(c[2]), float(c[3])} * (1.0f / 255.0f);
    };
    low_ = stored(low);
    high_ = stored(high);
    bytes_ = Buffer<std::uint32_t>(device, std::span<const std::uint32_t>(texels), "a texture");
    view_.bytes = bytes_.data();
    view_.srgb = srgb;
}

Texture::Texture(Device& device, std::span<const float> pixels, int width, int height, int interpolation, int extension,
                 bool associated_alpha)
    : view_(checked_view(pixels.size(), width, height, interpolation, extension, associated_alpha)) {
    const auto cleaned = [](float value) { return is_finite(value) && value > 0.0f ? value : 0.0f; };
    std::vector<Vec4> texels(pixels.size() / 4);
    for (std::size_t i = 0; i < texels.size(); ++i)
        texels[i] = {cleaned(pixels[4 * i]), cleaned(pixels[4 * i + 1]), cleaned(pixels[4 * i + 2]),
                     cleaned(pixels[4 * i + 3])};
    low_ = high_ = texels[0];
    for (const Vec4& texel : texels) {
        low_ = {min(low_.x, texel.x), min(low_.y, texel.y), min(low_.z, texel.z), min(low_.w, texel.w)};
        high_ = {max(high_.x, texel.x), max(high_.y, texel.y), max(high_.z, texel.z), max(high_.w, texel.w)};
    }
    floats_ = Buffer<Vec4>(device, std::span<const Vec4>(texels), "a texture");
    view_.floats = floats_.data();
}

}  // namespace svgf
