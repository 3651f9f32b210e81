// SPDX-License-Identifier: Apache-2.0
// A node of the wide trees: up to 8 child boxes in 80 bytes, in the spirit of [Ylitie17].
#pragma once

#include <cstdint>

#include "core/bits.h"
#include "core/vec.h"

namespace svgf {

constexpr int wide_node_children = 8;
constexpr int max_leaf_size = 4;

// Levels of nodes that a tree may have. The builder guarantees it for any input; traversal sizes its stack by it.
constexpr int max_tree_levels = 20;

// Child boxes are 8-bit steps from `origin`, rounded outwards; the step is a power of two per axis. Slot s holds a
// child towards the corner of the node whose axis k is positive where bit k of s is set: a ray that visits the slots
// in the order s ^ (signs of its direction) goes front to back.
struct alignas(16) WideNode {
    Vec3 origin;
    std::uint32_t exponents_and_mask;  // bytes 0..2: biased exponents of the steps; byte 3: which slots are used
    std::uint32_t first_child;         // inner children lie next to each other
    std::uint32_t first_primitive;     // so do the primitives of all leaf children
    std::uint32_t slot[2];             // a byte per slot: primitives in bits 5..7, 0 for an inner child; offset in 0..4
    std::uint32_t low[3][2];           // a byte per slot, for each axis
    std::uint32_t high[3][2];

    SVGF_HD float step(int axis) const { return float_from_bits(((exponents_and_mask >> (8 * axis)) & 0xffu) << 23); }
    SVGF_HD std::uint32_t used_slots() const { return exponents_and_mask >> 24; }

    SVGF_HD static std::uint32_t byte(const std::uint32_t (&words)[2], int s) {
        return (words[s >> 2] >> (8 * (s & 3))) & 0xffu;
    }
    SVGF_HD static std::uint32_t primitive_count(std::uint32_t slot) { return slot >> 5; }
    SVGF_HD static std::uint32_t offset(std::uint32_t slot) { return slot & 31u; }
};
static_assert(sizeof(WideNode) == 80);
static_assert(wide_node_children * max_leaf_size <= 32, "a leaf's offset has 5 bits");

}  // namespace svgf
