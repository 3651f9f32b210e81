// SPDX-License-Identifier: Apache-2.0
// Fresnel terms, the GGX distribution and the albedos of its lobes. Directions are in the local frame, the surface
// normal is +z.
#pragma once

#include "core/approximate.h"
#include "core/sampling.h"
#include "core/vec.h"
#include "scene/flat_scene.h"

namespace svgf {

// Reflectance of a dielectric for unpolarized light [Walter07, Eq. 22]; 1 at total internal reflection. eta: IOR beyond
// the surface over IOR before it.
SVGF_HD inline float fresnel_dielectric(float cos_incident, float eta) {
    if (eta == 1.0f) return 0.0f;
    const float c = std::fabs(cos_incident);
    const float g_squared = eta * eta - 1.0f + c * c;
    if (!(g_squared > 0.0f)) return 1.0f;
    const float g = fast_sqrt(g_squared);
    const float perpendicular = fast_quotient(g - c, g + c);
    const float ratio = fast_quotient(c * (g + c) - 1.0f, c * (g - c) + 1.0f);
    return saturate(0.5f * perpendicular * perpendicular * (1.0f + ratio * ratio));
}

SVGF_HD inline float normal_reflectance(float ior) { return square(fast_quotient(ior - 1.0f, ior + 1.0f)); }

// A dielectric's reflectance with its range [F(1), 1] mapped to [f0, 1].
SVGF_HD inline Vec3 fresnel_tinted(float reflectance, float eta, Vec3 f0) {
    const float real_f0 = normal_reflectance(eta);
    return lerp(f0, {1, 1, 1}, saturate(fast_quotient(reflectance - real_f0, 1.0f - real_f0)));
}

// Schlick's approximation from f0 to f90, with the dip around 82 degrees of [Kutz21].
SVGF_HD inline Vec3 fresnel_metal(Vec3 f0, Vec3 f90, Vec3 dip, float cos_incident) {
    const float c = saturate(cos_incident), x = 1.0f - c;
    const float x5 = square(square(x)) * x;
    return min(max(lerp(f0, f90, x5) - dip * (c * x5 * x), 0.0f), Vec3{1, 1, 1});
}

// Mean Fresnel reflectance of a dielectric over the hemisphere: the fit of [Kulla17].
SVGF_HD inline float dielectric_mean(float eta) {
    if (eta < 1.0f) return 0.997118f + eta * (0.1014f - eta * (0.965241f + eta * 0.130607f));
    return fast_quotient(eta - 1.0f, 4.08567f + 1.00071f * eta);
}

// A table of albedos: where it starts in SceneView.albedo_tables, and its entries along roughness, cosine and IOR.
// reference/albedo.py says what they hold and how they came about.
struct AlbedoTable {
    int start, columns, rows, depth;

