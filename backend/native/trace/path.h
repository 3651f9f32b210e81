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

// Light of one sample of a pixel.
struct Gathered {
    Vec3 emission, first, second;
};

// What a path carries from one vertex to the next.
struct Path {
    Ray ray;
    Vec3 throughput{1, 1, 1};
    Vec3 diffuse_share{1, 1, 1};  // of all light found after the first vertex
    float pdf = 0;                // of the BSDF sample that the ray follows; 0: a mirror's, or the camera's
};

// Light that arrives unless something stands in the ray's way.
struct ShadowRay {
    Ray ray;
    Vec3 light;  // all zero: there is none
    Vec3 diffuse_share;

    SVGF_HD bool exists() const { return max_component(light) > 0.0f; }
};

// The vertices of paths, apart from the rays between them.
template <Effects kernel>
struct PathVertices {
    SceneView scene;
    int bounces;
    bool splits_direct;  // signals: direct and indirect, else diffuse and specular
    bool two_signals;    // else the first one gets all

    // What the path finds where its ray ended, at vertex 0 first. Returns whether it goes on, with its next ray.
    SVGF_HD bool shade(const Sampler& sampler, int vertex, const Hit& hit, Path& path, Gathered& light,
                       ShadowRay& shadow) const {
        if (vertex == 0)
            path.ray.direction = normalize(path.ray.direction);
        else
            add_lamps(path, hit, vertex, light);
        if (!hit.found()) {
            if (vertex == 0)
                light.emission = scene.world_radiance;
            else
                add(light, path.throughput * scene.world_radiance, path.diffuse_share, vertex);
            return false;
        }
        const Surface surface = find_surface<kernel>(scene, hit, -path.ray.direction,
                                                     surface_choice<kernel>(sampler, vertex));
        if (max_component(surface.emission) > 0.0f) add_emission(path, surface, hit, vertex, light);
        if (vertex == bounces + 1) return false;  // the last ray only looks for light

        const Vec2 lobe_and_roulette = sampler.pair(SamplePair::lobe_and_roulette, vertex);
        if (vertex >= roulette_start) {
            const float survival = min(1.0f, max_component(path.throughput));
            if (!(lobe_and_roulette.y < survival)) return false;
            path.throughput = path.throughput / survival;
        }
        const Bsdf<kernel> bsdf(scene, surface, -path.ray.direction);
        if (scene.light_count > 0) find_direct_light(sampler, path, surface, bsdf, vertex, shadow);

        const BsdfSample next = bsdf.sample(sampler.pair(SamplePair::direction, vertex), lobe_and_roulette.x);
        if (vertex == 0) path.diffuse_share = share_of(next.weight);
        path.throughput *= next.weight.total();
        if (!(max_component(path.throughput) > 0.0f) || !is_finite(path.throughput)) return false;
        path.pdf = next.delta ? 0.0f : next.weight.pdf;
        path.ray = {offset_from_surface(surface, next.direction), next.direction};
        return true;
    }

    // edges: rays from the first hit to the light. A value that is not finite is dropped.
    SVGF_HD void add(Gathered& light, Vec3 value, Vec3 diffuse_share, int edges) const {
        if (!is_finite(value)) return;
        if (splits_direct) {
            (edges == 1 ? light.first : light.second) += value;
        } else if (covers(kernel, Effects::specular) && two_signals) {
            light.first += diffuse_share * value;
            light.second += (1.0f - diffuse_share) * value;
        } else {
            light.first += value;
        }
    }

private:
    SVGF_HD Vec3 share_of(const BsdfValue& value) const {
        if constexpr (covers(kernel, Effects::specular)) return value.diffuse_share();
        return {1, 1, 1};
    }

    // Weight of light that the ray ran into; a mirror direction is found in no other way.
    SVGF_HD static float hit_weight(const Path& path, float light_pdf) {
        return path.pdf == 0.0f ? 1.0f : power_heuristic(path.pdf, light_pdf);
    }

