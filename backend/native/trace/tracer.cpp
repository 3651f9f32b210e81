// SPDX-License-Identifier: Apache-2.0
// The half of Tracer that takes frames: the choice of kernels and the order of stages. The other one: trace/upload.cpp.
#include "trace/tracer.h"

#include <algorithm>
#include <functional>

#include "trace/cast.h"
#include "trace/gbuffer.h"
#include "trace/path.h"
#include "trace/specular_chain.h"
#include "trace/wavefront.h"

namespace svgf {
namespace {

// Of surfaces, what takes most of the code and few scenes have.
constexpr Effects rare_effects =
    Effects::alpha | Effects::coat | Effects::sheen | Effects::anisotropy | Effects::material_mixes;

// Every kernel is compiled once for each of these. The first one that covers the effects of a frame runs, so they go
// from the cheapest to the one that covers everything. `svgf bench effects` shows what each saves; other effects cost
// nothing where a scene lacks them, as a branch that all threads skip.
constexpr Effects kernel_effects[] = {
    without(Effects::all, rare_effects | Effects::transmission | Effects::specular | Effects::perfect_specular |
                              Effects::normal_maps),
    without(Effects::all, rare_effects | Effects::transmission),
    without(Effects::all, without(rare_effects, Effects::alpha) | Effects::transmission),
    without(Effects::all, rare_effects),
    Effects::all,
};

// Calls run.template operator()<kernel>() for the kernel that a frame with these effects takes.
template <std::size_t index = 0, class Run>
auto with_kernel(Effects effects, const Run& run) {
    constexpr Effects kernel = kernel_effects[index];
    if constexpr (index + 1 < std::size(kernel_effects))
        if (!covers(kernel, effects)) return with_kernel<index + 1>(effects, run);
    return run.template operator()<kernel>();
}

}  // namespace

std::span<const Effects> Tracer::kernels() { return kernel_effects; }

std::vector<Image> Tracer::trace(const Frame& frame) {
    expect(frame.width >= 1 && frame.height >= 1 && std::int64_t(frame.width) * frame.height < (std::int64_t(1) << 30),
           "An image must have at least one pixel, and at most 2^30.");
    expect(frame.samples >= 1 && frame.light_paths.bounces >= 0,
           "There must be at least one sample, and no negative bounces.");
    expect(std::size_t(largest_emitter_ + 1) <= emitters_.size(), "An instance names an emitter that is not there.");
    expect(scene_.world.light < scene_.lights.count, "The world names a light that is not there.");
    const std::int32_t world_texture = std::max(scene_.world.texture, scene_.world.backdrop_texture);
    expect(std::size_t(std::max(largest_texture_, world_texture) + 1) <= textures_.size(),
           "A light or the world names a texture that is not there.");
    expect(std::size_t(largest_material_ + 1) <= materials_.size(),
           "The material table names a material that is not there.");
    expect(scene_.albedo_tables, "There are no tables of albedos yet.");
    if (!knows_opacity_) find_opacity();
    return with_kernel(Effects(frame.effects) | Effects(frame.kernel),
                       [&]<Effects kernel>() { return trace_with<kernel>(frame); });
}

template <Effects kernel>
std::vector<Image> Tracer::trace_with(const Frame& frame) {
    const std::size_t pixels = std::size_t(frame.width) * std::size_t(frame.height);
    std::vector<Image> images;
    // A record of `channels` floats per pixel.
    const auto floats = [&](const char* name, int channels) {
        images.push_back({name, channels, Buffer<float>(device_, pixels * std::size_t(channels), name)});
        return std::get<Buffer<float>>(images.back().pixels).data();
    };
    const auto vectors = [&](const char* name) { return reinterpret_cast<Vec3*>(floats(name, 3)); };
    const auto integers = [&](const char* name) {
        images.push_back({name, 1, Buffer<std::int32_t>(device_, pixels, name)});
        return std::get<Buffer<std::int32_t>>(images.back().pixels).data();
    };
    for (Camera* camera : {&camera_, &previous_camera_}) {
        camera->width = frame.width;
        camera->height = frame.height;
    }
    const bool box_filter = frame.pixel_filter == PixelFilter::box;
    const bool splits_direct = frame.signals == Signals::direct_indirect;
    const Effects effects{frame.effects};
    const bool has_specular = covers(effects, Effects::specular);
    const bool two_signals = splits_direct || has_specular;
    const bool has_chains = covers(effects, Effects::specular | Effects::perfect_specular);
    const bool has_motion =
        (effects & (Effects::camera_motion | Effects::object_motion | Effects::deformation)) != Effects::none;

    Buffer<Hit> hits(device_, pixels, "primary hits");
    device_.launch("gbuffer hits", frame.width, frame.height,
                   PrimaryHitStage<kernel>{scene_, camera_, frame.sample, frame.seed, box_filter,
                                           frame.light_paths.transparent_bounces, hits.data()});
    GbufferStage<kernel> gbuffer{
        .scene = scene_,
        .camera = camera_,
        .previous_camera = previous_camera_,
        .sample = frame.sample,
        .seed = frame.seed,
        .box_filter = box_filter,
        .camera_moves = covers(effects, Effects::camera_motion),
        .limits = frame.light_paths,
        .in_hit = hits.data(),
        .out_normal = vectors("normal"),
        .out_depth = floats("depth", 1),
        .out_depth_gradient = reinterpret_cast<Vec2*>(floats("depth_gradient", 2)),
        .out_object_id = integers("object_id"),
        .out_material_id = integers("material_id"),
        .out_roughness = floats("roughness", 1),
        .out_diffuse_albedo = vectors("diffuse_albedo"),
        .out_specular_albedo = has_specular ? vectors("specular_albedo") : nullptr,
        .out_motion = has_motion ? vectors("motion") : nullptr,
    };
    Buffer<std::int32_t> smooth_pixels, smooth_count;
    Buffer<Vec3> chain_light;
    if (has_chains) {
        smooth_pixels = Buffer<std::int32_t>(device_, pixels, "pixels of mirrors");
        smooth_count = Buffer<std::int32_t>(device_, 1, "pixels of mirrors");
        smooth_count.clear();
        chain_light = Buffer<Vec3>(device_, pixels, "light in mirrors");
        gbuffer.out_smooth_pixels = smooth_pixels.data();
        gbuffer.out_smooth_count = smooth_count.data();
        gbuffer.out_chain_light = chain_light.data();
        gbuffer.out_first_normal = vectors("first_normal");
        gbuffer.out_first_depth = floats("first_depth", 1);
        gbuffer.out_first_object_id = integers("first_object_id");
        gbuffer.out_first_motion = has_motion ? vectors("first_motion") : nullptr;
    }
    const auto follow_chains = [&] {
        if constexpr (covers(kernel, Effects::specular))
            if (has_chains)
                device_.launch_queue("gbuffer chains", int(pixels), smooth_count.data(),
                                     SpecularChainStage<kernel>{gbuffer, smooth_pixels.data()});
    };

    PathVertices<kernel> vertices{.scene = scene_,
                                  .limits = frame.light_paths,
                                  .transparent_film = frame.transparent_film,
                                  .splits_direct = splits_direct,
                                  .two_signals = two_signals,
                                  .follows_chains = has_chains,
                                  .in_chain_light = chain_light.data()};
    RadianceImages radiance{
        .first_of_frame = true,
        .weight = 1.0f / float(frame.samples),
        .out_emission = vectors("emission"),
        .out_first_signal = vectors(splits_direct ? "direct" : "diffuse"),
        .out_second_signal = two_signals ? vectors(splits_direct ? "indirect" : "specular") : nullptr,
        .out_alpha = frame.transparent_film ? floats("alpha", 1) : nullptr,
        .out_hit_distance = has_specular ? floats("hit_distance", 1) : nullptr,
    };
    const auto add_chain_light = [&] {
        if (has_chains)
            device_.launch_queue("path", int(pixels), smooth_count.data(),
                                 ChainLightStage{smooth_pixels.data(), chain_light.data(), radiance.weight,
                                                 radiance.out_emission});
    };
    // With a lens each sample has a ray of its own even through the middle of the pixel.
    // So has each where chance decides what it passes.
    const bool same_rays = !box_filter && camera_.aperture.radius == 0.0f && !covers(kernel, Effects::alpha);
    if constexpr (Device::follows_paths_together) {
        // Where a path's ray may go on straight from its first vertex, what the camera sees is found before the paths.
        const bool is_apart = opacity_.has_shaded();
        if (is_apart) {
            device_.launch("gbuffer", frame.width, frame.height, gbuffer);
            follow_chains();
        }
        trace_wavefront(frame, vertices, gbuffer, !is_apart, same_rays, radiance, follow_chains);
        if (!is_apart) add_chain_light();
    } else {
        PathStage<kernel> path{.vertices = vertices,
                               .camera = camera_,
                               .sample = frame.sample,
                               .seed = frame.seed,
                               .box_filter = box_filter,
                               .in_hit = hits.data(),
                               .gbuffer = &gbuffer,
                               .out = radiance};
        for (int i = 0; i < frame.samples; ++i) {
            device_.launch("path", frame.width, frame.height, path);
            if (path.gbuffer) {
                follow_chains();
                add_chain_light();
            }
            path.gbuffer = nullptr;
            ++path.sample;
            path.out.first_of_frame = false;
            path.vertices.in_chain_light = nullptr;  // of the first sample
            if (!same_rays) path.in_hit = nullptr;
        }
    }
    return images;
}

template <Effects kernel>
void Tracer::trace_wavefront(const Frame& frame, PathVertices<kernel> vertices, const GbufferStage<kernel>& gbuffer,
                             bool writes_gbuffer, bool same_rays, RadianceImages out,
                             const std::function<void()>& follow_chains) {
    const int width = frame.width, height = frame.height, pixels = width * height;
    const bool box_filter = frame.pixel_filter == PixelFilter::box;
    // The last ray of a path only looks for light. A surface that lets it straight through may be a vertex, too.
    const int vertex_count = frame.light_paths.bounces + 2 +
                             (opacity_.has_shaded() ? frame.light_paths.transparent_bounces + 1 : 0);
    Buffer<PathRecord> paths(device_, std::size_t(pixels), "paths");
    Buffer<ShadowRecord> shadows(device_, std::size_t(pixels), "shadow rays");
    Buffer<ShadowRecord> lasts(device_, scene_.last_hits_are_dark ? std::size_t(pixels) : 0, "last rays");
    Buffer<GatheredRecord> gathered(device_, std::size_t(pixels), "gathered light");
    Buffer<Hit> hits(device_, std::size_t(pixels), "hits");
    // The queues of a vertex and the next one, of shadow rays and of last rays; their lengths for all vertices.
    Buffer<std::int32_t> queues(device_, 4 * std::size_t(pixels), "queues");
    Buffer<std::int32_t> counts(device_, 2 * std::size_t(vertex_count) + 2, "queues");
    const PathMemory memory{paths.data(), shadows.data(), lasts.data(), gathered.data(), hits.data()};
    const auto path_queue = [&](int vertex) {
        return PixelQueue{queues.data() + std::size_t(vertex & 1) * std::size_t(pixels), counts.data() + vertex};
    };
    const auto shadow_queue = [&](int vertex) {
        return PixelQueue{queues.data() + 2 * std::size_t(pixels), counts.data() + vertex_count + 1 + vertex};
    };
    const PixelQueue last_queue{queues.data() + 3 * std::size_t(pixels),
                                counts.data() + 2 * std::size_t(vertex_count) + 1};
    const auto queues_after = [&](int vertex) {
        return VertexQueues{path_queue(vertex + 1), shadow_queue(vertex), last_queue};
    };
    const Hit* first_hits = gbuffer.in_hit;
    std::uint32_t sample = frame.sample;
    const auto trace_shadows = [&](const char* name, int vertex, const ShadowRecord* rays, const PixelQueue& queue) {
        device_.launch_queue(name, pixels, queue.count,
                             ShadowStage<kernel>{vertices, memory, sample, frame.seed, vertex, rays, queue.pixels});
    };
    // Shadow rays, and the chains of the G-buffer, run beside what does not wait for them: 0.4 ms less of Sponza's 9.3
    // (H200).
    Device::Fork fork(device_);
    for (int i = 0; i < frame.samples; ++i, ++sample) {
        counts.clear();
        if (i > 0 && !same_rays) {
            device_.launch("path extend", width, height,
                           PrimaryHitStage<kernel>{scene_, camera_, sample, frame.seed, box_filter,
                                               frame.light_paths.transparent_bounces, hits.data()});
            first_hits = hits.data();
        }
        device_.launch("path shade", width, height,
                       FirstShadeStage<kernel>{vertices, memory, camera_, sample, frame.seed, box_filter, first_hits,
                                               gbuffer, writes_gbuffer, queues_after(0)});
        fork.beside([&] {
            if (writes_gbuffer) follow_chains();  // first: few threads that take long
            trace_shadows("path shadow", 0, shadows.data(), shadow_queue(0));
        });
        for (int vertex = 1; vertex < vertex_count; ++vertex) {
            const PixelQueue queue = path_queue(vertex);
            device_.launch_queue("path extend", pixels, queue.count,
                                 ExtendStage<kernel>{vertices, memory, sample, frame.seed, vertex, queue.pixels});
            fork.join();  // a vertex's light is added to that of the one before
            device_.launch_queue("path shade", pixels, queue.count,
                                 ShadeStage<kernel>{vertices, memory, sample, frame.seed, vertex, queue.pixels,
                                                    queues_after(vertex)});
            if (vertex + 1 < vertex_count)
                fork.beside([&] { trace_shadows("path shadow", vertex, shadows.data(), shadow_queue(vertex)); });
            // Many vertices are rarely used up, and a launch for nothing costs time, too.
            if (vertex % 16 == 0) {
                std::int32_t left;
                device_.download(&left, path_queue(vertex + 1).count, sizeof(left));
                if (left == 0) break;
            }
        }
        fork.join();
        if (scene_.last_hits_are_dark) trace_shadows("path last", 0, lasts.data(), last_queue);
        device_.launch("path gather", pixels, GatherStage{gathered.data(), out});
        out.first_of_frame = false;
        vertices.in_chain_light = nullptr;  // of the first sample
        writes_gbuffer = false;
    }
}

std::vector<Image> Tracer::cast(std::span<const float> rays, int width, int height, bool any_hit) {
    expect(width >= 1 && height >= 1 && std::int64_t(width) * height < (std::int64_t(1) << 28) &&
               rays.size() == 8 * std::size_t(width) * std::size_t(height),
           "Rays must be [H, W, 8], at least one and at most 2^28.");
    const std::size_t count = std::size_t(width) * std::size_t(height);
    const Buffer<GivenRay> in(device_, std::span(reinterpret_cast<const GivenRay*>(rays.data()), count), "rays");
    std::vector<Image> images;
    const auto integers = [&](const char* name) {
        images.push_back({name, 1, Buffer<std::int32_t>(device_, count, name)});
        return std::get<Buffer<std::int32_t>>(images.back().pixels).data();
    };
    if (any_hit) {
        device_.launch("occluded", width, height, OccludedStage{scene_, width, in.data(), integers("occluded")});
    } else {
        images.push_back({"distance", 1, Buffer<float>(device_, count, "distance")});
        float* const distance = std::get<Buffer<float>>(images.back().pixels).data();
        std::int32_t* const instance = integers("instance");
        device_.launch("closest", width, height,
                       ClosestStage{scene_, width, in.data(), distance, instance, integers("triangle")});
    }
    return images;
}

}  // namespace svgf