    SVGF_HD constexpr int end() const { return start + columns * rows * depth; }
};
constexpr AlbedoTable energy_table{0, 32, 32, 1};
constexpr AlbedoTable mean_energy_table{energy_table.end(), 32, 1, 1};
constexpr AlbedoTable schlick_table{mean_energy_table.end(), 16, 16, 1};
constexpr AlbedoTable dielectric_table{schlick_table.end(), 16, 16, 16};
constexpr AlbedoTable dielectric_leaving_table{dielectric_table.end(), 16, 17, 16};
constexpr AlbedoTable glass_entering_table{dielectric_leaving_table.end(), 16, 16, 16};
constexpr AlbedoTable glass_leaving_table{glass_entering_table.end(), 16, 16, 16};
constexpr AlbedoTable mean_glass_entering_table{glass_leaving_table.end(), 16, 1, 16};
constexpr AlbedoTable mean_glass_leaving_table{mean_glass_entering_table.end(), 16, 1, 16};
constexpr AlbedoTable sheen_table{mean_glass_leaving_table.end(), 32, 32, 1};
constexpr int albedo_table_size = sheen_table.end();

// Trilinear.
SVGF_HD inline SVGF_NOINLINE float look_up_albedo(const float* tables, AlbedoTable table, float roughness,
                                                  float cosine = 0, float ior_coordinate = 0) {
    const float x = saturate(roughness) * float(table.columns - 1), y = saturate(cosine) * float(table.rows - 1);
    const float z = saturate(ior_coordinate) * float(table.depth - 1);
    const int i = int(x), j = int(y), k = int(z);
    const int corners = table.depth > 1 ? 8 : table.rows > 1 ? 4 : 2;
    float sum = 0;
    for (int corner = 0; corner < corners; ++corner) {
        const int a = corner & 1, b = (corner >> 1) & 1, c = corner >> 2;
        const float weight = (a ? x - float(i) : 1.0f - (x - float(i))) * (b ? y - float(j) : 1.0f - (y - float(j))) *
                             (c ? z - float(k) : 1.0f - (z - float(k)));
        if (weight > 0.0f)
            sum += weight * tables[table.start + ((k + c) * table.rows + j + b) * table.columns + i + a];
    }
    return sum;
}

SVGF_HD inline float ior_coordinate(float ior) { return fast_sqrt(std::fabs(fast_quotient(ior - 1.0f, ior + 1.0f))); }

// The cosine with the critical angle at 0.5, and fine steps around it.
SVGF_HD inline float critical_angle_coordinate(float cosine, float eta) {
    const float critical = fast_sqrt(1.0f - eta * eta), beyond = saturate(cosine) - critical;
    const float range = max(beyond < 0.0f ? critical : 1.0f - critical, 1e-6f);
    const float root = fast_sqrt(fast_quotient(std::fabs(beyond), range));
    return 0.5f + 0.5f * (beyond < 0.0f ? -root : root);
}

// s, where the mean reflectance of a rough dielectric, its range [F(1), 1] mapped to [f0, 1], is f0 + (1 - f0) s.
SVGF_HD inline float dielectric_share(const float* tables, float roughness, float cosine, float eta) {
    AlbedoTable table = dielectric_table;
    if (eta < 1.0f) {
        table = dielectric_leaving_table;
        cosine = critical_angle_coordinate(cosine, eta);
    }
    return look_up_albedo(tables, table, roughness, cosine, ior_coordinate(eta));
}

// Light that a lobe loses between microfacets, of which `mean` (its mean Fresnel reflectance) comes back [Kulla17]: the
// factor on the lobe.
SVGF_HD inline float given_back(float energy, float mean_energy, float mean) {
    return 1.0f + fast_quotient(mean * mean_energy * (1.0f - energy), (1.0f - mean * (1.0f - mean_energy)) * energy);
}
SVGF_HD inline Vec3 given_back(float energy, float mean_energy, Vec3 mean) {
    return {given_back(energy, mean_energy, mean.x), given_back(energy, mean_energy, mean.y),
            given_back(energy, mean_energy, mean.z)};
}

// GGX alpha along x and y.
struct Alpha {
    float x = 1, y = 1;

    SVGF_HD bool is_smooth() const { return max(x, y) < smooth_alpha; }
    // Below it a lobe is a mirror.
    static constexpr float smooth_alpha = 1e-3f;
};

// Distribution of microfacet normals [Heitz14, Eq. 85]. The sine comes from the tangential part of the half vector: as
// 1 - cosine^2 it would lose all its digits where alpha is small.
SVGF_HD inline float ggx_density(Vec3 half, Alpha alpha) {
    if (!(half.z > 0.0f)) return 0.0f;
    const float product = alpha.x * alpha.y;
    const float x = half.x * alpha.y, y = half.y * alpha.x, z = half.z * product;
    return product * (1.0f / pi) * square(fast_quotient(product, x * x + y * y + z * z));
}

// 1 + 2 Lambda of Smith's masking [Heitz14, Eq. 72].
SVGF_HD inline float ggx_masking(Vec3 direction, Alpha alpha) {
    const float slope = square(alpha.x * direction.x) + square(alpha.y * direction.y);
    return fast_sqrt(1.0f + fast_quotient(slope, max(direction.z * direction.z, 1e-30f)));
}

// Visible microfacet normal by spherical caps [Dupuy23, Listing 1].
SVGF_HD inline Vec3 sample_visible_normal(Vec3 view, Alpha alpha, Vec2 u) {
    const Vec3 standard = normalize(Vec3{alpha.x * view.x, alpha.y * view.y, view.z});
    const float z = (1.0f - u.y) * (1.0f + standard.z) - standard.z;
    const float sine = fast_sqrt(saturate(1.0f - z * z));
    const Vec2 around = point_on_circle(2.0f * u.x) * sine;
    const Vec3 half = Vec3{around.x, around.y, z} + standard;
    return normalize(Vec3{alpha.x * half.x, alpha.y * half.y, max(half.z, 0.0f)});
}

SVGF_HD inline Vec3 reflect(Vec3 view, Vec3 half) { return half * (2.0f * dot(view, half)) - view; }

// Transmitted direction [Walter07, Eq. 40], half on the viewer's side. Where all is reflected: within the surface.
SVGF_HD inline Vec3 refract(Vec3 view, Vec3 half, float eta) {
    const float cosine = dot(view, half);
    const float inverse = fast_reciprocal(eta);
    const float inside = fast_sqrt(max(0.0f, 1.0f - (1.0f - cosine * cosine) * (inverse * inverse)));
    return half * (cosine * inverse - inside) - view * inverse;
}

}  // namespace svgf
