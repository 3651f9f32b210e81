// SPDX-License-Identifier: Apache-2.0
// The half of Tracer that takes scenes: checks what it is given, cleans it, and puts it on the device.
#include <algorithm>
#include <cstring>
#include <tuple>
#include <utility>

#include "device/threads.h"
#include "scene/top_level.h"
#include "trace/microfacet.h"
#include "trace/tracer.h"

namespace svgf {
namespace {

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

// Empty where no mesh with normals of its own has any.
std::vector<float> cleaned_terminator_offsets(const Tracer::Instances& arrays,
                                              std::span<const std::shared_ptr<Mesh>> meshes) {
    constexpr float smallest = 1e-6f, largest = 1e6f;
    std::vector<float> offsets(arrays.terminator_offset.begin(), arrays.terminator_offset.end());
    bool has_any = false;
    for (std::size_t i = 0; i < offsets.size(); ++i) {
        offsets[i] = offsets[i] >= smallest ? std::min(offsets[i], largest) : 0.0f;
        has_any |= offsets[i] > 0.0f && meshes[std::size_t(arrays.mesh[i])]->view().normals;
    }
    if (!has_any) offsets.clear();
    return offsets;
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
    material.coat_normal_mapped = row[47] > 0.0f;
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

// Whether no light passes a material straight, whatever its maps hold.
bool is_opaque(const Material& material) {
    if (material.kind == MaterialKind::principled) return material.alpha >= 1.0f && material.alpha_map < 0;
    return material.kind != MaterialKind::transparent && !is_mix(material.kind);
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
    expect(arrays.visibility.size() == count && arrays.emitter.size() == count &&
               arrays.terminator_offset.size() == count,
           "Each instance needs a visibility, an emitter and a terminator offset.");
    expect(count < (std::size_t(1) << 30), "There may be at most 2^30 instances.");

    std::vector<Instance> instances(count);
    std::vector<Placement> placements(count);
    std::vector<std::uint8_t> opaque(count);
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
            const auto slots = arrays.material_table.subspan(std::size_t(arrays.material_start[i]),
                                                             std::size_t(mesh.slot_count()));
            opaque[i] = std::all_of(slots.begin(), slots.end(), [&](std::int32_t material) {
                return material >= 0 && std::size_t(material) < material_rows_.size() &&
                       is_opaque(material_rows_[std::size_t(material)]);
            });
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

    merged_.update(device_, meshes, instances, placements, opaque);
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
    const std::vector<float> terminator_offsets = cleaned_terminator_offsets(arrays, meshes);
    terminator_offsets_ = Buffer<float>(device_, std::span<const float>(terminator_offsets), "instances");
    scene_.terminator_offsets = terminator_offsets.empty() ? nullptr : terminator_offsets_.data();
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
    expect(arrays.data.size() == 24 * count && arrays.visibility.size() == count && arrays.emission_map.size() == count,
           "Each light needs 24 values, a visibility and an emission map.");
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
        if (light.kind != LightKind::sun && light.kind != LightKind::environment) continue;
        expect(std::size_t(view.everywhere_count) == i, "Suns and the environment must come before other lights.");
        ++view.everywhere_count;
    }
    if (view.everywhere_count > 0) view.only = 0;
    view.choices = view.everywhere_count;
    for (std::size_t leaf = 0; leaf < leaves; ++leaf) {
        const std::int32_t light = arrays.light_of_leaf[leaf];
        expect(light >= -1 && light < std::int32_t(count), "The light tree names a light that is not there.");
        if (light < 0) continue;
        view.only = light;
        for (std::size_t i = std::size_t(light);; ++i) {
            expect(i < count, "A leaf of the light tree goes on beyond the last light.");
            lights[i].leaf = std::int32_t(leaf);
            ++view.choices;
            if (lights[i].ambient >= 1.0f) break;
        }
    }
    if (view.choices > 1) view.only = -1;
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
    const std::vector<LightNode> nodes = rows_of<LightNode>(arrays.tree);
    light_tree_ = Buffer<LightNode>(device_, std::span<const LightNode>(nodes), "the light tree");
    light_of_leaf_ = Buffer<std::int32_t>(device_, arrays.light_of_leaf, "the light tree");
    emitters_ = Buffer<Emitter>(device_, std::span<const Emitter>(emitters), "lights");
    light_of_triangle_ = Buffer<std::int32_t>(device_, arrays.light_of_triangle, "lights");
    emission_maps_ = Buffer<EmissionMap>(device_, std::span<const EmissionMap>(emission_maps), "lights");
    view.rows = lights_.data();
    view.count = std::int32_t(count);
    view.nodes = leaves ? light_tree_.data() : nullptr;
    view.light_of_leaf = light_of_leaf_.data();
    for (std::size_t n = leaves; n > 1; n /= 2) ++view.tree_depth;
    view.emitters = emitters_.data();
    view.light_of_triangle = light_of_triangle_.data();
    view.emission_maps = emission_maps_.data();
    scene_.lights = view;
}

void Tracer::set_world(const World& arrays) {
    WorldView view;
    view.radiance = cleaned_color({arrays.radiance[0], arrays.radiance[1], arrays.radiance[2]});
    view.visibility = arrays.visibility;
    view.texture = std::max(arrays.texture, -1);
    const auto& backdrop = arrays.backdrop_radiance;
    view.backdrop_radiance = cleaned_color({backdrop[0], backdrop[1], backdrop[2]});
    view.backdrop_texture = std::max(arrays.backdrop_texture, -1);
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
    std::vector<std::uint8_t> dark;
    for (const Material& material : material_rows_)
        dark.push_back(!shines(material) && !is_mix(material.kind) && material.kind != MaterialKind::transparent);
    dark_materials_ = Buffer<std::uint8_t>(device_, std::span<const std::uint8_t>(dark), "materials");
    scene_.dark_materials = dark_materials_.data();
    knows_opacity_ = true;
}

}  // namespace svgf
