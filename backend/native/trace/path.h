// SPDX-License-Identifier: Apache-2.0
// Stage "path": light that reaches the camera, by unidirectional path tracing.
//
// At each vertex light is looked for twice, by a point on a light (next-event estimation) and by the direction that
// the BSDF samples; multiple importance sampling weighs the two by the power heuristic [Veach97]. The light is
// written as two signals and as emission, which is what the camera sees shine by itself.
#pragma once

#include <cstddef>
#include <new>
#include <utility>

#include "core/effects.h"
#include "core/sampling.h"
#include "device/launch_shape.h"
#include "trace/bsdf.h"
#include "trace/camera.h"
#include "trace/gbuffer.h"
#include "trace/intersect.h"
#include "trace/light_paths.h"
#include "trace/lights.h"
#include "trace/opacity.h"
#include "trace/shadow_terminator.h"
#include "trace/surface.h"

namespace svgf {

// Paths of fewer bounces are never cut short.
constexpr int roulette_start = 3;

// Light of one sample of a pixel.
struct Gathered {
    Vec3 emission, first, second;
    float alpha = 1;
    float hit_distance = 0;  // see Tracer::trace

    SVGF_HD void add_emission(Vec3 value) { emission += value; }
    SVGF_HD void add_first(Vec3 value) { first += value; }
    SVGF_HD void add_second(Vec3 value) { second += value; }
    SVGF_HD void take_alpha(float value) { alpha -= value; }
    SVGF_HD void set_hit_distance(float value) { hit_distance = value; }
};

// What a path carries from one vertex to the next.
struct Path {
    Ray ray;
    Vec3 throughput{1, 1, 1};
    Vec3 diffuse_share{1, 1, 1};    // of all light found after the first vertex
    Vec3 normal;                    // Bsdf::lit_normal() of the vertex that the ray left
    float pdf = 0;                  // of the BSDF sample that the ray follows
    float smallest_pdf = infinity;  // of those so far
    int bounces = 0, diffuse_bounces = 0, glossy_bounces = 0, transmission_bounces = 0;
    int transparent_bounces = 0;  // these are not among the bounces
    int links = 0;                // bounces along the chain of trace/specular_chain.h
    bool on_chain = true;         // all bounces so far are; without a chain there are none
    bool delta = true;
    bool ends = false;  // the ray only looks for light
    bool measures_distance = false;  // the ray left the seen surface by a specular lobe
};

// A ray whose light is known and arrives as far as its way is free.
struct ShadowRay {
    Ray ray;
    Vec3 light;  // all zero: there is none
    Vec3 diffuse_share;
    int bounces = 0;   // between the camera and the light
    int links = 0;     // of these, along the chain
    int surfaces = 0;  // that it may pass straight at most

    SVGF_HD bool exists() const { return max_component(light) > 0.0f; }
};

// Where a vertex leaves the rays that it sends to lights. last: of its path, see find_last_ray.
struct LightRays {
    ShadowRay shadow, last;

    SVGF_HD void put_shadow(const ShadowRay& ray) { shadow = ray; }
    SVGF_HD void put_last(const ShadowRay& ray) { last = ray; }
};

// Is shown what the camera's rays see, on the way of their paths.
struct Unseen {
    SVGF_HD void background(const Path&) const {}
    template <class... Parts>
    SVGF_HD void surface(const Parts&...) const {}
};

// The vertices of paths, apart from the rays between them.
template <Effects kernel>
struct PathVertices {
    SceneView scene;
    LightPaths limits;
    bool transparent_film;
    bool splits_direct;  // signals: direct and indirect, else diffuse and specular
    bool two_signals;    // else the first one gets all
    bool follows_chains;          // the G-buffer is of what is seen in mirrors and through glass
    const Vec3* in_chain_light;   // what it holds of the pixels' light; null: nothing

    // Of a pixel's light what is known before its path starts.
    SVGF_HD Gathered start(int pixel) const {
        Gathered light;
        if (in_chain_light) light.emission = in_chain_light[pixel];
        return light;
    }

    // Where the ray of a path ends.
    SVGF_HD Hit find_hit(const Sampler& sampler, int vertex, const Ray& ray, int transparent_bounces) const {
        return find_path_hit<kernel>(scene, ray, sampler, vertex, allowed(transparent_bounces));
    }

