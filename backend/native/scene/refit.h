// SPDX-License-Identifier: Apache-2.0
// Stages of "refit": a tree's boxes after its triangles have moved, level by level from the leaves up.
#pragma once

#include "core/append.h"
#include "scene/flat_scene.h"
#include "scene/hittable.h"

namespace svgf {

// Writes the triangles, in leaf order, from the arrays of svgf.Mesh.
struct RefitTrianglesStage {
    Vec3 centre;
    const std::int32_t* in_vertices;      // [T, 3]
    const Vec3* in_positions;             // [V]
    const Vec3* in_normals;               // [T, 3]
    const Vec4* in_tangents;              // [T, 3]
    const Vec3* in_previous_positions;    // [V]
    LeafTriangle* out_triangles;          // index and material slot stay
    CornerNormals* out_normals;           // null: none
    CornerTangents* out_tangents;         // null: none
    TrianglePositions* out_previous_positions;
    std::int32_t* out_changed;  // number of triangles that can no longer be hit

    SVGF_HD void operator()(int i) const {
        LeafTriangle triangle = out_triangles[i];
        const std::int32_t* const index = in_vertices + 3 * std::size_t(triangle.index);
        const Vec3 a = in_positions[index[0]], b = in_positions[index[1]], c = in_positions[index[2]];
        if (!is_hittable(a, b, c)) {
            append(out_changed);
            return;
        }
        triangle.vertex0 = a - centre;
        triangle.vertex1 = b - centre;
        triangle.vertex2 = c - centre;
        out_triangles[i] = triangle;
        if (out_normals) out_normals[i] = checked_normals(in_normals + 3 * std::size_t(triangle.index));
        if (out_tangents) out_tangents[i] = checked_tangents(in_tangents + 3 * std::size_t(triangle.index));
        TrianglePositions before{{triangle.vertex0, triangle.vertex1, triangle.vertex2}};
        for (int k = 0; k < 3; ++k) {
            const Vec3 p = in_previous_positions[index[k]] - centre;
            if (is_finite(p)) before.vertex[k] = p;
        }
        out_previous_positions[i] = before;
    }
};

// Triangles that the tree was built without, in their order in the mesh.
struct RefitLeftOutStage {
    const std::int32_t* in_left_out;
    const std::int32_t* in_vertices;  // [T, 3]
    const Vec3* in_positions;         // [V]
    std::int32_t* out_changed;        // number of them that can be hit now

    SVGF_HD void operator()(int i) const {
        const std::int32_t* const index = in_vertices + 3 * std::size_t(in_left_out[i]);
        if (is_hittable(in_positions[index[0]], in_positions[index[1]], in_positions[index[2]]))
            append(out_changed);
    }
};

// Of a node what the level above it needs to know.
struct NodeExtent {
    Bounds bounds;
    float cost = 0;  // areas of all children in its subtree, times their triangles where they are leaves
};

// The nodes of one level; those below are done.
struct RefitNodesStage {
    const std::uint32_t* in_level;  // nodes of this level
    const LeafTriangle* in_triangles;
    WideNode* nodes;
    NodeExtent* extents;  // of each node

    SVGF_HD void operator()(int i) const {
        const std::uint32_t index = in_level[i];
        WideNode node = nodes[index];
        Bounds box, child[wide_node_children];
        std::uint32_t inner = 0;
        float cost = 0;
        for (int s = 0; s < wide_node_children; ++s) {
            const std::uint32_t slot = WideNode::byte(node.slot, s);
            if (slot == 0) continue;
            float weight = 1;
            if (WideNode::is_inner(slot)) {
                const NodeExtent& extent = extents[node.first_child + inner++];
                child[s] = extent.bounds;
                cost += extent.cost;
            } else {
                weight = float(WideNode::count_of(slot));
                for (std::uint32_t k = 0; k < WideNode::count_of(slot); ++k) {
                    const LeafTriangle& triangle = in_triangles[node.first_primitive + WideNode::first_of(slot) + k];
                    child[s].add(triangle.vertex0);
                    child[s].add(triangle.vertex1);
                    child[s].add(triangle.vertex2);
                }
            }
            box.add(child[s]);
            cost += child[s].half_area() * weight;
        }
        node.set_boxes(box, child);
        nodes[index] = node;
        extents[index] = {box, cost};
    }
};

}  // namespace svgf
