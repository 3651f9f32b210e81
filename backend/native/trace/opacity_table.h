// SPDX-License-Identifier: Apache-2.0
// What light passes each triangle, found once so that rays need not ask its material: most triangles of a material with
// an alpha map, or most parts of them, are opaque or clear all over.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "device/device.h"
#include "scene/flat_scene.h"
#include "scene/mesh.h"
#include "scene/texture.h"

namespace svgf {

class OpacityTable {
public:
    // What the classes depend on. instance_mesh, material_start: [instances], with indices into meshes and
    // material_table; that has indices into materials.
    struct Scene {
        std::span<const std::shared_ptr<Mesh>> meshes;
        std::span<const std::int32_t> instance_mesh, material_start, material_table;
        std::span<const Material> materials;
        std::span<const MaterialMap> maps;
        std::span<const std::shared_ptr<Texture>> textures;
    };

    // view: of the same scene. Stages "opacity" and "opacity parts".
    void find(Device& device, const Scene& scene, const SceneView& view);

    // Of each instance that of its triangles, in leaf order, or null: no light passes any of them.
    const TriangleOpacity* const* view() const { return of_instance_.data(); }
    const std::uint32_t* words() const { return words_.data(); }
    // Whether any triangle is OpacityClass::shaded.
    bool has_shaded() const { return has_shaded_; }

private:
    std::vector<Buffer<TriangleOpacity>> triangles_;
    Buffer<const TriangleOpacity*> of_instance_;
    Buffer<std::uint32_t> words_;
    bool has_shaded_ = false;
};

}  // namespace svgf
