// SPDX-License-Identifier: Apache-2.0
// Which way a surface faces for shading: flipped to the viewer, bent where its reflections would pass through the
// surface, and what a normal map hides.
#pragma once

#include "core/effects.h"
#include "core/vec.h"
#include "trace/surface.h"

namespace svgf {

// Shading normals are bent until the viewer is this far above their horizon.
constexpr float smallest_cos_view = 0.01f;

struct Orientation {
    Vec3 normal, geometric_normal, smooth_normal;  // on the viewer's side; smooth: before the normal map
    bool entering;                                 // the viewer is outside
    // Under a kernel with normal maps, where the material has one: of these lobes, which differ from `normal`. Else 0.
    Vec3 diffuse_normal, coat_normal;
};

// The normal, turned towards the geometric one just as far as the mirror image of the view needs to be above the
// surface. With Ng as z and N in the xz plane, V = (Vx, ., Vz): 2 (N.V) Nz - Vz = t is quadratic in Nz^2.
SVGF_HD inline Vec3 make_reflection_valid(Vec3 normal, Vec3 geometric_normal, Vec3 view) {
    const float height = dot(view, geometric_normal);
    const float threshold = min(0.9f * height, 0.01f);
    const float across = dot(normal, geometric_normal);
    if (2.0f * dot(normal, view) * across - height >= threshold) return normal;
    const Vec3 sideways = normal - geometric_normal * across;
    const float length = svgf::length(sideways);
    if (!(length > 1e-6f)) return normal;
    const Vec3 x = sideways * fast_reciprocal(length);
    const float vx = dot(view, x);
    const float a = vx * vx + height * height, b = 2.0f * (a + height * threshold), c = square(threshold + height);
    const float root = fast_sqrt(max(b * b - 4.0f * a * c, 0.0f));
    const float z2 = saturate(fast_quotient(0.25f * (b + (vx < 0.0f ? root : -root)), max(a, 1e-30f)));
    return x * fast_sqrt(1.0f - z2) + geometric_normal * fast_sqrt(z2);
}

// The same for a lobe that mirrors, which also needs the viewer above its horizon.
SVGF_HD inline Vec3 make_reflecting(Vec3 normal, Vec3 geometric_normal, Vec3 view) {
    normal = make_reflection_valid(normal, geometric_normal, view);
    const float cosine = dot(normal, view);
    return cosine < smallest_cos_view ? normalize(normal + view * (smallest_cos_view - cosine)) : normal;
}

// Whether a material has any lobe that mirrors, whose normal must then keep mirrored views above the surface.
SVGF_HD inline bool has_reflection(const Material& material) {
    if (material.kind != MaterialKind::principled)
        return material.kind == MaterialKind::glossy || material.kind == MaterialKind::glass ||
               material.kind == MaterialKind::refraction;
    return material.metallic > 0.0f || material.transmission > 0.0f || material.coat_weight > 0.0f ||
           material.sheen_weight > 0.0f || (material.ior != 1.0f && material.specular_ior_level > 0.0f);
}

template <Effects kernel>
SVGF_HD Orientation orient(const Surface& surface, Vec3 view) {
    Orientation result{surface.shading_normal, surface.geometric_normal, {},
                       dot(surface.geometric_normal, view) > 0.0f, {}, {}};
    if (dot(result.geometric_normal, view) < 0.0f) result.geometric_normal = -result.geometric_normal;
    if (dot(result.normal, result.geometric_normal) < 0.0f) result.normal = -result.normal;
    if constexpr (covers(kernel, Effects::normal_maps)) {
        result.smooth_normal = surface.smooth_normal;
        if (dot(result.smooth_normal, result.geometric_normal) < 0.0f) result.smooth_normal = -result.smooth_normal;
    }
    if constexpr (covers(kernel, Effects::specular))
        if (has_reflection(surface.material)) {
            const Vec3 mapped = result.normal;
            result.normal = make_reflecting(mapped, result.geometric_normal, view);
            // Reflections must stay above the surface; what a normal map makes of diffuse light may be below.
            if constexpr (covers(kernel, Effects::normal_maps))
                if (surface.material.normal_uv_layer >= 0 && max_component(abs(result.normal - mapped)) > 0.0f)
                    result.diffuse_normal = mapped;
        }
    if constexpr (covers(kernel, Effects::normal_maps) && covers(kernel, Effects::coat))
        if (surface.material.coat_weight > 0.0f && has_smooth_coat_normal(surface.material))
            result.coat_normal = make_reflecting(result.smooth_normal, result.geometric_normal, view);
    return result;
}

// Share of diffuse reflection to a direction that bumps leave, softened towards the horizon of the unperturbed surface
// [Chiang19]; 0 where the direction is on its wrong side. cos_light: with the normal.
SVGF_HD inline float bump_shadowing(Vec3 smooth_normal, Vec3 normal, Vec3 light, float cos_light) {
    if (!(max_component(abs(smooth_normal - normal)) > 1e-6f)) return 1.0f;
    const float cos_smooth = dot(smooth_normal, light), cos_normal = dot(smooth_normal, normal);
    if (cos_smooth * cos_normal * cos_light < 0.0f) return 0.0f;
    const float c2 = max(square(cos_smooth), 1e-12f), d2 = square(max(std::fabs(cos_normal), 1e-6f));
    const float alpha2 = saturate(0.125f * max(fast_reciprocal(d2) - 1.0f, 0.0f));
    return 2.0f * fast_reciprocal(1.0f + fast_sqrt(1.0f + alpha2 * max(fast_reciprocal(c2) - 1.0f, 0.0f)));
}

}  // namespace svgf
