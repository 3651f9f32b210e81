// SPDX-License-Identifier: Apache-2.0
// The tree over the instances of a scene. Instances that overlap cost every ray that passes where they do, so the
// largest are opened: in place of an instance, the top level then holds the parts of its mesh's tree [Benthin17].
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "scene/bvh.h"
#include "scene/flat_scene.h"
#include "scene/mesh.h"

namespace svgf {

struct TopLevel {
    std::vector<WideNode> nodes;
    std::vector<TopLeaf> leaves;
};

// instances, placements: as in SceneView. The tree is a function of its arguments alone.
TopLevel build_top_level(std::span<const std::shared_ptr<Mesh>> meshes, std::span<const Instance> instances,
                         std::span<const Placement> placements);

}  // namespace svgf