    // What the path finds where its ray ended, at vertex 0 first. Returns whether it goes on, with its next ray. rays:
    // are given those to lights, the path's last one among them where what it looks for is known. seen: is shown what
    // the G-buffer holds.
    template <class Sum, class Rays, class Seen = Unseen>
    SVGF_HD bool shade(const Sampler& sampler, int vertex, const Hit& hit, Path& path, Sum& light, Rays& rays,
                       const Seen& seen = {}) const {
        Ray& ray = path.ray;
        const bool is_known = is_in_chain_light(path);
        path.transparent_bounces += hit.passed;
        if (!is_known && (scene.lights.sized_lamps_seen_by & ray.kind)) add_lamps(path, hit, light);
        if (!hit.found()) {
            if (path.measures_distance) light.set_hit_distance(background_depth);
            seen.background(path);
            if (!is_known) add_world(path, light);
            return false;
        }
        if (path.ends && !path.measures_distance && is_dark(hit)) return false;
        Surface surface =
            find_surface<kernel>(scene, hit, -ray.direction, surface_choice<kernel>(sampler, vertex, hit));
        if (!is_known && max_component(surface.emission) > 0.0f) add_emission(path, surface, hit, light);
        if constexpr (has_alpha) {
            // As in Cycles: the surface after the last that may be passed only shines, and one may always be passed.
            if (path.transparent_bounces >= max(limits.transparent_bounces, 1)) {
                seen.surface(path, surface, hit);
                return false;
            }
            if (max_component(surface.straight) > 0.0f) {
                // The same ray goes on, so that what it finds has the density with which it was sampled.
                ++path.transparent_bounces;
                path.throughput *= surface.straight;
                ray.t_min = hit.t;
                return true;
            }
        }
        if constexpr (covers(kernel, Effects::specular)) {
            if (path.measures_distance) light.set_hit_distance(hit.t);
            path.measures_distance = false;
        }
        if (path.ends) return false;

        const VertexSampler numbers(sampler, vertex);
        const Vec2 lobe_and_roulette = numbers.pair(SamplePair::lobe_and_roulette);
        if (path.bounces >= roulette_start) {
            const float survival = min(1.0f, max_component(path.throughput));
            if (!(lobe_and_roulette.y < survival)) return false;
            path.throughput *= fast_reciprocal(survival);
        }
        if constexpr (has_limits) simplify(path, surface.material);
        const Bsdf<kernel> bsdf(scene, surface, -ray.direction);
        seen.surface(path, surface, hit, bsdf);
        if (scene.lights.choices > 0) find_direct_light(numbers, path, surface, hit, bsdf, rays);

        BsdfSample next = bsdf.sample(numbers.pair(SamplePair::direction), lobe_and_roulette.x);
        if constexpr (has_limits) keep(next.weight, allowed_kinds(path), next.event == BsdfEvent::transmission);
        if (path.on_chain) leave_or_follow_chain(path, bsdf, next);
        path.throughput *= next.weight.total();
        if (!(max_component(path.throughput) > 0.0f) || !is_finite(path.throughput)) return false;
        count_bounce(path, next);
        path.normal = bsdf.lit_normal();
        ray = {offset_from_surface(surface, next.direction), next.direction, 0.0f, infinity, kind_of(next.event)};
        return !(path.ends && find_last_ray(path, rays));
    }

    // Adds what arrives of a shadow ray that left vertex `vertex`.
    SVGF_HD void add_arriving(const Sampler& sampler, int vertex, const ShadowRay& shadow, Gathered& light) const {
        if (!shadow.exists()) return;
        const Vec3 share = find_arriving(sampler, vertex, shadow.ray, shadow.surfaces);
        if (max_component(share) > 0.0f) add_share(shadow, share, light);
    }

    // The same in two steps.
    SVGF_HD Vec3 find_arriving(const Sampler& sampler, int vertex, const Ray& ray, int surfaces) const {
        return find_transmittance_along<kernel>(scene, ray, sampler, vertex, surfaces);
    }
    template <class Sum>
    SVGF_HD void add_share(const ShadowRay& shadow, Vec3 share, Sum& light) const {
        add(light, shadow.light * share, shadow.diffuse_share, shadow.bounces, shadow.links);
    }

private:
    static constexpr bool has_limits = covers(kernel, Effects::light_path_limits);
    static constexpr bool has_alpha = covers(kernel, Effects::alpha);

    // Surfaces that a path may still pass. One may always be passed.
    SVGF_HD int allowed(int transparent_bounces) const {
        return max(limits.transparent_bounces, 1) - transparent_bounces;
    }

