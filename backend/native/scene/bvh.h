// SPDX-License-Identifier: Apache-2.0
// Builds the wide trees, on all cores of the host: of a mesh over its triangles, of a scene over its instances.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "scene/bounds.h"
#include "scene/wide_node.h"

namespace svgf {

struct Bvh {
    std::vector<WideNode> nodes;            // the root is the first; always there, without children if nothing is in it
    std::vector<std::uint32_t> primitives;  // index into the boxes, in leaf order
    Bounds bounds;
    int levels = 1;  // of nodes, at most max_tree_levels
};

// high: the tree is improved after it is built, as scene/reinsertion.h does. quick: for what is built in every frame.
enum class TreeQuality { quick, high };

// Empty boxes are left out of the tree, the others must be finite. leaf_size: primitives per leaf, 1..max_leaf_size.
// The tree is a function of the boxes, not of the number of threads.
Bvh build_bvh(std::span<const Bounds> boxes, int leaf_size, TreeQuality quality);

}  // namespace svgf
