// SPDX-License-Identifier: Apache-2.0
// The materials as Cycles defines them, as a sum of five lobes:
//
//   D  diffuse: Lambert or Oren-Nayar; in transmission for a translucent material
//   H  sheen: a linearly transformed cosine
//   S  specular: GGX reflection, of the interface of plastic and of metal
//   C  coat: GGX reflection of its own roughness
//   G  glass: GGX reflection and refraction; radiance is not scaled by eta^2, as in Cycles
//
// Sheen, coat and interface lie on each other in this order, and each takes its albedo away from what lies below, so
// that no mixture reflects more than it gets. What GGX loses between microfacets comes back as a factor on each lobe.
// In this one thing not as Cycles: of rough glass seen from within at a slant Cycles gives back too little (0.75 of all
// light at 85 degrees and roughness 1); here white glass stays white, within 0.5 %.
// A lobe of vanishing roughness is a mirror ("delta"): sampled on its own, and no part of evaluate().
// Directions point away from the surface; what lies on the wrong side of the geometric normal is black.
// Under a normal map, D and H have the map's normal, of which S and G take what keeps their reflections above the
// surface, and C the smooth one unless told otherwise. A lobe whose normal is not that of S is called tilted.
#pragma once

#include "core/effects.h"
#include "core/sampling.h"
#include "trace/diffuse.h"
#include "trace/layers.h"
#include "trace/microfacet.h"
#include "trace/shading_normal.h"
#include "trace/surface.h"

namespace svgf {

constexpr float largest_f0 = 0.99f;

// Lobe values times |cosine|, and the density with which sample() finds the direction. Sheen counts as diffuse.
struct BsdfValue {
    Vec3 diffuse, specular;
    float pdf = 0;

    SVGF_HD Vec3 total() const { return diffuse + specular; }
    // Of the light from this direction, what belongs to the diffuse signal.
    SVGF_HD Vec3 diffuse_share() const {
        const Vec3 sum = total();
        // Exactly 1 where nothing is specular: the specular signal is then 0, as is its albedo.
        return {sum.x > 0.0f ? exact_quotient(diffuse.x, sum.x) : 0.0f,
                sum.y > 0.0f ? exact_quotient(diffuse.y, sum.y) : 0.0f,
                sum.z > 0.0f ? exact_quotient(diffuse.z, sum.z) : 0.0f};
    }
};

// What a sample did, as Cycles counts bounces: translucency is a transmission.
enum class BsdfEvent : std::int32_t { none, diffuse, glossy, transmission };

// The value is divided by the pdf; of a mirror, by the probability of its lobe. All zero: the path ends.
struct BsdfSample {
    Vec3 direction;
    BsdfValue weight;  // its pdf is that of the direction
    bool delta = false;
    BsdfEvent event = BsdfEvent::none;
};

// The mirrored or the refracted direction of a surface that is smooth and not diffuse, whichever carries more.
struct SmoothBounce {
    BsdfEvent event = BsdfEvent::none;  // none: the surface scatters, or ends the path
    Vec3 direction;
    Vec3 weight;     // of all mirrors that lead there
    Vec3 elsewhere;  // albedo of the rest; less than the weight
    float eta = 0;   // of refraction, as in refract(); 0: a mirror
};

template <Effects kernel>
class Bsdf {
public:
    Vec3 normal, geometric_normal;  // on the viewer's side
    Vec3 diffuse_albedo, specular_albedo;

    // view: unit, towards the viewer.
    SVGF_HD Bsdf(const SceneView& scene, const Surface& surface, Vec3 view)
        : Bsdf(scene.albedo_tables, surface, view, orient<kernel>(surface, view)) {}

    SVGF_HD BsdfValue evaluate(Vec3 light) const {
        return evaluate_local(frame_.to_local(light), dot(geometric_normal, light), light);
    }

    // u: direction within the lobe. lobe: chooses D, H, S, C or G in this order; what is left of it reflection or
    // refraction. Events are chosen first and evaluated in one place, as evaluate() is much code for the instruction
    // cache.
    SVGF_HD BsdfSample sample(Vec2 u, float lobe) const {
        const Event event = choose_event(u, lobe);
        return event.is_mirror ? finish_mirror(event) : finish(event);
    }

