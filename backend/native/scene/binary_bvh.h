// SPDX-License-Identifier: Apache-2.0
// The binary tree that a wide tree is made of, a leaf for each primitive: binned surface area heuristic [Wald07], top
// down, on all cores.
#pragma once

#include <cstdint>
#include <span>

#include "core/host_buffer.h"
#include "scene/bounds.h"

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
        std::uint32_t right;      // inner: the right child; the left one is the next node
        std::uint32_t primitive;  // leaf
    };
    std::uint32_t height;  // levels below this node; 0: a leaf

    bool is_leaf() const { return height == 0; }
};
static_assert(sizeof(BinaryNode) == 32);

// The root is node 0; nodes that no one names are not initialised. Sorts the primitives, at least one, into leaf order.
// height: most levels below the root, of which 2^height must be at least the number of primitives.
HostBuffer<BinaryNode> build_binary_bvh(std::span<Primitive> primitives, int height);

}  // namespace svgf
