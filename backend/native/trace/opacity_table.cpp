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

// Of what a map gives on a triangle.
struct MapOnTriangle {
    const MeshView& mesh;
    const TextureView& texture;
    const MaterialMap& map;
    int triangle;

    // The texels that the map may read anywhere between three points, given as weights of vertices 1 and 2, and some
    // around them.
    SVGF_HD Range range_between(const Vec2 (&corners)[3]) const {
        constexpr Range all{0.0f, 1.0f};
        if (!keeps_ranges(texture, map.channel)) return all;
        Vec2 low{infinity, infinity}, high{-infinity, -infinity};
        for (const Vec2 corner : corners) {
            const Vec2 uv = uv_at(corner);
            low = {min(low.x, uv.x), min(low.y, uv.y)};
            high = {max(high.x, uv.x), max(high.y, uv.y)};
        }
        int first_x, last_x, first_y, last_y;
        if (!find_texels(low.x, high.x, texture.width, first_x, last_x) ||
            !find_texels(low.y, high.y, texture.height, first_y, last_y) ||
            (last_x - first_x + 1) * (last_y - first_y + 1) > most_texels)
            return all;
        Range range{infinity, -infinity};
        for (int y = first_y; y <= last_y; ++y)
            for (int x = first_x; x <= last_x; ++x) {
                const float value = channel_of(
                    load_texel(texture, wrapped(x, texture.width), wrapped(y, texture.height)), map.channel);
                range = {min(range.low, value), max(range.high, value)};
                if (range.opacity() == OpacityClass::cut_out) return range;
            }
        return range;
    }

    // At which parts of a cut-out have few texels each.
    SVGF_HD int level() const {
        constexpr float texels_per_part = 12.0f;
        const Vec2 a = uv_at({0, 0}), b = uv_at({1, 0}) - a, c = uv_at({0, 1}) - a;
        const float texels = 0.5f * std::fabs(b.x * c.y - c.x * b.y) * float(texture.width) * float(texture.height);
        int level = TriangleOpacity::lowest_level;
        while (level < TriangleOpacity::highest_level && float(1 << (2 * level)) * texels_per_part < texels) ++level;
        return level;
    }

private:
    SVGF_HD Vec2 uv_at(Vec2 weights) const {
        return map_uv(mesh, map, {.weight1 = weights.x, .weight2 = weights.y, .leaf_triangle = triangle});
    }

    // Of a texel at any distance from the image.
    SVGF_HD int wrapped(int i, int size) const {
        const bool repeats = texture.extension == Extension::repeat || texture.extension == Extension::mirror;
        const int images = 2 * size;
        return wrap_texel(repeats ? (i % images + images) % images : i, size, texture.extension);
    }

    // The texels that coordinates from low to high read along one axis, numbered from a whole number of images. False
    // where they are too many, or rounding makes them unsure.
    SVGF_HD bool find_texels(float low, float high, int size, int& first, int& last) const {
        if (!(max(std::fabs(low), std::fabs(high)) * float(size) < float(1 << 18))) return false;
        // Beside the point, and half a texel for roundings.
        const float around = texture.interpolation == Interpolation::cubic ? 2.0f : 1.0f;
        const float start = 2.0f * std::floor(low * 0.5f);
        const bool repeats = texture.extension == Extension::repeat || texture.extension == Extension::mirror;
        const float from = repeats ? low - start : clamp(low, -2.0f, 3.0f);
        const float to = repeats ? high - start : clamp(high, -2.0f, 3.0f);
        first = int(std::floor(from * float(size) - around));
        last = int(std::floor(to * float(size) + around));
        return last - first < most_texels;
    }
};

struct OpacityStage {
    SceneView scene;
    MeshView mesh;
    std::int32_t material_start;
    const OpacityClass* in_class;  // of the materials
    TriangleOpacity* out;          // with the level of its parts, which are nowhere yet

    SVGF_HD void operator()(int i) const {
        const std::int32_t material = scene.material_table[material_start + mesh.triangles[i].material_slot];
        OpacityClass found = in_class[material];
        int level = 0;
        const std::int32_t map = scene.materials[material].alpha_map;
        if (found == OpacityClass::cut_out && map >= 0) {
            const MaterialMap& alpha = scene.material_maps[map];
            const MapOnTriangle on_triangle{mesh, scene.textures[alpha.texture], alpha, i};
            found = on_triangle.range_between({{0, 0}, {1, 0}, {0, 1}}).opacity();
            if (found == OpacityClass::cut_out) level = on_triangle.level();
        }
        out[i] = TriangleOpacity(found, level);
    }
};

