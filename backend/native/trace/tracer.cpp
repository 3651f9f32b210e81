// SPDX-License-Identifier: Apache-2.0
#include "trace/tracer.h"

#include <algorithm>
#include <cstring>
#include <tuple>
#include <utility>

#include "device/threads.h"
#include "scene/top_level.h"
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
    material.alpha_map = -1;
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

// Sorts the maps of a material so that those which read the same texel follow each other, and are marked.
void put_same_texels_together(std::span<MaterialMap> maps) {
    const auto place = [](const MaterialMap& map) {
        const float* m = map.uv_transform;
        return std::tuple(map.texture, map.uv_layer, m[0], m[1], m[2], m[3], m[4], m[5]);
    };
    std::stable_sort(maps.begin(), maps.end(),
                     [&](const MaterialMap& a, const MaterialMap& b) { return place(a) < place(b); });
    for (std::size_t i = 0; i < maps.size(); ++i)
        maps[i].same_texel = i > 0 && place(maps[i]) == place(maps[i - 1]) ? 1 : 0;
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
    expect(arrays.visibility.size() == count && arrays.emitter.size() == count,
           "Each instance needs a visibility and an emitter.");
    expect(count < (std::size_t(1) << 30), "There may be at most 2^30 instances.");

    std::vector<Instance> instances(count);
    std::vector<Placement> placements(count);
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
                            arrays.mesh[i], arrays.object_id[i], arrays.material_start[i], arrays.visibility[i],
                            std::uint32_t(arrays.emitter[i] + 1)};
        }
    });
    largest_material_ = -1;
    for (const std::int32_t material : arrays.material_table) {
        expect(material >= 0, "The material table names a material that is not there.");
        largest_material_ = std::max(largest_material_, material);
    }

    largest_emitter_ = -1;
    for (const std::int32_t emitter : arrays.emitter) {
        expect(emitter >= -1 && emitter < (1 << 24) - 1, "An instance names an emitter that is not there.");
        largest_emitter_ = std::max(largest_emitter_, emitter);
    }

    merged_.update(device_, meshes, instances, placements);
    // Behind all others, as an instance that stands where the world does.
    std::vector<std::shared_ptr<Mesh>> trees = meshes;
    scene_.merged_instance = -1;
    if (merged_.has_members()) {
        constexpr Mat34 identity{{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};
        scene_.merged_instance = std::int32_t(count);
        instances.push_back({identity, std::int32_t(trees.size()), 0, 0, ray_kind::all, 0});
        placements.push_back({identity, identity});
        trees.push_back(merged_.mesh());
    }
    scene_.members = merged_.view();
    const TopLevel top = build_top_level(trees, instances, placements, merged_.members());
    std::vector<MeshView> views;
    for (const auto& tree : trees) views.push_back(tree->view());
    const auto keep = [this]<class Rows>(Rows& kept, const auto& rows) {
        if (std::equal(kept.begin(), kept.end(), rows.begin(), rows.end())) return;
        kept = Rows(rows.begin(), rows.end());
        knows_opacity_ = false;
    };
    keep(meshes_, meshes);
    keep(instance_mesh_, arrays.mesh);
    keep(material_start_, arrays.material_start);
    keep(material_table_rows_, arrays.material_table);
    nodes_ = Buffer<WideNode>(device_, std::span<const WideNode>(top.nodes), "the scene's tree");
    top_leaves_ = Buffer<TopLeaf>(device_, std::span<const TopLeaf>(top.leaves), "the scene's tree");
    instances_ = Buffer<Instance>(device_, std::span<const Instance>(instances), "instances");
    placements_ = Buffer<Placement>(device_, std::span<const Placement>(placements), "instances");
    mesh_views_ = Buffer<MeshView>(device_, std::span<const MeshView>(views), "meshes");
    material_table_ = Buffer<std::int32_t>(device_, arrays.material_table, "the material table");
    scene_.nodes = nodes_.data();
    scene_.has_one_leaf = top.leaves.size() == 1;
    scene_.top_leaves = top_leaves_.data();
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
    for (Material& material : rows) {
        const auto own_maps = std::span(maps).subspan(std::size_t(material.map_start), std::size_t(material.map_count));
        put_same_texels_together(own_maps);
        for (std::size_t i = 0; i < own_maps.size(); ++i)
            if (own_maps[i].input == MaterialInput::alpha) material.alpha_map = material.map_start + std::int32_t(i);
    }
    std::vector<TextureView> views;
    for (const auto& texture : textures) views.push_back(texture->view());
    textures_ = std::move(textures);
    materials_ = Buffer<Material>(device_, std::span<const Material>(rows), "materials");
    texture_views_ = Buffer<TextureView>(device_, std::span<const TextureView>(views), "textures");
    material_maps_ = Buffer<MaterialMap>(device_, std::span<const MaterialMap>(maps), "materials");
    scene_.materials = materials_.data();
    scene_.material_maps = material_maps_.data();
    scene_.textures = texture_views_.data();
    material_rows_ = std::move(rows);
    material_map_rows_ = std::move(maps);
    knows_opacity_ = false;
}

