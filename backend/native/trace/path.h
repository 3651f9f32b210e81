// SPDX-License-Identifier: Apache-2.0
// Stage "path": light that reaches the camera, by unidirectional path tracing.
//
// At each vertex light is looked for twice, by a point on a light (next-event estimation) and by the direction that
// the BSDF samples; multiple importance sampling weighs the two by the power heuristic [Veach97]. The light is
// written as two signals and as emission, which is what the camera sees shine by itself.
#pragma once

#include "core/effects.h"
#include "core/sampling.h"
#include "device/launch_shape.h"
#include "trace/bsdf.h"
#include "trace/camera.h"
#include "trace/gbuffer.h"
#include "trace/intersect.h"
#include "trace/lights.h"
#include "trace/surface.h"

namespace svgf {

// Paths of fewer vertices are never cut short.
constexpr int roulette_start = 3;

template <Effects kernel>
struct PathStage {
    // Six blocks leave 80 registers to a thread. The spills cost less than the warps gain: 23.4 ms instead of 26.4 ms
    // (H200, atrium, 1920x1080, 6 bounces).
    static constexpr LaunchShape launch_shape{8, 16, 6};

    SceneView scene;
    Camera camera;
    std::uint32_t sample, seed;
    int bounces;
    bool box_filter;
    bool splits_direct;   // signals: direct and indirect, else diffuse and specular
    bool first_of_frame;  // overwrites the images, else adds to them
    float weight;         // of this sample in the images

    const Hit* in_hit;  // of the primary rays; null: they are traced here
    Vec3* out_emission;
    Vec3* out_first_signal;
    Vec3* out_second_signal;  // null: the first one gets all

    SVGF_HD void operator()(int x, int y) const {
        const Sampler sampler(x, y, camera.width, seed, sample);
        const int pixel = y * camera.width + x;
        Gathered light;
        trace(sampler, pixel, primary_ray(camera, pixel_point(x, y, sampler, box_filter)), light);
        accumulate(out_emission[pixel], light.emission);
        accumulate(out_first_signal[pixel], light.first);
        if (out_second_signal) accumulate(out_second_signal[pixel], light.second);
    }

private:
    struct Gathered {
        Vec3 emission, first, second;
    };

    // What a path carries from one vertex to the next.
    struct Path {
        Vec3 throughput{1, 1, 1};
        Vec3 diffuse_share{1, 1, 1};  // of all light found after the first vertex
        float pdf = 0;                // of the BSDF sample that the ray follows
        bool delta = true;
    };

    SVGF_HD void trace(const Sampler& sampler, int pixel, Ray ray, Gathered& light) const {
        Path path;
        for (int vertex = 0;; ++vertex) {
            const Hit hit = vertex == 0 && in_hit ? in_hit[pixel] : find_closest_hit(scene, ray);
            if (vertex == 0)
                ray.direction = normalize(ray.direction);
            else
                add_lamps(path, ray, hit, vertex, light);
            if (!hit.found()) {
                if (vertex == 0)
                    light.emission = scene.world_radiance;
                else
                    add(light, path.throughput * scene.world_radiance, path.diffuse_share, vertex);
                return;
            }
            const Surface surface = find_surface<kernel>(scene, hit, -ray.direction,
                                                         surface_choice<kernel>(sampler, vertex));
            if (max_component(surface.emission) > 0.0f) add_emission(path, surface, ray, hit, vertex, light);
            if (vertex == bounces + 1) return;  // the last ray only looks for light

            const Vec2 lobe_and_roulette = sampler.pair(SamplePair::lobe_and_roulette, vertex);
            if (vertex >= roulette_start) {
                const float survival = min(1.0f, max_component(path.throughput));
                if (!(lobe_and_roulette.y < survival)) return;
                path.throughput = path.throughput / survival;
            }
            const Bsdf<kernel> bsdf(scene, surface, -ray.direction);
            if (scene.light_count > 0) add_direct_light(sampler, path, surface, bsdf, vertex, light);

            const BsdfSample next = bsdf.sample(sampler.pair(SamplePair::direction, vertex), lobe_and_roulette.x);
            if (vertex == 0) path.diffuse_share = share_of(next.weight);
            path.throughput *= next.weight.total();
            if (!(max_component(path.throughput) > 0.0f) || !is_finite(path.throughput)) return;
            path.pdf = next.weight.pdf;
            path.delta = next.delta;
            ray = {offset_from_surface(surface, next.direction), next.direction};
        }
    }

