// SPDX-License-Identifier: Apache-2.0
// The Principled BSDF that svgf simulates, three lobes:
//
//   D  diffuse: Lambert under a dielectric coat
//   S  specular: GGX reflection, of the coat and of metal
//   G  glass: GGX reflection and refraction; radiance is not scaled by eta^2, as in Cycles
//
// The coat takes its albedo [MaterialX] away from what lies below, so that no mixture of lobes reflects more than it
// gets. A lobe of vanishing roughness is a mirror ("delta"): sampled on its own, and no part of evaluate().
// Directions point away from the surface; what lies on the wrong side of the geometric normal is black.
#pragma once

#include "core/effects.h"
#include "core/sampling.h"
#include "trace/microfacet.h"
#include "trace/surface.h"

namespace svgf {

// GGX alpha below which a lobe is a mirror.
constexpr float smooth_alpha = 1e-3f;
// Shading normals are bent until the viewer is this far above their horizon.
constexpr float smallest_cos_view = 0.01f;
constexpr float largest_f0 = 0.99f;

// Lobe values times |cosine|, and the density with which sample() finds the direction.
struct BsdfValue {
    Vec3 diffuse, specular;
    float pdf = 0;

    SVGF_HD Vec3 total() const { return diffuse + specular; }
    // Of the light from this direction, what belongs to the diffuse signal.
    SVGF_HD Vec3 diffuse_share() const {
        const Vec3 sum = total();
        return {sum.x > 0.0f ? diffuse.x / sum.x : 0.0f, sum.y > 0.0f ? diffuse.y / sum.y : 0.0f,
                sum.z > 0.0f ? diffuse.z / sum.z : 0.0f};
    }
};

// The value is divided by the pdf; of a mirror, by the probability of its lobe. All zero: the path ends.
struct BsdfSample {
    Vec3 direction;
    BsdfValue weight;  // its pdf is that of the direction
    bool delta = false;
    std::uint32_t kind = ray_kind::diffuse;  // of the ray that it starts
};

template <Effects kernel>
class Bsdf {
public:
    Vec3 normal, geometric_normal;  // on the viewer's side
    Vec3 diffuse_albedo, specular_albedo;

    // view: unit, towards the viewer.
    SVGF_HD Bsdf(const Surface& surface, Vec3 view) : Bsdf(surface, view, orient(surface, view)) {}

    SVGF_HD BsdfValue evaluate(Vec3 light) const {
        return evaluate_local(frame_.to_local(light), dot(geometric_normal, light));
    }

    // u: direction within the lobe. lobe: chooses D, S or G in this order; what is left of it reflection or refraction.
    // Events are chosen first and evaluated in one place, as evaluate() is much code for the instruction cache.
    SVGF_HD BsdfSample sample(Vec2 u, float lobe) const {
        const Event event = choose_event(u, lobe);
        BsdfSample result = event.is_mirror ? finish_mirror(event) : finish(event);
        result.kind = event.side < 0.0f              ? ray_kind::transmission
                      : lobe < diffuse_probability_ ? ray_kind::diffuse
                                                    : ray_kind::glossy;
        return result;
    }

private:
    static constexpr bool has_specular = covers(kernel, Effects::specular);
    static constexpr bool has_transmission = covers(kernel, Effects::transmission);

    struct Orientation {
        Vec3 normal, geometric_normal;
        bool entering;
    };

    SVGF_HD static Orientation orient(const Surface& surface, Vec3 view) {
        Orientation result{surface.shading_normal, surface.geometric_normal,
                           dot(surface.geometric_normal, view) > 0.0f};
        if (dot(result.geometric_normal, view) < 0.0f) result.geometric_normal = -result.geometric_normal;
        if (dot(result.normal, result.geometric_normal) < 0.0f) result.normal = -result.normal;
        const float cosine = dot(result.normal, view);
        if (cosine < smallest_cos_view) result.normal = normalize(result.normal + view * (smallest_cos_view - cosine));
        return result;
    }

