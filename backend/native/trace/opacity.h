// SPDX-License-Identifier: Apache-2.0
// Rays through surfaces that let light pass straight, decided where the traversal meets them: opaque triangles stop a
// ray there and then, and cut-outs read a texture only where the part of the triangle that was hit is neither opaque
// nor clear all over.
//
// A path's ray passes a cut-out or not by a random number of the triangle's own, so that it does not matter in which
// order triangles are met. Shadow rays take the share that is let through: in Sponza, whose plants and chains are cut
// out, they cost 2.0 instead of 11.9 ms (H200, 1920x1080, one bounce) since no surface ends the traversal. Surfaces
// whose tint, parts or emission only shading knows (OpacityClass::shaded) stop a path's ray; trace/path.h sends it on.
#pragma once

#include "core/effects.h"
#include "core/sampling.h"
#include "trace/intersect.h"
#include "trace/surface.h"

namespace svgf {

// Blocks of 128 threads that a multiprocessor should hold of a kernel that traces a path's rays. Reading alpha from
// within the traversal takes registers.
template <Effects kernel>
constexpr int path_trace_blocks = covers(kernel, Effects::alpha) ? 5 : trace_blocks;

SVGF_HD inline TriangleOpacity triangle_opacity(const SceneView& scene, const Hit& hit) {
    const TriangleOpacity* const triangles = scene.opacity[hit.instance];
    return triangles ? triangles[hit.leaf_triangle] : TriangleOpacity(OpacityClass::opaque);
}

// What chooses the part of a mix, and whether a ray passes straight, at a path's vertex. Costs nothing where there is
// neither.
template <Effects kernel>
SVGF_HD float surface_choice(const Sampler& sampler, int vertex, const Hit& hit) {
    if constexpr (covers(kernel, Effects::alpha) || covers(kernel, Effects::material_mixes))
        return sampler.at_triangle(SamplePair::surface, vertex, hit.instance, hit.triangle);
    return 0.0f;
}

// Opacity of a cut-out at a hit.
SVGF_HD inline float find_cut_out_opacity(const SceneView& scene, TriangleOpacity triangle, Hit hit) {
    const OpacityClass part = triangle.at(scene.opacity_words, hit.weight1, hit.weight2);
    if (part != OpacityClass::cut_out) return part == OpacityClass::opaque ? 1.0f : 0.0f;
    const Instance& instance = scene.instances[hit.instance];
    const MeshView& mesh = scene.meshes[instance.mesh];
    const std::int32_t slot = mesh.triangles[hit.leaf_triangle].material_slot;
    const Material& material = scene.materials[scene.material_table[instance.material_start + slot]];
    if (material.alpha_map < 0) return material.alpha;
    const MaterialMap& map = scene.material_maps[material.alpha_map];
    return saturate(sample_channel(scene.textures[map.texture], map_uv(mesh, map, hit), map.channel));
}

// Distances of the first surfaces that a ray passed, in no order.
struct PassedDistances {
    static constexpr int most = 8;
    float t[most];
};

// What a path's ray passes.
template <Effects kernel>
struct PathPasses {
    const SceneView& scene;
    const Sampler& sampler;
    int vertex;  // at which the ray ends
    PassedDistances& distances;
    int passed = 0;

