// SPDX-License-Identifier: Apache-2.0
// The shadow terminator of coarse meshes with smooth normals. Their triangles lie below the surface that the normals
// describe: where light grazes it, triangles shadow themselves and their neighbours, in dark steps. Rays to lights that
// graze an object therefore start above it, on a patch that its corner normals span over the triangle [Hanika21], as
// in Cycles, whose objects say from which angle on ("Geometry Offset", a cosine). Its patch is half of a quadratic one,
// which is exact for a sphere, and nowhere lower than the tangent planes of the corners, each lifted until no other
// corner is above it. Which side of the surface a light is on then follows from the smooth normal alone.
//
// The patch is found in object space and carried into the world as its points are. Cycles does so with instances;
// meshes with one user it transforms first, and where that stretches them, its patch is another one. Without an offset,
// light behind a triangle is none for it, where Cycles lets it through open meshes.
#pragma once

#include "core/effects.h"
#include "core/load.h"
#include "core/vec.h"
#include "scene/flat_scene.h"
#include "trace/intersect.h"
#include "trace/surface.h"

namespace svgf {

// Outside of the mesh.
template <Effects kernel>
SVGF_HD Vec3 smooth_normal_of(const Surface& surface) {
    if constexpr (covers(kernel, Effects::normal_maps)) return surface.smooth_normal;
    return surface.shading_normal;
}

// Cosine of a light with the normal that tells the sides of the surface apart; that of the viewer is positive.
// geometric_normal: on that side.
template <Effects kernel>
SVGF_HD float find_light_side(const Surface& surface, Vec3 geometric_normal, Vec3 light) {
    if (!(surface.terminator_offset > 0.0f)) return dot(geometric_normal, light);
    const Vec3 normal = smooth_normal_of<kernel>(surface);
    const float cosine = dot(normal, light);
    return dot(normal, geometric_normal) < 0.0f ? -cosine : cosine;
}

// Share of the patch's height at which a ray to a light starts. Cosines with the light: of the smooth normal, >= 0, and
// of the geometric one on the same side.
SVGF_HD inline float terminator_share(float cos_smooth, float cos_geometric, float terminator_offset) {
    const float near = cos_smooth < terminator_offset
                           ? 2.0f - fast_quotient(cos_geometric + cos_smooth, terminator_offset)
                           : 1.0f - fast_quotient(cos_geometric, terminator_offset);
    return saturate(near);
}

// Height of the patch over a point of a triangle in units of the interpolated normal. normals: unit, on the side of the
// light. weights: of the corners.
SVGF_HD inline float patch_height(Vec3 edge01, Vec3 edge02, const Vec3 (&normals)[3], Vec3 weights) {
    const Vec3 edge12 = edge02 - edge01;
    // How far corner j is above the tangent plane of corner i.
    const float at01 = dot(edge01, normals[0]), at02 = dot(edge02, normals[0]);
    const float at10 = -dot(edge01, normals[1]), at12 = dot(edge12, normals[1]);
    const float at20 = -dot(edge02, normals[2]), at21 = -dot(edge12, normals[2]);
    const float quadratic = -(weights.x * weights.y * (at01 + at10) + weights.x * weights.z * (at02 + at20) +
                              weights.y * weights.z * (at12 + at21));
    const float tangent0 = max(max(at01, at02), 0.0f) - weights.y * at01 - weights.z * at02;
    const float tangent1 = max(max(at10, at12), 0.0f) - weights.x * at10 - weights.z * at12;
    const float tangent2 = max(max(at20, at21), 0.0f) - weights.x * at20 - weights.y * at21;
    return max(max(min(min(tangent0, tangent1), tangent2), 0.0f), 0.5f * quadratic);
}

// From a point of a triangle to the patch, in the world. outwards: the geometric normal on the side of the light.
SVGF_HD inline Vec3 find_patch_offset(const SceneView& scene, const Hit& hit, Vec3 outwards) {
    const MeshView& mesh = scene.meshes[scene.instances[hit.instance].mesh];
    const LeafTriangle triangle = load(mesh.triangles + hit.leaf_triangle);
    CornerNormals normals = load(mesh.normals + hit.leaf_triangle);
    Vec3 along = transform_vector(scene.placements[hit.instance].object_to_world, interpolate(normals.corner, hit));
    if (dot(along, outwards) < 0.0f) {
        along = -along;
        for (Vec3& normal : normals.corner) normal = -normal;
    }
    const Vec3 weights{1.0f - hit.weight1 - hit.weight2, hit.weight1, hit.weight2};
    const Vec3 offset = along * patch_height(triangle.vertex1 - triangle.vertex0, triangle.vertex2 - triangle.vertex0,
                                             normals.corner, weights);
    return is_finite(offset) ? offset : Vec3{};
}

// Where a ray to a light starts.
template <Effects kernel>
SVGF_HD Vec3 find_shadow_origin(const SceneView& scene, const Surface& surface, const Hit& hit, Vec3 light) {
    if (!(surface.terminator_offset > 0.0f)) return offset_from_surface(surface, light);
    const Vec3 normal = smooth_normal_of<kernel>(surface);
    const float cosine = dot(normal, light);
    const Vec3 outwards =
        cosine * dot(normal, surface.geometric_normal) < 0.0f ? -surface.geometric_normal : surface.geometric_normal;
    const Vec3 origin = surface.position + outwards * surface.clearance;
    const float share = terminator_share(std::fabs(cosine), dot(outwards, light), surface.terminator_offset);
    return share > 0.0f ? origin + find_patch_offset(scene, hit, outwards) * share : origin;
}

}  // namespace svgf
