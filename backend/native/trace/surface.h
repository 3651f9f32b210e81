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
    Material material;  // with the texture's base colour
};

// Unit vector for any length, also where its square would vanish or overflow.
SVGF_HD inline Vec3 normalize_any_length(Vec3 v) {
    const float size = max_component(abs(v));
    return size > 0.0f ? normalize(v * (1.0f / size)) : v;
}

SVGF_HD inline Vec3 interpolate(const Vec3 (&corner)[3], const Hit& hit) {
    return corner[0] + (corner[1] - corner[0]) * hit.weight1 + (corner[2] - corner[0]) * hit.weight2;
}

SVGF_HD inline Vec3 sample_base_color(const SceneView& scene, const MeshView& mesh, const Material& material,
                                      const Hit& hit) {
    if (!(material.base_color_texture >= 0.0f)) return material.base_color;
    Vec2 uv;
    if (mesh.uvs) {
        const CornerUvs& uvs = mesh.uvs[hit.leaf_triangle];
        uv = uvs.corner[0] + (uvs.corner[1] - uvs.corner[0]) * hit.weight1 +
             (uvs.corner[2] - uvs.corner[0]) * hit.weight2;
    }
    // A surface reflects no more than it gets, whatever an image holds.
    return min(sample_texture(scene.textures[int(material.base_color_texture)], uv), Vec3{1, 1, 1});
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
    surface.material.base_color = sample_base_color(scene, mesh, surface.material, hit);
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
