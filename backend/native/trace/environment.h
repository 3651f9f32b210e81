// SPDX-License-Identifier: Apache-2.0
// The world as an image: its radiance, and directions sampled by it.
//
// Directions are sampled by a piecewise constant density, rows and then columns of an equirectangular map. It is
// lowered by its mean and cut off at zero ("MIS compensation" [Karlik19]): what is left to rays that run into the sky
// anyway is not sampled twice.
#pragma once

#include "core/approximate.h"
#include "core/vec.h"
#include "scene/flat_scene.h"
#include "trace/texture.h"

namespace svgf {

SVGF_HD inline Vec3 rotate(const Vec3 (&rows)[3], Vec3 v) {
    return {dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)};
}

// Blender's equirectangular map. direction: unit, in the environment's space.
SVGF_HD inline Vec2 equirectangular_uv(Vec3 direction) {
    return {0.5f - std::atan2(direction.y, direction.x) / (2.0f * pi),
            0.5f + std::atan2(direction.z, std::sqrt(direction.x * direction.x + direction.y * direction.y)) / pi};
}

SVGF_HD SVGF_NOINLINE inline Vec3 sample_environment_image(const SceneView& scene, std::int32_t texture,
                                                           Vec3 direction) {
    const Vec2 uv = equirectangular_uv(rotate(scene.world.to_environment, direction));
    return sample_texture(scene.textures[texture], uv).xyz();
}

SVGF_HD inline Vec3 environment_radiance(const SceneView& scene, Vec3 direction, bool is_backdrop = false) {
    const WorldView& world = scene.world;
    const Vec3 radiance = is_backdrop ? world.backdrop_radiance : world.radiance;
    const std::int32_t texture = is_backdrop ? world.backdrop_texture : world.texture;
    return texture < 0 ? radiance : radiance * sample_environment_image(scene, texture, direction);
}

// The i with cdf[i] <= u < cdf[i + 1], of `count` intervals. u becomes the place within it, in [0, 1).
SVGF_HD inline int choose_interval(const float* cdf, int count, float& u) {
    // Halves what is left without a branch: which half is chance.
    int low = 0;
    for (int left = count; left > 1;) {
        const int half = left / 2;
        low = cdf[low + half] <= u ? low + half : low;
        left -= half;
    }
    const float width = cdf[low + 1] - cdf[low];
    u = width > 0.0f ? clamp(fast_quotient(u - cdf[low], width), 0.0f, 0x1.fffffep-1f) : 0.0f;
    return low;
}

// Density per solid angle of a cell, given the cosine of its direction's elevation.
SVGF_HD inline float environment_cell_density(const WorldView& world, int row, int column, float cos_elevation) {
    const float* columns = world.column_cdf + row * (world.columns + 1);
    const float probability = (world.row_cdf[row + 1] - world.row_cdf[row]) * (columns[column + 1] - columns[column]);
    const float cells = float(world.rows) * float(world.columns);
    return cos_elevation > 0.0f ? fast_quotient(probability * cells, 2.0f * pi * pi * cos_elevation) : 0.0f;
}

// With which sample_environment finds a unit direction.
SVGF_HD SVGF_NOINLINE inline float environment_density(const WorldView& world, Vec3 direction) {
    const Vec3 local = rotate(world.to_environment, direction);
    const Vec2 uv = equirectangular_uv(local);
    return environment_cell_density(world, clamp(int(uv.y * float(world.rows)), 0, world.rows - 1),
                                    clamp(int(uv.x * float(world.columns)), 0, world.columns - 1),
                                    std::sqrt(local.x * local.x + local.y * local.y));
}

// Returns a unit direction and sets its density.
SVGF_HD SVGF_NOINLINE inline Vec3 sample_environment(const WorldView& world, Vec2 u, float& density) {
    const int row = choose_interval(world.row_cdf, world.rows, u.y);
    const int column = choose_interval(world.column_cdf + row * (world.columns + 1), world.columns, u.x);
    const float elevation = ((float(row) + u.y) / float(world.rows) - 0.5f) * pi;
    const float azimuth = (0.5f - (float(column) + u.x) / float(world.columns)) * (2.0f * pi);
    const float cosine = std::cos(elevation);
    density = environment_cell_density(world, row, column, cosine);
    const Vec3 local{cosine * std::cos(azimuth), cosine * std::sin(azimuth), std::sin(elevation)};
    // The inverse of a rotation is its transpose.
    return normalize(world.to_environment[0] * local.x + world.to_environment[1] * local.y +
                     world.to_environment[2] * local.z);
}

}  // namespace svgf
