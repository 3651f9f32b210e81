// SPDX-License-Identifier: Apache-2.0
// The point, normals and material where a ray hit.
#pragma once

#include "core/load.h"
#include "core/vec.h"
#include "scene/flat_scene.h"
#include "trace/intersect.h"
#include "trace/texture.h"

namespace svgf {

struct Surface {
    Vec3 position;
    Vec3 geometric_normal, shading_normal;  // unit, outside of the mesh
    float clearance;                        // see offset_from_surface
    std::int32_t material_index;
    Material material;  // with the values of its maps
};

// Unit vector for any length, also where its square would vanish or overflow.
SVGF_HD inline Vec3 normalize_any_length(Vec3 v) {
    const float size = max_component(abs(v));
    return size > 0.0f ? normalize(v * (1.0f / size)) : v;
}

SVGF_HD inline Vec3 interpolate(const Vec3 (&corner)[3], const Hit& hit) {
    return corner[0] + (corner[1] - corner[0]) * hit.weight1 + (corner[2] - corner[0]) * hit.weight2;
}

SVGF_HD inline Vec2 interpolate_uv(const MeshView& mesh, std::int32_t layer, const Hit& hit) {
    if (layer >= mesh.uv_layers) return {};
    const CornerUvs& uvs = mesh.uvs[layer * mesh.triangle_count + hit.leaf_triangle];
    return uvs.corner[0] + (uvs.corner[1] - uvs.corner[0]) * hit.weight1 + (uvs.corner[2] - uvs.corner[0]) * hit.weight2;
}

// Gives an input of a material the value of a texel. Shares stay shares, whatever an image holds: a surface reflects no
// more than it gets.
SVGF_HD inline void set_input(Material& material, MaterialInput input, Vec4 texel, std::int32_t channel) {
    const float value = channel <= 0 ? texel.x : channel == 1 ? texel.y : channel == 2 ? texel.z : texel.w;
    const float share = saturate(value);
    const Vec3 color = min(texel.xyz(), Vec3{1, 1, 1});
    switch (input) {
        case MaterialInput::base_color: material.base_color = color; break;
        case MaterialInput::specular_tint: material.specular_tint = color; break;
        case MaterialInput::coat_tint: material.coat_tint = color; break;
        case MaterialInput::sheen_tint: material.sheen_tint = color; break;
        case MaterialInput::normal: material.normal = texel.xyz(); break;
        case MaterialInput::emission: material.emission *= texel.xyz(); break;
        case MaterialInput::ior: material.ior = clamp(value, smallest_ior, largest_ior); break;
        case MaterialInput::coat_ior: material.coat_ior = clamp(value, smallest_ior, largest_ior); break;
        case MaterialInput::specular_ior_level: material.specular_ior_level = value; break;
        case MaterialInput::normal_strength: material.normal_strength = value; break;
        case MaterialInput::metallic: material.metallic = share; break;
        case MaterialInput::roughness: material.roughness = share; break;
        case MaterialInput::transmission: material.transmission = share; break;
        case MaterialInput::alpha: material.alpha = share; break;
        case MaterialInput::diffuse_roughness: material.diffuse_roughness = share; break;
        case MaterialInput::anisotropic: material.anisotropic = share; break;
        case MaterialInput::anisotropic_rotation: material.anisotropic_rotation = share; break;
        case MaterialInput::coat_weight: material.coat_weight = share; break;
        case MaterialInput::coat_roughness: material.coat_roughness = share; break;
        case MaterialInput::sheen_weight: material.sheen_weight = share; break;
        case MaterialInput::sheen_roughness: material.sheen_roughness = share; break;
        case MaterialInput::factor: material.factor = share; break;
    }
}

// The one place where materials read images.
SVGF_HD inline void apply_maps(const SceneView& scene, const MeshView& mesh, const Hit& hit, Material& material) {
    SVGF_NO_UNROLL
    for (std::int32_t i = 0; i < material.map_count; ++i) {
        const MaterialMap& map = scene.material_maps[material.map_start + i];
        const Vec2 uv = interpolate_uv(mesh, map.uv_layer, hit);
        const float* m = map.uv_transform;
        const Vec4 texel = sample_texture(scene.textures[map.texture], {m[0] * uv.x + m[1] * uv.y + m[2],
                                                                        m[3] * uv.x + m[4] * uv.y + m[5]});
        set_input(material, map.input, texel, map.channel);
    }
}

// How far off a triangle its rays must start so as not to hit it again: the roundings of the hit point and of the
// next test, along the normal. Relative to the coordinates that take part, as in [Wachter19], but to all of them: the
// triangle test rounds relative to the whole triangle in object space, in whatever direction, and a transform
// relative to its terms, not to their sum. normal_scale: world units along the normal per object unit, inverted.
SVGF_HD inline float find_clearance(const LeafTriangle& triangle, const Mat34& to_object, const Mat34& to_world,
                                    Vec3 geometric_normal, float normal_scale) {
    constexpr float roundings = 16.0f / 16777216.0f;
    const Vec3 extent = max(abs(triangle.vertex0), max(abs(triangle.vertex1), abs(triangle.vertex2)));
    const Vec3 world{dot(abs(to_world.row[0].xyz()), extent), dot(abs(to_world.row[1].xyz()), extent),
                     dot(abs(to_world.row[2].xyz()), extent)};
    const float object = max_component(extent + abs(translation(to_object)));
    return roundings * (object / normal_scale + dot(world + abs(translation(to_world)), abs(geometric_normal)));
}

// Where a ray leaves a surface point, on the side of its direction.
SVGF_HD inline Vec3 offset_from_surface(const Surface& surface, Vec3 direction) {
    const bool below = dot(surface.geometric_normal, direction) < 0;
    return surface.position + surface.geometric_normal * (below ? -surface.clearance : surface.clearance);
}

SVGF_HD inline Surface find_surface(const SceneView& scene, const Hit& hit) {
    const Instance& instance = scene.instances[hit.instance];
    const Mat34& to_world = scene.placements[hit.instance].object_to_world;
    const MeshView& mesh = scene.meshes[instance.mesh];
    const LeafTriangle triangle = load(mesh.triangles + hit.leaf_triangle);
    const Vec3 edge1 = triangle.vertex1 - triangle.vertex0, edge2 = triangle.vertex2 - triangle.vertex0;

    Surface surface;
    // From the weights: nearer to the triangle than origin + t * direction.
    surface.position = transform_point(to_world, triangle.vertex0 + edge1 * hit.weight1 + edge2 * hit.weight2);
    const Vec3 face_normal = normalize_any_length(accurate_cross(edge1, edge2));
    const Vec3 scaled_normal = transform_normal(instance.world_to_object, face_normal);
    surface.geometric_normal = normalize_any_length(scaled_normal);
    surface.clearance = find_clearance(triangle, instance.world_to_object, to_world, surface.geometric_normal,
                                       length(scaled_normal));
    surface.shading_normal = surface.geometric_normal;
    if (mesh.normals) {
        const Vec3 normal = interpolate(mesh.normals[hit.leaf_triangle].corner, hit);
        // Shorter ones are corners that have none, or that cancel.
        if (max_component(abs(normal)) > 1e-6f)
            surface.shading_normal = normalize_any_length(transform_normal(instance.world_to_object, normal));
    }
    surface.material_index = scene.material_table[instance.material_start + triangle.material_slot];
    surface.material = load(scene.materials + surface.material_index);
    apply_maps(scene, mesh, hit, surface.material);
    return surface;
}

// Whether the point that was hit may have been elsewhere at the previous frame.
SVGF_HD inline bool is_moving(const SceneView& scene, const Hit& hit) {
    if (scene.meshes[scene.instances[hit.instance].mesh].previous_positions) return true;
    const Placement& placement = scene.placements[hit.instance];
    for (int i = 0; i < 3; ++i) {
        const Vec4 now = placement.object_to_world.row[i], before = placement.previous_object_to_world.row[i];
        if (now.x != before.x || now.y != before.y || now.z != before.z || now.w != before.w) return true;
    }
    return false;
}

// Where the point that was hit was at the previous frame.
SVGF_HD inline Vec3 find_previous_position(const SceneView& scene, const Hit& hit) {
    const MeshView& mesh = scene.meshes[scene.instances[hit.instance].mesh];
    Vec3 position;
    if (mesh.previous_positions) {
        position = interpolate(mesh.previous_positions[hit.leaf_triangle].vertex, hit);
    } else {
        const LeafTriangle& triangle = mesh.triangles[hit.leaf_triangle];
        position = triangle.vertex0 + (triangle.vertex1 - triangle.vertex0) * hit.weight1 +
                   (triangle.vertex2 - triangle.vertex0) * hit.weight2;
    }
    return transform_point(scene.placements[hit.instance].previous_object_to_world, position);
}

}  // namespace svgf
