// SPDX-License-Identifier: Apache-2.0
// Stage "path" on the GPU: all paths go from vertex to vertex together, in three launches each [Laine13].
//
//   extend  closest hits of the rays that the paths follow
//   shade   light found at the vertices, the paths' next rays and their shadow rays
//   shadow  whether the shadow rays arrive
//
// What a path carries lies in memory, one record per pixel; queues name the pixels whose paths go on, so that warps
// stay full, and each kernel is small enough for the instruction cache. Every pixel's light is summed in the order in
// which trace/path.h finds it, to the same bits.
#pragma once

#include "core/append.h"
#include "core/load.h"
#include "trace/path.h"

namespace svgf {

// Blocks of 128 threads that a multiprocessor should hold of a kernel that shades: 80 registers per thread. Eight make
// the full kernel slower by a fifth, with spills (H200, cornell).
constexpr int shade_blocks = 6;

// Records as they lie in memory: whole reads of 16 bytes.
struct alignas(16) PathRecord {
    Vec3 origin;
    float pdf;
    Vec3 direction;
    float unused0;
    Vec3 throughput;
    float unused1;
    Vec3 diffuse_share;
    float unused2;
};
struct alignas(16) ShadowRecord {
    Vec3 origin;
    float distance;
    Vec3 direction;
    float unused0;
    Vec3 light;
    float unused1;
    Vec3 diffuse_share;
    float unused2;
};
struct alignas(16) GatheredRecord {
    Vec3 emission;
    float unused0;
    Vec3 first;
    float unused1;
    Vec3 second;
    float unused2;
};

// Pixels that a launch works on, in any order.
struct PixelQueue {
    std::int32_t* pixels;
    std::int32_t* count;

    SVGF_HD void push_if(bool wanted, int pixel) const {
        if (wanted) pixels[append(count)] = pixel;
    }
};

struct PathMemory {
    PathRecord* paths;
    ShadowRecord* shadows;
    GatheredRecord* gathered;
    Hit* hits;
};

struct ExtendStage {
    static constexpr LaunchShape launch_shape{32, 4, trace_blocks};

    SceneView scene;
    PathMemory memory;
    const std::int32_t* in_pixels;

    SVGF_HD void operator()(int i) const {
        const int pixel = in_pixels[i];
        const PathRecord& path = memory.paths[pixel];
        memory.hits[pixel] = find_closest_hit(scene, {path.origin, path.direction});
    }
};

template <Effects kernel>
struct ShadeStage {
    static constexpr LaunchShape launch_shape{32, 4, shade_blocks};

    PathVertices<kernel> vertices;
    PathMemory memory;
    int width;
    std::uint32_t sample, seed;
    int vertex;  // not 0
    const std::int32_t* in_pixels;
    PixelQueue out_paths, out_shadows;

    SVGF_HD void operator()(int i) const {
        const int pixel = in_pixels[i];
        const PathRecord record = load(memory.paths + pixel);
        const Sampler sampler(pixel % width, pixel / width, width, seed, sample);
        Path path{{record.origin, record.direction}, record.throughput, record.diffuse_share, record.pdf};
        shade(vertices, memory, sampler, vertex, pixel, memory.hits[pixel], path, load(memory.gathered + pixel),
              out_paths, out_shadows);
    }

    SVGF_HD static void shade(const PathVertices<kernel>& vertices, const PathMemory& memory, const Sampler& sampler,
                              int vertex, int pixel, const Hit& hit, Path& path, const GatheredRecord& before,
                              const PixelQueue& out_paths, const PixelQueue& out_shadows) {
        Gathered light{before.emission, before.first, before.second};
        ShadowRay shadow;
        const bool goes_on = vertices.shade(sampler, vertex, hit, path, light, shadow);
        store(memory.gathered + pixel, {light.emission, 0, light.first, 0, light.second, 0});
        if (goes_on)
            store(memory.paths + pixel, {path.ray.origin, path.pdf, path.ray.direction, 0, path.throughput, 0,
                                         path.diffuse_share, 0});
        if (shadow.exists())
            store(memory.shadows + pixel, {shadow.ray.origin, shadow.ray.t_max, shadow.ray.direction, 0, shadow.light, 0,
                                           shadow.diffuse_share, 0});
        out_paths.push_if(goes_on, pixel);
        out_shadows.push_if(shadow.exists(), pixel);
    }
};

// Vertex 0 of all pixels.
template <Effects kernel>
struct FirstShadeStage {
    static constexpr LaunchShape launch_shape{8, 16, shade_blocks};

    PathVertices<kernel> vertices;
    PathMemory memory;
    Camera camera;
    std::uint32_t sample, seed;
    bool box_filter;
    const Hit* in_hit;
    PixelQueue out_paths, out_shadows;

    SVGF_HD void operator()(int x, int y) const {
        const Sampler sampler(x, y, camera.width, seed, sample);
        const int pixel = y * camera.width + x;
        Path path{primary_ray(camera, pixel_point(x, y, sampler, box_filter))};
        ShadeStage<kernel>::shade(vertices, memory, sampler, 0, pixel, in_hit[pixel], path, {}, out_paths, out_shadows);
    }
};

// Primary rays where the gbuffer did not trace them.
struct FirstExtendStage {
    static constexpr LaunchShape launch_shape{8, 16, trace_blocks};

    SceneView scene;
    Camera camera;
    std::uint32_t sample, seed;
    Hit* out_hit;

    SVGF_HD void operator()(int x, int y) const {
        const Sampler sampler(x, y, camera.width, seed, sample);
        out_hit[y * camera.width + x] =
            find_closest_hit(scene, primary_ray(camera, pixel_point(x, y, sampler, true)));
    }
};

template <Effects kernel>
struct ShadowStage {
    static constexpr LaunchShape launch_shape{32, 4, trace_blocks};

    PathVertices<kernel> vertices;
    PathMemory memory;
    int vertex;  // from which the rays start
    const std::int32_t* in_pixels;

    SVGF_HD void operator()(int i) const {
        const int pixel = in_pixels[i];
        const ShadowRecord shadow = load(memory.shadows + pixel);
        if (is_occluded(vertices.scene, {shadow.origin, shadow.direction, 0.0f, shadow.distance})) return;
        const GatheredRecord before = load(memory.gathered + pixel);
        Gathered light{before.emission, before.first, before.second};
        vertices.add(light, shadow.light, shadow.diffuse_share, vertex + 1);
        store(memory.gathered + pixel, {light.emission, 0, light.first, 0, light.second, 0});
    }
};

// Adds a sample to the images.
struct GatherStage {
    const GatheredRecord* in_gathered;
    RadianceImages out;

    SVGF_HD void operator()(int pixel) const {
        const GatheredRecord light = load(in_gathered + pixel);
        out.add(pixel, {light.emission, light.first, light.second});
    }
};

}  // namespace svgf
