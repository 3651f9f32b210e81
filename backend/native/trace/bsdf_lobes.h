// SPDX-License-Identifier: Apache-2.0
// Bsdf, from a material to its lobes: weight, Fresnel term, roughness and probability of each. From the top of the
// surface down, each takes its albedo from what is left for those below it.
#pragma once

#include "trace/bsdf.h"

namespace svgf {

template <Effects kernel>
SVGF_HD inline void Bsdf<kernel>::find_lobes(const float* tables, const Surface& surface, bool entering) {
    const Material& material = surface.material;
    const bool is_principled = material.kind == MaterialKind::principled;
    const bool is_glossy = material.kind == MaterialKind::glossy;
    const Vec3 base = material.base_color;
    const float cos_view = view_.z;
    const float cos_diffuse_view = diffuse_is_tilted() ? dot(frame_.to_world(view_), diffuse_normal_) : cos_view;

    Vec3 below{surface.weight, surface.weight, surface.weight};
    float sheen_sum = 0, coat_sum = 0;
    if constexpr (has_sheen || has_coat)
        if (is_principled) {
            const float cos_coat = coat_is_tilted() ? dot(frame_.to_world(view_), coat_normal_) : cos_view;
            const Layers<kernel> layers(tables, material, cos_diffuse_view, cos_coat);
            below = below * layers.below;
            if constexpr (has_sheen) {
                sheen_ = layers.sheen;
                sheen_weight_ = layers.sheen_weight * surface.weight;
                diffuse_albedo = sheen_weight_;
                sheen_sum = luminance(sheen_weight_);
            }
            if constexpr (has_coat) {
                coat_ = layers.coat_weight * surface.weight;
                coat_eta_ = layers.coat_eta;
                coat_alpha_ = layers.coat_alpha;
                coat_sum = layers.coat_albedo * surface.weight;
                specular_albedo = {coat_sum, coat_sum, coat_sum};
            }
        }

    alpha_ = find_alpha(material);
    const SpecularEnergy table = find_specular_energy(tables, material);
    const float metallic = is_principled ? material.metallic : is_glossy ? 1.0f : 0.0f;
    Vec3 specular;
    if (metallic > 0.0f) {
        specular = find_metal(tables, material, below * metallic, table);
        below *= 1.0f - metallic;
    }

    Vec3 glass;
    if constexpr (has_transmission) {
        const bool is_glass = material.kind == MaterialKind::glass || material.kind == MaterialKind::refraction;
        const float transmission = is_principled ? material.transmission : is_glass ? 1.0f : 0.0f;
        if (transmission > 0.0f) {
            glass = find_glass(tables, material, below * transmission, entering);
            below *= 1.0f - transmission;
        }
    }

    if (is_principled) specular += find_plastic(tables, material, table, below);
    if (has_diffuse(material.kind)) {
        const float roughness = transmits_diffuse_ ? 0.0f : material.diffuse_roughness;
        oren_nayar_ = OrenNayar(roughness, cos_diffuse_view, base);
        diffuse_ = below * base;
        diffuse_albedo += diffuse_ * oren_nayar_.albedo;
    }
    specular_albedo += specular + glass;

    const float diffuse_sum = luminance(diffuse_albedo) - sheen_sum;
    const float specular_sum = luminance(specular), glass_sum = luminance(glass);
    const float sum = diffuse_sum + sheen_sum + specular_sum + coat_sum + glass_sum;
    if (sum > 0.0f) {
        const float inverse = fast_reciprocal(sum);
        // Exactly 1 where nothing else is.
        diffuse_probability_ = diffuse_sum / sum;
        sheen_probability_ = sheen_sum * inverse;
        specular_probability_ = specular_sum * inverse;
        coat_probability_ = coat_sum * inverse;
        glass_probability_ = glass_sum * inverse;
    }
}

// Of an anisotropic lobe the roughness that tables know is the fourth root of both alphas' product.
template <Effects kernel>
SVGF_HD inline auto Bsdf<kernel>::find_specular_energy(const float* tables, const Material& material) const
    -> SpecularEnergy {
    SpecularEnergy table{fast_sqrt(fast_sqrt(alpha_.x * alpha_.y))};
    if (material.kind == MaterialKind::principled || material.kind == MaterialKind::glossy) {
        table.energy = look_up_albedo(tables, energy_table, table.roughness, view_.z);
        table.mean_energy = look_up_albedo(tables, mean_energy_table, table.roughness);
    }
    return table;
}

// Lobe S of metal, and of GLOSSY, whose Fresnel term is its colour from all directions. Returns its albedo.
template <Effects kernel>
SVGF_HD inline Vec3 Bsdf<kernel>::find_metal(const float* tables, const Material& material, Vec3 weight,
                                             SpecularEnergy table) {
    const bool is_glossy = material.kind == MaterialKind::glossy;
    const Vec3 base = material.base_color;
    metal_f0_ = base;
    metal_f90_ = is_glossy ? base : Vec3{1, 1, 1};
    // Schlick's term at 82 degrees, where the tint is what remains of it.
    constexpr float x = 6.0f / 7.0f, x5 = x * x * x * x * x;
    if (!is_glossy) metal_dip_ = lerp(base, {1, 1, 1}, x5) * (1.0f - material.specular_tint) * (7.0f / (x5 * x));
    const Vec3 mean = lerp(metal_f0_, metal_f90_, 1.0f / 21.0f) - metal_dip_ * (1.0f / 126.0f);
    metal_ = weight;
    if (material.multiscatter > 0.0f) metal_ *= given_back(table.energy, table.mean_energy, mean);
    const float s = look_up_albedo(tables, schlick_table, table.roughness, view_.z), c = saturate(view_.z);
    const Vec3 dip = metal_dip_ * (c * square((1.0f - c) * square(1.0f - c)));
    return metal_ * min(max(lerp(metal_f0_, metal_f90_, s) - dip, 0.0f), Vec3{1, 1, 1}) * table.energy;
}

// Lobe S of plastic. Returns its albedo, which what lies below does not get.
template <Effects kernel>
SVGF_HD inline Vec3 Bsdf<kernel>::find_plastic(const float* tables, const Material& material, SpecularEnergy table,
                                               Vec3& below) {
    constexpr float largest_f0 = 0.99f;
    const bool gives_back = material.multiscatter > 0.0f;
    const float f0 = normal_reflectance(material.ior) * 2.0f * material.specular_ior_level;
    plastic_eta_ = material.ior;
    if (material.specular_ior_level != 0.5f) {
        const float root = fast_sqrt(min(f0, largest_f0));
        plastic_eta_ = fast_quotient(1.0f + root, 1.0f - root);
        if (material.ior < 1.0f) plastic_eta_ = 1.0f / plastic_eta_;
    }
    if (!(plastic_eta_ != 1.0f && f0 > 0.0f)) return {};
    plastic_f0_ = min(material.specular_tint * f0, Vec3{1, 1, 1});
    const float real_f0 = normal_reflectance(plastic_eta_);
    const float mean = saturate(fast_quotient(dielectric_mean(plastic_eta_) - real_f0, 1.0f - real_f0));
    Vec3 factor{1, 1, 1};
    if (gives_back) factor = given_back(table.energy, table.mean_energy, lerp(plastic_f0_, {1, 1, 1}, mean));
    const float s = dielectric_share(tables, table.roughness, view_.z, plastic_eta_);
    const Vec3 single = lerp(plastic_f0_, {1, 1, 1}, s);
    plastic_ = below * factor;
    // What is lost between microfacets is not given to the base.
    below *= saturate(1.0f - max_component(single * factor) * (gives_back ? table.energy : 1.0f));
    return plastic_ * single * table.energy;
}

// Lobe G of this weight. Returns its albedo.
template <Effects kernel>
SVGF_HD inline Vec3 Bsdf<kernel>::find_glass(const float* tables, const Material& material, Vec3 weight,
                                             bool entering) {
    const bool is_principled = material.kind == MaterialKind::principled;
    const Vec3 base = material.base_color;
    const float cos_view = view_.z;
    glass_eta_ = entering ? material.ior : 1.0f / material.ior;
    glass_alpha_ = {square(material.roughness), square(material.roughness)};
    const float f0 = normal_reflectance(material.ior);
    glass_f0_ = is_principled ? material.specular_tint * f0 : Vec3{f0, f0, f0};
    transmission_tint_ = is_principled ? Vec3{fast_sqrt(base.x), fast_sqrt(base.y), fast_sqrt(base.z)} : base;
    refracts_only_ = material.kind == MaterialKind::refraction;
    reflection_tint_ = material.kind == MaterialKind::glass ? base : Vec3{1, 1, 1};
    glass_ = weight;
    const float z = ior_coordinate(material.ior);
    if (material.multiscatter > 0.0f && !refracts_only_ && glass_eta_ != 1.0f) {
        AlbedoTable table = glass_entering_table, mean_table = mean_glass_entering_table;
        if (glass_eta_ < 1.0f) {
            table.start = glass_leaving_table.start;
            mean_table.start = mean_glass_leaving_table.start;
        }
        const float energy = look_up_albedo(tables, table, material.roughness, cos_view, z);
        const float mean = look_up_albedo(tables, mean_table, material.roughness, 0.0f, z);
        glass_ *= given_back(energy, mean, transmission_tint_);
    }
    if (refracts_only_) return weight * transmission_tint_;
    const float inside = fresnel_dielectric(cos_view, glass_eta_);
    Vec3 reflected{inside, inside, inside};
    if (entering && glass_eta_ != 1.0f) {
        const float s = dielectric_share(tables, material.roughness, cos_view, material.ior);
        reflected = lerp(glass_f0_, {1, 1, 1}, s);
    }
    return weight * (reflected * reflection_tint_ + (1.0f - reflected) * transmission_tint_);
}

// Of lobe S.
template <Effects kernel>
SVGF_HD inline Alpha Bsdf<kernel>::find_alpha(const Material& material) {
    const float alpha = square(material.roughness);
    if constexpr (has_anisotropy) {
        if (material.kind == MaterialKind::glossy) {
            const float ratio = 1.0f - min(std::fabs(material.anisotropic), 0.99f);
            const float narrow = alpha * ratio, wide = min(fast_quotient(alpha, ratio), 1.0f);
            return material.anisotropic < 0.0f ? Alpha{wide, narrow} : Alpha{narrow, wide};
        }
        if (material.kind == MaterialKind::principled) {
            const float aspect = fast_sqrt(1.0f - saturate(material.anisotropic) * 0.9f);
            return {min(fast_quotient(alpha, aspect), 1.0f), alpha * aspect};
        }
    }
    return {alpha, alpha};
}

// x along the direction of anisotropy.
template <Effects kernel>
SVGF_HD inline void Bsdf<kernel>::turn_frame(const Surface& surface) {
    if (surface.material.anisotropic == 0.0f) return;
    const Vec3 across = cross(normal, surface.tangent);
    if (!(dot(across, across) > 1e-12f * dot(surface.tangent, surface.tangent))) return;
    const Vec3 side = normalize_any_length(across), along = cross(side, normal);
    const float angle = 2.0f * pi * surface.material.anisotropic_rotation;
    frame_.x = along * std::cos(angle) + side * std::sin(angle);
    frame_.y = cross(normal, frame_.x);
}

}  // namespace svgf
