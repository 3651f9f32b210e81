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
    static constexpr bool compares_means = false, compares_taps = false;
};

// Our own: svgf+, a sixth of the work.
struct Plus {
    using Storage = PackedStorage;
    using Normal = CosineLobe;
    static constexpr int radius = 1;  // 3x3 binomial
    // Eq. 5 as a Gaussian of the difference of two means, by the variance of both of them, see atrous.h.
    static constexpr bool compares_means = true, compares_taps = true;
};

// Its filter where every signal may hold sharp reflections, by the centre's variance alone.
struct SharpPlus : Plus {
    static constexpr bool compares_taps = false;
};

}  // namespace svgf