void Tracer::set_albedo_tables(std::span<const float> tables) {
    expect(tables.size() == std::size_t(albedo_table_size), "The tables of albedos have another size.");
    albedo_tables_ = Buffer<float>(device_, tables, "tables of albedos");
    scene_.albedo_tables = albedo_tables_.data();
}

void Tracer::set_lights(const Lights& arrays) {
    const std::size_t count = arrays.kind.size();
    expect(arrays.data.size() == 24 * count && arrays.probability.size() == count &&
               arrays.visibility.size() == count && arrays.emission_map.size() == count,
           "Each light needs 24 values, a probability, a visibility and an emission map.");
    expect(count < (std::size_t(1) << 30), "There may be at most 2^30 lights.");
    const std::size_t leaves = arrays.light_of_leaf.size(), maps = arrays.emission_maps.size() / 8;
    expect(leaves == 0 ? arrays.tree.empty() : arrays.tree.size() == 12 * (2 * leaves - 1) && !(leaves & (leaves - 1)),
           "The light tree must have 2^n leaves and 2^(n + 1) - 1 nodes of 12 values.");
    std::vector<Light> lights(count);
    LightsView view;
    largest_texture_ = -1;
    for (std::size_t i = 0; i < count; ++i) {
        Light& light = lights[i];
        std::memcpy(static_cast<void*>(&light), arrays.data.data() + 24 * i, 24 * sizeof(float));
        light.kind = LightKind(arrays.kind[i]);
        light.visibility = arrays.visibility[i];
        light.probability = arrays.probability[i];
        light.emission_map = arrays.emission_map[i];
        light.leaf = -1;
        light.radiance = cleaned_color(light.radiance);
        expect(light.kind >= LightKind::point && light.kind <= LightKind::environment, "Unknown kind of light.");
        expect(light.emission_map >= -1 && light.emission_map < std::int32_t(maps),
               "A light names an emission map that is not there.");
        if (light.kind == LightKind::triangle) continue;
        expect(std::size_t(view.lamp_count) == i, "Lamps must come before triangles.");
        ++view.lamp_count;
        if (light.is_delta == 0.0f && light.kind != LightKind::environment) view.sized_lamps_seen_by |= light.visibility;
    }
    for (std::size_t leaf = 0; leaf < leaves; ++leaf) {
        const std::int32_t light = arrays.light_of_leaf[leaf];
        expect(light >= -1 && light < std::int32_t(count), "The light tree names a light that is not there.");
        if (light >= 0) lights[std::size_t(light)].leaf = std::int32_t(leaf);
    }
    std::vector<Emitter> emitters(arrays.emitters.size() / 2);
    for (std::size_t i = 0; i < emitters.size(); ++i) {
        emitters[i] = {arrays.emitters[2 * i], arrays.emitters[2 * i + 1]};
        expect(emitters[i].first_light >= 0 && emitters[i].table >= 0, "An emitter starts before the first light.");
    }
    std::vector<EmissionMap> emission_maps(maps);
    for (std::size_t i = 0; i < maps; ++i) {
        const float* row = arrays.emission_maps.data() + 8 * i;
        emission_maps[i] = {{{row[0], row[1]}, {row[2], row[3]}, {row[4], row[5]}}, std::int32_t(row[6]), 0};
        expect(emission_maps[i].texture >= 0, "A light names a texture that is not there.");
        largest_texture_ = std::max(largest_texture_, emission_maps[i].texture);
    }
    lights_ = Buffer<Light>(device_, std::span<const Light>(lights), "lights");
    light_cdf_ = Buffer<float>(device_, arrays.cdf, "lights");
    const std::vector<LightNode> nodes = rows_of<LightNode>(arrays.tree);
    light_tree_ = Buffer<LightNode>(device_, std::span<const LightNode>(nodes), "the light tree");
    light_of_leaf_ = Buffer<std::int32_t>(device_, arrays.light_of_leaf, "the light tree");
    emitters_ = Buffer<Emitter>(device_, std::span<const Emitter>(emitters), "lights");
    light_of_triangle_ = Buffer<std::int32_t>(device_, arrays.light_of_triangle, "lights");
    emission_maps_ = Buffer<EmissionMap>(device_, std::span<const EmissionMap>(emission_maps), "lights");
    view.rows = lights_.data();
    view.count = std::int32_t(count);
    view.cdf = light_cdf_.data();
    view.interval_count = std::max(std::int32_t(arrays.cdf.size()) - 1, 0);
    view.nodes = leaves ? light_tree_.data() : nullptr;
    view.light_of_leaf = light_of_leaf_.data();
    for (std::size_t n = leaves; n > 1; n /= 2) ++view.tree_depth;
    view.emitters = emitters_.data();
    view.light_of_triangle = light_of_triangle_.data();
    view.emission_maps = emission_maps_.data();
    expect(std::size_t(view.interval_count) <= count + (leaves ? 1 : 0), "The lights' cdf has too many intervals.");
    scene_.lights = view;
}

