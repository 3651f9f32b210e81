// SPDX-License-Identifier: Apache-2.0
#include "trace/tracer.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "device/threads.h"
#include "scene/bvh.h"
#include "trace/gbuffer.h"
#include "trace/path.h"

namespace svgf {
namespace {

// Every kernel is compiled once for each of these. The first one that covers the effects of a frame runs, so they go
// from the cheapest to the one that covers everything.
constexpr Effects kernel_effects[] = {
    without(Effects::all, Effects::specular | Effects::transmission),
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

void expect(bool holds, const char* message) {
    if (!holds) throw InputError(message);
}

template <class Row>
std::vector<Row> rows_of(std::span<const float> values) {
    std::vector<Row> rows(values.size_bytes() / sizeof(Row));
    if (!rows.empty()) std::memcpy(static_cast<void*>(rows.data()), values.data(), values.size_bytes());
    return rows;
}

Mat34 matrix_at(std::span<const float> values, std::size_t i) {
    Mat34 matrix;
    for (int row = 0; row < 3; ++row) {
        const float* v = values.data() + 12 * i + 4 * std::size_t(row);
        matrix.row[row] = {v[0], v[1], v[2], v[3]};
    }
    return matrix;
}

Mat34 absolute(const Mat34& m) {
    Mat34 result;
    for (int row = 0; row < 3; ++row)
        result.row[row] = {std::fabs(m.row[row].x), std::fabs(m.row[row].y), std::fabs(m.row[row].z),
                           std::fabs(m.row[row].w)};
    return result;
}

// The transforms of a mesh whose vertices are relative to `centre`; in double, because the terms may cancel.
Mat34 with_centre(const Mat34& object_to_world, Vec3 centre) {
    Mat34 result = object_to_world;
    for (Vec4& row : result.row)
        row.w = float(double(row.x) * centre.x + double(row.y) * centre.y + double(row.z) * centre.z + row.w);
    return result;
}

// The translation that goes with the linear part of world_to_object, exactly opposite to that of the rounded
// object_to_world: a hit point must lie where rays find the triangle.
Mat34 inverse_of(const Mat34& object_to_world, const Mat34& world_to_object) {
    const Vec3 t = translation(object_to_world);
    Mat34 result = world_to_object;
    for (Vec4& row : result.row) row.w = float(-(double(row.x) * t.x + double(row.y) * t.y + double(row.z) * t.z));
    return result;
}

// Box of an instance in the world, with room for the roundings of both matrices: a ray finds the mesh where its
// world_to_object puts it. Empty if anything is not finite.
Bounds instance_bounds(const Bounds& mesh, const Mat34& object_to_world, const Mat34& world_to_object) {
    constexpr float rounding = 8.0f / 16777216.0f;
    if (mesh.is_empty()) return {};
    const Mat34 to_world = absolute(object_to_world), to_object = absolute(world_to_object);
    const Vec3 centre = transform_point(object_to_world, (mesh.low + mesh.high) * 0.5f);
    const Vec3 half = transform_vector(to_world, (mesh.high - mesh.low) * 0.5f);
    const Vec3 world_size = transform_point(to_world, max(abs(mesh.low), abs(mesh.high)));
    const Vec3 object_size = transform_point(to_object, world_size);
    const Vec3 margin = (world_size + transform_vector(to_world, object_size)) * rounding;
    const Bounds box{centre - half - margin, centre + half + margin};
    return is_finite(box.low) && is_finite(box.high) ? box : Bounds{};
}

Vec3 cleaned_color(Vec3 c) {
    const auto cleaned = [](float x) { return is_finite(x) && x > 0.0f ? x : 0.0f; };
    return {cleaned(c.x), cleaned(c.y), cleaned(c.z)};
}

// A row of floats of which some are whole numbers.
Material material_from(const float* row) {
    Material material;
    std::memcpy(static_cast<void*>(&material), row, sizeof(Material));
    material.kind = MaterialKind(row[3]);
    material.first = std::int32_t(row[32]);
    material.second = std::int32_t(row[33]);
    material.normal_uv_layer = std::int32_t(row[39]);
    material.map_start = std::int32_t(row[40]);
    material.map_count = std::int32_t(row[41]);
    material.tangent_uv_layer = std::int32_t(row[42]);
    return material;
}

MaterialMap material_map_from(const float* row) {
    MaterialMap map;
    std::memcpy(static_cast<void*>(&map), row, sizeof(MaterialMap));
    map.input = MaterialInput(row[0]);
    map.texture = std::int32_t(row[1]);
    map.channel = std::int32_t(row[2]);
    map.uv_layer = std::int32_t(row[3]);
    return map;
}

// What is out of range, or not a number, goes to the nearest value that shading can work with.
Material cleaned_material(Material material) {
    for (Vec3* color : {&material.base_color, &material.specular_tint, &material.coat_tint, &material.sheen_tint})
        *color = min(cleaned_color(*color), Vec3{1, 1, 1});
    for (float* share : {&material.metallic, &material.roughness, &material.transmission, &material.alpha,
                         &material.diffuse_roughness, &material.anisotropic_rotation, &material.coat_weight,
                         &material.coat_roughness, &material.sheen_weight, &material.sheen_roughness, &material.factor})
        *share = is_finite(*share) ? saturate(*share) : 0.0f;
    for (float* ior : {&material.ior, &material.coat_ior})
        *ior = is_finite(*ior) ? clamp(*ior, smallest_ior, largest_ior) : 1.0f;
    for (float* level : {&material.specular_ior_level, &material.normal_strength, &material.factor_fresnel_ior})
        *level = is_finite(*level) ? max(*level, 0.0f) : 0.0f;
    material.anisotropic = is_finite(material.anisotropic) ? clamp(material.anisotropic, -1.0f, 1.0f) : 0.0f;
    if (!is_finite(material.factor_facing_blend)) material.factor_facing_blend = -1.0f;
    material.emission = cleaned_color(material.emission);
    material.light_emission = cleaned_color(material.light_emission);
    return material;
}

// That what a material names is there, and that mixes end.
void check_materials(std::span<const Material> materials, std::size_t map_count) {
    std::vector<int> depths(materials.size(), 0);
    for (const Material& material : materials) {
        expect(material.kind >= MaterialKind::principled && material.kind <= MaterialKind::add,
               "Unknown kind of material.");
        expect(material.map_start >= 0 && material.map_count >= 0 &&
                   std::size_t(material.map_start) + std::size_t(material.map_count) <= map_count,
               "A material names maps that are not there.");
        expect(!is_mix(material.kind) || (material.first >= 0 && material.second >= 0 &&
                                          std::size_t(material.first) < materials.size() &&
                                          std::size_t(material.second) < materials.size()),
               "A material mixes one that is not there.");
    }
    for (int round = 0; round <= deepest_mix; ++round) {
        bool changed = false;
        for (std::size_t i = 0; i < materials.size(); ++i) {
            if (!is_mix(materials[i].kind)) continue;
            const int depth = 1 + std::max(depths[std::size_t(materials[i].first)],
                                           depths[std::size_t(materials[i].second)]);
            changed |= depth != depths[i];
            depths[i] = depth;
        }
        if (!changed) return;
    }
    throw InputError("A material mixes itself, or mixes are too deep.");
}

}  // namespace

Tracer::Tracer(Device& device) : device_(device) {
    set_instances({}, {});
    set_materials({}, {}, {});
    set_lights({});
}

void Tracer::set_instances(std::vector<std::shared_ptr<Mesh>> meshes, const Instances& arrays) {
    const std::size_t count = arrays.mesh.size();
    expect(arrays.object_to_world.size() == 12 * count && arrays.world_to_object.size() == 12 * count &&
               arrays.previous_object_to_world.size() == 12 * count,
           "Each instance needs three transforms of 3 x 4.");
    expect(arrays.object_id.size() == count && arrays.material_start.size() == count,
           "Each instance needs an object id and a material start.");
    expect(count < (std::size_t(1) << 30), "There may be at most 2^30 instances.");

    std::vector<Instance> instances(count);
    std::vector<Placement> placements(count);
    std::vector<Bounds> boxes(count);
    parallel_for(count, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            expect(arrays.mesh[i] >= 0 && std::size_t(arrays.mesh[i]) < meshes.size(),
                   "An instance names a mesh that is not there.");
            const Mesh& mesh = *meshes[std::size_t(arrays.mesh[i])];
            expect(arrays.material_start[i] >= 0 &&
                       std::size_t(arrays.material_start[i]) + std::size_t(mesh.slot_count()) <=
                           arrays.material_table.size(),
                   "The material slots of an instance reach beyond the material table.");
            placements[i] = {with_centre(matrix_at(arrays.object_to_world, i), mesh.centre()),
                             with_centre(matrix_at(arrays.previous_object_to_world, i), mesh.centre())};
            instances[i] = {inverse_of(placements[i].object_to_world, matrix_at(arrays.world_to_object, i)),
                            arrays.mesh[i], arrays.object_id[i], arrays.material_start[i]};
            boxes[i] = instance_bounds(mesh.bounds(), placements[i].object_to_world, instances[i].world_to_object);
        }
    });
    largest_material_ = -1;
    for (const std::int32_t material : arrays.material_table) {
        expect(material >= 0, "The material table names a material that is not there.");
        largest_material_ = std::max(largest_material_, material);
    }