    SVGF_HD Vec3 share_of(const BsdfValue& value) const {
        if constexpr (covers(kernel, Effects::specular)) return value.diffuse_share();
        return {1, 1, 1};
    }

    // edges: rays from the first hit to the light. A value that is not finite is dropped.
    SVGF_HD void add(Gathered& light, Vec3 value, Vec3 diffuse_share, int edges) const {
        if (!is_finite(value)) return;
        if (splits_direct) {
            (edges == 1 ? light.first : light.second) += value;
        } else if (covers(kernel, Effects::specular) && out_second_signal) {
            light.first += diffuse_share * value;
            light.second += (1.0f - diffuse_share) * value;
        } else {
            light.first += value;
        }
    }

    // Weight of light that the ray ran into; a mirror direction is found in no other way.
    SVGF_HD static float hit_weight(const Path& path, float light_pdf) {
        return path.delta ? 1.0f : power_heuristic(path.pdf, light_pdf);
    }

    // Lamps stop no ray: all that are crossed before the hit shine. Primary rays do not see them.
    SVGF_HD void add_lamps(const Path& path, const Ray& ray, const Hit& hit, int vertex, Gathered& light) const {
        if (scene.sized_lamp_count == 0) return;
        for (int i = 0; i < scene.lamp_count; ++i) {
            Vec3 radiance;
            float pdf;
            if (cross_lamp(scene.lights[i], ray.origin, ray.direction, hit.t, radiance, pdf))
                add(light, path.throughput * radiance * hit_weight(path, pdf), path.diffuse_share, vertex);
        }
    }

    SVGF_HD void add_emission(const Path& path, const Surface& surface, const Ray& ray, const Hit& hit, int vertex,
                              Gathered& light) const {
        const Vec3 emission = surface.emission;
        if (vertex == 0) {
            light.emission = emission;
            return;
        }
        const float pdf = triangle_density(scene, scene.materials[surface.material_index].light_emission, hit.t, dot(surface.geometric_normal, ray.direction));
        add(light, path.throughput * emission * hit_weight(path, pdf), path.diffuse_share, vertex);
    }

    SVGF_HD void add_direct_light(const Sampler& sampler, const Path& path, const Surface& surface,
                                  const Bsdf<kernel>& bsdf, int vertex, Gathered& light) const {
        const int index = choose_light(scene, sampler.pair(SamplePair::light, vertex).x);
        const LightSample found = sample_light(scene.lights[index], surface.position,
                                               sampler.pair(SamplePair::light_point, vertex));
        if (!(found.pdf > 0.0f)) return;
        const BsdfValue value = bsdf.evaluate(found.direction);
        const float mis = found.delta ? 1.0f : power_heuristic(found.pdf, value.pdf);
        const Vec3 arriving = path.throughput * value.total() * found.radiance * (mis / found.pdf);
        if (!(max_component(arriving) > 0.0f)) return;
        const Vec3 origin = offset_from_surface(surface, found.direction);
        if (is_occluded(scene, {origin, found.direction, 0.0f, found.distance * shadow_ray_end})) return;
        add(light, arriving, vertex == 0 ? share_of(value) : path.diffuse_share, vertex + 1);
    }

    SVGF_HD void accumulate(Vec3& out, Vec3 value) const {
        out = first_of_frame ? value * weight : out + value * weight;
    }
};

}  // namespace svgf
