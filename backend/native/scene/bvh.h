// SPDX-License-Identifier: Apache-2.0
// Builds the wide trees, on the host: of a mesh over its triangles, of a scene over its instances.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "scene/wide_node.h"

namespace svgf {

// Axis-aligned box; the default is empty.
struct Bounds {
    Vec3 low{infinity, infinity, infinity};
    Vec3 high{-infinity, -infinity, -infinity};

    void add(Vec3 p) { low = min(low, p), high = max(high, p); }
    void add(const Bounds& other) { low = min(low, other.low), high = max(high, other.high); }
    bool is_empty() const { return !(low.x <= high.x && low.y <= high.y && low.z <= high.z); }
    // Half the surface area.
    float half_area() const {
        const Vec3 size = high - low;
        return is_empty() ? 0.0f : size.x * size.y + size.y * size.z + size.z * size.x;
    }
};

struct Bvh {
    std::vector<WideNode> nodes;            // the root is the first; always there, without children if nothing is in it
    std::vector<std::uint32_t> primitives;  // index into the boxes, in leaf order
    Bounds bounds;
    int levels = 1;  // of nodes, at most max_tree_levels
};

// Empty boxes are left out of the tree, the others must be finite. leaf_size: primitives per leaf, 1..max_leaf_size.
Bvh build_bvh(std::span<const Bounds> boxes, int leaf_size);

}  // namespace svgf
