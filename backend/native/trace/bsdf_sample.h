// SPDX-License-Identifier: Apache-2.0
// Bsdf, without a direction: the choice of a lobe and of a direction within it, and where the surface is smooth the
// one direction that counts.
#pragma once

#include "trace/bsdf.h"

namespace svgf {

template <Effects kernel>
SVGF_HD inline auto Bsdf<kernel>::choose_event(Vec2 u, float lobe) const -> Event {
    if (lobe < diffuse_probability_) {
        const Vec3 light = sample_cosine_hemisphere(u);
        if (diffuse_is_tilted()) return tilted_diffuse_event(light);
        if (transmits_diffuse_) return {BsdfEvent::transmission, {light.x, light.y, -light.z}, below_surface};
        return {BsdfEvent::diffuse, light, above_surface};
    }
    if constexpr (has_specular) {
        float rest = lobe - diffuse_probability_;
        if constexpr (has_sheen) {
            if (rest < sheen_probability_) {
                if (diffuse_is_tilted()) {
                    const Vec3 view = Frame(diffuse_normal_).to_local(frame_.to_world(view_));
                    return tilted_diffuse_event(turned(sheen_.sample(u), view, -1.0f));
                }
                return {BsdfEvent::diffuse, turned(sheen_.sample(u), view_, -1.0f), above_surface};
            }
            rest -= sheen_probability_;
        }
        const bool is_specular = rest < specular_probability_;
        if (!is_specular) rest -= specular_probability_;
        const bool is_coat = has_coat && !is_specular && rest < coat_probability_;
        if (has_coat && !is_specular && !is_coat) rest -= coat_probability_;
        const bool is_glass = has_transmission && !is_specular && !is_coat && glass_probability_ > 0.0f;
        if (!is_specular && !is_coat && !is_glass) return {};

        const Alpha alpha = is_coat ? coat_alpha_ : is_glass ? glass_alpha_ : alpha_;
        const bool smooth = alpha.is_smooth() || (is_glass && glass_eta_ == 1.0f);
        const Vec3 half = smooth ? Vec3{0, 0, 1} : sample_visible_normal(view_, alpha, u);
        const Vec3 reflected = smooth ? mirrored() : reflect(view_, half);
        if (is_specular)
            return {BsdfEvent::glossy, reflected, above_surface, smooth,
                    specular_at(view_.z) * fast_reciprocal(specular_probability_)};
        if constexpr (has_tilted_coats)
            if (is_coat && coat_is_tilted()) return choose_tilted_coat(u);
        if constexpr (has_coat)
            if (is_coat)
                return {BsdfEvent::glossy, reflected, above_surface, smooth,
                        coat_at(view_.z) * fast_reciprocal(coat_probability_)};
        if constexpr (has_transmission) {
            const float cos_half_view = dot(view_, half);
            const GlassEvents events = glass_at(cos_half_view);
            if (rest < events.chance * glass_probability_)
                return {BsdfEvent::glossy, reflected, above_surface, smooth,
                        glass_ * events.reflectance * fast_reciprocal(events.chance * glass_probability_)};
            const Vec3 light = glass_eta_ == 1.0f ? -view_ : refract(view_, half, glass_eta_);
            return {BsdfEvent::transmission, light, below_surface, smooth,
                    glass_ * events.transmittance * fast_reciprocal((1.0f - events.chance) * glass_probability_)};
        }
    }
    return {};
}

// light: in the frame of the diffuse normal.
template <Effects kernel>
SVGF_HD inline auto Bsdf<kernel>::tilted_diffuse_event(Vec3 light) const -> Event {
    const Vec3 local = frame_.to_local(Frame(diffuse_normal_).to_world(light));
    return {BsdfEvent::diffuse, local, above_surface, false, {}, true};
}

template <Effects kernel>
SVGF_HD inline auto Bsdf<kernel>::choose_tilted_coat(Vec2 u) const -> Event {
    const Frame frame(coat_normal_);
    const Vec3 coat_view = frame.to_local(frame_.to_world(view_));
    const bool smooth = coat_alpha_.is_smooth();
    const Vec3 half = smooth ? Vec3{0, 0, 1} : sample_visible_normal(coat_view, coat_alpha_, u);
    const Vec3 light = reflect(coat_view, half);
    if (!(coat_view.z > 0.0f && light.z > 0.0f)) return {};
    return {BsdfEvent::glossy, frame_.to_local(frame.to_world(light)), above_surface, smooth,
            coat_at(coat_view.z) * fast_reciprocal(coat_probability_), true};
}

// A microfacet may send light to the wrong side. That light is lost: evaluated there, it would pass for what the
// other event sends.
template <Effects kernel>
SVGF_HD inline BsdfSample Bsdf<kernel>::finish(const Event& event) const {
    BsdfSample result;
    if (!event.is_on_its_side()) return result;
    result.direction = normalize(frame_.to_world(event.light));
    const float side = dot(geometric_normal, result.direction);
    if (event.is_tilted && !(side * event.side > 0.0f)) return result;
    result.weight = evaluate_local(event.light, side, result.direction);
    if (!(result.weight.pdf > 0.0f)) {
        result.weight = {};
        return result;
    }
    const float inverse = fast_reciprocal(result.weight.pdf);
    result.weight.diffuse *= inverse;
    result.weight.specular *= inverse;
    result.event = event.kind;
    return result;
}

template <Effects kernel>
SVGF_HD inline BsdfSample Bsdf<kernel>::finish_mirror(const Event& event) const {
    BsdfSample result;
    result.direction = normalize(frame_.to_world(event.light));
    result.delta = true;
    const float side = dot(geometric_normal, result.direction);
    if (!(event.is_on_its_side() && side * event.side > 0.0f)) return result;
    result.weight.specular = event.mirror_weight;
    result.event = event.kind;
    return result;
}

template <Effects kernel>
SVGF_HD inline SmoothBounce Bsdf<kernel>::find_smooth_bounce() const {
    if constexpr (!has_specular) return {};
    if (max_component(diffuse_albedo) > 0.0f) return {};
    Vec3 reflected, refracted;
    if (alpha_.is_smooth()) reflected = specular_at(view_.z);
    if constexpr (has_coat)
        if (coat_alpha_.is_smooth() && !coat_is_tilted()) reflected += coat_at(view_.z);
    if constexpr (has_transmission)
        if (glass_probability_ > 0.0f && is_glass_smooth()) {
            const GlassEvents events = glass_at(view_.z);
            reflected += glass_ * events.reflectance;
            refracted = glass_ * events.transmittance;
        }
    const Vec3 rough = max(specular_albedo - reflected - refracted, 0.0f);
    const bool refracts = luminance(refracted) > luminance(reflected);
    SmoothBounce bounce;
    bounce.weight = refracts ? refracted : reflected;
    bounce.elsewhere = rough + (refracts ? reflected : refracted);
    if (!(luminance(bounce.weight) > luminance(bounce.elsewhere))) return {};
    bounce.eta = refracts ? glass_eta_ : 0.0f;
    const Vec3 light = !refracts ? mirrored() : glass_eta_ == 1.0f ? -view_ : refract(view_, {0, 0, 1}, glass_eta_);
    const float side = refracts ? below_surface : above_surface;
    bounce.direction = normalize(frame_.to_world(light));
    if (light.z * side > 0.0f && dot(geometric_normal, bounce.direction) * side > 0.0f)
        bounce.event = refracts ? BsdfEvent::transmission : BsdfEvent::glossy;
    return bounce;
}

}  // namespace svgf