    const Bvh bvh = build_bvh(boxes, 1);
    std::vector<MeshView> views;
    for (const auto& mesh : meshes) views.push_back(mesh->view());
    const std::vector<std::int32_t> order(bvh.primitives.begin(), bvh.primitives.end());
    meshes_ = std::move(meshes);
    nodes_ = Buffer<WideNode>(device_, std::span<const WideNode>(bvh.nodes), "the scene's tree");
    instance_order_ = Buffer<std::int32_t>(device_, std::span<const std::int32_t>(order), "the scene's tree");
    instances_ = Buffer<Instance>(device_, std::span<const Instance>(instances), "instances");
    placements_ = Buffer<Placement>(device_, std::span<const Placement>(placements), "instances");
    mesh_views_ = Buffer<MeshView>(device_, std::span<const MeshView>(views), "meshes");
    material_table_ = Buffer<std::int32_t>(device_, arrays.material_table, "the material table");
    scene_.nodes = nodes_.data();
    scene_.instance_order = instance_order_.data();
    scene_.instances = instances_.data();
    scene_.placements = placements_.data();
    scene_.meshes = mesh_views_.data();
    scene_.material_table = material_table_.data();
}

void Tracer::set_materials(std::span<const float> materials, std::span<const float> material_maps,
                           std::vector<std::shared_ptr<Texture>> textures) {
    expect(materials.size() % 48 == 0, "Materials must be [M, 48].");
    expect(material_maps.size() % 12 == 0, "Maps of materials must be [K, 12].");
    std::vector<Material> rows;
    for (std::size_t i = 0; i < materials.size(); i += 48) rows.push_back(cleaned_material(material_from(&materials[i])));
    std::vector<MaterialMap> maps;
    for (std::size_t i = 0; i < material_maps.size(); i += 12) {
        maps.push_back(material_map_from(&material_maps[i]));
        expect(maps.back().texture >= 0 && std::size_t(maps.back().texture) < textures.size(),
               "A material names a texture that is not there.");
    }
    check_materials(rows, maps.size());
    std::vector<TextureView> views;
    for (const auto& texture : textures) views.push_back(texture->view());
    textures_ = std::move(textures);
    materials_ = Buffer<Material>(device_, std::span<const Material>(rows), "materials");
    texture_views_ = Buffer<TextureView>(device_, std::span<const TextureView>(views), "textures");
    material_maps_ = Buffer<MaterialMap>(device_, std::span<const MaterialMap>(maps), "materials");
    scene_.materials = materials_.data();
    scene_.material_maps = material_maps_.data();
    scene_.textures = texture_views_.data();
}

