// SPDX-License-Identifier: Apache-2.0
// Stage "atrous": one level of the edge-avoiding a-trous wavelet transform, taps 2^level pixels apart.
// Atrous is the filter of [Schied17], driven by variance; EdgeAvoiding that of [Dammertz10].
//
// Departures from [Schied17]:
// - Epsilon of Eq. 3 grows with depth, see depth_epsilon (guides.h).
// - Taps outside the frame and on the background are left out and the weights renormalised, in the 3x3 prefilter of the
//   variance too: reading them as 0 would under-estimate it along every border.
// - The centre weighs h(0)^2 whatever its normal, so that the sum of weights is never 0.
// Of svgf+ alone:
// - Eq. 5 is a Gaussian of the difference of two means, over the larger of their variances: weights are the same from p
//   to q and from q to p, so that the filter keeps the light. With the centre's variance alone, pixels that happen to
//   have seen no light, and so seem to be certain, take in none, while the lit ones around take in their darkness. (The
//   sum of the variances is what theory asks for; the larger has as low errors, and needs one division per pixel, not
//   per tap.)
// - The variance is prefiltered at the first level alone: later the larger of two does as much. relMSE and FLIP of our
//   own box and arcade over OIDN's, frames 5 to 16, with a threshold of change of 0.3: 1.75 .895 and .977 .886 at every
//   level, 1.64 .877 and .961 .882 so.
// - At the border of a sharp reflection the dark side is certain indeed: the glossier a tap's surface is, the less its
//   variance counts for the specular signal, and a mirror's not at all.
//   Our own tracer's box of metal and glass, its arcade and its toys, whole pictures of all frames from the fifth on;
//   relMSE and FLIP over those of OIDN 2.5.1:
//
//     the centre's variance alone         1.24 1.123     1.02 1.110     1.25 .768
//     all reflections taken for sharp     1.39 0.980     0.98 0.967     1.27 .774
//     by their gloss                      1.55 0.870     0.95 0.862     1.38 .758
// - Taps of other objects count as any. Left out, thin objects keep their noise: relMSE and FLIP of the box 1.55 .870,
//   then 2.63 .879, of the arcade 0.95 .862 and 0.96 .877, of the toys 1.38 .758 and 1.37 .765; though rims of lamps
//   would leave no specks 8 and 16 pixels beside them (Cycles' teapots 1.68 .817 and 1.67 .811).
// From [Dammertz10], of which the text and the listing at its end disagree: weights are Gaussians of squared distances,
// as in the listing; sigma_rt is halved at each level, as in the text. Positions are compared in camera space, where
// distances are those of world space and coordinates stay small.
//
// On tiles. The taps of a level with spacing s join only pixels that are multiples of s apart, so a tile is taken from
// one such lattice (of 1, 2 or 4 neighbouring columns, so that reads of memory stay whole): whatever the spacing, a
// pixel is read and unpacked 1.4 times instead of 9 or 25, and a tap is two loads from fast memory at fixed
// distances. A thread filters two or four pixels, which share half of their taps.
#pragma once

#include "denoise/method.h"

namespace svgf {

// [Schied17, Eq. 5] epsilon, radiance; only keeps 0 / 0 away.
constexpr float luminance_epsilon = 1e-10f;

// Kernels by distance from the centre, per axis: B3 spline [Dammertz10] and binomial; a 3x3 Gaussian.
template <int Radius>
SVGF_HD constexpr float kernel(int distance) {
    if constexpr (Radius == 2)
        return distance == 0 ? 0.375f : distance == 1 ? 0.25f : 0.0625f;
    else
        return distance == 0 ? 0.5f : 0.25f;
}
// Its logarithm to the base 2, of a tap (i, j) steps away.
template <int Radius>
SVGF_HD constexpr float kernel_log2(int i, int j) {
    const auto of = [](int distance) {
        if constexpr (Radius == 2)
            return distance == 0 ? -1.4150374993f : distance == 1 || distance == -1 ? -2.0f : -4.0f;
        else
            return distance == 0 ? -1.0f : -2.0f;
    };
    return of(i) + of(j);
}
SVGF_HD constexpr float gaussian(int distance) { return distance == 0 ? 0.5f : 0.25f; }

// Columns of the lattice that a tile takes together.
constexpr int most_phases_log2 = 2;

// Where the tiles of a level lie: 32 x 16 pixels of a lattice with spacing 2^level, 2^phases_log2 neighbouring columns
// of it, with a margin for the taps.
template <int radius, int phases_log2>
struct Lattice {
    static constexpr int columns = 32, rows = 16;
    static constexpr int margin = radius << phases_log2;  // columns
    static constexpr int width = columns + 2 * margin, height = rows + 2 * radius;
    static constexpr int right = 1 << phases_log2, below = width;  // from a place to that of the next tap