    SVGF_HD bool is_in_chain_light(const Path& path) const {
        return in_chain_light && path.on_chain && path.links > 0;
    }

    // Where surfaces do not shine, and no lamp stands in its way, the last ray of a path finds what is infinitely far,
    // if it arrives there: it is a shadow ray. Returns false where it is not.
    template <class Rays>
    SVGF_HD bool find_last_ray(const Path& path, Rays& rays) const {
        if (!scene.last_hits_are_dark || path.measures_distance) return false;
        if (has_limits && limits.has_clamps()) return false;  // which are of what arrives at once
        Vec3 found;
        for (int i = 0; i < sized_lamp_count(path.ray); ++i) {
            const Light& lamp = scene.lights.rows[i];
            Vec3 value;
            if (!find_lamp(path, lamp, infinity, value)) continue;
            if (lamp.kind != LightKind::sun) return false;
            found += value;
        }
        found += find_world(path);
        if (is_in_chain_light(path)) found = {};
        rays.put_last(
            {path.ray, found, path.diffuse_share, path.bounces, path.links, allowed(path.transparent_bounces)});
        return true;
    }

    // Whether the last ray of a path finds nothing at a hit.
    SVGF_HD bool is_dark(const Hit& hit) const {
        if (scene.last_hits_are_dark) return true;
#if defined(__CUDACC__)
        return false;  // most of a warp would wait for the others all the same
#else
        const Instance& instance = scene.instances[hit.instance];
        const std::int32_t slot = scene.meshes[instance.mesh].triangles[hit.leaf_triangle].material_slot;
        return scene.dark_materials[scene.material_table[instance.material_start + slot]] != 0;
#endif
    }

    // At a surface of the chain. The first one that does not go on with it is what the pixel sees.
    SVGF_HD void leave_or_follow_chain(Path& path, const Bsdf<kernel>& bsdf, const BsdfSample& next) const {
        BsdfEvent chain_event = BsdfEvent::none;
        if constexpr (covers(kernel, Effects::specular))
            if (follows_chains) chain_event = bsdf.find_smooth_bounce().event;
        const bool goes_on =
            may_follow(limits, chain_event, path.links, path.glossy_bounces, path.transmission_bounces);
        path.on_chain = goes_on && next.delta && next.event == chain_event;
        if (path.on_chain) {
            ++path.links;
            return;
        }
        path.diffuse_share = share_of(next.weight);
        path.measures_distance =
            !goes_on && next.event != BsdfEvent::diffuse && max_component(next.weight.specular) > 0.0f;
    }

    // A limit is reached by one bounce more: the ray after it still finds the light that it runs into, as in Cycles.
    SVGF_HD void count_bounce(Path& path, const BsdfSample& next) const {
        path.pdf = next.weight.pdf;
        path.delta = next.delta;
        path.ends = ++path.bounces > limits.bounces;
        if constexpr (has_limits) {
            if (!next.delta) path.smallest_pdf = min(path.smallest_pdf, next.weight.pdf);
            if (next.event == BsdfEvent::diffuse)
                path.ends |= ++path.diffuse_bounces > limits.diffuse_bounces;
            else if (next.event == BsdfEvent::glossy)
                path.ends |= ++path.glossy_bounces > limits.glossy_bounces;
            else
                path.ends |= ++path.transmission_bounces > limits.transmission_bounces;
        }
    }

    SVGF_HD static std::uint32_t kind_of(BsdfEvent event) {
        return event == BsdfEvent::diffuse  ? ray_kind::diffuse
               : event == BsdfEvent::glossy ? ray_kind::glossy
                                            : ray_kind::transmission;
    }

    // What Cycles leaves out or blurs of a surface that is seen by a diffuse ray, or by one that few samples follow.
    SVGF_HD void simplify(const Path& path, Material& material) const {
        if (path.ray.kind == ray_kind::diffuse && !limits.reflective_caustics) material.specular_ior_level = 0.0f;
        if (!(limits.filter_glossy > 0.0f)) return;
        const float density = path.smallest_pdf / limits.filter_glossy;
        // GGX alpha is the square of roughness.
        if (density < 1.0f) material.roughness = max(material.roughness, std::sqrt(0.5f * std::sqrt(1.0f - density)));
    }

    SVGF_HD std::uint32_t allowed_kinds(const Path& path) const {
        std::uint32_t kinds = ray_kind::all;
        if constexpr (has_limits) {
            if (path.ray.kind == ray_kind::diffuse && !limits.reflective_caustics) kinds &= ~ray_kind::glossy;
            if (path.ray.kind == ray_kind::diffuse && !limits.refractive_caustics) kinds &= ~ray_kind::transmission;
        }
        return kinds;
    }

