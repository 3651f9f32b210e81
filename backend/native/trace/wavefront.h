// SPDX-License-Identifier: Apache-2.0
// Stage "path" on the GPU: all paths go from vertex to vertex together, in three launches each [Laine13].
//
//   extend  closest hits of the rays that the paths follow
//   shade   light found at the vertices, the paths' next rays and their shadow rays
//   shadow  whether the shadow rays arrive; at the end, whether the paths' last rays do
//
// What a path carries lies in memory, one record per pixel; queues name the pixels whose paths go on, so that warps
// stay full, and each kernel is small enough for the instruction cache. Every pixel's light is summed in the order in
// which trace/path.h finds it, to the same bits.
//
// Rays are traced in the order of their pixels. In Sponza, sorted by the octant of their direction and 15 bits of their
// origin, warps visit 2 % fewer nodes with bounce rays and 6 % fewer with last ones; with 4 bits more of direction 9 %:
// less than it takes to sort them. A thread keeps its ray until the warp is done. Taking the next one as soon as 8 to
// 16 threads are idle [Aila09] leaves 15 instead of 12 of them at work, but what must then be kept across rays does not
// fit into the registers: 5.3 instead of 4.0 ms for the rays that surfaces scatter in Sponza (H200), 4.7 with fewer
// blocks. Giving up the last 4 to 16 rays of a warp and tracing them again with those of others saves as much as the
// second launch costs, and in Sponza less. Of the last light and the last ray of a path only one, by chance, as bright
// as both: 35 % more variance there.
#pragma once

#include "core/append.h"
#include "core/load.h"
#include "trace/path.h"

namespace svgf {

// Records as they lie in memory: whole reads of 16 bytes.
struct alignas(16) PathRecord {
    Vec3 origin;
    float t_min;
    Vec3 direction;
    float t_max;
    Vec3 throughput;
    float pdf;
    Vec3 diffuse_share;
    float smallest_pdf;
    Vec3 normal;
    std::uint32_t bounces;          // and above bit 16 transparent_bounces
    std::uint32_t diffuse_bounces;  // and above bit 16 glossy_bounces
    std::uint32_t transmission_bounces;
    std::uint32_t kind_and_flags;  // bit 28: on_chain, 29: measures_distance, 30: delta, 31: ends
    std::int32_t links;

    PathRecord() = default;
    SVGF_HD explicit PathRecord(const Path& path)
        : origin(path.ray.origin), t_min(path.ray.t_min), direction(path.ray.direction), t_max(path.ray.t_max),
          throughput(path.throughput), pdf(path.pdf), diffuse_share(path.diffuse_share),
          smallest_pdf(path.smallest_pdf), normal(path.normal),
          bounces(std::uint32_t(path.bounces) | std::uint32_t(path.transparent_bounces) << 16),
          diffuse_bounces(std::uint32_t(path.diffuse_bounces) | std::uint32_t(path.glossy_bounces) << 16),
          transmission_bounces(std::uint32_t(path.transmission_bounces)),
          kind_and_flags(path.ray.kind | (path.on_chain ? 1u << 28 : 0u) | (path.measures_distance ? 1u << 29 : 0u) |
                         (path.delta ? 1u << 30 : 0u) | (path.ends ? 1u << 31 : 0u)),
          links(path.links) {}

    SVGF_HD Ray ray() const { return {origin, direction, t_min, t_max, kind_and_flags & 0xffu}; }
    SVGF_HD int transparent_bounces() const { return int(bounces >> 16); }
    SVGF_HD bool measures_distance() const { return (kind_and_flags >> 29 & 1u) != 0; }
    SVGF_HD Path path() const {
        Path path;
        path.ray = ray();
        path.throughput = throughput;
        path.diffuse_share = diffuse_share;
        path.normal = normal;
        path.pdf = pdf;
        path.smallest_pdf = smallest_pdf;
        path.bounces = int(bounces & 0xffffu);
        path.transparent_bounces = transparent_bounces();
        path.diffuse_bounces = int(diffuse_bounces & 0xffffu);
        path.glossy_bounces = int(diffuse_bounces >> 16);
        path.transmission_bounces = int(transmission_bounces);
        path.links = links;
        path.on_chain = (kind_and_flags >> 28 & 1u) != 0;
        path.measures_distance = measures_distance();
        path.delta = (kind_and_flags >> 30 & 1u) != 0;
        path.ends = kind_and_flags >> 31 != 0;
        return path;
    }
};
struct alignas(16) ShadowRecord {
    Vec3 origin;
    float t_max;
    Vec3 direction;
    std::int32_t bounces_and_kind;  // the kind above bit 16
    Vec3 light;
    std::int32_t surfaces;
    Vec3 diffuse_share;
    std::int32_t links;

