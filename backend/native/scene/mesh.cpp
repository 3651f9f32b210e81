// SPDX-License-Identifier: Apache-2.0
#include "scene/mesh.h"

#include <algorithm>
#include <atomic>
#include <vector>

#include "core/host_buffer.h"
#include "device/threads.h"
#include "scene/hittable.h"
#include "scene/refit.h"
#include "scene/triangle_parts.h"

namespace svgf {
namespace {

// Nodes that the top level of a scene may open.
constexpr std::size_t most_top_nodes = 512;

Vec3 vector_at(std::span<const float> values, std::size_t i) {
    return {values[3 * i], values[3 * i + 1], values[3 * i + 2]};
}

// Relative to centre.
TrianglePositions positions_of(const Mesh::Arrays& arrays, std::span<const float> positions, std::size_t triangle,
                               Vec3 centre) {
    TrianglePositions result;
    for (int k = 0; k < 3; ++k)
        result.vertex[k] = vector_at(positions, std::size_t(arrays.triangles[3 * triangle + k])) - centre;
    return result;
}

void check(const Mesh::Arrays& arrays) {
    const std::size_t count = arrays.material_slots.size();
    expect(arrays.positions.size() % 3 == 0, "A mesh's positions must be [V, 3].");
    expect(arrays.triangles.size() == 3 * count, "A mesh needs one material slot for each triangle.");
    expect(arrays.normals.size() == 9 * count, "A mesh needs three normals for each triangle.");
    expect(count == 0 ? arrays.uvs.empty() : arrays.uvs.size() % (6 * count) == 0,
           "A mesh needs three UVs for each triangle in every layer, or none.");
    expect(arrays.previous_positions.empty() || arrays.previous_positions.size() == arrays.positions.size(),
           "A mesh's previous positions must be as many as its positions.");
    expect(arrays.tangents.empty() || arrays.tangents.size() == 12 * count,
           "A mesh needs three tangents for each triangle, or none.");
    // Offsets in the tree are 32 bits, and the device's loops count in int.
    expect(count < (std::size_t(1) << 30), "A mesh may have at most 2^30 triangles.");
}

// Box of a triangle; empty if it cannot be hit.
Bounds triangle_bounds(const Mesh::Arrays& arrays, std::size_t triangle) {
    const std::int64_t vertex_count = std::int64_t(arrays.positions.size() / 3);
    for (int k = 0; k < 3; ++k) {
        const std::int64_t index = arrays.triangles[3 * triangle + k];
        if (index < 0 || index >= vertex_count) return {};
    }
    const auto [vertex] = positions_of(arrays, arrays.positions, triangle, {});
    Bounds box;
    if (is_hittable(vertex[0], vertex[1], vertex[2]))
        for (const Vec3& p : vertex) box.add(p);
    return box;
}

bool has_valid_indices(const Mesh::Arrays& arrays) {
    const std::int64_t vertex_count = std::int64_t(arrays.positions.size() / 3);
    return std::all_of(arrays.triangles.begin(), arrays.triangles.end(),
                       [&](std::int32_t index) { return index >= 0 && index < vertex_count; });
}

// Triangles of empty boxes.
std::vector<std::int32_t> find_left_out(std::span<const Bounds> boxes) {
    std::vector<std::int32_t> left_out;
    for (std::size_t i = 0; i < boxes.size(); ++i)
        if (boxes[i].is_empty()) left_out.push_back(std::int32_t(i));
    return left_out;
}

void raise_to(std::atomic<std::int32_t>& value, std::int32_t at_least) {
    std::int32_t current = value;
    while (current < at_least && !value.compare_exchange_weak(current, at_least)) {
    }
}

// Centre of a box on those axes where it lies farther from 0 than it is wide, else 0. Subtracting it is then exact.
Vec3 find_centre(const Bounds& box) {
    if (box.is_empty()) return {};
    const auto along = [](float low, float high) {
        const float middle = 0.5f * (low + high);
        return std::fabs(middle) > high - low ? middle : 0.0f;
    };
    return {along(box.low.x, box.high.x), along(box.low.y, box.high.y), along(box.low.z, box.high.z)};
}

}  // namespace

bool is_centred(const Bounds& box) {
    const Vec3 centre = find_centre(box);
    return max_component(abs(centre)) == 0.0f;
}

Mesh::Mesh(Device& device, const Arrays& arrays) {
    check(arrays);
    const std::size_t triangle_count = arrays.material_slots.size();
    HostBuffer<Bounds> boxes(triangle_count);
    parallel_for(triangle_count, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) boxes[i] = triangle_bounds(arrays, i);
    });
    Bounds bounds;
    for (const Bounds& box : std::span<const Bounds>(boxes)) bounds.add(box);
    centre_ = find_centre(bounds);
    parallel_for(triangle_count, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) boxes[i] = {boxes[i].low - centre_, boxes[i].high - centre_};
    });
    const Bvh bvh = build_bvh(boxes, max_leaf_size, TreeQuality::high);

    const std::size_t count = bvh.primitives.size();
    HostBuffer<LeafTriangle> triangles(count);
    HostBuffer<CornerNormals> normals(count);
    const std::size_t uv_layers = arrays.uvs.size() / std::max<std::size_t>(6 * triangle_count, 1);
    HostBuffer<CornerUvs> uvs(uv_layers * count);
    HostBuffer<CornerTangents> tangents(arrays.tangents.empty() ? 0 : count);
    HostBuffer<TrianglePositions> previous(arrays.previous_positions.empty() ? 0 : count);
    std::atomic<bool> any_normal = false;
    std::atomic<std::int32_t> smallest_slot = 0, largest_slot = -1;
    parallel_for(count, [&](std::size_t begin, std::size_t end) {
        bool finds_normal = false;
        std::int32_t smallest = 0, largest = -1;
        for (std::size_t i = begin; i < end; ++i) {
            const std::size_t t = bvh.primitives[i];
            const auto [vertex] = positions_of(arrays, arrays.positions, t, centre_);
            triangles[i] = {vertex[0], std::int32_t(t), vertex[1], {arrays.material_slots[t]}, vertex[2]};
            smallest = std::min(smallest, arrays.material_slots[t]);
            largest = std::max(largest, arrays.material_slots[t]);
            normals[i] = checked_normals(reinterpret_cast<const Vec3*>(arrays.normals.data()) + 3 * t);
            finds_normal |= dot(normals[i].corner[0], normals[i].corner[0]) > 0.0f;
            for (std::size_t layer = 0; layer < uv_layers; ++layer) {
                const float* uv = &arrays.uvs[6 * (layer * triangle_count + t)];
                uvs[layer * count + i] = {{{uv[0], uv[1]}, {uv[2], uv[3]}, {uv[4], uv[5]}}};
            }
            if (!tangents.empty())
                tangents[i] = checked_tangents(reinterpret_cast<const Vec4*>(arrays.tangents.data()) + 3 * t);
            if (!previous.empty()) {
                previous[i] = positions_of(arrays, arrays.previous_positions, t, centre_);
                for (int k = 0; k < 3; ++k)
                    if (!is_finite(previous[i].vertex[k])) previous[i].vertex[k] = vertex[k];
            }
        }
        if (finds_normal) any_normal = true;
        raise_to(largest_slot, largest);
        if (smallest < 0) smallest_slot = smallest;
    });
    if (smallest_slot < 0) throw InputError("A mesh's material slots must not be negative.");
    slot_count_ = largest_slot + 1;

    set_tree(device, bvh, triangles);
    if (any_normal) {
        normals_ = Buffer<CornerNormals>(device, normals, "normals");
        view_.normals = normals_.data();
    }
    if (!uvs.empty()) {
        uvs_ = Buffer<CornerUvs>(device, uvs, "texture coordinates");
        view_.uvs = uvs_.data();
        view_.uv_layers = std::int32_t(uv_layers);
        view_.triangle_count = std::int32_t(count);
    }
    if (!tangents.empty()) {
        tangents_ = Buffer<CornerTangents>(device, tangents, "tangents");
        view_.tangents = tangents_.data();
        view_.tangent_layer = arrays.tangent_layer;
    }
    if (!previous.empty()) {
        top_nodes_.clear();
        previous_positions_ = Buffer<TrianglePositions>(device, previous, "previous positions");
        view_.previous_positions = previous_positions_.data();
        const std::vector<std::int32_t> left_out = find_left_out(boxes);
        if (count > 0 && has_valid_indices(arrays))
            refit_ = std::make_unique<Refit>(device, arrays, bvh.nodes, left_out, *this);
    }
}

