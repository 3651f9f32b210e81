// SPDX-License-Identifier: Apache-2.0
// Bsdf, for a direction: value and density of all lobes that are not mirrors.
#pragma once

#include "trace/bsdf.h"

namespace svgf {

// light: in the local frame, and in the world. side: its side of the surface by sign, see evaluate().
template <Effects kernel>
SVGF_HD inline BsdfValue Bsdf<kernel>::evaluate_local(Vec3 light, float side, Vec3 world_light) const {
    BsdfValue value;
    add_diffuse(light, side, world_light, value);
    if constexpr (has_tilted_coats)
        if (coat_is_tilted() && side > 0.0f) add_tilted_coat(world_light, value);
    if constexpr (has_specular) {
        if (!(light.z * side > 0.0f)) return value;
        if (light.z > 0.0f) {
            if (diffuse_probability_ < 1.0f && view_.z > 0.0f) add_reflection(light, value);
        } else if constexpr (has_transmission) {
            if (!is_glass_smooth() && glass_probability_ > 0.0f) add_refraction(light, value);
        }
    }
    return value;
}

// D and H. What bumps hide they are found by all the same.
template <Effects kernel>
SVGF_HD inline void Bsdf<kernel>::add_diffuse(Vec3 light, float side, Vec3 world_light, BsdfValue& value) const {
    Vec3 view = view_;
    if (diffuse_is_tilted()) {
        const Frame frame(diffuse_normal_);
        view = frame.to_local(frame_.to_world(view_));
        light = frame.to_local(world_light);
    }
    if (!(light.z * side > 0.0f)) return;
    const bool above = light.z > 0.0f;
    float darkening = 1.0f;
    if constexpr (has_normal_maps)
        darkening = bump_shadowing(smooth_normal_, diffuse_is_tilted() ? diffuse_normal_ : normal, world_light,
                                   light.z);
    if (above != transmits_diffuse_) {
        const float cosine = std::fabs(light.z);
        value.pdf = diffuse_probability_ * (cosine * (1.0f / pi));
        if constexpr (has_specular)
            value.diffuse = diffuse_ * oren_nayar_.evaluate(view.z, cosine, dot(view, light)) * cosine;
        else
            value.diffuse = diffuse_ * (1.0f / pi) * cosine;  // the same to the bit, of no roughness
        if constexpr (has_normal_maps)
            if (above || !(darkening > 0.0f)) value.diffuse *= darkening;
    }
    if constexpr (has_sheen)
        if (above) {
            const float density = sheen_.density(turned(light, view, 1.0f));
            value.diffuse += sheen_weight_ * (density * darkening);
            value.pdf += sheen_probability_ * density;
        }
}

// Microfacets mirror light to view: D G2 / (4 NV NL) times NL, G2 height-correlated [Heitz14, Eq. 99]. Once for
// each roughness: base, then coat, then glass where the base is anisotropic.
template <Effects kernel>
SVGF_HD inline void Bsdf<kernel>::add_reflection(Vec3 light, BsdfValue& value) const {
    constexpr int roughnesses = 1 + int(has_coat) + int(has_anisotropy && has_transmission);
    const Vec3 half = normalize(view_ + light);
    const float cos_half_view = dot(view_, half);
    SVGF_NO_UNROLL
    for (int i = 0; i < roughnesses; ++i) {
        const bool is_coat = has_coat && i == 1, is_glass = i > int(has_coat);
        if (is_coat && coat_is_tilted()) continue;
        const Alpha alpha = is_coat ? coat_alpha_ : is_glass ? glass_alpha_ : alpha_;
        const bool is_smooth = alpha.is_smooth();
        if (is_smooth) continue;
        const float spread = fast_quotient(ggx_density(half, alpha), 4.0f * view_.z);
        const float view_masking = ggx_masking(view_, alpha);
        const float shadowed = fast_quotient(spread * 2.0f, view_masking + ggx_masking(light, alpha));
        const float masked = fast_quotient(spread * 2.0f, 1.0f + view_masking);
        if (is_coat) {
            if constexpr (has_coat) {
                value.specular += coat_at(cos_half_view) * shadowed;
                value.pdf += coat_probability_ * masked;
            }
            continue;
        }
        if (!is_glass) {
            value.specular += specular_at(cos_half_view) * shadowed;
            value.pdf += specular_probability_ * masked;
        }
        if constexpr (has_transmission)
            if (is_glass == has_anisotropy && glass_probability_ > 0.0f && glass_eta_ != 1.0f) {
                const GlassEvents events = glass_at(cos_half_view);
                value.specular += glass_ * events.reflectance * shadowed;
                value.pdf += glass_probability_ * events.chance * masked;
            }
    }
}

// The same for a coat whose normal is not that of the other lobes.
template <Effects kernel>
SVGF_HD inline void Bsdf<kernel>::add_tilted_coat(Vec3 world_light, BsdfValue& value) const {
    if (coat_alpha_.is_smooth() || !(coat_probability_ > 0.0f)) return;
    const Frame frame(coat_normal_);
    const Vec3 coat_view = frame.to_local(frame_.to_world(view_)), coat_light = frame.to_local(world_light);
    if (!(coat_view.z > 0.0f && coat_light.z > 0.0f)) return;
    const Vec3 half = normalize(coat_view + coat_light);
    const float spread = fast_quotient(ggx_density(half, coat_alpha_), 4.0f * coat_view.z);
    const float view_masking = ggx_masking(coat_view, coat_alpha_);
    value.specular +=
        coat_at(dot(coat_view, half)) *
        fast_quotient(spread * 2.0f, view_masking + ggx_masking(coat_light, coat_alpha_));
    value.pdf += coat_probability_ * fast_quotient(spread * 2.0f, 1.0f + view_masking);
}

// Microfacets refract light to view [Walter07, Eq. 21]. The Jacobian's (VH + eta LH)^2 is the squared length of
// V + eta L, which is along H.
template <Effects kernel>
SVGF_HD inline void Bsdf<kernel>::add_refraction(Vec3 light, BsdfValue& value) const {
    const Vec3 sum = view_ + light * glass_eta_;
    const float squared = dot(sum, sum);
    Vec3 half = normalize(sum);
    if (half.z < 0.0f) half = -half;
    const float cos_half_view = dot(view_, half), cos_half_light = dot(light, half);
    if (!(squared > 0.0f && cos_half_view > 0.0f && cos_half_light < 0.0f)) return;
    const float jacobian = fast_quotient(glass_eta_ * glass_eta_ * -cos_half_light, squared);
    const float spread = fast_quotient(ggx_density(half, glass_alpha_) * cos_half_view, view_.z) * jacobian;
    const GlassEvents events = glass_at(cos_half_view);
    const float view_masking = ggx_masking(view_, glass_alpha_);
    value.specular += glass_ * events.transmittance *
                     fast_quotient(spread * 2.0f, view_masking + ggx_masking(light, glass_alpha_));
    value.pdf += glass_probability_ * (1.0f - events.chance) * fast_quotient(spread * 2.0f, 1.0f + view_masking);
}

}  // namespace svgf
