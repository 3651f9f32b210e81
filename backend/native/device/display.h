// SPDX-License-Identifier: Apache-2.0
// Pictures for a screen.
#pragma once

#include <cstddef>

namespace svgf {

// A part of an image in memory. stride: of rows and of pixels, in values; the channels of a pixel lie side by side.
template <class T>
struct Pixels {
    T* data;
    ptrdiff_t row_stride, pixel_stride;
};

// Writes an image of 1 or 3 channels as opaque RGBA, as OpenGL's textures are: bottom row first. Values are limited to
// [0, largest], and what is no number becomes 0.
void write_display(Pixels<const float> image, int height, int width, int channels, float largest, Pixels<float> rgba);

}  // namespace svgf
