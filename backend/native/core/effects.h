// SPDX-License-Identifier: Apache-2.0
// What a scene calls for; the bits are those of svgf.Effects, which documents each.
#pragma once

#include <cstdint>

#include "core/platform.h"

namespace svgf {

enum class Effects : std::uint32_t {
    none = 0,
    textures = 1u << 0,
    specular = 1u << 1,
    transmission = 1u << 2,
    mesh_lights = 1u << 3,
    delta_lights = 1u << 4,
    area_lights = 1u << 5,
    environment = 1u << 6,
    camera_motion = 1u << 7,
    object_motion = 1u << 8,
    deformation = 1u << 9,
    alpha = 1u << 10,
    normal_maps = 1u << 11,
    coat = 1u << 12,
    sheen = 1u << 13,
    anisotropy = 1u << 14,
    material_mixes = 1u << 15,
    environment_map = 1u << 16,
    depth_of_field = 1u << 17,
    ray_visibility = 1u << 18,
    light_path_limits = 1u << 19,
    many_lights = 1u << 20,
    perfect_specular = 1u << 21,
    all = (1u << 22) - 1,
};

SVGF_HD constexpr Effects operator|(Effects a, Effects b) { return Effects(std::uint32_t(a) | std::uint32_t(b)); }
SVGF_HD constexpr Effects operator&(Effects a, Effects b) { return Effects(std::uint32_t(a) & std::uint32_t(b)); }
SVGF_HD constexpr Effects without(Effects a, Effects b) { return Effects(std::uint32_t(a) & ~std::uint32_t(b)); }

// Whether a kernel compiled for `kernel` simulates all of `scene`.
SVGF_HD constexpr bool covers(Effects kernel, Effects scene) { return (kernel & scene) == scene; }

}  // namespace svgf