    SVGF_HD Bsdf(const Surface& surface, Vec3 view, const Orientation& oriented)
        : normal(oriented.normal), geometric_normal(oriented.geometric_normal), frame_(oriented.normal) {
        const Material& material = surface.material;
        view_ = frame_.to_local(view);
        if constexpr (!has_specular) {
            diffuse_albedo = material.base_color;
            diffuse_probability_ = luminance(diffuse_albedo) > 0.0f ? 1.0f : 0.0f;
        } else {
            base_ = material.base_color;
            tint_ = material.specular_tint;
            alpha_ = square(material.roughness);
            metal_ = material.metallic;
            const float transmission = has_transmission ? material.transmission : 0.0f;
            plastic_ = (1.0f - metal_) * (1.0f - transmission);
            const float f0 = min(normal_reflectance(material.ior) * 2.0f * material.specular_ior_level, largest_f0);
            coat_eta_ = (1.0f + std::sqrt(f0)) / (1.0f - std::sqrt(f0));

            const GgxAlbedo albedo(material.roughness, view_.z);
            const float coat_albedo = albedo.dielectric(f0);
            diffuse_albedo = base_ * (plastic_ * (1.0f - coat_albedo));
            specular_albedo = tint_ * (plastic_ * coat_albedo) + albedo.metal(base_) * metal_;
            float diffuse_weight = luminance(diffuse_albedo), specular_weight = luminance(specular_albedo);
            float glass_weight = 0.0f;
            if constexpr (has_transmission) {
                glass_ = glass_weight = (1.0f - metal_) * transmission;
                glass_eta_ = oriented.entering ? material.ior : 1.0f / material.ior;
                const float glass_albedo = albedo.dielectric(normal_reflectance(material.ior));
                specular_albedo += (root(base_) * (1.0f - glass_albedo) + glass_albedo) * glass_;
            }
            const float sum = diffuse_weight + specular_weight + glass_weight;
            if (sum > 0.0f) {
                diffuse_probability_ = diffuse_weight / sum;
                specular_probability_ = specular_weight / sum;
                glass_probability_ = glass_weight / sum;
            }
        }
    }

    SVGF_HD bool is_smooth() const { return alpha_ < smooth_alpha; }
    // Without an interface there is nothing rough about glass: light goes straight on.
    SVGF_HD bool is_glass_smooth() const { return is_smooth() || glass_eta_ == 1.0f; }

    SVGF_HD static Vec3 root(Vec3 v) { return {std::sqrt(v.x), std::sqrt(v.y), std::sqrt(v.z)}; }
    SVGF_HD Vec3 mirrored() const { return {-view_.x, -view_.y, view_.z}; }
    SVGF_HD Vec3 coat_and_metal(float cos_half_view) const {
        return tint_ * (plastic_ * fresnel_dielectric(cos_half_view, coat_eta_)) +
               fresnel_metal(base_, cos_half_view) * metal_;
    }

    // light: in the local frame. side: its cosine with the geometric normal.
    SVGF_HD BsdfValue evaluate_local(Vec3 light, float side) const {
        BsdfValue value;
        if (light.z > 0.0f && side > 0.0f) {
            value.diffuse = diffuse_albedo * (light.z / pi);
            value.pdf = diffuse_probability_ * (light.z / pi);
            if constexpr (has_specular)
                if (!is_smooth()) add_reflection(light, value);
        } else if (light.z < 0.0f && side < 0.0f) {
            if constexpr (has_transmission)
                if (!is_glass_smooth() && glass_probability_ > 0.0f) add_refraction(light, value);
        }
        return value;
    }

    // Microfacets mirror light to view: D G2 / (4 NV NL) times NL, G2 height-correlated [Heitz14, Eq. 99].
    SVGF_HD void add_reflection(Vec3 light, BsdfValue& value) const {
        const Vec3 half = normalize(view_ + light);
        const float cos_half_view = dot(view_, half);
        const float spread = ggx_density(half, alpha_) / (4.0f * view_.z);
        const float view_masking = ggx_masking(view_.z, alpha_);
        const float shadowed = spread * 2.0f / (view_masking + ggx_masking(light.z, alpha_));
        const float masked = spread * 2.0f / (1.0f + view_masking);
        value.specular = coat_and_metal(cos_half_view) * shadowed;
        value.pdf += specular_probability_ * masked;
        if constexpr (has_transmission)
            if (!is_glass_smooth()) {
                const float reflectance = fresnel_dielectric(cos_half_view, glass_eta_);
                value.specular = value.specular + glass_ * reflectance * shadowed;
                value.pdf += glass_probability_ * reflectance * masked;
            }
    }

