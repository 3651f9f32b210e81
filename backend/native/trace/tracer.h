// SPDX-License-Identifier: Apache-2.0
// Traces frames: owns the scene on the device, the order of the stages and the choice of their kernels.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "core/effects.h"
#include "device/device.h"
#include "scene/flat_scene.h"
#include "scene/merged_objects.h"
#include "scene/mesh.h"
#include "scene/texture.h"
#include "trace/camera.h"
#include "trace/light_paths.h"
#include "trace/opacity_table.h"

namespace svgf {

struct Hit;
template <Effects kernel>
struct GbufferStage;
template <Effects kernel>
struct PathVertices;
struct RadianceImages;

enum class PixelFilter { box, center };
enum class Signals { diffuse_specular, direct_indirect };

// An image on the device: [height, width] if channels is 1, else [height, width, channels]; row 0 on top.
struct Image {
    std::string name;
    int channels;
    std::variant<Buffer<float>, Buffer<std::int32_t>> pixels;
};

// The setters copy what they are given, may be called in any order and again; meshes and textures are shared. All of
// them throw InputError on lengths and indices that do not fit. Not thread-safe. The device must outlive the tracer.
class Tracer {
public:
    // Rows of svgf.FlatScene; N instances.
    struct Instances {
        std::span<const std::int32_t> mesh;               // [N], index into meshes
        std::span<const float> object_to_world;           // [N, 3, 4]
        std::span<const float> world_to_object;           // [N, 3, 4]
        std::span<const float> previous_object_to_world;  // [N, 3, 4]
        std::span<const std::int32_t> object_id;          // [N]
        std::span<const std::int32_t> material_start;     // [N]
        std::span<const std::int32_t> material_table;
        std::span<const std::uint8_t> visibility;         // [N]
        std::span<const std::int32_t> emitter;            // [N], index into Lights::emitters, or -1
        std::span<const float> terminator_offset;         // [N], >= 0
    };

    // L lights: suns, the environment, other lamps, triangles.
    struct Lights {
        std::span<const std::int32_t> kind;               // [L]
        std::span<const float> data;                      // [L, 24]
        std::span<const std::uint8_t> visibility;         // [L]
        std::span<const float> tree;                      // [2^(depth + 1) - 1, 12], or empty
        std::span<const std::int32_t> light_of_leaf;      // [2^depth]
        std::span<const std::int32_t> emitters;           // [E, 2]
        std::span<const std::int32_t> light_of_triangle;
        std::span<const std::int32_t> emission_map;       // [L], row of emission_maps, or -1
        std::span<const float> emission_maps;             // [K, 8]
    };

    struct World {
        std::array<float, 3> radiance{};
        std::uint32_t visibility = 0;
        std::int32_t texture = -1;                  // index into the textures of set_materials
        std::array<float, 3> backdrop_radiance{};   // the same two for the camera's rays
        std::int32_t backdrop_texture = -1;
        std::int32_t light = -1;                    // the environment's row of the lights
        std::array<float, 9> to_environment{};      // by rows
        std::int32_t rows = 0, columns = 0;         // 0: directions are not sampled by the image
        std::span<const float> row_cdf;             // [rows + 1]
        std::span<const float> column_cdf;          // [rows, columns + 1]
    };

    struct Cameras {
        std::span<const float, 12> camera_to_world;           // [3, 4]
        std::span<const float, 12> previous_camera_to_world;  // [3, 4]
        std::span<const float, 4> window;                     // left, right, bottom, top
        std::span<const float, 4> previous_window;
        std::span<const float, 2> clip;              // near, far
        std::span<const float, 6> lens;              // as FlatScene.lens
        std::span<const float, 6> previous_lens;
    };

    struct Frame {
        int width = 1, height = 1;  // >= 1
        std::uint32_t sample = 0;   // running number of the first sample
        int samples = 1;            // >= 1, of each pixel
        std::uint32_t seed = 0;
        LightPaths light_paths;
        bool transparent_film = false;
        std::uint32_t effects = 0;  // bits of Effects: all that the scene has, at least
        std::uint32_t kernel = 0;   // more that the kernel must cover, to measure what it costs
        PixelFilter pixel_filter = PixelFilter::center;
        Signals signals = Signals::diffuse_specular;
    };