    // Lamps stop no ray: all that are crossed before the hit shine. Primary rays do not see them.
    SVGF_HD void add_lamps(const Path& path, const Hit& hit, int vertex, Gathered& light) const {
        if (scene.sized_lamp_count == 0) return;
        for (int i = 0; i < scene.lamp_count; ++i) {
            Vec3 radiance;
            float pdf;
            if (cross_lamp(scene.lights[i], path.ray.origin, path.ray.direction, hit.t, radiance, pdf))
                add(light, path.throughput * radiance * hit_weight(path, pdf), path.diffuse_share, vertex);
        }
    }

    SVGF_HD void add_emission(const Path& path, const Surface& surface, const Hit& hit, int vertex,
                              Gathered& light) const {
        const Vec3 emission = surface.emission;
        if (vertex == 0) {
            light.emission = emission;
            return;
        }
        const float pdf = triangle_density(scene, scene.materials[surface.material_index].light_emission, hit.t,
                                           dot(surface.geometric_normal, path.ray.direction));
        add(light, path.throughput * emission * hit_weight(path, pdf), path.diffuse_share, vertex);
    }

    SVGF_HD void find_direct_light(const Sampler& sampler, const Path& path, const Surface& surface,
                                   const Bsdf<kernel>& bsdf, int vertex, ShadowRay& shadow) const {
        const int index = choose_light(scene, sampler.pair(SamplePair::light, vertex).x);
        const LightSample found = sample_light(scene.lights[index], surface.position,
                                               sampler.pair(SamplePair::light_point, vertex));
        if (!(found.pdf > 0.0f)) return;
        const BsdfValue value = bsdf.evaluate(found.direction);
        const float mis = found.delta ? 1.0f : power_heuristic(found.pdf, value.pdf);
        const Vec3 arriving = path.throughput * value.total() * found.radiance * (mis / found.pdf);
        if (!(max_component(arriving) > 0.0f)) return;
        const Vec3 origin = offset_from_surface(surface, found.direction);
        shadow = {{origin, found.direction, 0.0f, found.distance * shadow_ray_end},
                  arriving,
                  vertex == 0 ? share_of(value) : path.diffuse_share};
    }
};

// Images of a frame, to which samples are added.
struct RadianceImages {
    bool first_of_frame;  // overwrites the images, else adds to them
    float weight;         // of this sample in the images
    Vec3* out_emission;
    Vec3* out_first_signal;
    Vec3* out_second_signal;  // null: the first one gets all

    SVGF_HD void add(int pixel, const Gathered& light) const {
        accumulate(out_emission[pixel], light.emission);
        accumulate(out_first_signal[pixel], light.first);
        if (out_second_signal) accumulate(out_second_signal[pixel], light.second);
    }

private:
    SVGF_HD void accumulate(Vec3& out, Vec3 value) const {
        out = first_of_frame ? value * weight : out + value * weight;
    }
};

// A whole path at once, for the CPU. The GPU takes all paths from vertex to vertex together: trace/wavefront.h.
template <Effects kernel>
struct PathStage {
    PathVertices<kernel> vertices;
    Camera camera;
    std::uint32_t sample, seed;
    bool box_filter;
    const Hit* in_hit;  // of the primary rays; null: they are traced here
    RadianceImages out;

    SVGF_HD void operator()(int x, int y) const {
        const Sampler sampler(x, y, camera.width, seed, sample);
        const int pixel = y * camera.width + x;
        Path path{primary_ray(camera, pixel_point(x, y, sampler, box_filter))};
        Gathered light;
        for (int vertex = 0;; ++vertex) {
            const Hit hit = vertex == 0 && in_hit ? in_hit[pixel] : find_closest_hit(vertices.scene, path.ray);
            ShadowRay shadow;
            const bool goes_on = vertices.shade(sampler, vertex, hit, path, light, shadow);
            if (shadow.exists() && !is_occluded(vertices.scene, shadow.ray))
                vertices.add(light, shadow.light, shadow.diffuse_share, vertex + 1);
            if (!goes_on) break;
        }
        out.add(pixel, light);
    }
};

}  // namespace svgf
