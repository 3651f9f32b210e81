// SPDX-License-Identifier: Apache-2.0
// Lamps, emissive triangles and the environment: choosing one, sampling a point on it, and the densities of the same
// for rays that run into one.
//
// Densities are per solid angle and hold the probability of choosing the light. A lamp without size has density 1 for
// its only direction.
#pragma once

#include "core/approximate.h"
#include "core/effects.h"
#include "core/sampling.h"
#include "core/vec.h"
#include "scene/flat_scene.h"
#include "trace/environment.h"
#include "trace/intersect.h"
#include "trace/light_tree.h"
#include "trace/texture.h"

namespace svgf {

// Shadow rays end this much of their length before the light.
constexpr float shadow_ray_end = 1.0f - 1e-4f;

struct LightSample {
    Vec3 direction;  // unit, towards the light
    float distance = infinity;
    Vec3 radiance;
    float pdf = 0;  // 0: no light comes from there
    bool delta = false;
};

struct LightChoice {
    std::int32_t index = -1;  // -1: no light
    float probability = 0;
};

// One light for a point. normal: Bsdf::lit_normal() of the receiver.
template <Effects kernel>
SVGF_HD LightChoice choose_light(const LightsView& lights, Vec3 point, Vec3 normal, Vec2 u) {
    if constexpr (covers(kernel, Effects::many_lights)) {
        if (lights.choices > 1) {
            LightChoice choice;
            choice.probability = find_light_choice(lights, point, normal, u, choice.index);
            return choice;
        }
    }
    return {lights.only, 1.0f};
}

// The probability with which choose_light would have chosen a light.
template <Effects kernel>
SVGF_HD float choice_probability(const LightsView& lights, const Light& light, Vec3 point, Vec3 normal) {
    if constexpr (covers(kernel, Effects::many_lights)) {
        if (lights.choices > 1) {
            std::int32_t index = std::int32_t(&light - lights.rows);
            return find_light_choice(lights, point, normal, {}, index);
        }
    }
    return &light == lights.rows + lights.only ? 1.0f : 0.0f;
}

// 1 - cosine of half the angle under which a sphere is seen; from within 2, all directions. Without the difference.
SVGF_HD inline float sphere_cone(float radius, float distance_squared) {
    if (distance_squared <= radius * radius) return 2.0f;
    const float sine_squared = fast_quotient(radius * radius, distance_squared);
    return fast_quotient(sine_squared, 1.0f + fast_sqrt(max(0.0f, 1.0f - sine_squared)));
}

SVGF_HD inline float sun_cone(const Light& sun) { return fast_quotient(sun.size.x * sun.size.x, 1.0f + sun.size.y); }

SVGF_HD inline float cone_density(float one_minus_cosine) { return fast_reciprocal(2.0f * pi * one_minus_cosine); }

// Of a disk that faces the point from which it is seen at this distance; cosine: of the direction with its axis.
SVGF_HD inline float disk_density(float distance, float cosine, float radius) {
    return fast_quotient(distance * distance, cosine * pi * radius * radius);
}

// Where a ray enters a sphere, or leaves it from within. One that passes by: the point closest to the centre, and
// misses is set.
SVGF_HD inline float sphere_distance(Vec3 to_centre, Vec3 direction, float radius, bool& misses) {
    const float along = dot(to_centre, direction);
    const Vec3 beside = to_centre - direction * along;
    const float half_chord_squared = radius * radius - dot(beside, beside);
    const float half_chord = fast_sqrt(max(half_chord_squared, 0.0f));
    misses = !(half_chord_squared >= 0.0f);
    return dot(to_centre, to_centre) <= radius * radius ? along + half_chord : along - half_chord;
}

// direction: towards the lamp. 1 for what is no spot.
SVGF_HD inline float spot_attenuation(const Light& light, Vec3 direction) {
    if (light.kind != LightKind::spot) return 1.0f;
    const float t = saturate((dot(direction, light.axis_z) - light.cos_half_spot) * light.spot_scale);
    return t * t * (3.0f - 2.0f * t);
}

// Of an area lamp behind a grid of slats that hide it from where it is seen at an angle; 1 for a full spread. cosine:
// of the angle, > 0. As Cycles has it: max(0, tan(half spread) - tan(angle)), normalized.
SVGF_HD inline float spread_attenuation(const Light& light, float cosine) {
    if (!(light.spot_scale > 0.0f)) return 1.0f;
    const float tangent = fast_quotient(fast_sqrt((1.0f - cosine) * (1.0f + cosine)), cosine);
    return max(0.0f, light.cos_half_spot - tangent) * light.spot_scale;
}

// Where the emission of triangles is an image: its value at a point of one, given the weights of the edges.
SVGF_HD SVGF_NOINLINE inline Vec3 sample_emission_map(const SceneView& scene, const Light& light, Vec2 share) {
    const EmissionMap& map = scene.lights.emission_maps[light.emission_map];
    const Vec2 edge1 = map.corner[1] - map.corner[0], edge2 = map.corner[2] - map.corner[0];
    const Vec2 uv = map.corner[0] + edge1 * share.x + edge2 * share.y;
    return sample_texture(scene.textures[map.texture], uv).xyz();
}

// A point on a light as seen from `point`. probability: with which the light was chosen.
template <Effects kernel>
SVGF_HD LightSample sample_light(const SceneView& scene, const Light& light, float probability, Vec3 point, Vec2 u) {
    LightSample sample;
    sample.radiance = light.radiance;
    sample.delta = light.is_delta != 0.0f;
    sample.pdf = 1.0f;
    switch (light.kind) {
        case LightKind::sun:
            sample.direction = light.axis_z;
            if (!sample.delta) {
                const float cone = sun_cone(light);
                sample.direction = Frame(light.axis_z).to_world(sample_cone(u, cone));
                sample.pdf = cone_density(cone);
            }
            break;
        case LightKind::point:
        case LightKind::spot: {
            const Vec3 to_centre = light.position - point;
            const float distance_squared = dot(to_centre, to_centre);
            sample.direction = normalize(to_centre);
            if (sample.delta) {
                sample.distance = fast_sqrt(distance_squared);
                sample.radiance *= fast_reciprocal(distance_squared);
            } else if (light.soft_falloff != 0.0f) {
                const Frame frame(sample.direction);
                const Vec2 disk = sample_unit_disk(u) * light.size.x;
                const Vec3 to_light = to_centre + frame.to_world({disk.x, disk.y, 0.0f});
                sample.distance = length(to_light);
                const float cosine = fast_quotient(fast_sqrt(distance_squared), sample.distance);
                sample.direction = to_light * fast_reciprocal(sample.distance);
                sample.pdf = disk_density(sample.distance, cosine, light.size.x);
            } else {
                const float cone = sphere_cone(light.size.x, distance_squared);
                bool misses;
                sample.direction = normalize(Frame(sample.direction).to_world(sample_cone(u, cone)));
                sample.distance = sphere_distance(to_centre, sample.direction, light.size.x, misses);
                sample.pdf = cone_density(cone);
            }
            sample.radiance *= spot_attenuation(light, sample.direction);
            break;
        }
        case LightKind::rectangle:
        case LightKind::ellipse:
        case LightKind::triangle: {
            Vec2 share;
            if (light.kind == LightKind::triangle) {
                share = sample_triangle(u);
            } else if (light.kind == LightKind::ellipse) {
                const Vec2 disk = sample_unit_disk(u) * 0.5f;
                share = {disk.x * light.size.x, disk.y * light.size.y};
            } else {
                share = {(u.x - 0.5f) * light.size.x, (u.y - 0.5f) * light.size.y};
            }
            const Vec3 to_light = light.position - point + light.axis_x * share.x + light.axis_y * share.y;
            sample.distance = length(to_light);
            sample.direction = to_light * fast_reciprocal(sample.distance);
            // Lamps shine along -axis_z alone, triangles both ways.
            float cosine = dot(sample.direction, light.axis_z);
            if (light.kind == LightKind::triangle) {
                cosine = std::fabs(cosine);
                if constexpr (covers(kernel, Effects::textures | Effects::mesh_lights))
                    if (light.emission_map >= 0) sample.radiance *= sample_emission_map(scene, light, share);
            } else if (cosine > 0.0f) {
                sample.radiance *= spread_attenuation(light, cosine);
            }
            sample.pdf = cosine > 0.0f ? fast_quotient(sample.distance * sample.distance, cosine * light.area) : 0.0f;
            break;
        }
        case LightKind::environment:
            if constexpr (covers(kernel, Effects::environment_map)) {
                sample.direction = sample_environment(scene.world, u, sample.pdf);
                sample.radiance = environment_radiance(scene, sample.direction);
            } else {
                sample.pdf = 0.0f;
            }
            break;
    }
    // From a point on the light itself, or a density without bound, nothing comes.
    if (!(is_finite(sample.pdf) && is_finite(sample.radiance) && sample.distance > 0.0f)) sample.pdf = 0.0f;
    sample.pdf *= probability;
    return sample;
}

// Light of a lamp that a ray crosses between t_min and t_hit, which is infinite where it hits nothing. Returns false
// where it does not; else radiance is set, and pdf, without the probability of choosing the lamp. Lamps without size
// are never crossed.
SVGF_HD inline bool cross_lamp(const Light& light, Vec3 origin, Vec3 direction, float t_min, float t_hit,
                               Vec3& radiance, float& pdf) {
    if (light.is_delta != 0.0f || light.kind == LightKind::environment) return false;
    float spread = 1.0f;
    if (light.kind == LightKind::sun) {
        // By the sine: the cosine of a small angle has few digits left.
        const Vec3 sine = cross(direction, light.axis_z);
        if (t_hit < infinity || dot(direction, light.axis_z) < 0.0f || dot(sine, sine) > light.size.x * light.size.x)
            return false;
        pdf = cone_density(sun_cone(light));
    } else if (light.soft_falloff != 0.0f) {
        const Vec3 to_centre = light.position - origin;
        const float centre_distance = length(to_centre);
        const float cosine = fast_quotient(dot(direction, to_centre), centre_distance);
        const float t = fast_quotient(centre_distance, cosine);
        if (!(cosine > 0.0f && t > t_min && t < t_hit)) return false;
        const Vec3 beside = direction * t - to_centre;
        if (!(dot(beside, beside) <= light.size.x * light.size.x)) return false;
        pdf = disk_density(t, cosine, light.size.x);
    } else if (light.kind == LightKind::point || light.kind == LightKind::spot) {
        const Vec3 to_centre = light.position - origin;
        bool misses;
        const float t = sphere_distance(to_centre, direction, light.size.x, misses);
        if (misses || !(t > t_min && t < t_hit)) return false;
        pdf = cone_density(sphere_cone(light.size.x, dot(to_centre, to_centre)));
    } else {
        const float cosine = dot(direction, light.axis_z);
        const float t = fast_quotient(dot(light.position - origin, light.axis_z), cosine);
        if (!(cosine > 0.0f && t > t_min && t < t_hit)) return false;
        const Vec3 local = origin + direction * t - light.position;
        const float x = fast_quotient(dot(local, light.axis_x), light.size.x);
        const float y = fast_quotient(dot(local, light.axis_y), light.size.y);
        const bool inside = light.kind == LightKind::ellipse ? x * x + y * y <= 0.25f
                                                             : std::fabs(x) <= 0.5f && std::fabs(y) <= 0.5f;
        if (!inside) return false;
        pdf = fast_quotient(t * t, cosine * light.area);
        spread = spread_attenuation(light, cosine);
    }
    radiance = light.radiance * (spot_attenuation(light, direction) * spread);
    return true;
}

// The light that a hit triangle is; null where its emission is in no light.
SVGF_HD inline const Light* find_light(const SceneView& scene, const Hit& hit) {
    const std::uint32_t emitter = scene.instances[hit.instance].emitter;
    if (emitter == 0) return nullptr;
    const Emitter& row = scene.lights.emitters[emitter - 1];
    const std::int32_t number = scene.lights.light_of_triangle[row.table + hit.triangle];
    return number < 0 ? nullptr : scene.lights.rows + row.first_light + number;
}

// Density of a triangle that a ray hits at distance t, without the probability of choosing it.
SVGF_HD inline float triangle_density(const Light& light, float t, float cosine) {
    return fast_quotient(t * t, std::fabs(cosine) * light.area);
}

}  // namespace svgf