void Tracer::set_albedo_tables(std::span<const float> tables) {
    expect(tables.size() == std::size_t(albedo_table_size), "The tables of albedos have another size.");
    albedo_tables_ = Buffer<float>(device_, tables, "tables of albedos");
    scene_.albedo_tables = albedo_tables_.data();
}

void Tracer::set_lights(const Lights& arrays) {
    const std::size_t count = arrays.kind.size();
    expect(arrays.data.size() == 24 * count && arrays.probability.size() == count,
           "Each light needs 24 values and a probability.");
    expect(arrays.cdf.size() == count + 1 || count == 0, "The lights' cdf must be [L + 1].");
    expect(count < (std::size_t(1) << 30), "There may be at most 2^30 lights.");
    std::vector<Light> lights = rows_of<Light>(arrays.data);
    scene_.lamp_count = scene_.sized_lamp_count = 0;
    for (std::size_t i = 0; i < count; ++i) {
        Light& light = lights[i];
        light.kind = LightKind(arrays.kind[i]);
        light.probability = arrays.probability[i];
        light.radiance = cleaned_color(light.radiance);
        expect(light.kind >= LightKind::point && light.kind <= LightKind::triangle, "Unknown kind of light.");
        if (light.kind == LightKind::triangle) continue;
        expect(std::size_t(scene_.lamp_count) == i, "Lamps must come before triangles.");
        ++scene_.lamp_count;
        if (light.is_delta == 0.0f) ++scene_.sized_lamp_count;
    }
    lights_ = Buffer<Light>(device_, std::span<const Light>(lights), "lights");
    light_cdf_ = Buffer<float>(device_, arrays.cdf, "lights");
    scene_.lights = lights_.data();
    scene_.light_cdf = light_cdf_.data();
    scene_.light_count = std::int32_t(count);
    scene_.triangle_light_scale = is_finite(arrays.triangle_light_scale) ? arrays.triangle_light_scale : 0.0f;
    scene_.world_radiance = cleaned_color(
        {arrays.world_radiance[0], arrays.world_radiance[1], arrays.world_radiance[2]});
}

