// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "core/vec.h"

namespace svgf {

// Axis-aligned box; the default is empty.
struct Bounds {
    Vec3 low{infinity, infinity, infinity};
    Vec3 high{-infinity, -infinity, -infinity};

    SVGF_HD void add(Vec3 p) { low = min(low, p), high = max(high, p); }
    SVGF_HD void add(const Bounds& other) { low = min(low, other.low), high = max(high, other.high); }
    SVGF_HD bool is_empty() const { return !(low.x <= high.x && low.y <= high.y && low.z <= high.z); }
    // Half the surface area.
    SVGF_HD float half_area() const {
        const Vec3 size = high - low;
        return is_empty() ? 0.0f : size.x * size.y + size.y * size.z + size.z * size.x;
    }
};

}  // namespace svgf
