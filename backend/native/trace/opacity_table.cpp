// SPDX-License-Identifier: Apache-2.0
#include "trace/opacity_table.h"

#include <algorithm>

#include "trace/surface.h"

namespace svgf {
namespace {

// Texels under a triangle beyond which it is not looked at one by one.
constexpr int most_texels = 1024;

// Least and largest value of a channel.
struct Range {
    float low, high;

    SVGF_HD OpacityClass opacity() const {
        return low >= 1.0f ? OpacityClass::opaque : high <= 0.0f ? OpacityClass::clear : OpacityClass::cut_out;
    }
};

// Interpolation goes between texels, and a transfer curve keeps 0, 1 and the order; but colours that are divided by
// alpha may leave the range of their texels.
SVGF_HD bool keeps_ranges(const TextureView& texture, std::int32_t channel) {
    return channel == 3 || !texture.associated_alpha;
}

// The class of a material as a whole.
OpacityClass class_of(const OpacityTable::Scene& scene, const Material& material) {
    switch (material.kind) {
        case MaterialKind::mix:
        case MaterialKind::add: {
            const auto is_opaque = [&](std::int32_t part) {
                return class_of(scene, scene.materials[std::size_t(part)]) == OpacityClass::opaque;
            };
            const bool both = is_opaque(material.first) && is_opaque(material.second);
            return both ? OpacityClass::opaque : OpacityClass::shaded;
        }
        case MaterialKind::transparent:
            return material.map_count == 0 && min_component(material.base_color) >= 1.0f ? OpacityClass::clear
                                                                                         : OpacityClass::shaded;
        case MaterialKind::principled: break;
        default: return OpacityClass::opaque;
    }
    Range alpha{material.alpha, material.alpha};
    if (material.alpha_map >= 0) {
        const MaterialMap& map = scene.maps[std::size_t(material.alpha_map)];
        const Texture& texture = *scene.textures[std::size_t(map.texture)];
        const bool is_covered = texture.view().extension != Extension::clip;
        alpha = {0.0f, 1.0f};
        if (keeps_ranges(texture.view(), map.channel))
            alpha = {is_covered ? channel_of(texture.low(), map.channel) : 0.0f,
                     channel_of(texture.high(), map.channel)};
    }
    const OpacityClass found = alpha.opacity();
    const bool shines = max_component(material.emission) > 0.0f;
    return found != OpacityClass::opaque && shines ? OpacityClass::shaded : found;
}

struct OpacityStage {
    SceneView scene;
    MeshView mesh;
    std::int32_t material_start;
    const OpacityClass* in_class;  // of the materials
    std::uint8_t* out_class;       // of the triangles

    SVGF_HD void operator()(int i) const {
        const std::int32_t material = scene.material_table[material_start + mesh.triangles[i].material_slot];
        OpacityClass found = in_class[material];
        const std::int32_t map = scene.materials[material].alpha_map;
        if (found == OpacityClass::cut_out && map >= 0) found = find_range(scene.material_maps[map], i).opacity();
        out_class[i] = std::uint8_t(found);
    }

private:
    // Of the texels that the map may read anywhere on the triangle, and of some around them.
    SVGF_HD Range find_range(const MaterialMap& map, int triangle) const {
        constexpr Range all{0.0f, 1.0f};
        const TextureView& texture = scene.textures[map.texture];
        if (!keeps_ranges(texture, map.channel)) return all;
        Vec2 low{infinity, infinity}, high{-infinity, -infinity};
        for (int corner = 0; corner < 3; ++corner) {
            const Vec2 uv = map_uv(mesh, map, {.weight1 = corner == 1 ? 1.0f : 0.0f,
                                               .weight2 = corner == 2 ? 1.0f : 0.0f,
                                               .leaf_triangle = triangle});
            low = {min(low.x, uv.x), min(low.y, uv.y)};
            high = {max(high.x, uv.x), max(high.y, uv.y)};
        }
        int first_x, last_x, first_y, last_y;
        if (!find_texels(low.x, high.x, texture.width, texture, first_x, last_x) ||
            !find_texels(low.y, high.y, texture.height, texture, first_y, last_y) ||
            (last_x - first_x + 1) * (last_y - first_y + 1) > most_texels)
            return all;
        Range range{infinity, -infinity};
        for (int y = first_y; y <= last_y; ++y)
            for (int x = first_x; x <= last_x; ++x) {
                const Vec4 texel = load_texel(texture, wrap_texel(x, texture.width, texture.extension),
                                              wrap_texel(y, texture.height, texture.extension));
                const float value = channel_of(texel, map.channel);
                range = {min(range.low, value), max(range.high, value)};
            }
        return range;
    }

    // The texels that coordinates from low to high read along one axis, numbered from a whole number of images. False
    // where they are too many, or rounding makes them unsure.
    SVGF_HD static bool find_texels(float low, float high, int size, const TextureView& texture, int& first,
                                    int& last) {
        if (!(max(std::fabs(low), std::fabs(high)) * float(size) < float(1 << 20))) return false;
        // Beside the point, and one more for roundings.
        const float around = texture.interpolation == Interpolation::cubic ? 3.0f : 2.0f;
        const float start = 2.0f * std::floor(low * 0.5f);
        const bool repeats = texture.extension == Extension::repeat || texture.extension == Extension::mirror;
        const float from = repeats ? low - start : clamp(low, -2.0f, 3.0f);
        const float to = repeats ? high - start : clamp(high, -2.0f, 3.0f);
        first = int(std::floor(from * float(size) - around));
        last = int(std::floor(to * float(size) + around));
        return last - first < most_texels;
    }
};

}  // namespace

void OpacityTable::find(Device& device, const Scene& scene, const SceneView& view) {
    classes_.clear();
    has_shaded_ = false;
    std::vector<OpacityClass> of_material;
    for (const Material& material : scene.materials) of_material.push_back(class_of(scene, material));
    const Buffer<OpacityClass> device_classes(device, std::span<const OpacityClass>(of_material), "materials");

    std::vector<const std::uint8_t*> of_instance(scene.instance_mesh.size());
    // Instances of one mesh with the same materials share their classes.
    std::map<std::pair<std::int32_t, std::vector<std::int32_t>>, const std::uint8_t*> known;
    for (std::size_t i = 0; i < of_instance.size(); ++i) {
        const Mesh& mesh = *scene.meshes[std::size_t(scene.instance_mesh[i])];
        const auto slots = scene.material_table.subspan(std::size_t(scene.material_start[i]),
                                                        std::size_t(mesh.slot_count()));
        const auto has = [&](OpacityClass wanted) {
            return std::any_of(slots.begin(), slots.end(),
                               [&](std::int32_t material) { return of_material[std::size_t(material)] == wanted; });
        };
        has_shaded_ |= has(OpacityClass::shaded);
        if (!has(OpacityClass::shaded) && !has(OpacityClass::cut_out) && !has(OpacityClass::clear)) continue;
        auto [place, is_new] = known.try_emplace({scene.instance_mesh[i], {slots.begin(), slots.end()}});
        if (is_new) {
            classes_.emplace_back(device, mesh.triangle_count(), "opacity");
            place->second = classes_.back().data();
            device.launch("opacity", int(mesh.triangle_count()),
                          OpacityStage{view, mesh.view(), scene.material_start[i], device_classes.data(),
                                       classes_.back().data()});
        }
        of_instance[i] = place->second;
    }
    of_instance_ = Buffer<const std::uint8_t*>(device, std::span<const std::uint8_t* const>(of_instance), "opacity");
}

}  // namespace svgf
