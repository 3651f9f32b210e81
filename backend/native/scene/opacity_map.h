// SPDX-License-Identifier: Apache-2.0
// What light passes a triangle straight: for all of it, and where that differs for parts of it [Gruen20].
//
// The parts come from cutting each edge into 2^level: 4^level triangles of one size, in rows by the weight of vertex 1
// and within a row by that of vertex 2, two bits each.
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/vec.h"

namespace svgf {

// What light passes a triangle, or a part of it.
enum class OpacityClass : std::uint8_t {
    opaque,   // none
    clear,    // all
    cut_out,  // of any colour the same share: find_opacity
    shaded,   // that which only shading tells, as the surface tints it, is one of several, or shines
};

// Of a triangle its class and, of a cut-out, where the classes of its parts begin.
struct TriangleOpacity {
    static constexpr int parts_per_word = 16;
    static constexpr int lowest_level = 2, highest_level = 6;  // the parts of the lowest fill a word
    static constexpr std::uint32_t most_words = 1u << 27;

    // Bits 0 and 1: class; 2 to 4: level, 0: parts are not told apart; above: the first word.
    std::uint32_t bits = 0;

    SVGF_HD TriangleOpacity(OpacityClass whole, int level = 0, std::uint32_t first_word = 0)
        : bits(std::uint32_t(whole) | std::uint32_t(level) << 2 | first_word << 5) {}

    SVGF_HD OpacityClass whole() const { return OpacityClass(bits & 3u); }
    SVGF_HD int level() const { return int(bits >> 2 & 7u); }
    SVGF_HD std::uint32_t first_word() const { return bits >> 5; }
    static constexpr std::uint32_t words(int level) { return 1u << (2 * (level - lowest_level)); }

    // The class of the part that a point lies in. words: of all triangles.
    SVGF_HD OpacityClass at(const std::uint32_t* words, float weight1, float weight2) const {
        if (level() == 0) return whole();
        const std::uint32_t part = part_at(level(), weight1, weight2);
        const std::uint32_t word = words[first_word() + part / parts_per_word];
        return OpacityClass(word >> (2u * (part % parts_per_word)) & 3u);
    }

    // Number of the part that a point lies in; weights that rounding put outside of the triangle count as on its edge.
    SVGF_HD static std::uint32_t part_at(int level, float weight1, float weight2) {
        const int rows = 1 << level;
        const float x = weight1 * float(rows), y = weight2 * float(rows);
        const int row = clamp(int(x), 0, rows - 1), column = clamp(int(y), 0, rows - 1 - row);
        const bool upper = x - float(row) + (y - float(column)) > 1.0f && row + column < rows - 1;
        return std::uint32_t(row * (2 * rows - row) + 2 * column + (upper ? 1 : 0));
    }

    // Weights of vertices 1 and 2 at the corners of a part.
    SVGF_HD static void find_corners(int level, std::uint32_t part, Vec2 (&corners)[3]) {
        const int rows = 1 << level;
        int row = 0, place = int(part);
        for (; place >= 2 * (rows - row) - 1; ++row) place -= 2 * (rows - row) - 1;
        const float size = 1.0f / float(rows), x = float(row), y = float(place / 2);
        const bool upper = place % 2 == 1;
        corners[0] = upper ? Vec2{(x + 1) * size, (y + 1) * size} : Vec2{x * size, y * size};
        corners[1] = {(x + 1) * size, y * size};
        corners[2] = {x * size, (y + 1) * size};
    }
};

}  // namespace svgf