    // Leaves of a value what these kinds of rays carry. below: the direction is on the other side of the surface.
    SVGF_HD static void keep(BsdfValue& value, std::uint32_t kinds, bool below) {
        if (!(kinds & (below ? ray_kind::transmission : ray_kind::diffuse))) value.diffuse = {};
        if (!(kinds & (below ? ray_kind::transmission : ray_kind::glossy))) value.specular = {};
    }

    SVGF_HD Vec3 share_of(const BsdfValue& value) const {
        if constexpr (covers(kernel, Effects::specular)) return value.diffuse_share();
        return {1, 1, 1};
    }

    // bounces: between the camera and the light; links: those that lead to the seen surface. A value that is not finite
    // is dropped.
    template <class Sum>
    SVGF_HD void add(Sum& light, Vec3 value, Vec3 diffuse_share, int bounces, int links) const {
        if (!is_finite(value)) return;
        if constexpr (has_limits) value = limits.clamped(value, bounces);
        bounces -= links;
        if (bounces == 0) {
            light.add_emission(value);
        } else if (splits_direct && bounces > 1) {
            light.add_second(value);
        } else if (covers(kernel, Effects::specular) && two_signals && !splits_direct) {
            light.add_first(diffuse_share * value);
            light.add_second((1.0f - diffuse_share) * value);
        } else {
            light.add_first(value);
        }
    }

    // Light that the ray of a path ran into. light_pdf: with which it would have been sampled; not asked for a mirror
    // direction, which is found in no other way.
    template <class LightPdf>
    SVGF_HD Vec3 found_light(const Path& path, Vec3 radiance, const LightPdf& light_pdf) const {
        return path.throughput * radiance * (path.delta ? 1.0f : power_heuristic(path.pdf, light_pdf()));
    }
    template <class Sum>
    SVGF_HD void add(Sum& light, const Path& path, Vec3 value) const {
        add(light, value, path.diffuse_share, path.bounces, path.links);
    }

    // Of the lamps, which are the first lights, those that rays of a kind may run into.
    SVGF_HD int sized_lamp_count(const Ray& ray) const {
        return scene.lights.sized_lamps_seen_by & ray.kind ? scene.lights.lamp_count : 0;
    }
    // Whether the ray crosses a lamp before t_hit, and its light.
    SVGF_HD bool find_lamp(const Path& path, const Light& lamp, float t_hit, Vec3& value) const {
        const Ray& ray = path.ray;
        Vec3 radiance;
        float pdf;
        if (!(lamp.visibility & ray.kind)) return false;
        if (!cross_lamp(lamp, ray.origin, ray.direction, ray.t_min, t_hit, radiance, pdf)) return false;
        value = found_light(path, radiance, [&] {
            return pdf * choice_probability<kernel>(scene.lights, lamp, ray.origin, path.normal);
        });
        return true;
    }
    // Lamps stop no ray: all that are crossed before the hit shine.
    template <class Sum>
    SVGF_HD void add_lamps(const Path& path, const Hit& hit, Sum& light) const {
        for (int i = 0; i < sized_lamp_count(path.ray); ++i) {
            Vec3 value;
            if (find_lamp(path, scene.lights.rows[i], hit.t, value)) add(light, path, value);
        }
    }

    SVGF_HD Vec3 find_world(const Path& path) const {
        if (!(scene.world.visibility & path.ray.kind)) return {};
        const bool is_backdrop = path.ray.kind == ray_kind::camera;
        if constexpr (covers(kernel, Effects::environment_map)) {
            const std::int32_t row = scene.world.light;
            return found_light(path, environment_radiance(scene, path.ray.direction, is_backdrop), [&] {
                if (row < 0) return 0.0f;
                return environment_density(scene.world, path.ray.direction) *
                       choice_probability<kernel>(scene.lights, scene.lights.rows[row], path.ray.origin, path.normal);
            });
        }
        return path.throughput * (is_backdrop ? scene.world.backdrop_radiance : scene.world.radiance);
    }
    template <class Sum>
    SVGF_HD void add_world(const Path& path, Sum& light) const {
        if (transparent_film && path.bounces == 0)
            light.take_alpha((path.throughput.x + path.throughput.y + path.throughput.z) / 3.0f);
        else
            add(light, path, find_world(path));
    }

