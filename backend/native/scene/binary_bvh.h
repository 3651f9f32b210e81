// SPDX-License-Identifier: Apache-2.0
// The binary tree that a wide tree is made of, a leaf for each primitive: binned surface area heuristic [Wald07], top
// down, on all cores.
#pragma once

#include <cstdint>
#include <span>

#include "core/host_buffer.h"
#include "scene/bounds.h"
#include "scene/wide_node.h"

namespace svgf {

// A box to be sorted into a tree.
struct alignas(16) Primitive {
    Vec3 low;
    std::uint32_t index;
    Vec3 high;
    std::uint32_t unused;

    Bounds box() const { return {low, high}; }
    Vec3 centre() const { return (low + high) * 0.5f; }
};

struct BinaryNode {
    Bounds box;
    union {
        std::uint32_t left;       // inner: the children
        std::uint32_t primitive;  // leaf
    };
    std::uint32_t right;
    std::uint32_t parent;  // of the root: itself
    std::uint32_t height;  // levels below this node; 0: a leaf

    bool is_leaf() const { return height == 0; }
};
static_assert(sizeof(BinaryNode) == 40);

// Levels below the root at most: a wide node opens three of them.
constexpr int max_binary_height = 3 * max_tree_levels;

// The root is node 0. Sorts the primitives, 1 to 2^max_binary_height, into leaf order.
HostBuffer<BinaryNode> build_binary_bvh(std::span<Primitive> primitives);

}  // namespace svgf