// The parts of a word.
struct OpacityParts {
    std::int32_t triangle;
    std::uint32_t first;
};

struct OpacityPartsStage {
    SceneView scene;
    MeshView mesh;
    std::int32_t material_start;
    const TriangleOpacity* in_opacity;
    const OpacityParts* in_parts;
    std::uint32_t* out_words;

    SVGF_HD void operator()(int i) const {
        const OpacityParts parts = in_parts[i];
        const std::int32_t slot = mesh.triangles[parts.triangle].material_slot;
        const Material& material = scene.materials[scene.material_table[material_start + slot]];
        const MaterialMap& alpha = scene.material_maps[material.alpha_map];
        const MapOnTriangle on_triangle{mesh, scene.textures[alpha.texture], alpha, parts.triangle};
        const int level = in_opacity[parts.triangle].level();
        std::uint32_t word = 0;
        for (std::uint32_t k = 0; k < TriangleOpacity::parts_per_word; ++k) {
            Vec2 corners[3];
            TriangleOpacity::find_corners(level, parts.first + k, corners);
            word |= std::uint32_t(on_triangle.range_between(corners).opacity()) << (2u * k);
        }
        out_words[i] = word;
    }
};

// Gives the parts of triangles their words, from first_word on, one after the other, and lists what lies in each.
std::vector<OpacityParts> place_parts(std::vector<TriangleOpacity>& triangles, std::uint32_t first_word) {
    std::vector<OpacityParts> parts;
    for (std::size_t i = 0; i < triangles.size(); ++i) {
        const int level = triangles[i].level();
        if (level == 0) continue;
        const std::uint32_t words = TriangleOpacity::words(level), first = first_word + std::uint32_t(parts.size());
        if (first + words > TriangleOpacity::most_words) {
            triangles[i] = TriangleOpacity(triangles[i].whole());
            continue;
        }
        triangles[i] = TriangleOpacity(triangles[i].whole(), level, first);
        for (std::uint32_t word = 0; word < words; ++word)
            parts.push_back({std::int32_t(i), word * TriangleOpacity::parts_per_word});
    }
    return parts;
}

}  // namespace

void OpacityTable::find(Device& device, const Scene& scene, const SceneView& view) {
    triangles_.clear();
    has_shaded_ = false;
    std::vector<OpacityClass> of_material;
    for (const Material& material : scene.materials) of_material.push_back(class_of(scene, material));
    const Buffer<OpacityClass> device_classes(device, std::span<const OpacityClass>(of_material), "materials");

    // Of a mesh with the materials of one instance.
    struct Group {
        MeshView mesh;
        std::int32_t material_start;
        const TriangleOpacity* opacity;
        std::vector<OpacityParts> parts;
    };
    std::vector<Group> groups;
    std::uint32_t word_count = 0;
    std::vector<const TriangleOpacity*> of_instance(scene.instance_mesh.size());
    // Instances of one mesh with the same materials share what is found.
    std::map<std::pair<std::int32_t, std::vector<std::int32_t>>, const TriangleOpacity*> known;
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
            Buffer<TriangleOpacity> triangles(device, mesh.triangle_count(), "opacity");
            device.launch("opacity", int(mesh.triangle_count()),
                          OpacityStage{view, mesh.view(), scene.material_start[i], device_classes.data(),
                                       triangles.data()});
            if (has(OpacityClass::cut_out)) {
                std::vector<TriangleOpacity> placed(mesh.triangle_count(), TriangleOpacity(OpacityClass::opaque));
                device.download(placed.data(), triangles.data(), triangles.bytes());
                std::vector<OpacityParts> parts = place_parts(placed, word_count);
                word_count += std::uint32_t(parts.size());
                triangles.upload(placed);
                groups.push_back({mesh.view(), scene.material_start[i], triangles.data(), std::move(parts)});
            }
            place->second = triangles.data();
            triangles_.push_back(std::move(triangles));
        }
        of_instance[i] = place->second;
    }
    words_ = Buffer<std::uint32_t>(device, word_count, "opacity");
    std::uint32_t first_word = 0;
    for (const Group& group : groups) {
        const Buffer<OpacityParts> parts(device, std::span<const OpacityParts>(group.parts), "opacity");
        device.launch("opacity parts", int(group.parts.size()),
                      OpacityPartsStage{view, group.mesh, group.material_start, group.opacity, parts.data(),
                                        words_.data() + first_word});
        first_word += std::uint32_t(group.parts.size());
    }
    of_instance_ = Buffer<const TriangleOpacity*>(device, std::span<const TriangleOpacity* const>(of_instance),
                                                  "opacity");
}

}  // namespace svgf