    // Microfacets refract light to view [Walter07, Eq. 21]. The Jacobian's (VH + eta LH)^2 is the squared length of
    // V + eta L, which is along H.
    SVGF_HD void add_refraction(Vec3 light, BsdfValue& value) const {
        const Vec3 sum = view_ + light * glass_eta_;
        const float squared = dot(sum, sum);
        Vec3 half = normalize(sum);
        if (half.z < 0.0f) half = -half;
        const float cos_half_view = dot(view_, half), cos_half_light = dot(light, half);
        if (!(squared > 0.0f && cos_half_view > 0.0f && cos_half_light < 0.0f)) return;
        const float jacobian = glass_eta_ * glass_eta_ * -cos_half_light / squared;
        const float spread = ggx_density(half, alpha_) * cos_half_view / view_.z * jacobian *
                             (1.0f - fresnel_dielectric(cos_half_view, glass_eta_));
        const float view_masking = ggx_masking(view_.z, alpha_);
        value.specular = root(base_) * (glass_ * spread * 2.0f / (view_masking + ggx_masking(light.z, alpha_)));
        value.pdf = glass_probability_ * spread * 2.0f / (1.0f + view_masking);
    }

    // Which side of the surface an event leads to.
    static constexpr float above = 1.0f, below = -1.0f;

    struct Event {
        Vec3 light;          // local
        float side = 0;      // above or below; 0: no event, the path ends
        bool is_mirror = false;
        Vec3 mirror_weight{};  // of a mirror, over the probability of choosing it
    };

    SVGF_HD Event choose_event(Vec2 u, float lobe) const {
        if (lobe < diffuse_probability_) return {sample_cosine_hemisphere(u), above};
        if constexpr (has_specular) {
            const float rest = lobe - diffuse_probability_;
            const bool is_specular = rest < specular_probability_;
            if (!is_specular && !(has_transmission && glass_probability_ > 0.0f)) return {};
            const bool smooth = is_specular ? is_smooth() : is_glass_smooth();
            const Vec3 half = smooth ? Vec3{0, 0, 1} : sample_visible_normal(view_, alpha_, u);
            if (is_specular) {
                if (smooth) return {mirrored(), above, true, coat_and_metal(view_.z) / specular_probability_};
                return {reflect(view_, half), above};
            }
            if constexpr (has_transmission) {
                const float choice = (rest - specular_probability_) / glass_probability_;
                // What the chosen one carries is divided by the chance of choosing it, which is the same reflectance.
                const float weight = glass_ / glass_probability_;
                if (choice < fresnel_dielectric(dot(view_, half), glass_eta_))
                    return {smooth ? mirrored() : reflect(view_, half), above, smooth, {weight, weight, weight}};
                const Vec3 light = glass_eta_ == 1.0f ? -view_ : refract(view_, half, glass_eta_);
                return {light, below, smooth, root(base_) * weight};
            }
        }
        return {};
    }

    // A microfacet may send light to the wrong side. That light is lost: evaluated there, it would pass for what the
    // other event sends.
    SVGF_HD BsdfSample finish(const Event& event) const {
        BsdfSample result;
        if (!(event.light.z * event.side > 0.0f)) return result;
        result.direction = normalize(frame_.to_world(event.light));
        result.weight = evaluate_local(event.light, dot(geometric_normal, result.direction));
        if (result.weight.pdf > 0.0f) {
            result.weight.diffuse = result.weight.diffuse / result.weight.pdf;
            result.weight.specular = result.weight.specular / result.weight.pdf;
        } else {
            result.weight = {};
        }
        return result;
    }

    SVGF_HD BsdfSample finish_mirror(const Event& event) const {
        BsdfSample result;
        result.direction = normalize(frame_.to_world(event.light));
        result.delta = true;
        const float side = dot(geometric_normal, result.direction);
        if (event.light.z * event.side > 0.0f && side * event.side > 0.0f) result.weight.specular = event.mirror_weight;
        return result;
    }

    Frame frame_;
    Vec3 view_;  // local, as are all directions below
    Vec3 base_, tint_;
    float alpha_ = 1;
    float plastic_ = 1, metal_ = 0, glass_ = 0;  // shares of the three kinds of surface
    float coat_eta_ = 1;                         // relative IOR of plastic's coat
    float glass_eta_ = 1;                        // IOR beyond the surface over IOR on the viewer's side
    float diffuse_probability_ = 0, specular_probability_ = 0, glass_probability_ = 0;
};

}  // namespace svgf
