// SPDX-License-Identifier: Apache-2.0
// The tiles of a stage that reads the 3x3 pixels around each one: 32 x 16 pixels and a margin of one, so that a pixel
// is read and unpacked 1.2 times instead of nine.
#pragma once

#include "denoise/guides.h"

namespace svgf {

struct Tiles {
    static constexpr int columns = 32, rows = 16, width = columns + 2, height = rows + 2, places = width * height;
    static constexpr int threads_x = columns, threads_y = 8, rows_per_thread = rows / threads_y;

    int image_width = 0, image_height = 0;

    int tile_columns() const { return (image_width + columns - 1) / columns; }
    int tile_rows() const { return (image_height + rows - 1) / rows; }

    // Pixel of a place in a tile, which may lie outside the image.
    SVGF_HD int x(int tile_column, int place) const { return tile_column * columns + place % width - 1; }
    SVGF_HD int y(int tile_row, int place) const { return tile_row * rows + place / width - 1; }
    // Whether the place is no margin, and lies inside the image: every pixel does in one tile.
    SVGF_HD bool owns(int tile_column, int tile_row, int x, int y) const {
        const int column = x - tile_column * columns, row = y - tile_row * rows;
        return column >= 0 && column < columns && row >= 0 && row < rows && x < image_width && y < image_height;
    }
    SVGF_HD static int place(int column, int row) { return (row + 1) * width + column + 1; }

    // Places to the right and below of a place's neighbours, in rows from the upper left.
    static constexpr int neighbours = 8;
    SVGF_HD static constexpr int neighbour(int n) {
        const int k = n < 4 ? n : n + 1;
        return (k / 3 - 1) * width + k % 3 - 1;
    }
};

}  // namespace svgf