void Tracer::set_world(const World& arrays) {
    WorldView view;
    view.radiance = cleaned_color({arrays.radiance[0], arrays.radiance[1], arrays.radiance[2]});
    view.visibility = arrays.visibility;
    view.texture = std::max(arrays.texture, -1);
    view.light = arrays.light;
    for (int row = 0; row < 3; ++row)
        view.to_environment[row] = {arrays.to_environment[std::size_t(3 * row)],
                                    arrays.to_environment[std::size_t(3 * row + 1)],
                                    arrays.to_environment[std::size_t(3 * row + 2)]};
    const std::size_t rows = std::size_t(std::max(arrays.rows, 0)), columns = std::size_t(std::max(arrays.columns, 0));
    expect(rows == 0 || (arrays.row_cdf.size() == rows + 1 && arrays.column_cdf.size() == rows * (columns + 1)),
           "The environment's cdfs must be [rows + 1] and [rows, columns + 1].");
    row_cdf_ = Buffer<float>(device_, arrays.row_cdf, "the environment");
    column_cdf_ = Buffer<float>(device_, arrays.column_cdf, "the environment");
    view.row_cdf = row_cdf_.data();
    view.column_cdf = column_cdf_.data();
    view.rows = std::int32_t(rows);
    view.columns = std::int32_t(columns);
    scene_.world = view;
}

void Tracer::set_camera(const Cameras& arrays) {
    const auto camera = [&](std::span<const float, 12> to_world, std::span<const float, 4> window,
                            std::span<const float, 6> lens) {
        return Camera{.to_world = matrix_at(to_world, 0),
                      .left = window[0],
                      .right = window[1],
                      .bottom = window[2],
                      .top = window[3],
                      .near_clip = arrays.clip[0],
                      .far_clip = arrays.clip[1],
                      .is_orthographic = lens[0] != 0.0f,
                      .aperture = {lens[1], lens[2], lens[3], lens[4], lens[5]}};
    };
    camera_ = camera(arrays.camera_to_world, arrays.window, arrays.lens);
    previous_camera_ = camera(arrays.previous_camera_to_world, arrays.previous_window, arrays.previous_lens);
}

std::span<const Effects> Tracer::kernels() { return kernel_effects; }

void Tracer::find_opacity() {
    opacity_.find(device_, {meshes_, instance_mesh_, material_start_, material_table_rows_, material_rows_,
                            material_map_rows_, textures_}, scene_);
    scene_.opacity = opacity_.view();
    scene_.opacity_words = opacity_.words();
    const auto shines = [](const Material& material) {
        return max(max_component(material.emission), max_component(material.light_emission)) > 0.0f;
    };
    scene_.last_hits_are_dark =
        !opacity_.has_shaded() && std::none_of(material_rows_.begin(), material_rows_.end(), shines);
    knows_opacity_ = true;
}

