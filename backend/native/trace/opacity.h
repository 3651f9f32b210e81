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

#include <cstddef>

#include "core/effects.h"
#include "core/load.h"
#include "core/sampling.h"
#include "trace/intersect.h"
#include "trace/surface.h"

namespace svgf {

// Blocks of 128 threads that a multiprocessor should hold of a kernel that traces a path's rays. Reading alpha from
// within the traversal takes registers; as a call of its own it takes more: 2.9 instead of 2.2 ms in Sponza (H200).
template <Effects kernel>
constexpr int path_trace_blocks = covers(kernel, Effects::alpha) ? 7 : trace_blocks;
template <Effects kernel>
constexpr int shadow_trace_blocks = covers(kernel, Effects::alpha) ? 8 : trace_blocks;

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

// Distances of the nearest surfaces that a ray passed, in no order.
struct PassedDistances {
    static constexpr int most = 16;
    float t[most];

    // count: passed so far.
    SVGF_HD void add(float distance, int count) {
        int place = count;
        if (count >= most) {
            place = 0;
            for (int i = 1; i < most; ++i)
                if (t[i] > t[place]) place = i;
            if (distance >= t[place]) return;
        }
        t[place] = distance;
    }

    // Of so many passed how many are nearer than this, of the nearest `most`.
    SVGF_HD int count_before(float distance, int count) const {
        int before = 0;
        for (int i = 0; i < min(count, most); ++i) before += t[i] < distance ? 1 : 0;
        return before;
    }

    // Number `rank` in order, of so many passed.
    SVGF_HD float find(int rank, int count) const {
        float found = infinity;
        for (int i = 0; i < min(count, most); ++i) {
            int others = 0;  // that do not come after it
            for (int j = 0; j < min(count, most); ++j) others += t[j] <= t[i] ? 1 : 0;
            if (others > rank) found = min(found, t[i]);
        }
        return found;
    }
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
        distances.add(hit.t, passed++);
        return true;
    }
};

// What stops a ray that passed more than `allowed` surfaces: the first of them that is too many.
SVGF_HD SVGF_NOINLINE inline Hit find_surface_at(const SceneView& scene, Ray ray, float t, int allowed) {
    ray.t_min = std::nextafter(t, 0.0f);
    ray.t_max = std::nextafter(t, infinity);
    Hit hit = find_closest_hit(scene, ray);
    hit.passed = allowed;
    return hit;
}

// The hit with the number of surfaces before it that the ray passed, where they are more than PassedDistances holds. Of
// more than `allowed`, the last one of them and one more stops the ray.
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
    hit.passed = distances.count_before(hit.t, passes.passed);
    if (hit.passed > allowed) return find_surface_at(scene, ray, distances.find(allowed, passes.passed), allowed);
    if (hit.passed < distances.most || passes.passed == distances.most) return hit;
    return count_passed<kernel>(scene, ray, sampler, vertex, allowed, hit);
}

// The same where it is the exception: a call of its own.
template <Effects kernel>
SVGF_HD SVGF_NOINLINE Hit find_path_hit_apart(const SceneView& scene, Ray ray, Sampler sampler, int vertex,
                                              int allowed) {
    return find_path_hit<kernel>(scene, ray, sampler, vertex, allowed);
}

// See find_transmittance.
template <Effects kernel>
SVGF_HD SVGF_NOINLINE Vec3 find_shaded_transmittance(const SceneView& scene, Hit hit, Vec3 view, float choice) {
    return find_transmittance<kernel>(scene, hit, view, choice);
}

// The share of a shadow ray's light that a surface lets through, which is not opaque.
template <Effects kernel>
SVGF_HD Vec3 find_share(const SceneView& scene, const Ray& ray, const Sampler& sampler, int vertex,
                        TriangleOpacity opacity, const Hit& hit) {
    if (opacity.whole() == OpacityClass::shaded) {
        const float choice = sampler.at_triangle(SamplePair::shadow, vertex, hit.instance, hit.triangle);
        return find_shaded_transmittance<kernel>(scene, hit, -normalize(ray.direction), choice);
    }
    const float passing = 1.0f - find_cut_out_opacity(scene, opacity, hit);
    return {passing, passing, passing};
}