    explicit Tracer(Device& device);

    // After set_materials, and again where that is called again: an object's tree depends on whether light passes it.
    void set_instances(std::vector<std::shared_ptr<Mesh>> meshes, const Instances& arrays);
    // [M, 48] and [K, 12]
    void set_materials(std::span<const float> materials, std::span<const float> material_maps,
                       std::vector<std::shared_ptr<Texture>> textures);
    void set_albedo_tables(std::span<const float> tables);  // of trace/microfacet.h
    void set_lights(const Lights& arrays);
    void set_world(const World& arrays);
    void set_camera(const Cameras& arrays);

    // Stages "gbuffer" and "path". The images: "normal" 3, "depth", "depth_gradient" 2, "object_id" (int),
    // "material_id" (int), "roughness", "diffuse_albedo" 3, "specular_albedo" 3, "motion" 3, of the first sample; and
    // "emission" 3 and the signals, 3 each, means over the samples. The signals are "diffuse" and "specular", or
    // "direct" and "indirect". "hit_distance", of the first sample: in metres from the seen surface to what its
    // specular lobes' ray hit next, background_depth for the world, 0 where the path took no such ray. With
    // perfect_specular among the effects, all but "material_id" are of what is seen in mirrors and through clear glass
    // (trace/specular_chain.h), and "first_normal" 3, "first_depth", "first_object_id" (int) and "first_motion" 3 of
    // what the camera's ray hits. Left out: "specular", "specular_albedo" and "hit_distance" where the effects lack
    // specular, "motion" and "first_motion" where nothing moves. With a transparent film, "alpha" too.
    std::vector<Image> trace(const Frame& frame);

    // What each kernel simulates, from the cheapest on: the first one that covers a frame's effects runs.
    static std::span<const Effects> kernels();

    // rays: [height, width, 8], origin, direction, and the distances between which hits count, in lengths of the
    // direction. Stage "closest": images "distance", infinity where nothing is hit, "instance" and "triangle" (int),
    // -1 there. With any_hit stage "occluded": image "occluded" (int), 0 or 1.
    std::vector<Image> cast(std::span<const float> rays, int width, int height, bool any_hit);

private:
    template <Effects kernel>
    std::vector<Image> trace_with(const Frame& frame);
    template <Effects kernel>
    void trace_wavefront(const Frame& frame, PathVertices<kernel> vertices, const GbufferStage<kernel>& gbuffer,
                         bool writes_gbuffer, bool same_rays, RadianceImages out,
                         const std::function<void()>& follow_chains);

    void find_opacity();

    Device& device_;
    std::vector<std::shared_ptr<Mesh>> meshes_;
    std::vector<std::shared_ptr<Texture>> textures_;
    MergedObjects merged_;
    Buffer<WideNode> nodes_;
    Buffer<TopLeaf> top_leaves_;
    Buffer<Instance> instances_;
    Buffer<Placement> placements_;
    Buffer<float> terminator_offsets_;
    Buffer<MeshView> mesh_views_;
    Buffer<std::int32_t> material_table_;
    Buffer<Material> materials_;
    Buffer<MaterialMap> material_maps_;
    Buffer<std::uint8_t> dark_materials_;
    Buffer<TextureView> texture_views_;
    Buffer<float> albedo_tables_;
    Buffer<Light> lights_;
    Buffer<LightNode> light_tree_;
    Buffer<std::int32_t> light_of_leaf_;
    Buffer<Emitter> emitters_;
    Buffer<std::int32_t> light_of_triangle_;
    Buffer<EmissionMap> emission_maps_;
    Buffer<float> row_cdf_, column_cdf_;
    // What the opacity of triangles depends on.
    std::vector<std::int32_t> instance_mesh_, material_start_, material_table_rows_;
    std::vector<Material> material_rows_;
    std::vector<MaterialMap> material_map_rows_;
    OpacityTable opacity_;
    bool knows_opacity_ = false;
    int largest_material_ = -1;  // that the table names
    int largest_emitter_ = -1;   // that an instance names
    int largest_texture_ = -1;   // that lights and the world name
    SceneView scene_;
    Camera camera_, previous_camera_;
};

}  // namespace svgf
