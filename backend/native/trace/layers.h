// SPDX-License-Identifier: Apache-2.0
// What lies on the base of a Principled BSDF: sheen, and below it a coat.
#pragma once

#include "core/effects.h"
#include "core/sampling.h"
#include "trace/microfacet.h"

namespace svgf {

// Fuzz as a linearly transformed cosine [Zeltner22]: (x, y, z) -> (a x + b z, a y, z), x along the view's azimuth,
// makes the lobe a cosine. The fits are those of [MaterialX]; that of the albedo is off by up to 10 %, hence a table.
struct Sheen {
    float a = 1, b = 0, albedo = 0;

    Sheen() = default;
    SVGF_HD Sheen(const float* tables, float cos_view, float roughness) {
        const float x = saturate(cos_view), y = clamp(roughness, smallest_roughness, 1.0f);
        a = fast_quotient((2.58126f * x + 0.813703f * y) * y, 1.0f + 0.310327f * x * x + 2.60994f * x * y);
        b = fast_quotient(fast_sqrt(1.0f - x) * (y - 1.0f) * y * y * y,
                          0.0000254053f + 1.71228f * x - 1.71506f * x * y + 1.34174f * y * y);
        albedo = look_up_albedo(tables, sheen_table, roughness, cos_view);
    }

    // Density, which is also the lobe's value over its weight [Zeltner22, Eq. 3]. light: local, x along the view's
    // azimuth.
    SVGF_HD float density(Vec3 light) const {
        const float squared = square(a * light.x + b * light.z) + square(a * light.y) + square(light.z);
        return max(light.z, 0.0f) * (1.0f / pi) * square(fast_quotient(a, max(squared, 1e-30f)));
    }

    SVGF_HD Vec3 sample(Vec2 u) const {
        const Vec3 cosine = sample_cosine_hemisphere(u);
        return normalize(Vec3{cosine.x - b * cosine.z, cosine.y, a * cosine.z});
    }

    // Below it the fits divide by almost 0.
    static constexpr float smallest_roughness = 0.01f;
};

// Whether the coat is smooth over a base that a normal map bends.
SVGF_HD inline bool has_smooth_coat_normal(const Material& material) {
    return material.normal_uv_layer >= 0 && !material.coat_normal_mapped;
}

template <Effects kernel>
struct Layers {
    Vec3 below{1, 1, 1};  // share of light that reaches the base and comes back, and of what the base emits
    Sheen sheen;
    Vec3 sheen_weight;      // of the lobe
    float coat_weight = 0;  // of the lobe, with what is given back
    float coat_albedo = 0;
    float coat_eta = 1;
    Alpha coat_alpha;

    // cos_sheen, cos_coat: of the view with the normals of sheen and coat. material: a Principled BSDF.
    SVGF_HD Layers(const float* tables, const Material& material, float cos_sheen, float cos_coat) {
        float share = 1.0f;
        if constexpr (covers(kernel, Effects::sheen))
            if (material.sheen_weight > 0.0f) {
                sheen = Sheen(tables, cos_sheen, material.sheen_roughness);
                sheen_weight = material.sheen_tint * (material.sheen_weight * sheen.albedo);
                share = saturate(1.0f - max_component(sheen_weight));
                below = {share, share, share};
            }
        if constexpr (covers(kernel, Effects::coat))
            if (material.coat_weight > 0.0f) {
                const float roughness = material.coat_roughness;
                coat_eta = max(material.coat_ior, 1.0f);
                coat_alpha = {square(roughness), square(roughness)};
                const float f0 = normal_reflectance(coat_eta);
                const float energy = look_up_albedo(tables, energy_table, roughness, cos_coat);
                const float factor = given_back(energy, look_up_albedo(tables, mean_energy_table, roughness),
                                                dielectric_mean(coat_eta));
                const float single = lerp(f0, 1.0f, dielectric_share(tables, roughness, cos_coat, coat_eta));
                coat_weight = material.coat_weight * share * factor;
                coat_albedo = coat_weight * energy * single;
                const float passed = saturate(1.0f - material.coat_weight * factor * energy * single);
                // Beer's law along the refracted ray; the tint is that of a ray along the normal.
                const float sine_squared = fast_quotient(1.0f - square(saturate(cos_coat)), square(coat_eta));
                const float inside = fast_sqrt(1.0f - sine_squared);
                const float depth = fast_reciprocal(max(inside, 1e-6f));
                const Vec3 absorbed{std::pow(material.coat_tint.x, depth), std::pow(material.coat_tint.y, depth),
                                    std::pow(material.coat_tint.z, depth)};
                below = below * passed * lerp({1, 1, 1}, absorbed, material.coat_weight);
            }
    }
};

}  // namespace svgf
