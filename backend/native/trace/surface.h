// SPDX-License-Identifier: Apache-2.0
// The point, normals and material where a ray hit.
#pragma once

#include "core/load.h"
#include "core/vec.h"
#include "scene/flat_scene.h"
#include "trace/intersect.h"
#include "trace/layers.h"
#include "trace/microfacet.h"
#include "trace/texture.h"

namespace svgf {

struct Surface {
    Vec3 position;
    Vec3 geometric_normal, shading_normal;  // unit, outside of the mesh
    Vec3 smooth_normal;                     // shading_normal without the normal map; only with normal maps
    Vec3 tangent;                           // of anisotropy, of any length; only with anisotropy
    float clearance;                        // see offset_from_surface
    float terminator_offset = 0.0f;         // of a triangle with smooth normals, see trace/shadow_terminator.h
    std::int32_t material_index;            // in the mesh's slot; `material` may be a part of it
    Material material;                      // with the values of its maps
    float weight = 1.0f;                    // of all that the material does, as a part of the one in the slot
    // What a ray that goes straight on is multiplied by if this hit lets it pass, else 0: then neither Bsdf nor its
    // samples count. By Cycles' rules that is a transparent bounce.
    Vec3 straight;
    Vec3 emission;  // towards the viewer
};

// Unit vector for any length, also where its square would vanish or overflow.
SVGF_HD inline Vec3 normalize_any_length(Vec3 v) {
    const float squared = dot(v, v);
    if (squared > 1e-30f && squared < 1e30f) return v * fast_reciprocal_sqrt(squared);
    const float size = max_component(abs(v));
    return size > 0.0f ? normalize(v * (1.0f / size)) : v;
}

// Below 1, whatever rounding a division brings.
constexpr float largest_choice = 1.0f - 1.0f / 16777216.0f;

SVGF_HD inline Vec3 interpolate(const Vec3 (&corner)[3], const Hit& hit) {
    return corner[0] + (corner[1] - corner[0]) * hit.weight1 + (corner[2] - corner[0]) * hit.weight2;
}

SVGF_HD inline Vec2 interpolate_uv(const MeshView& mesh, std::int32_t layer, const Hit& hit) {
    if (layer >= mesh.uv_layers) return {};
    const CornerUvs& uvs = mesh.uvs[layer * mesh.triangle_count + hit.leaf_triangle];
    return uvs.corner[0] + (uvs.corner[1] - uvs.corner[0]) * hit.weight1 +
           (uvs.corner[2] - uvs.corner[0]) * hit.weight2;
}

// Gives an input of a material the value of a texel. Shares stay shares, whatever an image holds: a surface reflects no
// more than it gets.
SVGF_HD inline void set_input(Material& material, MaterialInput input, Vec4 texel, std::int32_t channel) {
    const float value = channel_of(texel, channel);
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

// uv: of the map's layer.
SVGF_HD inline Vec2 transform_uv(const MaterialMap& map, Vec2 uv) {
    const float* m = map.uv_transform;
    return {m[0] * uv.x + m[1] * uv.y + m[2], m[3] * uv.x + m[4] * uv.y + m[5]};
}

SVGF_HD inline Vec2 map_uv(const MeshView& mesh, const MaterialMap& map, const Hit& hit) {
    return transform_uv(map, interpolate_uv(mesh, map.uv_layer, hit));
}

SVGF_HD inline void prefetch_maps([[maybe_unused]] const SceneView& scene, [[maybe_unused]] const MeshView& mesh,
                                  [[maybe_unused]] const Hit& hit, [[maybe_unused]] const Material& material) {
#if !defined(__CUDACC__)
    for (std::int32_t i = 0; i < material.map_count; ++i) {
        const MaterialMap& map = scene.material_maps[material.map_start + i];
        if (map.same_texel == 0) prefetch_texture(scene.textures[map.texture], map_uv(mesh, map, hit));
    }
#endif
}

SVGF_HD inline void apply_maps(const SceneView& scene, const MeshView& mesh, const Hit& hit, Material& material) {
    Vec4 texel;
    Vec2 uv;
    std::int32_t uv_layer = -1;  // that uv is of
    SVGF_NO_UNROLL
    for (std::int32_t i = 0; i < material.map_count; ++i) {
        const MaterialMap map = load(scene.material_maps + material.map_start + i);
        if (map.uv_layer != uv_layer) uv = interpolate_uv(mesh, uv_layer = map.uv_layer, hit);
        if (map.same_texel == 0) texel = sample_texture(load(scene.textures + map.texture), transform_uv(map, uv));
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
    return roundings * (fast_quotient(object, normal_scale) +
                        dot(world + abs(translation(to_world)), abs(geometric_normal)));
}

// Where a ray leaves a surface point, on the side of its direction.
SVGF_HD inline Vec3 offset_from_surface(const Surface& surface, Vec3 direction) {
    const bool below = dot(surface.geometric_normal, direction) < 0;
    return surface.position + surface.geometric_normal * (below ? -surface.clearance : surface.clearance);
}

// Direction of the U axis of a UV layer in object space, of any length, and whether V is to its left as seen from the
// front. 0 where the layer does not say.
struct UvAxes {
    Vec3 tangent;
    bool mirrored = false;
};

SVGF_HD inline UvAxes find_uv_axes(const MeshView& mesh, std::int32_t layer, const Hit& hit, Vec3 edge1, Vec3 edge2) {
    if (layer < 0 || layer >= mesh.uv_layers) return {};
    const CornerUvs& uvs = mesh.uvs[layer * mesh.triangle_count + hit.leaf_triangle];
    const Vec2 uv1 = uvs.corner[1] - uvs.corner[0], uv2 = uvs.corner[2] - uvs.corner[0];
    const float area = uv1.x * uv2.y - uv2.x * uv1.y;
    const Vec3 along = edge1 * uv2.y - edge2 * uv1.y;
    if (area == 0.0f) return {};
    return {area > 0.0f ? along : -along, area < 0.0f};
}

// The mesh's own tangent of a UV layer, with the side of V; 0 where it has none.
SVGF_HD inline Vec4 find_mesh_tangent(const MeshView& mesh, std::int32_t layer, const Hit& hit) {
    if (!mesh.tangents || layer != mesh.tangent_layer) return {};
    const CornerTangents tangents = load(mesh.tangents + hit.leaf_triangle);
    return tangents.corner[0] * (1.0f - hit.weight1 - hit.weight2) + tangents.corner[1] * hit.weight1 +
           tangents.corner[2] * hit.weight2;
}

// What a normal map is relative to, in object space. normal: interpolated, of any length. With tangents of the mesh's
// own, all three stay as they are interpolated [Mikkelsen08]; that of a triangle is made perpendicular to the normal.
struct NormalMapAxes {
    Vec3 tangent, bitangent, normal;

    SVGF_HD NormalMapAxes(const MeshView& mesh, std::int32_t layer, const Hit& hit, Vec3 edge1, Vec3 edge2,
                          Vec3 object_normal)
        : normal(object_normal) {
        const Vec4 own = find_mesh_tangent(mesh, layer, hit);
        tangent = own.xyz();
        float side = own.w;
        if (!(max_component(abs(tangent)) > 0.0f)) {
            const UvAxes axes = find_uv_axes(mesh, layer, hit, edge1, edge2);
            normal = normalize_any_length(object_normal);
            tangent = normalize_any_length(axes.tangent - normal * dot(normal, axes.tangent));
            side = axes.mirrored ? -1.0f : 1.0f;
        }
        bitangent = cross(normal, tangent) * side;
    }
};

// Turns the shading normal by the normal map.
SVGF_HD inline void apply_normal_map(const Instance& instance, const NormalMapAxes& axes, Surface& surface) {
    const Material& material = surface.material;
    if (!(max_component(abs(axes.tangent)) > 0.0f)) return;
    const float x = (2.0f * material.normal.x - 1.0f) * material.normal_strength;
    const float y = (2.0f * material.normal.y - 1.0f) * material.normal_strength;
    const float z = lerp(1.0f, 2.0f * material.normal.z - 1.0f, saturate(material.normal_strength));
    const Vec3 mapped = transform_normal(instance.world_to_object,
                                         axes.tangent * x + axes.bitangent * y + axes.normal * z);
    if (is_finite(mapped) && max_component(abs(mapped)) > 0.0f) surface.shading_normal = normalize_any_length(mapped);
}

// Tangent of anisotropy: that of a UV layer, or without one Blender's default, circles around the object's Z axis
// through the middle of its box.
SVGF_HD inline Vec3 find_tangent(const MeshView& mesh, const Hit& hit, const LeafTriangle& triangle,
                                 const Instance& instance, const Mat34& to_world, Vec3 object_position,
                                 std::int32_t layer) {
    const Vec3 own = find_mesh_tangent(mesh, layer, hit).xyz();
    if (max_component(abs(own)) > 0.0f) return transform_vector(to_world, own);
    const UvAxes axes = find_uv_axes(mesh, layer, hit, triangle.vertex1 - triangle.vertex0,
                                     triangle.vertex2 - triangle.vertex0);
    if (max_component(abs(axes.tangent)) > 0.0f) return transform_vector(to_world, axes.tangent);
    const Vec3 around{(mesh.box_middle.y - object_position.y) * mesh.box_scale.y,
                      (object_position.x - mesh.box_middle.x) * mesh.box_scale.x, 0.0f};
    return transform_normal(instance.world_to_object, around);
}

// Share of the second part of a mix.
SVGF_HD inline float find_factor(const Material& material, Vec3 normal, Vec3 geometric_normal, Vec3 view) {
    const float cosine = std::fabs(dot(normal, view));
    if (material.factor_fresnel_ior > 0.0f) {
        const float ior = max(material.factor_fresnel_ior, smallest_ior);
        return fresnel_dielectric(cosine, dot(geometric_normal, view) > 0.0f ? ior : 1.0f / ior);
    }
    if (material.factor_facing_blend >= 0.0f) {
        const float blend = min(material.factor_facing_blend, 1.0f - 1e-5f);
        return 1.0f - std::pow(cosine, blend < 0.5f ? 2.0f * blend : 0.5f / (1.0f - blend));
    }
    return material.factor;
}

// The material at a hit with the values of its maps. Of a mix, one part is chosen with its share as probability, of a
// sum each with one half and twice its weight. choice: in [0, 1); what is left of it when all is chosen is left in it.
template <Effects kernel>
SVGF_HD void find_material(const SceneView& scene, const MeshView& mesh, const Hit& hit, Vec3 view, Surface& surface,
                           float& choice) {
    std::int32_t index = surface.material_index;
    for (int depth = 0;; ++depth) {
        surface.material = load(scene.materials + index);
        if constexpr (covers(kernel, Effects::textures)) apply_maps(scene, mesh, hit, surface.material);
        if constexpr (!covers(kernel, Effects::material_mixes)) return;
        if (!is_mix(surface.material.kind) || depth > deepest_mix) return;
        const bool is_sum = surface.material.kind == MaterialKind::add;
        const float share =
            is_sum ? 0.5f : find_factor(surface.material, surface.shading_normal, surface.geometric_normal, view);
        const bool second = choice < share;
        choice = second ? fast_quotient(choice, share) : fast_quotient(choice - share, 1.0f - share);
        choice = min(choice, largest_choice);
        index = second ? surface.material.second : surface.material.first;
        if (is_sum) surface.weight *= 2.0f;
    }
}

// Share of a material that lets light straight through, and its tint.
struct Opacity {
    float opacity;
    Vec3 tint;
};

SVGF_HD inline Opacity find_opacity(const Material& material) {
    if (material.kind == MaterialKind::transparent) return {0.0f, material.base_color};
    return {material.kind == MaterialKind::principled ? material.alpha : 1.0f, {1, 1, 1}};
}

// view: unit, towards where the ray came from. choice: uniform in [0, 1), of the part of a mix and of passing straight.
template <Effects kernel>
SVGF_HD Surface find_surface(const SceneView& scene, const Hit& hit, Vec3 view, float choice) {
    const Instance& instance = load(scene.instances + hit.instance);
    const Mat34& to_world = scene.placements[hit.instance].object_to_world;
    const MeshView& mesh = scene.meshes[instance.mesh];
    const LeafTriangle triangle = load(mesh.triangles + hit.leaf_triangle);
    const Vec3 edge1 = triangle.vertex1 - triangle.vertex0, edge2 = triangle.vertex2 - triangle.vertex0;

    const std::int32_t slot = scene.material_table[instance.material_start + triangle.material_slot];
    if constexpr (covers(kernel, Effects::textures)) prefetch_maps(scene, mesh, hit, scene.materials[slot]);

    Surface surface;
    // From the weights: nearer to the triangle than origin + t * direction.
    const Vec3 object_position = triangle.vertex0 + edge1 * hit.weight1 + edge2 * hit.weight2;
    surface.position = transform_point(to_world, object_position);
    const Vec3 face_normal = normalize_any_length(accurate_cross(edge1, edge2));
    const Vec3 scaled_normal = transform_normal(instance.world_to_object, face_normal);
    surface.geometric_normal = normalize_any_length(scaled_normal);
    surface.clearance = find_clearance(triangle, instance.world_to_object, to_world, surface.geometric_normal,
                                       length(scaled_normal));
    surface.shading_normal = surface.geometric_normal;
    Vec3 object_normal = face_normal;
    if (mesh.normals) {
        const Vec3 normal = interpolate(load(mesh.normals + hit.leaf_triangle).corner, hit);
        // Shorter ones are corners that have none, or that cancel.
        if (max_component(abs(normal)) > 1e-6f) {
            object_normal = normal;
            surface.shading_normal = normalize_any_length(transform_normal(instance.world_to_object, normal));
            if (scene.terminator_offsets) surface.terminator_offset = scene.terminator_offsets[hit.instance];
        }
    }
    surface.material_index = slot;
    find_material<kernel>(scene, mesh, hit, view, surface, choice);
    const Material& material = surface.material;
    if constexpr (covers(kernel, Effects::normal_maps)) {
        surface.smooth_normal = surface.shading_normal;
        if (material.normal_uv_layer >= 0)
            apply_normal_map(instance, {mesh, material.normal_uv_layer, hit, edge1, edge2, object_normal}, surface);
    }
    if constexpr (covers(kernel, Effects::anisotropy))
        if (material.anisotropic != 0.0f)
            surface.tangent = find_tangent(mesh, hit, triangle, instance, to_world, object_position,
                                           material.tangent_uv_layer);
    surface.emission = material.emission;
    if constexpr (covers(kernel, Effects::coat) || covers(kernel, Effects::sheen))
        if (max_component(surface.emission) > 0.0f && material.kind == MaterialKind::principled) {
            const float cos_view = std::fabs(dot(surface.shading_normal, view));
            float cos_coat = cos_view;
            if constexpr (covers(kernel, Effects::normal_maps))
                if (has_smooth_coat_normal(material)) cos_coat = std::fabs(dot(surface.smooth_normal, view));
            const Layers<kernel> layers(scene.albedo_tables, material, cos_view, cos_coat);
            surface.emission = surface.emission * layers.below;
        }
    if constexpr (covers(kernel, Effects::alpha)) {
        const Opacity found = find_opacity(material);
        surface.emission *= found.opacity;
        if (choice >= found.opacity) surface.straight = found.tint * surface.weight;
    }
    if constexpr (covers(kernel, Effects::material_mixes)) {
        surface.emission *= surface.weight;
        // Of a mix of lamps that paths aim at: all of it, always.
        const Material& whole = scene.materials[slot];
        if (is_mix(whole.kind) && max_component(whole.light_emission) > 0.0f) surface.emission = whole.light_emission;
    }
    return surface;
}

// What is left of light that goes straight through a hit, on the mean over choice: of a shadow ray.
template <Effects kernel>
SVGF_HD Vec3 find_transmittance(const SceneView& scene, const Hit& hit, Vec3 view, float choice) {
    if constexpr (!covers(kernel, Effects::alpha)) return {};
    // Normals are needed for factors by Fresnel's term and by facing.
    Surface surface = covers(kernel, Effects::material_mixes) ? find_surface<kernel>(scene, hit, view, choice) : Surface{};
    if constexpr (!covers(kernel, Effects::material_mixes)) {
        const Instance& instance = scene.instances[hit.instance];
        const MeshView& mesh = scene.meshes[instance.mesh];
        surface.material_index =
            scene.material_table[instance.material_start + mesh.triangles[hit.leaf_triangle].material_slot];
        find_material<kernel>(scene, mesh, hit, view, surface, choice);
    }
    const Opacity found = find_opacity(surface.material);
    return found.tint * ((1.0f - found.opacity) * surface.weight);
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
