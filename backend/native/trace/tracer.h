// SPDX-License-Identifier: Apache-2.0
// Traces frames: owns the scene on the device, the order of the stages and the choice of their kernels.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "core/effects.h"
#include "device/device.h"
#include "scene/flat_scene.h"
#include "scene/mesh.h"
#include "scene/texture.h"
#include "trace/camera.h"

namespace svgf {

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
    };

    // L lights, lamps before triangles.
    struct Lights {
        std::span<const std::int32_t> kind;  // [L]
        std::span<const float> data;         // [L, 24]
        std::span<const float> probability;  // [L]
        std::span<const float> cdf;          // [L + 1]; may be empty if L is 0
        float triangle_light_scale = 0;
        std::array<float, 3> world_radiance{};
    };

    struct Cameras {
        std::span<const float, 12> camera_to_world;           // [3, 4]
        std::span<const float, 12> previous_camera_to_world;  // [3, 4]
        std::span<const float, 4> window;                     // left, right, bottom, top
        std::span<const float, 4> previous_window;
        std::span<const float, 2> clip;  // near, far
    };

    struct Frame {
        int width = 1, height = 1;  // >= 1
        std::uint32_t sample = 0;   // running number of the first sample
        int samples = 1;            // >= 1, of each pixel
        std::uint32_t seed = 0;
        int bounces = 0;            // >= 0; 0 is direct light
        std::uint32_t effects = 0;  // bits of Effects: all that the scene has, at least
        PixelFilter pixel_filter = PixelFilter::center;
        Signals signals = Signals::diffuse_specular;
    };

    explicit Tracer(Device& device);

    void set_instances(std::vector<std::shared_ptr<Mesh>> meshes, const Instances& arrays);
    // [M, 48] and [K, 12]
    void set_materials(std::span<const float> materials, std::span<const float> material_maps,
                       std::vector<std::shared_ptr<Texture>> textures);
    void set_albedo_tables(std::span<const float> tables);  // of trace/microfacet.h
    void set_lights(const Lights& arrays);
    void set_camera(const Cameras& arrays);

    // Stages "gbuffer" and "path". The images: "normal" 3, "depth", "depth_gradient" 2, "object_id" (int),
    // "material_id" (int), "roughness", "diffuse_albedo" 3, "specular_albedo" 3, "motion" 3, of the first sample; and
    // "emission" 3 and the signals, 3 each, means over the samples. The signals are "diffuse" and "specular", or
    // "direct" and "indirect"; "specular" is left out where the effects lack it.
    std::vector<Image> trace(const Frame& frame);

private:
    template <Effects kernel>
    std::vector<Image> trace_with(const Frame& frame);

    Device& device_;
    std::vector<std::shared_ptr<Mesh>> meshes_;
    std::vector<std::shared_ptr<Texture>> textures_;
    Buffer<WideNode> nodes_;
    Buffer<std::int32_t> instance_order_;
    Buffer<Instance> instances_;
    Buffer<Placement> placements_;
    Buffer<MeshView> mesh_views_;
    Buffer<std::int32_t> material_table_;
    Buffer<Material> materials_;
    Buffer<MaterialMap> material_maps_;
    Buffer<TextureView> texture_views_;
    Buffer<float> albedo_tables_;
    Buffer<Light> lights_;
    Buffer<float> light_cdf_;
    int largest_material_ = -1;  // that the table names
    SceneView scene_;
    Camera camera_, previous_camera_;
};

}  // namespace svgf