std::vector<Image> Tracer::trace(const Frame& frame) {
    expect(frame.width >= 1 && frame.height >= 1 && std::int64_t(frame.width) * frame.height < (std::int64_t(1) << 30),
           "An image must have at least one pixel, and at most 2^30.");
    expect(frame.samples >= 1 && frame.light_paths.bounces >= 0,
           "There must be at least one sample, and no negative bounces.");
    expect(std::size_t(largest_emitter_ + 1) <= emitters_.size(), "An instance names an emitter that is not there.");
    expect(scene_.world.light < scene_.lights.count, "The world names a light that is not there.");
    expect(std::size_t(std::max(largest_texture_, scene_.world.texture) + 1) <= textures_.size(),
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
    device_.launch("gbuffer", frame.width, frame.height, gbuffer);
    if constexpr (covers(kernel, Effects::specular))
        if (has_chains)
            device_.launch_queue("gbuffer chains", int(pixels), smooth_count.data(),
                                 SpecularChainStage<kernel>{gbuffer, smooth_pixels.data()});

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
    // With a lens each sample has a ray of its own even through the middle of the pixel.
    // So has each where chance decides what it passes.
    const bool same_rays = !box_filter && camera_.aperture.radius == 0.0f && !covers(kernel, Effects::alpha);
    if constexpr (Device::follows_paths_together) {
        trace_wavefront(frame, vertices, same_rays, hits.data(), radiance);
    } else {
        PathStage<kernel> path{.vertices = vertices,
                               .camera = camera_,
                               .sample = frame.sample,
                               .seed = frame.seed,
                               .box_filter = box_filter,
                               .in_hit = hits.data(),
                               .out = radiance};
        for (int i = 0; i < frame.samples; ++i) {
            device_.launch("path", frame.width, frame.height, path);
            ++path.sample;
            path.out.first_of_frame = false;
            path.vertices.in_chain_light = nullptr;  // of the first sample
            if (!same_rays) path.in_hit = nullptr;
        }
    }
    return images;
}

template <Effects kernel>
void Tracer::trace_wavefront(const Frame& frame, PathVertices<kernel> vertices, bool same_rays,
                             const Hit* first_hits, RadianceImages out) {
    const int width = frame.width, height = frame.height, pixels = width * height;
    const bool box_filter = frame.pixel_filter == PixelFilter::box;
    // The last ray of a path only looks for light. A surface that lets it straight through may be a vertex, too.
    const int vertex_count = frame.light_paths.bounces + 2 +
                             (opacity_.has_shaded() ? frame.light_paths.transparent_bounces + 1 : 0);
    Buffer<PathRecord> paths(device_, std::size_t(pixels), "paths");
    Buffer<ShadowRecord> shadows(device_, std::size_t(pixels), "shadow rays");
    Buffer<GatheredRecord> gathered(device_, std::size_t(pixels), "gathered light");
    Buffer<Hit> hits(device_, std::size_t(pixels), "hits");
    // The queues of a vertex and the next one, and of shadow rays; their lengths for all vertices.
    Buffer<std::int32_t> queues(device_, 3 * std::size_t(pixels), "queues");
    Buffer<std::int32_t> counts(device_, 2 * std::size_t(vertex_count) + 1, "queues");
    const PathMemory memory{paths.data(), shadows.data(), gathered.data(), hits.data()};
    const auto path_queue = [&](int vertex) {
        return PixelQueue{queues.data() + std::size_t(vertex & 1) * std::size_t(pixels), counts.data() + vertex};
    };
    const auto shadow_queue = [&](int vertex) {
        return PixelQueue{queues.data() + 2 * std::size_t(pixels), counts.data() + vertex_count + 1 + vertex};
    };
    std::uint32_t sample = frame.sample;
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
                                               path_queue(1), shadow_queue(0)});
        device_.launch_queue("path shadow", pixels, shadow_queue(0).count,
                             ShadowStage<kernel>{vertices, memory, sample, frame.seed, 0, shadow_queue(0).pixels});
        for (int vertex = 1; vertex < vertex_count; ++vertex) {
            const PixelQueue queue = path_queue(vertex);
            const ExtendStage<kernel> extend{vertices, memory, sample, frame.seed, vertex, queue.pixels};
            // Those that leave the first surface mostly measure a distance, if it has specular lobes.
            const bool measures_distance = vertex == 1 && covers(kernel, Effects::specular);
            if (vertex + 1 == vertex_count && scene_.last_hits_are_dark && !measures_distance)
                device_.launch_queue("path extend", pixels, queue.count, LastExtendStage<kernel>{extend});
            else
                device_.launch_queue("path extend", pixels, queue.count, extend);
            device_.launch_queue("path shade", pixels, queue.count,
                                 ShadeStage<kernel>{vertices, memory, sample, frame.seed, vertex, queue.pixels,
                                                    path_queue(vertex + 1), shadow_queue(vertex)});
            if (vertex + 1 < vertex_count)
                device_.launch_queue("path shadow", pixels, shadow_queue(vertex).count,
                                     ShadowStage<kernel>{vertices, memory, sample, frame.seed, vertex,
                                                         shadow_queue(vertex).pixels});
            // Many vertices are rarely used up, and a launch for nothing costs time, too.
            if (vertex % 16 == 0) {
                std::int32_t left;
                device_.download(&left, path_queue(vertex + 1).count, sizeof(left));
                if (left == 0) break;
            }
        }
        device_.launch("path gather", pixels, GatherStage{gathered.data(), out});
        out.first_of_frame = false;
        vertices.in_chain_light = nullptr;  // of the first sample
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