// In double, so that the order of the factors does not show.
struct Share {
    double left[3] = {1, 1, 1};

    SVGF_HD void multiply(Vec3 share) {
        left[0] *= share.x;
        left[1] *= share.y;
        left[2] *= share.z;
    }
    SVGF_HD bool is_left() const { return left[0] > 0.0 || left[1] > 0.0 || left[2] > 0.0; }
    SVGF_HD Vec3 value() const { return {float(left[0]), float(left[1]), float(left[2])}; }
};

// What a shadow ray passes, and what is left of its light.
template <Effects kernel>
struct ShadowPasses {
    const SceneView& scene;
    const Sampler& sampler;
    int vertex;  // from which the ray starts
    const Ray& world_ray;
    int allowed;  // surfaces that it may still pass
    Share& share;

    SVGF_HD bool operator()(const TriangleRay& ray, const LeafTriangle& triangle, const Hit& hit) {
        const TriangleOpacity found = triangle_opacity(scene, hit);
        if (found.whole() == OpacityClass::opaque) return false;
        if (!owns_hit(ray, triangle, hit.weight1, hit.weight2)) return true;
        if (allowed-- <= 0) return false;
        if (found.whole() == OpacityClass::clear) return true;
        share.multiply(find_share<kernel>(scene, world_ray, sampler, vertex, found, hit));
        return share.is_left();
    }
};

// Hits that are decided when the traversal is over.
class OpenHits {
public:
    static constexpr int most = 8;

    SVGF_HD void set(int i, const Hit& hit) { store(reinterpret_cast<Hit*>(memory_) + i, hit); }
    SVGF_HD Hit operator[](int i) const { return load(reinterpret_cast<const Hit*>(memory_) + i); }

private:
    alignas(Hit) std::byte memory_[most * sizeof(Hit)];  // not to be filled in advance
};

// The same, but what a texture must be read for is left open.
struct OpenShadowPasses {
    const SceneView& scene;
    int allowed;
    OpenHits& open;
    int open_count = 0;

    SVGF_HD bool operator()(const TriangleRay& ray, const LeafTriangle& triangle, const Hit& hit) {
        const TriangleOpacity found = triangle_opacity(scene, hit);
        if (found.whole() == OpacityClass::opaque) return false;
        if (!owns_hit(ray, triangle, hit.weight1, hit.weight2)) return true;
        if (allowed-- <= 0) return false;
        const OpacityClass part = found.whole() == OpacityClass::shaded
                                      ? OpacityClass::shaded
                                      : found.at(scene.opacity_words, hit.weight1, hit.weight2);
        if (part == OpacityClass::opaque) return false;
        if (part == OpacityClass::clear) return true;
        if (open_count < open.most) open.set(open_count, hit);
        ++open_count;
        return true;
    }
};

template <Effects kernel>
SVGF_HD SVGF_NOINLINE Vec3 find_transmittance_apart(const SceneView& scene, Ray ray, Sampler sampler, int vertex,
                                                    int allowed) {
    Hit unused;
    Share share;
    if (traverse<true>(scene, ray, unused, ShadowPasses<kernel>{scene, sampler, vertex, ray, allowed, share})) return {};
    return share.value();
}

// What is left of light that goes straight on to the end of a shadow ray, which may pass `allowed` surfaces.
template <Effects kernel>
SVGF_HD Vec3 find_transmittance_along(const SceneView& scene, const Ray& ray, const Sampler& sampler, int vertex,
                                      int allowed) {
    if constexpr (covers(kernel, Effects::alpha)) {
        Hit unused;
        OpenHits open;
        OpenShadowPasses passes{scene, allowed, open};
        if (traverse<true>(scene, ray, unused, passes)) return {};
        if (passes.open_count > open.most) return find_transmittance_apart<kernel>(scene, ray, sampler, vertex, allowed);
        Share share;
        for (int i = 0; i < passes.open_count && share.is_left(); ++i) {
            const Hit hit = open[i];
            share.multiply(find_share<kernel>(scene, ray, sampler, vertex, triangle_opacity(scene, hit), hit));
        }
        return share.value();
    }
    return is_occluded(scene, ray) ? Vec3{} : Vec3{1, 1, 1};
}

}  // namespace svgf