    int level = 0;  // at least phases_log2
    int image_width = 0, image_height = 0;

    int tile_columns() const { return divide_up(image_width, span_x_log2()) << (level - phases_log2); }
    int tile_rows() const { return divide_up(image_height, span_y_log2()) << level; }

    // Pixel of the place (column, row) in a tile with its margins; it may lie outside the image.
    SVGF_HD int x(int tile_column, int column) const {
        const int interleaved_log2 = level - phases_log2, phase_mask = (1 << phases_log2) - 1;
        const int left = ((tile_column >> interleaved_log2) << span_x_log2()) +
                         ((tile_column & ((1 << interleaved_log2) - 1)) << phases_log2);
        return left + (((column >> phases_log2) - radius) * (1 << level)) + (column & phase_mask);
    }
    SVGF_HD int y(int tile_row, int row) const {
        const int top = ((tile_row >> level) << span_y_log2()) + (tile_row & ((1 << level) - 1));
        return top + (row - radius) * (1 << level);
    }

private:
    // Pixels from a tile to the next of its lattice.
    SVGF_HD int span_x_log2() const { return 5 - phases_log2 + level; }
    SVGF_HD int span_y_log2() const { return 4 + level; }
    static int divide_up(int size, int unit_log2) { return (size + (1 << unit_log2) - 1) >> unit_log2; }
};

// sink(pixel, color) takes the result, rgb and variance of each signal.
template <class Method, int Signals, int PhasesLog2, class Sink>
struct Atrous {
    using Storage = typename Method::Storage;
    using Gradient = typename Storage::Gradients::Texel;
    // As the registers allow; fastest on an H200.
    static constexpr int radius = Method::radius, rows_per_thread = radius == 1 && Signals == 1 ? 4 : 2;
    static constexpr int blocks = rows_per_thread == 4 ? 5 : 5 - Signals, fetches = 2;
    using Lattice = svgf::Lattice<radius, PhasesLog2>;
    static constexpr int threads_x = Lattice::columns, threads_y = Lattice::rows / rows_per_thread;

    static constexpr int places = Lattice::width * Lattice::height;
    struct Tile {
        Vec4 surface[places];         // normal, depth; depth is infinity where there is nothing to filter
        Vec4 color[Signals][places];  // see to_tile
        float certainty[Signals][Method::compares_taps ? places : 1];  // what Eq. 5 scales squared differences with
    };
    struct Texel {
        typename Storage::Guides::Texel guide;
        typename Storage::Color::Texel color[Signals];
        Gradient gradient;  // where it is needed for the gloss
        bool is_inside;
    };
    struct Own {
        Gradient gradient[rows_per_thread];
    };

    typename Storage::Guides guides;
    typename Storage::Gradients gradients;
    Lattice lattice;
    float sigma_depth, sigma_normal, sigma_luminance;
    bool has_reflections[Signals] = {}, has_prefilter = true;  // read by svgf+ alone
    typename Storage::Color in_color[Signals];
    Sink sink;

    int bytes_per_pixel() const {
        return Storage::guide_bytes + Storage::gradient_bytes + Signals * Storage::color_bytes +
               sink.sink_bytes_per_pixel();
    }
    int tile_columns() const { return lattice.tile_columns(); }
    int tile_rows() const { return lattice.tile_rows(); }