    SVGF_HD SmoothBounce find_smooth_bounce() const {
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

private:
    static constexpr bool has_specular = covers(kernel, Effects::specular);
    static constexpr bool has_transmission = covers(kernel, Effects::transmission);
    static constexpr bool has_coat = covers(kernel, Effects::coat);
    static constexpr bool has_sheen = covers(kernel, Effects::sheen);
    static constexpr bool has_anisotropy = covers(kernel, Effects::anisotropy);
    static constexpr bool has_normal_maps = covers(kernel, Effects::normal_maps);
    static constexpr bool has_tilted_diffuse = has_specular && has_normal_maps;
    static constexpr bool has_tilted_coats = has_coat && has_normal_maps;

    SVGF_HD Bsdf(const float* tables, const Surface& surface, Vec3 view, const Orientation& oriented)
        : normal(oriented.normal), geometric_normal(oriented.geometric_normal), frame_(oriented.normal) {
        const Material& material = surface.material;
        if constexpr (has_normal_maps) smooth_normal_ = oriented.smooth_normal;
        if constexpr (has_anisotropy) turn_frame(surface);
        view_ = frame_.to_local(view);
        if constexpr (has_tilted_diffuse) diffuse_normal_ = oriented.diffuse_normal;
        if constexpr (has_tilted_coats) coat_normal_ = oriented.coat_normal;
        if constexpr (has_transmission) transmits_diffuse_ = material.kind == MaterialKind::translucent;
        if constexpr (!has_specular) {
            diffuse_ = has_diffuse(material.kind) ? material.base_color * surface.weight : Vec3{};
            diffuse_albedo = diffuse_;
            diffuse_probability_ = luminance(diffuse_) > 0.0f ? 1.0f : 0.0f;
        } else {
            find_lobes(tables, surface, oriented.entering);
        }
    }

    SVGF_HD static bool has_diffuse(MaterialKind kind) {
        return kind == MaterialKind::principled || kind == MaterialKind::diffuse || kind == MaterialKind::translucent;
    }

    SVGF_HD void turn_frame(const Surface& surface) {
        if (surface.material.anisotropic == 0.0f) return;
        const Vec3 across = cross(normal, surface.tangent);
        if (!(dot(across, across) > 1e-12f * dot(surface.tangent, surface.tangent))) return;
        const Vec3 side = normalize_any_length(across), along = cross(side, normal);
        const float angle = 2.0f * pi * surface.material.anisotropic_rotation;
        frame_.x = along * std::cos(angle) + side * std::sin(angle);
        frame_.y = cross(normal, frame_.x);
    }

    SVGF_HD void find_lobes(const float* tables, const Surface& surface, bool entering) {
        const Material& material = surface.material;
        const bool is_principled = material.kind == MaterialKind::principled;
        const bool is_glossy = material.kind == MaterialKind::glossy;
        const Vec3 base = material.base_color;
        const float cos_view = view_.z;
        const float cos_diffuse_view = diffuse_is_tilted() ? dot(frame_.to_world(view_), diffuse_normal_) : cos_view;
        const bool gives_back = material.multiscatter > 0.0f;

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

        // Of an anisotropic lobe the roughness that tables know is the fourth root of both alphas' product.
        alpha_ = find_alpha(material);
        const float roughness = std::sqrt(std::sqrt(alpha_.x * alpha_.y));
        float energy = 1.0f, mean_energy = 1.0f;
        if (is_principled || is_glossy) {
            energy = look_up_albedo(tables, energy_table, roughness, cos_view);
            mean_energy = look_up_albedo(tables, mean_energy_table, roughness);
        }

        // Metal, and GLOSSY, whose Fresnel term is its colour from all directions.
        const float metallic = is_principled ? material.metallic : is_glossy ? 1.0f : 0.0f;
        Vec3 specular;
        if (metallic > 0.0f) {
            metal_f0_ = base;
            metal_f90_ = is_glossy ? base : Vec3{1, 1, 1};
            // Schlick's term at 82 degrees, where the tint is what remains of it.
            constexpr float x = 6.0f / 7.0f, x5 = x * x * x * x * x;
            if (!is_glossy)
                metal_dip_ = lerp(base, {1, 1, 1}, x5) * (1.0f - material.specular_tint) * (7.0f / (x5 * x));
            const Vec3 mean = lerp(metal_f0_, metal_f90_, 1.0f / 21.0f) - metal_dip_ / 126.0f;
            metal_ = below * metallic;
            if (gives_back) metal_ *= given_back(energy, mean_energy, mean);
            const float s = look_up_albedo(tables, schlick_table, roughness, cos_view), c = saturate(cos_view);
            const Vec3 dip = metal_dip_ * (c * square((1.0f - c) * square(1.0f - c)));
            specular = metal_ * min(max(lerp(metal_f0_, metal_f90_, s) - dip, 0.0f), Vec3{1, 1, 1}) * energy;
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

        if (is_principled) {
            float f0 = normal_reflectance(material.ior) * 2.0f * material.specular_ior_level;
            plastic_eta_ = material.ior;
            if (material.specular_ior_level != 0.5f) {
                const float root = std::sqrt(min(f0, largest_f0));
                plastic_eta_ = (1.0f + root) / (1.0f - root);
                if (material.ior < 1.0f) plastic_eta_ = 1.0f / plastic_eta_;
            }
            if (plastic_eta_ != 1.0f && f0 > 0.0f) {
                plastic_f0_ = min(material.specular_tint * f0, Vec3{1, 1, 1});
                const float real_f0 = normal_reflectance(plastic_eta_);
                const float mean = saturate((dielectric_mean(plastic_eta_) - real_f0) / (1.0f - real_f0));
                Vec3 factor{1, 1, 1};
                if (gives_back) factor = given_back(energy, mean_energy, lerp(plastic_f0_, {1, 1, 1}, mean));
                const float s = dielectric_share(tables, roughness, cos_view, plastic_eta_);
                const Vec3 single = lerp(plastic_f0_, {1, 1, 1}, s);
                plastic_ = below * factor;
                specular += plastic_ * single * energy;
                // What is lost between microfacets is not given to the base.
                below *= saturate(1.0f - max_component(single * factor) * (gives_back ? energy : 1.0f));
            }
        }
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
            diffuse_probability_ = diffuse_sum / sum;
            sheen_probability_ = sheen_sum / sum;
            specular_probability_ = specular_sum / sum;
            coat_probability_ = coat_sum / sum;
            glass_probability_ = glass_sum / sum;
        }
    }

    SVGF_HD static Alpha find_alpha(const Material& material) {
        const float alpha = square(material.roughness);
        if constexpr (has_anisotropy) {
            if (material.kind == MaterialKind::glossy) {
                const float ratio = 1.0f - min(std::fabs(material.anisotropic), 0.99f);
                const float narrow = alpha * ratio, wide = min(alpha / ratio, 1.0f);
                return material.anisotropic < 0.0f ? Alpha{wide, narrow} : Alpha{narrow, wide};
            }
            if (material.kind == MaterialKind::principled) {
                const float aspect = std::sqrt(1.0f - saturate(material.anisotropic) * 0.9f);
                return {min(alpha / aspect, 1.0f), alpha * aspect};
            }
        }
        return {alpha, alpha};
    }

    // Lobe G of this weight; returns its albedo.
    SVGF_HD Vec3 find_glass(const float* tables, const Material& material, Vec3 weight, bool entering) {
        const bool is_principled = material.kind == MaterialKind::principled;
        const Vec3 base = material.base_color;
        const float cos_view = view_.z;
        glass_eta_ = entering ? material.ior : 1.0f / material.ior;
        glass_alpha_ = {square(material.roughness), square(material.roughness)};
        const float f0 = normal_reflectance(material.ior);
        glass_f0_ = is_principled ? material.specular_tint * f0 : Vec3{f0, f0, f0};
        transmission_tint_ = is_principled ? root(base) : base;
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

    // Without an interface there is nothing rough about glass: light goes straight on.
    SVGF_HD bool is_glass_smooth() const { return glass_alpha_.is_smooth() || glass_eta_ == 1.0f; }

    SVGF_HD static Vec3 root(Vec3 v) { return {std::sqrt(v.x), std::sqrt(v.y), std::sqrt(v.z)}; }
    SVGF_HD Vec3 mirrored() const { return {-view_.x, -view_.y, view_.z}; }
    SVGF_HD Vec3 specular_at(float cos_half_view) const {
        return plastic_ * fresnel_tinted(fresnel_dielectric(cos_half_view, plastic_eta_), plastic_eta_, plastic_f0_) +
               metal_ * fresnel_metal(metal_f0_, metal_f90_, metal_dip_, cos_half_view);
    }
    SVGF_HD bool diffuse_is_tilted() const {
        if constexpr (has_tilted_diffuse) return max_component(abs(diffuse_normal_)) > 0.0f;
        return false;
    }
    SVGF_HD bool coat_is_tilted() const {
        if constexpr (has_tilted_coats) return max_component(abs(coat_normal_)) > 0.0f;
        return false;
    }
    SVGF_HD Vec3 coat_at(float cos_half_view) const {
        const float value = coat_ * fresnel_dielectric(cos_half_view, coat_eta_);
        return {value, value, value};
    }

    // Lobe G at a microfacet.
    struct GlassEvents {
        Vec3 reflectance, transmittance;  // tinted
        float chance;                     // of choosing reflection
    };

    SVGF_HD GlassEvents glass_at(float cos_half_view) const {
        const float fresnel = fresnel_dielectric(cos_half_view, glass_eta_);
        GlassEvents events{{}, transmission_tint_, 0.0f};
        if (refracts_only_) {
            if (fresnel == 1.0f) events = {{}, {}, 1.0f};
        } else if (glass_eta_ != 1.0f) {
            const Vec3 reflectance = fresnel_tinted(fresnel, glass_eta_, glass_f0_);
            events.reflectance = reflectance * reflection_tint_;
            events.transmittance = (1.0f - reflectance) * transmission_tint_;
            const float reflected = sum(events.reflectance), both = reflected + sum(events.transmittance);
            events.chance = both > 0.0f ? reflected / both : 1.0f;
        }
        return events;
    }
    SVGF_HD static float sum(Vec3 v) { return v.x + v.y + v.z; }

    // light: in the local frame, and in the world. side: its cosine with the geometric normal.
    SVGF_HD BsdfValue evaluate_local(Vec3 light, float side, Vec3 world_light) const {
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
    SVGF_HD void add_diffuse(Vec3 light, float side, Vec3 world_light, BsdfValue& value) const {
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
            value.pdf = diffuse_probability_ * (cosine / pi);
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

    // Rotation of a local frame by the view's azimuth, or back by -1.
    SVGF_HD static Vec3 turned(Vec3 v, Vec3 view, float sense) {
        const float squared = view.x * view.x + view.y * view.y;
        if (!(squared > 1e-16f)) return v;
        const float scale = 1.0f / std::sqrt(squared), c = view.x * scale, s = view.y * scale * sense;
        return {c * v.x + s * v.y, c * v.y - s * v.x, v.z};
    }

    // Microfacets mirror light to view: D G2 / (4 NV NL) times NL, G2 height-correlated [Heitz14, Eq. 99]. Once for
    // each roughness: base, then coat, then glass where the base is anisotropic.
    SVGF_HD void add_reflection(Vec3 light, BsdfValue& value) const {
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
            const float spread = ggx_density(half, alpha) / (4.0f * view_.z);
            const float view_masking = ggx_masking(view_, alpha);
            const float shadowed = spread * 2.0f / (view_masking + ggx_masking(light, alpha));
            const float masked = spread * 2.0f / (1.0f + view_masking);
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
    SVGF_HD void add_tilted_coat(Vec3 world_light, BsdfValue& value) const {
        if (coat_alpha_.is_smooth() || !(coat_probability_ > 0.0f)) return;
        const Frame frame(coat_normal_);
        const Vec3 coat_view = frame.to_local(frame_.to_world(view_)), coat_light = frame.to_local(world_light);
        if (!(coat_view.z > 0.0f && coat_light.z > 0.0f)) return;
        const Vec3 half = normalize(coat_view + coat_light);
        const float spread = ggx_density(half, coat_alpha_) / (4.0f * coat_view.z);
        const float view_masking = ggx_masking(coat_view, coat_alpha_);
        value.specular +=
            coat_at(dot(coat_view, half)) * (spread * 2.0f / (view_masking + ggx_masking(coat_light, coat_alpha_)));
        value.pdf += coat_probability_ * (spread * 2.0f / (1.0f + view_masking));
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
        const float spread = ggx_density(half, glass_alpha_) * cos_half_view / view_.z * jacobian;
        const GlassEvents events = glass_at(cos_half_view);
        const float view_masking = ggx_masking(view_, glass_alpha_);
        value.specular += glass_ * events.transmittance *
                         (spread * 2.0f / (view_masking + ggx_masking(light, glass_alpha_)));
        value.pdf += glass_probability_ * (1.0f - events.chance) * spread * 2.0f / (1.0f + view_masking);
    }

    // Which side of the surface an event leads to.
    static constexpr float above_surface = 1.0f, below_surface = -1.0f;

    struct Event {
        BsdfEvent kind = BsdfEvent::none;  // none: the path ends
        Vec3 light;                        // local
        float side = 0;                    // above_surface or below_surface
        bool is_mirror = false;
        Vec3 mirror_weight{};  // of a mirror, over the probability of choosing it
        bool is_tilted = false;  // the side of the geometric normal alone counts

        SVGF_HD bool is_on_its_side() const { return is_tilted || light.z * side > 0.0f; }
    };

    SVGF_HD Event choose_event(Vec2 u, float lobe) const {
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
                        specular_at(view_.z) / specular_probability_};
            if constexpr (has_tilted_coats)
                if (is_coat && coat_is_tilted()) return choose_tilted_coat(u);
            if constexpr (has_coat)
                if (is_coat)
                    return {BsdfEvent::glossy, reflected, above_surface, smooth, coat_at(view_.z) / coat_probability_};
            if constexpr (has_transmission) {
                const float cos_half_view = dot(view_, half);
                const GlassEvents events = glass_at(cos_half_view);
                if (rest < events.chance * glass_probability_)
                    return {BsdfEvent::glossy, reflected, above_surface, smooth,
                            glass_ * events.reflectance / (events.chance * glass_probability_)};
                const Vec3 light = glass_eta_ == 1.0f ? -view_ : refract(view_, half, glass_eta_);
                return {BsdfEvent::transmission, light, below_surface, smooth,
                        glass_ * events.transmittance / ((1.0f - events.chance) * glass_probability_)};
            }
        }
        return {};
    }

    // light: in the frame of the diffuse normal.
    SVGF_HD Event tilted_diffuse_event(Vec3 light) const {
        const Vec3 local = frame_.to_local(Frame(diffuse_normal_).to_world(light));
        return {BsdfEvent::diffuse, local, above_surface, false, {}, true};
    }

    SVGF_HD Event choose_tilted_coat(Vec2 u) const {
        const Frame frame(coat_normal_);
        const Vec3 coat_view = frame.to_local(frame_.to_world(view_));
        const bool smooth = coat_alpha_.is_smooth();
        const Vec3 half = smooth ? Vec3{0, 0, 1} : sample_visible_normal(coat_view, coat_alpha_, u);
        const Vec3 light = reflect(coat_view, half);
        if (!(coat_view.z > 0.0f && light.z > 0.0f)) return {};
        return {BsdfEvent::glossy, frame_.to_local(frame.to_world(light)), above_surface, smooth,
                coat_at(coat_view.z) / coat_probability_, true};
    }

    // A microfacet may send light to the wrong side. That light is lost: evaluated there, it would pass for what the
    // other event sends.
    SVGF_HD BsdfSample finish(const Event& event) const {
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
        result.weight.diffuse = result.weight.diffuse / result.weight.pdf;
        result.weight.specular = result.weight.specular / result.weight.pdf;
        result.event = event.kind;
        return result;
    }

    SVGF_HD BsdfSample finish_mirror(const Event& event) const {
        BsdfSample result;
        result.direction = normalize(frame_.to_world(event.light));
        result.delta = true;
        const float side = dot(geometric_normal, result.direction);
        if (!(event.is_on_its_side() && side * event.side > 0.0f)) return result;
        result.weight.specular = event.mirror_weight;
        result.event = event.kind;
        return result;
    }

    Frame frame_;
    Vec3 view_;  // local, as are all directions below
    Vec3 smooth_normal_;
    Vec3 diffuse_;  // weights of the lobes, with all factors but Fresnel's terms
    Vec3 diffuse_normal_;  // in the world; 0: that of the other lobes
    bool transmits_diffuse_ = false;
    OrenNayar oren_nayar_;
    Sheen sheen_;
    Vec3 sheen_weight_;
    Alpha alpha_;
    Vec3 plastic_, plastic_f0_;
    float plastic_eta_ = 1;
    Vec3 metal_, metal_f0_, metal_f90_, metal_dip_;
    float coat_ = 0, coat_eta_ = 1;
    Alpha coat_alpha_;
    Vec3 coat_normal_;  // as diffuse_normal_
    Vec3 glass_, glass_f0_, reflection_tint_, transmission_tint_;
    float glass_eta_ = 1;  // IOR beyond the surface over IOR on the viewer's side
    Alpha glass_alpha_;
    bool refracts_only_ = false;
    float diffuse_probability_ = 0, sheen_probability_ = 0, specular_probability_ = 0, coat_probability_ = 0;
    float glass_probability_ = 0;
};

}  // namespace svgf