    template <class Sum>
    SVGF_HD void add_emission(const Path& path, const Surface& surface, const Hit& hit, Sum& light) const {
        add(light, path, found_light(path, surface.emission, [&] {
                const Light* row = find_light(scene, hit);
                if (!row) return 0.0f;
                const float cosine = dot(surface.geometric_normal, path.ray.direction);
                return triangle_density(*row, hit.t, cosine) *
                       choice_probability<kernel>(scene.lights, *row, path.ray.origin, path.normal);
            }));
    }

    template <class Rays>
    SVGF_HD void find_direct_light(const VertexSampler& numbers, const Path& path, const Surface& surface,
                                   const Hit& hit, const Bsdf<kernel>& bsdf, Rays& rays) const {
        const LightChoice choice = choose_light<kernel>(scene.lights, surface.position, bsdf.lit_normal(),
                                                        numbers.pair(SamplePair::light));
        if (choice.index < 0) return;
        const Light& row = scene.lights.rows[choice.index];
        const LightSample found = sample_light<kernel>(scene, row, choice.probability, surface.position,
                                                       numbers.pair(SamplePair::light_point));
        if (!(found.pdf > 0.0f)) return;
        const float side = find_light_side<kernel>(surface, bsdf.geometric_normal, found.direction);
        BsdfValue value = bsdf.evaluate(found.direction, side);
        if constexpr (has_limits || covers(kernel, Effects::ray_visibility))
            keep(value, row.visibility & allowed_kinds(path), side < 0.0f);
        const float mis = found.delta ? 1.0f : power_heuristic(found.pdf, value.pdf);
        const Vec3 arriving = path.throughput * value.total() * found.radiance * fast_quotient(mis, found.pdf);
        if (!(max_component(arriving) > 0.0f)) return;
        const Vec3 origin = find_shadow_origin<kernel>(scene, surface, hit, found.direction);
        ShadowRay shadow;
        shadow.ray = {origin, found.direction, 0.0f, infinity, ray_kind::shadow};
        if (found.distance < infinity) {
            // To the very point: beside it, a light that is seen at an angle would shadow itself.
            shadow.ray.direction = surface.position - origin + found.direction * found.distance;
            shadow.ray.t_max = shadow_ray_end;
        }
        shadow.light = arriving;
        shadow.diffuse_share = path.on_chain ? share_of(value) : path.diffuse_share;
        shadow.bounces = path.bounces + 1;
        shadow.links = path.links;
        shadow.surfaces = limits.transparent_bounces - path.transparent_bounces;
        rays.put_shadow(shadow);
    }
};

// Writes into the G-buffer what the camera sees on a path's way.
template <Effects kernel>
struct SeenByCamera {
    const GbufferStage<kernel>* gbuffer;  // of the path's sample; null: it is there
    int pixel;

    SVGF_HD void background(const Path& path) const {
        if (is_wanted(path)) gbuffer->write_background(pixel, path.ray.direction);
    }
    SVGF_HD void surface(const Path& path, const Surface& surface, const Hit& hit, const Bsdf<kernel>& bsdf) const {
        if (is_wanted(path)) write(path, surface, hit, bsdf, true);
    }
    // The path ends here.
    SVGF_HD void surface(const Path& path, const Surface& surface, const Hit& hit) const {
        if (is_wanted(path)) write(path, surface, hit, {gbuffer->scene, surface, -path.ray.direction}, false);
    }

private:
    SVGF_HD bool is_wanted(const Path& path) const { return gbuffer && path.bounces == 0; }
    SVGF_HD void write(const Path& path, const Surface& surface, const Hit& hit, const Bsdf<kernel>& bsdf,
                       bool may_reflect) const {
        gbuffer->write_surface(pixel, gbuffer->point_of(pixel), surface, bsdf, hit, path.throughput, may_reflect);
    }
};

// Images of a frame, to which samples are added.
struct RadianceImages {
    bool first_of_frame;  // overwrites the images, else adds to them
    float weight;         // of this sample in the images
    Vec3* out_emission;
    Vec3* out_first_signal;
    Vec3* out_second_signal;  // null: the first one gets all
    float* out_alpha;         // null: the film is not transparent
    float* out_hit_distance;  // of the first sample; null: nothing is specular

