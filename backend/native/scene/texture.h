// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>

#include "device/device.h"
#include "scene/flat_scene.h"

namespace svgf {

// One image on the device, row 0 at the bottom: 4 bytes per texel of 8-bit images, 16 of float ones.
class Texture {
public:
    // pixels: [height, width, 4]. interpolation, extension: values of the enums of these names. Throws InputError on an
    // empty image, a wrong length or an unknown enum value.
    Texture(Device& device, std::span<const std::uint8_t> pixels, int width, int height, bool srgb, int interpolation,
            int extension, bool associated_alpha);
    // Linear. Values that are negative or not finite become 0.
    Texture(Device& device, std::span<const float> pixels, int width, int height, int interpolation, int extension,
            bool associated_alpha);

    const TextureView& view() const { return view_; }
    // Least and largest values as stored, [0, 1] for bytes.
    Vec4 low() const { return low_; }
    Vec4 high() const { return high_; }

private:
    Buffer<std::uint32_t> bytes_;
    Buffer<Vec4> floats_;
    TextureView view_;
    Vec4 low_, high_;
};

}  // namespace svgf
