// SPDX-License-Identifier: Apache-2.0
// A node of the wide trees: up to 8 child boxes in 80 bytes [Ylitie17].
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/bits.h"
#include "core/vec.h"
#include "scene/bounds.h"

namespace svgf {

constexpr int wide_node_children = 8;
constexpr int max_leaf_size = 3;

// Levels of nodes that a tree may have. The builder guarantees it for any input; traversal sizes its stack by it.
constexpr int max_tree_levels = 20;

// Child boxes are 8-bit steps from `origin`, rounded outwards; the step is a power of two per axis. Slot s holds a
// child towards the corner of the node whose axis k is positive where bit k of s is set: a ray that visits the slots
// in the order s ^ (signs of its direction) goes front to back.
//
// A slot's byte says which bits its child sets in the node's hit mask, where all children that a ray meets end up: bits
// 5..7 are set, shifted left by bits 0..4. A leaf sets one bit for each of its primitives, below inner_bit; an inner
// child sets bit inner_bit + s. The byte of a free slot is 0.
struct alignas(16) WideNode {
    static constexpr int inner_bit = 24;

    Vec3 origin;
    std::uint32_t exponents_and_inner;  // bytes 0..2: biased exponents of the steps; byte 3: slots of inner children
    std::uint32_t first_child;          // inner children lie next to each other, in the order of their slots
    std::uint32_t first_primitive;      // so do the primitives of all leaf children, in the order of the hit mask
    std::uint32_t slot[2];              // a byte per slot
    // For each axis two bytes per slot, where its box begins and where it ends: side by side, so that the device picks
    // the side that a ray enters by and makes numbers of its bytes in one permutation.
    std::uint32_t sides[3][4];

    SVGF_HD float step(int axis) const { return float_from_bits(((exponents_and_inner >> (8 * axis)) & 0xffu) << 23); }
    SVGF_HD std::uint32_t inner_slots() const { return exponents_and_inner >> 24; }

    template <std::size_t words>
    SVGF_HD static std::uint32_t byte(const std::uint32_t (&bytes)[words], int i) {
        return (bytes[i >> 2] >> (8 * (i & 3))) & 0xffu;
    }
    SVGF_HD static std::uint32_t inner_slot(int s) { return (1u << 5) | std::uint32_t(inner_bit + s); }
    SVGF_HD static std::uint32_t leaf_slot(std::uint32_t first, std::uint32_t count) {
        return (((1u << count) - 1) << 5) | first;
    }
    SVGF_HD static bool is_inner(std::uint32_t slot) { return (slot & 31u) >= inner_bit; }
    // Of a leaf.
    SVGF_HD static std::uint32_t first_of(std::uint32_t slot) { return slot & 31u; }
    SVGF_HD static std::uint32_t count_of(std::uint32_t slot) {
        const std::uint32_t bits = slot >> 5;
        return (bits & 1u) + (bits >> 1 & 1u) + (bits >> 2);
    }

    // Box of the child in a slot, as wide as rays find it but for their margin.
    SVGF_HD Bounds child_box(int s) const {
        const Vec3 scale{step(0), step(1), step(2)};
        const auto side = [&](int axis, int end) { return float(byte(sides[axis], 2 * s + end)); };
        const Vec3 from{side(0, 0), side(1, 0), side(2, 0)}, to{side(0, 1), side(1, 1), side(2, 1)};
        return {origin + from * scale, origin + to * scale};
    }

    // Sets the boxes of the children, child[s] for slot s, and all that describes them. box: around all of them.
    SVGF_HD void set_boxes(const Bounds& box, const Bounds (&child)[wide_node_children]) {
        origin = box.low;
        exponents_and_inner &= 0xff000000u;
        set_axis(0, box.low.x, box.high.x, child, [](Vec3 p) { return p.x; });
        set_axis(1, box.low.y, box.high.y, child, [](Vec3 p) { return p.y; });
        set_axis(2, box.low.z, box.high.z, child, [](Vec3 p) { return p.z; });
    }

private:
    template <class Component>
    SVGF_HD void set_axis(int axis, float box_low, float box_high, const Bounds (&child)[wide_node_children],
                          const Component& component) {
        // The smallest power of two of which 255 steps reach across.
        const double extent = double(box_high) - double(box_low);
        const std::uint32_t bits = bits_of(float(extent * (1.0 / 255.0)) * 1.000001f);
        const std::uint32_t exponent = (bits >> 23) + ((bits & 0x007fffffu) ? 1u : 0u);
        const std::uint32_t biased = exponent < 1u ? 1u : exponent > 254u ? 254u : exponent;
        exponents_and_inner |= biased << (8 * axis);
        const double steps_per_unit = 1.0 / double(float_from_bits(biased << 23));
        std::uint32_t bytes[4] = {};
        for (int s = 0; s < wide_node_children; ++s) {
            if (byte(slot, s) == 0) continue;
            const double from = (double(component(child[s].low)) - double(box_low)) * steps_per_unit;
            const double to = (double(component(child[s].high)) - double(box_low)) * steps_per_unit;
            const int floor = int(from), ceiling = int(to) + (to > double(int(to)) ? 1 : 0);
            const std::uint32_t both = std::uint32_t(floor > 255 ? 255 : floor) |
                                       std::uint32_t(ceiling > 255 ? 255 : ceiling) << 8;
            bytes[s >> 1] |= both << (16 * (s & 1));
        }
        for (int word = 0; word < 4; ++word) sides[axis][word] = bytes[word];
    }
};
static_assert(sizeof(WideNode) == 80);
static_assert(wide_node_children * max_leaf_size <= WideNode::inner_bit);

}  // namespace svgf
