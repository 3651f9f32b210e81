// SPDX-License-Identifier: Apache-2.0
#include "device/display.h"

#include <algorithm>

#include "device/threads.h"

namespace svgf {
namespace {

// The comparison is false for what is no number.
inline float limit(float value, float largest) {
    return value > 0.0f ? std::min(value, largest) : 0.0f;
}

template <int Channels>
void write_row(const float* in, ptrdiff_t in_stride, int width, float largest, float* out, ptrdiff_t out_stride) {
    for (int x = 0; x < width; ++x, in += in_stride, out += out_stride) {
        for (int channel = 0; channel < 3; ++channel) out[channel] = limit(in[channel % Channels], largest);
        out[3] = 1.0f;
    }
}

}  // namespace

void write_display(Pixels<const float> image, int height, int width, int channels, float largest, Pixels<float> rgba) {
    const auto write = channels == 1 ? write_row<1> : write_row<3>;
    parallel_for(size_t(height), [&](size_t begin, size_t end) {
        for (size_t y = begin; y < end; ++y)
            write(image.data + ptrdiff_t(y) * image.row_stride, image.pixel_stride, width, largest,
                  rgba.data + ptrdiff_t(height - 1 - y) * rgba.row_stride, rgba.pixel_stride);
    });
}

}  // namespace svgf