    SVGF_HD Texel fetch(int tile_column, int tile_row, int place) const {
        const int row = place / Lattice::width, column = place % Lattice::width;
        const int x = lattice.x(tile_column, column), y = lattice.y(tile_row, row);
        const int pixel = guides.nearest_pixel(x, y);
        Texel texel;
        texel.is_inside = guides.contains(x, y);
        texel.guide = guides.fetch(pixel);
        bool reads_gloss = false;
        for (int s = 0; s < Signals; ++s) {
            texel.color[s] = in_color[s].fetch(pixel);
            reads_gloss = reads_gloss || (Method::compares_taps && has_reflections[s]);
        }
        if (reads_gloss) texel.gradient = gradients.fetch(pixel);
        return texel;
    }
    SVGF_HD void put(Tile& tile, int place, const Texel& texel) const {
        Vec4 surface = guides.normal_depth(texel.guide);
        if (!texel.is_inside || !is_surface(surface.w)) surface.w = infinity;
        tile.surface[place] = surface;
        for (int s = 0; s < Signals; ++s) {
            const Vec4 color = in_color[s].unpack(texel.color[s]);
            tile.color[s][place] = to_tile(color);
            if constexpr (Method::compares_taps) {
                const float gloss = has_reflections[s] ? Storage::Gradients::gloss(texel.gradient) : 0.0f;
                const float scale = gloss < 1.0f ? fast_reciprocal(1.0f - gloss) : largest_float;
                tile.certainty[s][place] = certainty(color.w) * scale;
            }
        }
    }
    SVGF_HD Own fetch_own(int tile_column, int tile_row, int thread_x, int thread_y) const {
        const int x = lattice.x(tile_column, thread_x + Lattice::margin);
        Own own;
        SVGF_UNROLL
        for (int p = 0; p < rows_per_thread; ++p)
            own.gradient[p] =
                gradients.fetch(guides.nearest_pixel(x, lattice.y(tile_row, thread_y * rows_per_thread + p + radius)));
        return own;
    }

    SVGF_HD void operator()(const Tile& tile, const Own& own, int tile_column, int tile_row, int thread_x,
                            int thread_y) const {
        const int column = thread_x + Lattice::margin, row = thread_y * rows_per_thread + radius;
        const int x = lattice.x(tile_column, column);
        if (!guides.contains(x, lattice.y(tile_row, row))) return;
        const int upper = row * Lattice::width + column;
        Pixel pixels[rows_per_thread];
        SVGF_UNROLL
        for (int p = 0; p < rows_per_thread; ++p)
            pixels[p].begin(*this, tile, own.gradient[p], upper + p * Lattice::below, x,
                            min(lattice.y(tile_row, row + p), guides.height - 1));
        SVGF_UNROLL
        for (int j = -radius; j < radius + rows_per_thread; ++j) {
            SVGF_UNROLL
            for (int i = -radius; i <= radius; ++i) {
                const int place = upper + j * Lattice::below + i * Lattice::right;
                const Vec4 surface = tile.surface[place];
                Vec4 color[Signals];
                float certainty[Signals];
                SVGF_UNROLL
                for (int s = 0; s < Signals; ++s) {
                    color[s] = tile.color[s][place];
                    certainty[s] = tile.certainty[s][Method::compares_taps ? place : 0];
                }
                SVGF_UNROLL
                for (int p = 0; p < rows_per_thread; ++p)
                    if (j - p >= -radius && j - p <= radius && !(i == 0 && j == p))
                        pixels[p].add(i, j - p, surface, color, certainty);
            }
        }
        SVGF_UNROLL
        for (int p = 0; p < rows_per_thread; ++p)
            if (const int y = lattice.y(tile_row, row + p); y < guides.height)
                pixels[p].finish(*this, tile, upper + p * Lattice::below, guides.pixel(x, y));
    }

private:
    // A pixel and the sums over its taps.
    struct Pixel {
        EdgeWeight<typename Method::Normal> edge;
        float depth_scale[radius + 1][2 * radius + 1];  // by row and column of the taps below; above they are the same
        float light[Signals], weight[Signals];
        float light_scale[Signals];  // of Eq. 5: Published scales the difference, svgf+ its square
        Vec4 sum[Signals];           // as the tile's colours

