// SPDX-License-Identifier: Apache-2.0
// Stage "gbuffer": what the primary ray of each pixel sees, for demodulation, reprojection and edges. Its hits are kept
// for stage "path", which starts with the same rays.
#pragma once

#include "core/append.h"
#include "core/effects.h"
#include "core/sampling.h"
#include "device/launch_shape.h"
#include "trace/bsdf.h"
#include "trace/camera.h"
#include "trace/intersect.h"
#include "trace/light_paths.h"
#include "trace/opacity.h"
#include "trace/surface.h"

namespace svgf {

constexpr float background_depth = 1e10f;
constexpr float largest_depth_gradient = 1e10f;
// Pixels that a point has moved which was behind the previous camera: reprojects to nowhere.
constexpr float no_motion = 1e6f;

// Links of a chain of mirrors and bends at most, see trace/specular_chain.h.
constexpr int longest_chain = 8;

// Whether a chain of so many links has another one, which does this.
SVGF_HD inline bool may_follow(const LightPaths& limits, BsdfEvent event, int links, int reflections,
                               int refractions) {
    if (links >= min(limits.bounces, longest_chain)) return false;
    return event == BsdfEvent::glossy ? reflections < limits.glossy_bounces
                                      : event == BsdfEvent::transmission && refractions < limits.transmission_bounces;
}

// Where the first ray of a sample goes through pixel (x, y).
SVGF_HD inline Vec2 pixel_point(int x, int y, const Sampler& sampler, bool box_filter) {
    const Vec2 offset = box_filter ? sampler.pair(SamplePair::pixel) : Vec2{0.5f, 0.5f};
    return {float(x) + offset.x, float(y) + offset.y};
}

// The first ray of a sample, through image point `point`, in metres: what goes on behind a hit must be this very ray.
template <Effects kernel>
SVGF_HD Ray primary_ray(const Camera& camera, Vec2 point, const Sampler& sampler) {
    Ray ray = camera.ray(point);
    if constexpr (covers(kernel, Effects::depth_of_field))
        if (camera.aperture.radius > 0.0f) ray = camera.ray_through_lens(point, sampler.pair(SamplePair::lens));
    const float scale = length(ray.direction);
    ray.direction = ray.direction / scale;
    ray.t_min *= scale;
    ray.t_max *= scale;
    return ray;
}

// Blocks of 128 threads that a multiprocessor should hold of a kernel that shades: the more it simulates, the more
// registers it needs. Of the kernels with specular lobes and with transmission one block more costs 10 % of the launch
// (H200, atrium and cornell).
template <Effects kernel>
constexpr int shade_blocks = covers(kernel, Effects::transmission) ? 3 : 4;

// Warps of a block of a stage that only shades. Those of one block start together, and in one that fills the
// multiprocessor they read the same instructions: kernels with specular lobes do not fit into its cache. 512 instead of
// 128 threads take 2.5 instead of 2.9 ms in Sponza, but in a box without such lobes 0.92 instead of 0.82 ms (H200).
template <Effects kernel>
constexpr int shade_warps = covers(kernel, Effects::specular) ? 4 * shade_blocks<kernel> : 4;
template <Effects kernel>
constexpr int shade_warp_blocks = 4 * shade_blocks<kernel> / shade_warps<kernel>;

// Primary rays: hits for the stages that shade. On its own, because tracing needs few registers and many threads.
template <Effects kernel>
struct PrimaryHitStage {
    // A warp is 8 x 4 pixels, whose rays stay together: 1.27 ms instead of 1.59 ms for rows of 32 (H200, atrium).
    static constexpr LaunchShape launch_shape{8, 16, path_trace_blocks<kernel>};

    SceneView scene;
    Camera camera;
    std::uint32_t sample, seed;
    bool box_filter;
    int transparent_bounces;
    Hit* out_hit;

    SVGF_HD void operator()(int x, int y) const {
        const int i = y * camera.width + x;
        const Sampler sampler(i, seed, sample);
        const Ray ray = primary_ray<kernel>(camera, pixel_point(x, y, sampler, box_filter), sampler);
        store(out_hit + i, find_path_hit<kernel>(scene, ray, sampler, 0, max(transparent_bounces, 1)));
    }
};

SVGF_HD inline Vec3 motion_between(ImagePoint now, ImagePoint before) {
    const Vec3 motion{before.point.x - now.point.x, before.point.y - now.point.y, before.depth - now.depth};
    return before.depth > 0.0f && is_finite(motion) ? motion : Vec3{no_motion, no_motion, 0.0f};
}

SVGF_HD inline Vec2 bounded(Vec2 gradient) {
    const auto bounded = [](float g) {
        return g == g ? clamp(g, -largest_depth_gradient, largest_depth_gradient) : 0.0f;
    };
    return {bounded(gradient.x), bounded(gradient.y)};
}

template <Effects kernel>
struct GbufferStage {
    static constexpr LaunchShape launch_shape{8, 16, shade_blocks<kernel>};

    SceneView scene;
    Camera camera, previous_camera;
    std::uint32_t sample, seed;
    bool box_filter;
    bool camera_moves;
    LightPaths limits;