    SVGF_HD void add(int pixel, const Gathered& light) const {
        accumulate(out_emission[pixel], light.emission);
        accumulate(out_first_signal[pixel], light.first);
        if (out_second_signal) accumulate(out_second_signal[pixel], light.second);
        if (out_alpha) accumulate(out_alpha[pixel], light.alpha);
        if (out_hit_distance && first_of_frame) out_hit_distance[pixel] = light.hit_distance;
    }

private:
    template <class Value>
    SVGF_HD void accumulate(Value& out, Value value) const {
        out = first_of_frame ? value * weight : out + value * weight;
    }
};

// The paths of a few pixels, for the CPU, from vertex to vertex together: their state stays in a core's cache, and so
// does the code of tracing, and then that of shading. Sponza takes 5 % and a room 7 % less than with one path after the
// other. The GPU does the same with all pixels: trace/wavefront.h.
//
// What the camera sees is shaded once for both images: the G-buffer is written on the way. That and last rays that are
// not shaded where nothing shines save 8 to 13 % of a frame, the shared scenes at 480x270.
template <Effects kernel>
struct PathStage {
    PathVertices<kernel> vertices;
    Camera camera;
    std::uint32_t sample, seed;
    bool box_filter;
    const Hit* in_hit;  // of the primary rays; null: they are traced here
    const GbufferStage<kernel>* gbuffer;  // of this sample; null: it is there
    RadianceImages out;

    // Pixels [x0, x1) x [y0, y1).
    void trace_tile(int x0, int y0, int x1, int y1) const {
        Batch batch;
        for (int y = y0; y < y1; ++y)
            for (int x = x0; x < x1; ++x) {
                batch.start(*this, x, y);
                if (batch.size == Batch::most) trace(batch);
            }
        trace(batch);
    }

private:
    // A path and where its ray ended.
    struct State {
        int pixel;
        Path path;
        Hit hit;
        Gathered light;
        LightRays rays;

        explicit State(int pixel) : pixel(pixel) {}
    };

    struct Batch {
        static constexpr int most = 64;

        alignas(State) std::byte memory[most * sizeof(State)];
        int size = 0;

        State& operator[](int i) { return reinterpret_cast<State*>(memory)[i]; }

        void start(const PathStage& stage, int x, int y) {
            const int pixel = y * stage.camera.width + x;
            State& state = *new (memory + size++ * sizeof(State)) State(pixel);
            const Sampler sampler = stage.sampler_of(state);
            state.path.ray = primary_ray<kernel>(stage.camera, pixel_point(x, y, sampler, stage.box_filter), sampler);
            if (!stage.gbuffer) state.light = stage.vertices.start(pixel);
        }
    };

    // Empties the batch.
    void trace(Batch& batch) const {
        int active[Batch::most], shadowed[Batch::most];
        int count = batch.size;
        for (int i = 0; i < count; ++i) active[i] = i;
        for (int vertex = 0; count > 0; ++vertex) {
            for (int i = 0; i < count; ++i) extend(batch[active[i]], vertex);
            const int tried = std::exchange(count, 0);
            int shadows = 0;
            for (int i = 0; i < tried; ++i) {
                State& state = batch[active[i]];
                state.rays = {};
                const bool goes_on = vertices.shade(sampler_of(state), vertex, state.hit, state.path, state.light,
                                                    state.rays, SeenByCamera<kernel>{gbuffer, state.pixel});
                if (state.rays.shadow.exists() || state.rays.last.exists()) shadowed[shadows++] = active[i];
                if (goes_on) active[count++] = active[i];
            }
            for (int i = 0; i < shadows; ++i) {
                State& state = batch[shadowed[i]];
                vertices.add_arriving(sampler_of(state), vertex, state.rays.shadow, state.light);
                vertices.add_arriving(sampler_of(state), vertex, state.rays.last, state.light);
            }
        }
        for (int i = 0; i < batch.size; ++i) out.add(batch[i].pixel, batch[i].light);
        batch.size = 0;
    }

    Sampler sampler_of(const State& state) const { return {state.pixel, seed, sample}; }

    void extend(State& state, int vertex) const {
        const Path& path = state.path;
        if (vertex == 0 && in_hit)
            state.hit = in_hit[state.pixel];
        else
            state.hit = vertices.find_hit(sampler_of(state), vertex, path.ray, path.transparent_bounces);
    }
};

// Adds the light of trace/specular_chain.h, where it was found after the paths.
struct ChainLightStage {
    const std::int32_t* in_pixels;
    const Vec3* in_light;
    float weight;
    Vec3* out_emission;

    SVGF_HD void operator()(int i) const { out_emission[in_pixels[i]] += in_light[in_pixels[i]] * weight; }
};

}  // namespace svgf