    ShadowRecord() = default;
    SVGF_HD explicit ShadowRecord(const ShadowRay& shadow)
        : origin(shadow.ray.origin), t_max(shadow.ray.t_max), direction(shadow.ray.direction),
          bounces_and_kind(shadow.bounces | std::int32_t(shadow.ray.kind) << 16), light(shadow.light),
          surfaces(shadow.surfaces), diffuse_share(shadow.diffuse_share), links(shadow.links) {}

    SVGF_HD Ray ray() const { return {origin, direction, 0.0f, t_max, std::uint32_t(bounces_and_kind) >> 16}; }
    SVGF_HD ShadowRay shadow() const {
        return {ray(), light, diffuse_share, bounces_and_kind & 0xffff, links, surfaces};
    }
};
struct alignas(16) GatheredRecord {
    Vec3 emission;
    float alpha;
    Vec3 first;
    float hit_distance;
    Vec3 second;
    float unused;

    GatheredRecord() = default;
    SVGF_HD explicit GatheredRecord(const Gathered& light)
        : emission(light.emission), alpha(light.alpha), first(light.first), hit_distance(light.hit_distance),
          second(light.second), unused(0) {}

    SVGF_HD Gathered gathered() const { return {emission, first, second, alpha, hit_distance}; }
};

// A pixel's light where it lies: read and written as it is found, which of most vertices none is, and in between no
// registers are held for it.
struct GatheredInMemory {
    GatheredRecord* record;

    SVGF_HD void add_emission(Vec3 value) const { add(0, value); }
    SVGF_HD void add_first(Vec3 value) const { add(1, value); }
    SVGF_HD void add_second(Vec3 value) const { add(2, value); }
    SVGF_HD void take_alpha(float value) const { record->alpha -= value; }
    SVGF_HD void set_hit_distance(float value) const { record->hit_distance = value; }

private:
    SVGF_HD void add(int row, Vec3 value) const {
        Vec4* const sum = reinterpret_cast<Vec4*>(record) + row;
        *sum = Vec4{sum->x + value.x, sum->y + value.y, sum->z + value.z, sum->w};
    }
};

// The same of rays to lights.
struct RaysInMemory {
    ShadowRecord *shadow, *last;
    bool has_shadow = false, has_last = false;

    SVGF_HD void put_shadow(const ShadowRay& ray) { has_shadow = put(ray, shadow); }
    SVGF_HD void put_last(const ShadowRay& ray) { has_last = put(ray, last); }

private:
    SVGF_HD static bool put(const ShadowRay& ray, ShadowRecord* record) {
        if (ray.exists()) store(record, ShadowRecord(ray));
        return ray.exists();
    }
};

// Pixels that a launch works on, in any order.
struct PixelQueue {
    std::int32_t* pixels;
    std::int32_t* count;
};

struct PathMemory {
    PathRecord* paths;
    ShadowRecord* shadows;  // of the vertex
    ShadowRecord* lasts;    // the paths' last rays, where they are shadow rays
    GatheredRecord* gathered;
    Hit* hits;
};

template <Effects kernel>
struct ExtendStage {
    static constexpr LaunchShape launch_shape{32, 4, path_trace_blocks<kernel>};

    PathVertices<kernel> vertices;
    PathMemory memory;
    std::uint32_t sample, seed;
    int vertex;  // at which the rays end
    const std::int32_t* in_pixels;

