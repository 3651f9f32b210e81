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
// Directions point away from the surface; what lies on the wrong side of the geometric normal is black, of light that
// is aimed at on the wrong side as trace/shadow_terminator.h knows it.
// Under a normal map, D and H have the map's normal, of which S and G take what keeps their reflections above the
// surface, and C the smooth one unless told otherwise. A lobe whose normal is not that of S is called tilted.
//
//   bsdf.h           what a Bsdf gives, and what it holds
//   bsdf_lobes.h     from a material to its lobes
//   bsdf_evaluate.h  value and density for a direction
//   bsdf_sample.h    the choice of a direction
#pragma once

#include "core/effects.h"
#include "core/sampling.h"
#include "trace/diffuse.h"
#include "trace/layers.h"
#include "trace/microfacet.h"
#include "trace/shading_normal.h"
#include "trace/surface.h"

namespace svgf {

// Lobe values times |cosine|, and the density with which sample() finds the direction. Sheen counts as diffuse.
struct BsdfValue {
    Vec3 diffuse, specular;
    float pdf = 0;

    SVGF_HD Vec3 total() const { return diffuse + specular; }
    // Of the light from this direction, what belongs to the diffuse signal.
    SVGF_HD Vec3 diffuse_share() const {
        const Vec3 sum = total();
        // Exactly 1 where nothing is specular: the specular signal is then 0, as is its albedo.
        return {sum.x > 0.0f ? diffuse.x / sum.x : 0.0f, sum.y > 0.0f ? diffuse.y / sum.y : 0.0f,
                sum.z > 0.0f ? diffuse.z / sum.z : 0.0f};
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

    // side: > 0 where light comes from the viewer's side of the surface, < 0 from the other one.
    SVGF_HD BsdfValue evaluate(Vec3 light, float side) const {
        return evaluate_local(frame_.to_local(light), side, light);
    }

    // u: direction within the lobe. lobe: chooses D, H, S, C or G in this order; what is left of it reflection or
    // refraction. Events are chosen first and evaluated in one place, as evaluate() is much code for the instruction
    // cache.
    SVGF_HD BsdfSample sample(Vec2 u, float lobe) const {
        const Event event = choose_event(u, lobe);
        return event.is_mirror ? finish_mirror(event) : finish(event);
    }

    SVGF_HD SmoothBounce find_smooth_bounce() const;

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

    // From a material to its lobes: bsdf_lobes.h. What the tables hold of lobe S, towards the viewer:
    struct SpecularEnergy {
        float roughness, energy = 1, mean_energy = 1;
    };
    SVGF_HD void turn_frame(const Surface& surface);
    SVGF_HD void find_lobes(const float* tables, const Surface& surface, bool entering);
    SVGF_HD static Alpha find_alpha(const Material& material);
    SVGF_HD SpecularEnergy find_specular_energy(const float* tables, const Material& material) const;
    SVGF_HD Vec3 find_metal(const float* tables, const Material& material, Vec3 weight, SpecularEnergy table);
    SVGF_HD Vec3 find_glass(const float* tables, const Material& material, Vec3 weight, bool entering);
    SVGF_HD Vec3 find_plastic(const float* tables, const Material& material, SpecularEnergy table, Vec3& below);

    // Without an interface there is nothing rough about glass: light goes straight on.
    SVGF_HD bool is_glass_smooth() const { return glass_alpha_.is_smooth() || glass_eta_ == 1.0f; }

    SVGF_HD bool diffuse_is_tilted() const {
        if constexpr (has_tilted_diffuse) return max_component(abs(diffuse_normal_)) > 0.0f;
        return false;
    }
    SVGF_HD bool coat_is_tilted() const {
        if constexpr (has_tilted_coats) return max_component(abs(coat_normal_)) > 0.0f;
        return false;
    }
    SVGF_HD Vec3 mirrored() const { return {-view_.x, -view_.y, view_.z}; }

    // Lobes S, C and G at a microfacet: weight times Fresnel's term.
    SVGF_HD Vec3 specular_at(float cos_half_view) const {
        return plastic_ * fresnel_tinted(fresnel_dielectric(cos_half_view, plastic_eta_), plastic_eta_, plastic_f0_) +
               metal_ * fresnel_metal(metal_f0_, metal_f90_, metal_dip_, cos_half_view);
    }
    SVGF_HD Vec3 coat_at(float cos_half_view) const {
        const float value = coat_ * fresnel_dielectric(cos_half_view, coat_eta_);
        return {value, value, value};
    }

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

    // bsdf_evaluate.h
    SVGF_HD BsdfValue evaluate_local(Vec3 light, float side, Vec3 world_light) const;
    SVGF_HD void add_diffuse(Vec3 light, float side, Vec3 world_light, BsdfValue& value) const;
    SVGF_HD void add_reflection(Vec3 light, BsdfValue& value) const;
    SVGF_HD void add_tilted_coat(Vec3 world_light, BsdfValue& value) const;
    SVGF_HD void add_refraction(Vec3 light, BsdfValue& value) const;

    // Rotation of a local frame by the view's azimuth, or back by -1.
    SVGF_HD static Vec3 turned(Vec3 v, Vec3 view, float sense) {
        const float squared = view.x * view.x + view.y * view.y;
        if (!(squared > 1e-16f)) return v;
        const float scale = fast_reciprocal_sqrt(squared), c = view.x * scale, s = view.y * scale * sense;
        return {c * v.x + s * v.y, c * v.y - s * v.x, v.z};
    }

    // bsdf_sample.h. Which side of the surface an event leads to:
    static constexpr float above_surface = 1.0f, below_surface = -1.0f;

    struct Event {
        BsdfEvent kind = BsdfEvent::none;  // none: the path ends
        Vec3 light;                        // local
        float side = 0;                    // above_surface or below_surface
        bool is_mirror = false;
        Vec3 mirror_weight{};    // of a mirror, over the probability of choosing it
        bool is_tilted = false;  // the side of the geometric normal alone counts

        SVGF_HD bool is_on_its_side() const { return is_tilted || light.z * side > 0.0f; }
    };
    SVGF_HD Event choose_event(Vec2 u, float lobe) const;
    SVGF_HD Event tilted_diffuse_event(Vec3 light) const;
    SVGF_HD Event choose_tilted_coat(Vec2 u) const;
    SVGF_HD BsdfSample finish(const Event& event) const;
    SVGF_HD BsdfSample finish_mirror(const Event& event) const;

    Frame frame_;
    Vec3 view_;  // local, as are all directions below
    Vec3 smooth_normal_;
    Vec3 diffuse_;         // weights of the lobes, with all factors but Fresnel's terms
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

#include "trace/bsdf_evaluate.h"
#include "trace/bsdf_lobes.h"
#include "trace/bsdf_sample.h"
