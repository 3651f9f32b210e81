// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "device/device.h"
#include "scene/bvh.h"
#include "scene/flat_scene.h"

namespace svgf {

struct NodeExtent;  // scene/refit.h

// The geometry of one mesh on the device, with its tree.
//
// What lies far from its own origin is moved towards it by `centre`, so that it keeps its digits in every product; an
// instance's transforms make up for it.
//
// Triangles that cannot be hit do not enter the mesh: without area, with a coordinate that is not finite or beyond
// largest_coordinate, or with an index outside the positions. The device must outlive the mesh.
class Mesh {
public:
    // Row-major arrays as svgf.Mesh documents them. V positions, T triangles; both may be 0.
    struct Arrays {
        std::span<const float> positions;         // [V, 3]
        std::span<const std::int32_t> triangles;  // [T, 3]
        std::span<const float> normals;           // [T, 3, 3]; a corner that is zero or not finite: the face normal
        std::span<const float> uvs;               // [layers, T, 3, 2], or empty: (0, 0)
        std::span<const std::int32_t> material_slots;  // [T], >= 0
        std::span<const float> previous_positions;     // [V, 3], or empty: as positions
        std::span<const float> tangents;               // [T, 3, 4], or empty: the triangles' own
        std::int32_t tangent_layer = 0;                // of uvs
    };

    // Throws InputError if the lengths do not fit together.
    Mesh(Device& device, const Arrays& arrays);
    // A tree for rays alone, in which triangles may be several times. may_be_cut: as in scene/triangle_parts.h.
    Mesh(Device& device, std::span<const LeafTriangle> triangles, std::span<const std::uint8_t> may_be_cut);

    // Moves the vertices of a mesh that was made with previous positions, on the device: the same triangles with the
    // same slots and UVs, whose tree keeps its shape. Returns false where that cannot be or does not pay; the mesh is
    // then in no state to be used, and one must be made anew.
    bool refit(Device& device, const Arrays& arrays);

    const MeshView& view() const { return view_; }
    // The topmost nodes of the tree, parents before children; none of a mesh that deforms.
    std::span<const WideNode> top_nodes() const { return top_nodes_; }
    Vec3 centre() const { return centre_; }           // of the view, in the coordinates of Arrays
    const Bounds& bounds() const { return bounds_; }  // of the view
    int slot_count() const { return slot_count_; }    // largest material slot of a hittable triangle + 1
    std::size_t triangle_count() const { return triangles_.size(); }  // of those that can be hit
    std::size_t bytes() const;

private:
    // What refitting needs to know of the tree.
    struct Refit {
        Refit(Device& device, const Arrays& arrays, std::span<const WideNode> nodes,
              std::span<const std::int32_t> left_out, Mesh& mesh);

        Buffer<std::int32_t> vertices;  // [T, 3]
        Buffer<NodeExtent> extents;     // of each node
        Buffer<std::int32_t> left_out;  // triangles that cannot be hit
        Buffer<std::uint32_t> levels;   // nodes, level by level
        std::vector<int> level_starts;
        std::size_t position_count = 0;
        double built_cost = 0;
    };
    struct RefitResult {
        Bounds bounds;
        double cost = 0;  // expected child boxes and triangles that a ray which meets the mesh meets
    };
    void set_tree(Device& device, const Bvh& bvh, std::span<const LeafTriangle> triangles);
    void set_bounds(const Bounds& bounds);
    RefitResult refit_nodes(Device& device, Refit& refit);

    Vec3 centre_;
    Bounds bounds_;
    int slot_count_ = 0;
    std::vector<WideNode> top_nodes_;
    Buffer<WideNode> nodes_;
    Buffer<LeafTriangle> triangles_;
    Buffer<CornerNormals> normals_;
    Buffer<CornerUvs> uvs_;
    Buffer<CornerTangents> tangents_;
    Buffer<TrianglePositions> previous_positions_;
    std::unique_ptr<Refit> refit_;  // of a mesh that deforms
    MeshView view_;
};

// Whether a box lies close enough to 0 for its size.
bool is_centred(const Bounds& box);

}  // namespace svgf