    SVGF_HD bool operator()(const TriangleRay& ray, const LeafTriangle& triangle, const Hit& hit) {
        const TriangleOpacity found = triangle_opacity(scene, hit);
        if (found.whole() == OpacityClass::opaque || found.whole() == OpacityClass::shaded) return false;
        if (!owns_hit(ray, triangle, hit.weight1, hit.weight2)) return true;
        if (found.whole() == OpacityClass::cut_out) {
            const float opacity = find_cut_out_opacity(scene, found, hit);
            if (opacity >= 1.0f || (opacity > 0.0f && surface_choice<kernel>(sampler, vertex, hit) < opacity))
                return false;
        }
        if (passed < distances.most) distances.t[passed] = hit.t;
        ++passed;
        return true;
    }
};

// The hit with the number of surfaces before it that the ray passed. Of more than `allowed`, the last one of them and
// one more stops the ray.
template <Effects kernel>
SVGF_HD SVGF_NOINLINE Hit count_passed(const SceneView& scene, Ray ray, Sampler sampler, int vertex, int allowed,
                                       Hit hit) {
    Ray before = ray;
    before.t_max = min(ray.t_max, hit.t);
    PassedDistances distances;
    PathPasses<kernel> passes{scene, sampler, vertex, distances};
    Hit nearest;
    traverse<true>(scene, before, nearest, passes);
    hit.passed = min(passes.passed, allowed);
    if (passes.passed <= allowed) return hit;
    for (int i = 0; i <= allowed; ++i) {
        nearest = find_closest_hit(scene, before);
        before.t_min = nearest.t;
    }
    nearest.passed = allowed;
    return nearest;
}

// What a path's ray hits. vertex: its number there. allowed: surfaces that the ray may pass, >= 0.
template <Effects kernel>
SVGF_HD Hit find_path_hit(const SceneView& scene, const Ray& ray, const Sampler& sampler, int vertex, int allowed) {
    if constexpr (!covers(kernel, Effects::alpha)) return find_closest_hit(scene, ray);
    Hit hit;
    PassedDistances distances;
    PathPasses<kernel> passes{scene, sampler, vertex, distances};
    traverse<false>(scene, ray, hit, passes);
    // Some of them may lie behind the hit.
    for (int i = 0; i < min(passes.passed, distances.most); ++i)
        if (distances.t[i] < hit.t) ++hit.passed;
    if (passes.passed <= distances.most && hit.passed <= allowed) return hit;
    return count_passed<kernel>(scene, ray, sampler, vertex, allowed, hit);
}

// The same where it is the exception: a call of its own.
template <Effects kernel>
SVGF_HD SVGF_NOINLINE Hit find_path_hit_apart(const SceneView& scene, Ray ray, Sampler sampler, int vertex,
                                              int allowed) {
    return find_path_hit<kernel>(scene, ray, sampler, vertex, allowed);
}

// Whether anything stops a path's ray: a hit of which no more is known than that it was found.
template <Effects kernel>
SVGF_HD Hit find_any_path_hit(const SceneView& scene, const Ray& ray, const Sampler& sampler, int vertex, int allowed) {
    Hit hit;
    PassedDistances distances;
    PathPasses<kernel> passes{scene, sampler, vertex, distances};
    bool found;
    if constexpr (covers(kernel, Effects::alpha))
        found = traverse<true>(scene, ray, hit, passes) || passes.passed > allowed;
    else
        found = is_occluded(scene, ray);
    hit.passed = passes.passed;
    if (found) hit = {.t = ray.t_min, .instance = 0};
    return hit;
}

// See find_transmittance.
template <Effects kernel>
SVGF_HD SVGF_NOINLINE Vec3 find_shaded_transmittance(const SceneView& scene, Hit hit, Vec3 view, float choice) {
    return find_transmittance<kernel>(scene, hit, view, choice);
}

// What a shadow ray passes, and what is left of its light.
template <Effects kernel>
struct ShadowPasses {
    const SceneView& scene;
    const Sampler& sampler;
    int vertex;  // from which the ray starts
    const Ray& world_ray;
    int allowed;  // surfaces that it may still pass
    // In double, so that the order of the factors does not show.
    double left[3] = {1, 1, 1};

    SVGF_HD bool operator()(const TriangleRay& ray, const LeafTriangle& triangle, const Hit& hit) {
        const TriangleOpacity opacity = triangle_opacity(scene, hit);
        const OpacityClass found = opacity.whole();
        if (found == OpacityClass::opaque) return false;
        if (!owns_hit(ray, triangle, hit.weight1, hit.weight2)) return true;
        if (allowed-- <= 0) return false;
        if (found == OpacityClass::clear) return true;
        Vec3 share;
        if (found == OpacityClass::cut_out) {
            const float passing = 1.0f - find_cut_out_opacity(scene, opacity, hit);
            share = {passing, passing, passing};
        } else {
            const float choice = sampler.at_triangle(SamplePair::shadow, vertex, hit.instance, hit.triangle);
            share = find_shaded_transmittance<kernel>(scene, hit, -normalize(world_ray.direction), choice);
        }
        left[0] *= share.x;
        left[1] *= share.y;
        left[2] *= share.z;
        return left[0] > 0.0 || left[1] > 0.0 || left[2] > 0.0;
    }
};

// What is left of light that goes straight on to the end of a shadow ray, which may pass `allowed` surfaces.
template <Effects kernel>
SVGF_HD Vec3 find_transmittance_along(const SceneView& scene, const Ray& ray, const Sampler& sampler, int vertex,
                                      int allowed) {
    Hit unused;
    if constexpr (covers(kernel, Effects::alpha)) {
        ShadowPasses<kernel> passes{scene, sampler, vertex, ray, allowed};
        if (traverse<true>(scene, ray, unused, passes)) return {};
        return {float(passes.left[0]), float(passes.left[1]), float(passes.left[2])};
    }
    return is_occluded(scene, ray) ? Vec3{} : Vec3{1, 1, 1};
}

}  // namespace svgf
