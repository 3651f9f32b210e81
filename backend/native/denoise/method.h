// SPDX-License-Identifier: Apache-2.0
// What the stages of a method share, chosen when they are compiled.
#pragma once

#include "denoise/guides.h"

namespace svgf {

// [Schied17] as published.
struct Published {
    using Storage = FloatStorage;
    using Normal = CosinePower;
    static constexpr int radius = 2;  // of the a-trous kernel: 5x5 B3 spline
    static constexpr bool prefilters_first_level_only = false;
    static constexpr bool squares_luminance = false;  // in the exponent of Eq. 5
};

// Our own: svgf+, a sixth of the work.
struct Plus {
    using Storage = PackedStorage;
    using Normal = CosineLobe;
    static constexpr int radius = 1;  // 3x3 binomial
    // After it, variance has been averaged over the taps of the level before.
    static constexpr bool prefilters_first_level_only = true;
    // A Gaussian of the difference: what is surely no noise weighs nothing, and there is no root to take.
    static constexpr bool squares_luminance = true;
};

}  // namespace svgf