        SVGF_HD void begin(const Atrous& stage, const Tile& tile, const Gradient& gradient, int place, int x, int y) {
            edge = {tile.surface[place], Storage::Gradients::unpack(gradient), stage.sigma_depth, stage.sigma_normal};
            const float step = float(1 << stage.lattice.level);
            SVGF_UNROLL
            for (int j = 0; j <= radius; ++j)
                SVGF_UNROLL
                for (int i = -radius; i <= radius; ++i)
                    if (j > 0 || i > 0) depth_scale[j][i + radius] = edge.depth_scale(i, j, step);
            float variance[Signals];
            stage.prefilter_variance(tile, place, x, y, variance);
            SVGF_UNROLL
            for (int s = 0; s < Signals; ++s) {
                const Vec4 color = tile.color[s][place];
                constexpr float w = kernel<radius>(0) * kernel<radius>(0);
                light[s] = light_of(color);
                if constexpr (Method::compares_means) {
                    light_scale[s] = stage.certainty(variance[s]);
                } else {
                    light_scale[s] =
                        -log2_e * fast_reciprocal(stage.sigma_luminance * fast_sqrt(variance[s]) + luminance_epsilon);
                }
                weight[s] = w;
                sum[s] = {w * color.x, w * color.y, w * color.z, w * w * color.w};
            }
        }

        // The tap (i, j) steps away [Schied17, Eq. 1, 2].
        SVGF_HD void add(int i, int j, Vec4 surface, const Vec4 (&color)[Signals],
                         [[maybe_unused]] const float (&certainty)[Signals]) {
            const bool above = j < 0 || (j == 0 && i < 0);
            const float w_log = edge(surface, depth_scale[above ? -j : j][(above ? -i : i) + radius],
                                     kernel_log2<radius>(i, j));
            SVGF_UNROLL
            for (int s = 0; s < Signals; ++s) {
                const Vec4 c = color[s];
                const float difference = light_of(c) - light[s];
                float scale = light_scale[s];
                if constexpr (Method::compares_taps) scale = fast_min(scale, certainty[s]);
                const float w = Method::compares_means ? fast_exp2(w_log - square(difference) * scale)
                                                       : fast_exp2(std::fabs(difference) * scale + w_log);
                weight[s] += w;
                sum[s] = {sum[s].x + w * c.x, sum[s].y + w * c.y, sum[s].z + w * c.z, sum[s].w + w * w * c.w};
            }
        }

        SVGF_HD void finish(const Atrous& stage, const Tile& tile, int place, int pixel) const {
            Vec4 result[Signals];
            for (int s = 0; s < Signals; ++s) {
                const bool is_filtered = is_surface(edge.depth);  // else it stays as it is
                const Vec4 mean = is_filtered ? sum[s] : tile.color[s][place];
                const float scale = is_filtered ? fast_reciprocal(weight[s]) : 1.0f;
                result[s] = from_tile({mean.x * scale, mean.y * scale, mean.z * scale,
                                       is_filtered ? mean.w * scale * scale : 0.0f});
            }
            stage.sink(pixel, result);
        }
    };

    // Colours of svgf+ are luminance, red, blue and variance in a tile, so that what is compared is at hand. What that
    // rounds off a dark green beside bright red or blue is below what PackedStorage does.
    static constexpr bool holds_luminance = Method::compares_means;
    SVGF_HD static Vec4 to_tile(Vec4 rgb) {
        return holds_luminance ? Vec4{luminance(rgb.xyz()), rgb.x, rgb.z, rgb.w} : rgb;
    }
    SVGF_HD static Vec4 from_tile(Vec4 c) {
        if constexpr (!holds_luminance) return c;
        const float green = (c.x - luminance({c.y, 0.0f, c.z})) * (1.0f / luminance({0.0f, 1.0f, 0.0f}));
        return {c.y, fast_max(green, 0.0f), c.z, c.w};
    }
    SVGF_HD static float light_of(Vec4 c) { return holds_luminance ? c.x : luminance(c.xyz()); }

    SVGF_HD float certainty(float variance) const {
        return fast_reciprocal((square(sigma_luminance) * ln_2) * variance + square(luminance_epsilon));
    }

