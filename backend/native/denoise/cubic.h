// SPDX-License-Identifier: Apache-2.0
// Catmull-Rom splines over 4x4 pixels without the four corners, which weigh least: what reads images between their
// pixels frame after frame, where four pixels would blur them.
#pragma once

#include "core/vec.h"

namespace svgf {

// Pixels that are read, and of the 4x4 the ones that are not.
constexpr int cubic_taps = 12;
SVGF_HD constexpr bool is_cubic_side(int i) { return i == 0 || i == 3; }
SVGF_HD constexpr bool is_cubic_corner(int i, int j) { return is_cubic_side(i) && is_cubic_side(j); }

// Weights of four pixels in a row for a place between the middle two, t from the second to the third: Catmull-Rom, and
// linear ones.
struct Cubic {
    float weight[4], linear[4];

    SVGF_HD explicit Cubic(float t)
        : weight{0.5f * t * ((2.0f - t) * t - 1.0f), 1.0f + t * t * (1.5f * t - 2.5f),
                 0.5f * t * ((4.0f - 3.0f * t) * t + 1.0f), 0.5f * t * t * (t - 1.0f)},
          linear{0.0f, 1.0f - t, t, 0.0f} {}
};

}  // namespace svgf