    const Hit* in_hit;         // of the primary rays
    Vec3* out_normal;          // world, on the viewer's side; 0 on the background
    float* out_depth;          // planar
    Vec2* out_depth_gradient;  // per pixel
    std::int32_t* out_object_id;
    std::int32_t* out_material_id;  // index + 1
    float* out_roughness;
    Vec3* out_diffuse_albedo;
    Vec3* out_specular_albedo;  // null: nothing is specular
    // Previous position minus this one in pixels, previous depth minus this one; null: nothing moves.
    Vec3* out_motion;

    // For trace/specular_chain.h, which puts there what is seen in mirrors and through glass; null: no surface is
    // smooth. The pixels that it works on, and the light that it finds, here 0.
    std::int32_t* out_smooth_pixels = nullptr;
    std::int32_t* out_smooth_count = nullptr;
    Vec3* out_chain_light = nullptr;
    // What the camera's ray itself hit.
    Vec3* out_first_normal = nullptr;
    float* out_first_depth = nullptr;
    std::int32_t* out_first_object_id = nullptr;
    Vec3* out_first_motion = nullptr;  // null: nothing moves

    // Where the primary ray of a pixel goes through the image.
    SVGF_HD Vec2 point_of(int pixel) const {
        return pixel_point(pixel % camera.width, pixel / camera.width, Sampler(pixel, seed, sample), box_filter);
    }

    SVGF_HD void operator()(int x, int y) const {
        const int i = y * camera.width + x;
        const Sampler sampler(i, seed, sample);
        const Vec2 point = pixel_point(x, y, sampler, box_filter);
        Ray ray = primary_ray<kernel>(camera, point, sampler);
        const Vec3 view = -ray.direction;
        int allowed = max(limits.transparent_bounces, 1);
        Hit hit = load(in_hit + i);
        Vec3 tint{1, 1, 1};
        Surface surface;
        for (int vertex = 0;; ++vertex) {
            if (!hit.found()) return write_background(i, ray.direction);
            surface = find_surface<kernel>(scene, hit, view, surface_choice<kernel>(sampler, vertex, hit));
            if constexpr (!covers(kernel, Effects::alpha)) break;
            // As the path does: what lies behind a hit that lets the ray pass is seen instead of it.
            allowed -= hit.passed;
            if (!(max_component(surface.straight) > 0.0f) || allowed <= 0) break;
            tint *= surface.straight;
            ray.t_min = hit.t;
            hit = find_path_hit_apart<kernel>(scene, ray, sampler, vertex + 1, --allowed);
        }
        write_surface(i, point, surface, Bsdf<kernel>(scene, surface, view), hit, tint, allowed > 0);
    }

    // point: of the image, through which pixel i sees the surface. tint: of what the ray passed. may_reflect: the path
    // does not end here.
    SVGF_HD void write_surface(int i, Vec2 point, const Surface& surface, const Bsdf<kernel>& bsdf, const Hit& hit,
                               Vec3 tint, bool may_reflect) const {
        const ImagePoint now = camera.project(surface.position);
        // What stands still moves by exactly 0, whatever two projections would round it to.
        Vec3 motion;
        if (out_motion && (camera_moves || is_moving(scene, hit)))
            motion = motion_between(now, previous_camera.project(find_previous_position(scene, hit)));
        if constexpr (covers(kernel, Effects::specular)) {
            if (out_smooth_pixels && may_reflect && may_follow(limits, bsdf.find_smooth_bounce().event, 0, 0, 0))
                out_smooth_pixels[append(out_smooth_count)] = i;
        }
        write_first(i, bsdf.normal, now.depth, scene.instances[hit.instance].object_id, motion);
        write(i, bsdf.normal, now.depth, bounded(camera.depth_gradient(point, now.depth, bsdf.geometric_normal)),
              scene.instances[hit.instance].object_id, surface.material.roughness, bsdf.diffuse_albedo * tint,
              bsdf.specular_albedo * tint, motion);
        out_material_id[i] = surface.material_index + 1;
    }

    // Infinitely far: only the camera's rotation moves it.
    SVGF_HD void write_background(int i, Vec3 direction) const {
        Vec3 motion;
        if (camera_moves)
            motion = motion_between(camera.project_direction(direction), previous_camera.project_direction(direction));
        motion.z = 0.0f;
        write_first(i, {}, background_depth, 0, motion);
        write(i, {}, background_depth, {}, 0, 0.0f, {}, {}, motion);
        out_material_id[i] = 0;
    }

    SVGF_HD void write(int i, Vec3 normal, float depth, Vec2 depth_gradient, std::int32_t object_id, float roughness,
                       Vec3 diffuse_albedo, Vec3 specular_albedo, Vec3 motion) const {
        out_normal[i] = normal;
        out_depth[i] = depth;
        out_depth_gradient[i] = depth_gradient;
        out_object_id[i] = object_id;
        out_roughness[i] = roughness;
        out_diffuse_albedo[i] = diffuse_albedo;
        if (out_specular_albedo) out_specular_albedo[i] = specular_albedo;
        if (out_motion) out_motion[i] = motion;
    }

private:
    SVGF_HD void write_first(int i, Vec3 normal, float depth, std::int32_t object_id, Vec3 motion) const {
        if (!out_smooth_pixels) return;
        out_chain_light[i] = {};
        out_first_normal[i] = normal;
        out_first_depth[i] = depth;
        out_first_object_id[i] = object_id;
        if (out_first_motion) out_first_motion[i] = motion;
    }
};

}  // namespace svgf
