// SPDX-License-Identifier: Apache-2.0
// Fresnel terms and the GGX distribution. Directions are in the local frame, the surface normal is +z.
#pragma once

#include "core/sampling.h"
#include "core/vec.h"

namespace svgf {

// Reflectance of a dielectric for unpolarized light [Walter07, Eq. 22]; 1 at total internal reflection. eta: IOR beyond
// the surface over IOR before it.
SVGF_HD inline float fresnel_dielectric(float cos_incident, float eta) {
    if (eta == 1.0f) return 0.0f;
    const float c = std::fabs(cos_incident);
    const float g_squared = eta * eta - 1.0f + c * c;
    if (!(g_squared > 0.0f)) return 1.0f;
    const float g = std::sqrt(g_squared);
    const float perpendicular = (g - c) / (g + c);
    const float ratio = (c * (g + c) - 1.0f) / (c * (g - c) + 1.0f);
    return saturate(0.5f * perpendicular * perpendicular * (1.0f + ratio * ratio));
}

// Schlick's approximation.
SVGF_HD inline Vec3 fresnel_metal(Vec3 base, float cos_incident) {
    const float x = 1.0f - saturate(cos_incident);
    return base + (Vec3{1, 1, 1} - base) * (x * x * x * x * x);
}

SVGF_HD inline float normal_reflectance(float ior) { return square((ior - 1.0f) / (ior + 1.0f)); }

// Share of light that a GGX lobe with Schlick's Fresnel term reflects, as scale * f0 + offset: the rational fit of
// [MaterialX], within 0.03 of the integral.
struct GgxAlbedo {
    float scale, offset;

    SVGF_HD GgxAlbedo(float roughness, float cos_view) {
        const float x = cos_view, y = roughness * roughness, x2 = x * x, y2 = y * y;
        const float above_scale = 0.1003f - 0.6303f * x + 9.748f * y - 2.038f * x * y + 29.34f * x2 - 8.245f * y2 -
                                  26.44f * x2 * y + 19.99f * x * y2 - 5.448f * x2 * y2;
        const float above_offset = 0.9345f - 2.323f * x + 2.229f * y - 3.748f * x * y + 1.424f * x2 - 0.7684f * y2 +
                                   1.436f * x2 * y + 0.2913f * x * y2 + 0.6286f * x2 * y2;
        const float below_scale = 1.0f - 1.765f * x + 8.263f * y + 11.53f * x * y + 28.96f * x2 - 7.507f * y2 -
                                  36.11f * x2 * y + 15.86f * x * y2 + 33.37f * x2 * y2;
        const float below_offset = 1.0f + 0.2281f * x + 15.94f * y - 55.83f * x * y + 13.08f * x2 + 41.26f * y2 +
                                   54.9f * x2 * y + 300.2f * x * y2 - 285.1f * x2 * y2;
        scale = saturate(above_scale / below_scale);
        offset = saturate(above_offset / below_offset);
    }

    SVGF_HD float metal(float f0) const { return saturate(f0 * scale + offset); }
    SVGF_HD Vec3 metal(Vec3 f0) const { return {metal(f0.x), metal(f0.y), metal(f0.z)}; }
    // Without an interface nothing is reflected, not even at grazing angles.
    SVGF_HD float dielectric(float f0) const { return f0 > 0.0f ? metal(f0) : 0.0f; }
};

// Distribution of microfacet normals [Walter07, Eq. 33]. The sine comes from the tangential part of the half vector: as
// 1 - cosine^2 it would lose all its digits where alpha is small.
SVGF_HD inline float ggx_density(Vec3 half, float alpha) {
    if (!(half.z > 0.0f)) return 0.0f;
    const float a2 = alpha * alpha;
    return a2 / (pi * square(half.x * half.x + half.y * half.y + a2 * half.z * half.z));
}

// 1 + 2 Lambda of Smith's masking [Heitz14, Eq. 72].
SVGF_HD inline float ggx_masking(float cosine, float alpha) {
    const float c2 = max(cosine * cosine, 1e-30f);
    return std::sqrt(1.0f + alpha * alpha * max(0.0f, 1.0f - c2) / c2);
}

// Visible microfacet normal by spherical caps [Dupuy23, Listing 1].
SVGF_HD inline Vec3 sample_visible_normal(Vec3 view, float alpha, Vec2 u) {
    const Vec3 standard = normalize(Vec3{alpha * view.x, alpha * view.y, view.z});
    const float angle = 2.0f * pi * u.x;
    const float z = (1.0f - u.y) * (1.0f + standard.z) - standard.z;
    const float sine = std::sqrt(saturate(1.0f - z * z));
    const Vec3 half = Vec3{sine * std::cos(angle), sine * std::sin(angle), z} + standard;
    return normalize(Vec3{alpha * half.x, alpha * half.y, max(half.z, 0.0f)});
}

SVGF_HD inline Vec3 reflect(Vec3 view, Vec3 half) { return half * (2.0f * dot(view, half)) - view; }

// Transmitted direction [Walter07, Eq. 40], half on the viewer's side. Where all is reflected: within the surface.
SVGF_HD inline Vec3 refract(Vec3 view, Vec3 half, float eta) {
    const float cosine = dot(view, half);
    const float inside = std::sqrt(max(0.0f, 1.0f - (1.0f - cosine * cosine) / (eta * eta)));
    return half * (cosine / eta - inside) - view / eta;
}

}  // namespace svgf