    SVGF_HD void operator()(int i) const {
        const int pixel = in_pixels[i];
        const PathRecord& path = memory.paths[pixel];
        const Sampler sampler(pixel, seed, sample);
        store(memory.hits + pixel,
              vertices.find_hit(sampler, vertex, path.ray(), path.transparent_bounces()));
    }
};

// Of those that a vertex adds to.
struct VertexQueues {
    PixelQueue paths, shadows, lasts;
};

// Shades a vertex and puts its path and its shadow rays into the queues.
template <Effects kernel, class Seen = Unseen>
SVGF_HD void shade(const PathVertices<kernel>& vertices, const PathMemory& memory, const Sampler& sampler, int vertex,
                   int pixel, const Hit& hit, Path& path, const VertexQueues& out, const Seen& seen = {}) {
    const GatheredInMemory light{memory.gathered + pixel};
    RaysInMemory rays{memory.shadows + pixel, memory.lasts + pixel};
    const bool goes_on = vertices.shade(sampler, vertex, hit, path, light, rays, seen);
    if (goes_on) store(memory.paths + pixel, PathRecord(path));
    const bool wanted[3] = {goes_on, rays.has_shadow, rays.has_last};
    std::int32_t* const counts[3] = {out.paths.count, out.shadows.count, out.lasts.count};
    std::int32_t place[3];
    append_together<32 * shade_warps<kernel>>(counts, wanted, place);
    if (wanted[0]) out.paths.pixels[place[0]] = pixel;
    if (wanted[1]) out.shadows.pixels[place[1]] = pixel;
    if (wanted[2]) out.lasts.pixels[place[2]] = pixel;
}

template <Effects kernel>
struct ShadeStage {
    static constexpr LaunchShape launch_shape{32, shade_warps<kernel>, shade_warp_blocks<kernel>};

    PathVertices<kernel> vertices;
    PathMemory memory;
    std::uint32_t sample, seed;
    int vertex;  // not 0
    const std::int32_t* in_pixels;
    VertexQueues out;

    SVGF_HD void operator()(int i) const {
        const int pixel = in_pixels[i];
        const Sampler sampler(pixel, seed, sample);
        Path path = load(memory.paths + pixel).path();
        shade(vertices, memory, sampler, vertex, pixel, load(memory.hits + pixel), path, out);
    }
};

// Vertex 0 of all pixels, and of a frame's first sample the G-buffer on the way: on its own that takes 0.4 ms more of
// Sponza's 9.6 (H200).
template <Effects kernel>
struct FirstShadeStage {
    static constexpr LaunchShape launch_shape{8, 4 * shade_warps<kernel>, shade_warp_blocks<kernel>};

    PathVertices<kernel> vertices;
    PathMemory memory;
    Camera camera;
    std::uint32_t sample, seed;
    bool box_filter;
    const Hit* in_hit;
    GbufferStage<kernel> gbuffer;
    bool writes_gbuffer;  // else it is there
    VertexQueues out;

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = y * camera.width + x;
        const Sampler sampler(pixel, seed, sample);
        Path path;
        path.ray = primary_ray<kernel>(camera, pixel_point(x, y, sampler, box_filter), sampler);
        Gathered light;
        if (!writes_gbuffer) light = vertices.start(pixel);
        store(memory.gathered + pixel, GatheredRecord(light));
        shade(vertices, memory, sampler, 0, pixel, load(in_hit + pixel), path, out,
              SeenByCamera<kernel>{writes_gbuffer ? &gbuffer : nullptr, pixel});
    }
};

template <Effects kernel>
struct ShadowStage {
    static constexpr LaunchShape launch_shape{32, 4, shadow_trace_blocks<kernel>};

    PathVertices<kernel> vertices;
    PathMemory memory;
    std::uint32_t sample, seed;
    int vertex;  // from which the rays start; of last rays any
    const ShadowRecord* in_rays;
    const std::int32_t* in_pixels;

    SVGF_HD void operator()(int i) const {
        const int pixel = in_pixels[i];
        const Sampler sampler(pixel, seed, sample);
        const ShadowRecord* const record = in_rays + pixel;
        const Vec3 share = vertices.find_arriving(sampler, vertex, record->ray(), record->surfaces);
        if (!(max_component(share) > 0.0f)) return;
        // Read only now, so that tracing has the registers.
        const GatheredInMemory light{memory.gathered + pixel};
        vertices.add_share(load(record).shadow(), share, light);
    }
};

// Adds a sample to the images.
struct GatherStage {
    const GatheredRecord* in_gathered;
    RadianceImages out;

    SVGF_HD void operator()(int pixel) const { out.add(pixel, load(in_gathered + pixel).gathered()); }
};

}  // namespace svgf