    // g_3x3(Var) [Schied17, Eq. 5] around a pixel that stands in the tile's `place`.
    SVGF_HD void prefilter_variance(const Tile& tile, int place, int x, int y, float (&variance)[Signals]) const {
        constexpr bool is_first = PhasesLog2 == 0;
        if (Method::compares_means && !(is_first && has_prefilter)) {
            for (int s = 0; s < Signals; ++s) variance[s] = tile.color[s][place].w;
            return;
        }
        float weight = 0.0f;
        for (int s = 0; s < Signals; ++s) variance[s] = 0.0f;
        SVGF_UNROLL
        for (int j = -1; j <= 1; ++j)
            SVGF_UNROLL
            for (int i = -1; i <= 1; ++i) {
                const float w = gaussian(i) * gaussian(j);
                if constexpr (is_first) {  // they are the level's taps
                    const int tap = place + j * Lattice::below + i * Lattice::right;
                    if (!is_surface(tile.surface[tap].w)) continue;
                    weight += w;
                    for (int s = 0; s < Signals; ++s) variance[s] += w * tile.color[s][tap].w;
                } else {
                    const int tap_x = x + i, tap_y = y + j;
                    if (!guides.contains(tap_x, tap_y)) continue;
                    const int tap = guides.pixel(tap_x, tap_y);
                    if (!is_surface(guides.depth(tap))) continue;
                    weight += w;
                    for (int s = 0; s < Signals; ++s) variance[s] += w * in_color[s].variance(tap);
                }
            }
        for (int s = 0; s < Signals; ++s) variance[s] *= fast_reciprocal(max(weight, 1e-30f));
    }
};

// The sink that keeps the result for the next level.
template <class Storage, int Signals>
struct StoreColor {
    typename Storage::Color out_color[Signals];

    int sink_bytes_per_pixel() const { return Signals * Storage::color_bytes; }

    SVGF_HD void operator()(int pixel, const Vec4 (&color)[Signals]) const {
        for (int s = 0; s < Signals; ++s) out_color[s].store(pixel, color[s]);
    }
};

template <int Signals>
struct EdgeAvoiding {
    FloatStorage::Guides guides;
    Vec4 window;  // left, right, bottom, top of the image one unit ahead of the camera
    int level;
    float sigma_color, sigma_normal, sigma_position;  // sigma_color: of level 0
    FloatStorage::Color in_color[Signals], out_color[Signals];

    int bytes_per_pixel() const { return 16 + Signals * 2 * FloatStorage::color_bytes; }

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y), step = 1 << level;
        const Vec4 p = guides.normal_depth(pixel);
        Vec3 sum[Signals];
        float weight[Signals] = {};
        if (!is_surface(p.w)) {
            for (int s = 0; s < Signals; ++s) out_color[s].store(pixel, in_color[s][pixel]);
            return;
        }
        const Vec3 position = camera_position(x, y, p.w);
        const float color_scale = -square(float(step) / sigma_color);
        const float normal_scale = -1.0f / square(sigma_normal * float(step));
        const float position_scale = -1.0f / square(sigma_position);
        for (int j = -2; j <= 2; ++j)
            for (int i = -2; i <= 2; ++i) {
                const int qx = x + i * step, qy = y + j * step;
                if (!guides.contains(qx, qy)) continue;
                const int tap = guides.pixel(qx, qy);
                const Vec4 q = guides.normal_depth(tap);
                if (!is_surface(q.w)) continue;
                const Vec3 normal_difference = p.xyz() - q.xyz();
                const Vec3 position_difference = position - camera_position(qx, qy, q.w);
                // The centre weighs whole, also where positions are so far off that rounding looks like a distance.
                const float w_log = tap == pixel ? 0.0f
                                                 : normal_scale * dot(normal_difference, normal_difference) +
                                                       position_scale * dot(position_difference, position_difference);
                const float h = kernel<2>(i < 0 ? -i : i) * kernel<2>(j < 0 ? -j : j);
                for (int s = 0; s < Signals; ++s) {
                    const Vec3 c = in_color[s][tap].xyz(), difference = in_color[s][pixel].xyz() - c;
                    const float w = h * fast_exp2(log2_e * (w_log + color_scale * dot(difference, difference)));
                    weight[s] += w;
                    sum[s] += w * c;
                }
            }
        for (int s = 0; s < Signals; ++s) {
            const Vec3 c = sum[s] / weight[s];
            out_color[s].store(pixel, {c.x, c.y, c.z, 0.0f});
        }
    }

private:
    SVGF_HD Vec3 camera_position(int x, int y, float depth) const {
        const float u = window.x + (window.y - window.x) * (float(x) + 0.5f) / float(guides.width);
        const float v = window.w + (window.z - window.w) * (float(y) + 0.5f) / float(guides.height);
        return {u * depth, v * depth, -depth};
    }
};

}  // namespace svgf