Mesh::Mesh(Device& device, std::span<const LeafTriangle> triangles, std::span<const std::uint8_t> may_be_cut) {
    const TriangleParts parts = cut_triangles(triangles, may_be_cut);
    const Bvh bvh = build_bvh(parts.boxes, max_leaf_size, TreeQuality::high);
    HostBuffer<LeafTriangle> in_order(bvh.primitives.size());
    parallel_for(in_order.size(), [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) in_order[i] = triangles[parts.triangles[bvh.primitives[i]]];
    });
    set_tree(device, bvh, in_order);
}

void Mesh::set_tree(Device& device, const Bvh& bvh, std::span<const LeafTriangle> triangles) {
    set_bounds(bvh.bounds);
    nodes_ = Buffer<WideNode>(device, std::span(bvh.nodes), "a mesh's tree");
    triangles_ = Buffer<LeafTriangle>(device, triangles, "triangles");
    view_.nodes = nodes_.data();
    view_.triangles = triangles_.data();
    top_nodes_.assign(bvh.nodes.begin(),
                      bvh.nodes.begin() + std::ptrdiff_t(std::min(bvh.nodes.size(), most_top_nodes)));
}

void Mesh::set_bounds(const Bounds& bounds) {
    bounds_ = bounds;
    if (bounds_.is_empty()) return;
    const Vec3 middle = (bounds_.low + bounds_.high) * 0.5f, width = bounds_.high - bounds_.low;
    const auto inverse = [](float x) { return x > 0.0f ? 1.0f / x : 0.0f; };
    view_.box_middle = {middle.x, middle.y};
    view_.box_scale = {inverse(width.x), inverse(width.y)};
}

std::size_t Mesh::bytes() const {
    std::size_t bytes =
        nodes_.bytes() + triangles_.bytes() + normals_.bytes() + uvs_.bytes() + tangents_.bytes() +
        previous_positions_.bytes();
    if (refit_)
        bytes += refit_->vertices.bytes() + refit_->extents.bytes() + refit_->levels.bytes() + refit_->left_out.bytes();
    return bytes;
}

}  // namespace svgf