void Tracer::set_camera(const Cameras& arrays) {
    const auto camera = [&](std::span<const float, 12> to_world, std::span<const float, 4> window) {
        return Camera{.to_world = matrix_at(to_world, 0),
                      .left = window[0],
                      .right = window[1],
                      .bottom = window[2],
                      .top = window[3],
                      .near_clip = arrays.clip[0],
                      .far_clip = arrays.clip[1]};
    };
    camera_ = camera(arrays.camera_to_world, arrays.window);
    previous_camera_ = camera(arrays.previous_camera_to_world, arrays.previous_window);
}

std::vector<Image> Tracer::trace(const Frame& frame) {
    expect(frame.width >= 1 && frame.height >= 1 && std::int64_t(frame.width) * frame.height < (std::int64_t(1) << 30),
           "An image must have at least one pixel, and at most 2^30.");
    expect(frame.samples >= 1 && frame.bounces >= 0, "There must be at least one sample, and no negative bounces.");
    expect(std::size_t(largest_material_ + 1) <= materials_.size(),
           "The material table names a material that is not there.");
    expect(scene_.albedo_tables, "There are no tables of albedos yet.");
    return with_kernel(Effects(frame.effects), [&]<Effects kernel>() { return trace_with<kernel>(frame); });
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
    const bool two_signals = splits_direct || covers(Effects(frame.effects), Effects::specular);

    Buffer<Hit> hits(device_, pixels, "primary hits");
    GbufferStage<kernel> gbuffer{
        .scene = scene_,
        .camera = camera_,
        .previous_camera = previous_camera_,
        .sample = frame.sample,
        .seed = frame.seed,
        .box_filter = box_filter,
        .camera_moves = covers(Effects(frame.effects), Effects::camera_motion),
        .out_hit = hits.data(),
        .out_normal = vectors("normal"),
        .out_depth = floats("depth", 1),
        .out_depth_gradient = reinterpret_cast<Vec2*>(floats("depth_gradient", 2)),
        .out_object_id = integers("object_id"),
        .out_material_id = integers("material_id"),
        .out_roughness = floats("roughness", 1),
        .out_diffuse_albedo = vectors("diffuse_albedo"),
        .out_specular_albedo = vectors("specular_albedo"),
        .out_motion = vectors("motion"),
    };
    device_.launch("gbuffer", frame.width, frame.height, gbuffer);

    PathStage<kernel> path{
        .scene = scene_,
        .camera = camera_,
        .sample = frame.sample,
        .seed = frame.seed,
        .bounces = frame.bounces,
        .box_filter = box_filter,
        .splits_direct = splits_direct,
        .first_of_frame = true,
        .weight = 1.0f / float(frame.samples),
        .in_hit = hits.data(),
        .out_emission = vectors("emission"),
        .out_first_signal = vectors(splits_direct ? "direct" : "diffuse"),
        .out_second_signal = two_signals ? vectors(splits_direct ? "indirect" : "specular") : nullptr,
    };
    for (int i = 0; i < frame.samples; ++i) {
        device_.launch("path", frame.width, frame.height, path);
        ++path.sample;
        path.first_of_frame = false;
        // Through the pixels' centres all samples start with the same ray.
        if (box_filter) path.in_hit = nullptr;
    }
    return images;
}

}  // namespace svgf
