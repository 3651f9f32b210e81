// SPDX-License-Identifier: Apache-2.0
#include "scene/mesh.h"

#include <algorithm>
#include <vector>

#include "device/threads.h"

namespace svgf {
namespace {

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
    const auto expect = [](bool holds, const char* message) {
        if (!holds) throw InputError(message);
    };
    expect(arrays.positions.size() % 3 == 0, "A mesh's positions must be [V, 3].");
    expect(arrays.triangles.size() == 3 * count, "A mesh needs one material slot for each triangle.");
    expect(arrays.normals.size() == 9 * count, "A mesh needs three normals for each triangle.");
    expect(count == 0 ? arrays.uvs.empty() : arrays.uvs.size() % (6 * count) == 0,
           "A mesh needs three UVs for each triangle in every layer, or none.");
    expect(arrays.previous_positions.empty() || arrays.previous_positions.size() == arrays.positions.size(),
           "A mesh's previous positions must be as many as its positions.");
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
    for (const Vec3& p : vertex) {
        if (!(max_component(abs(p)) <= Mesh::largest_coordinate) || !is_finite(p)) return {};
        box.add(p);
    }
    const Vec3 normal = accurate_cross(vertex[1] - vertex[0], vertex[2] - vertex[0]);
    return max_component(abs(normal)) >= std::numeric_limits<float>::min() ? box : Bounds{};
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

CornerNormals corner_normals(const Mesh::Arrays& arrays, std::size_t triangle) {
    CornerNormals result;
    for (int k = 0; k < 3; ++k) {
        const Vec3 normal = vector_at(arrays.normals, 3 * triangle + k);
        if (!is_finite(normal) || dot(normal, normal) == 0.0f) return {};
        result.corner[k] = normal;
    }
    return result;
}

}  // namespace

Mesh::Mesh(Device& device, const Arrays& arrays) {
    check(arrays);
    const std::size_t triangle_count = arrays.material_slots.size();
    std::vector<Bounds> boxes(triangle_count);
    parallel_for(triangle_count, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) boxes[i] = triangle_bounds(arrays, i);
    });
    Bounds bounds;
    for (const Bounds& box : boxes) bounds.add(box);
    centre_ = find_centre(bounds);
    parallel_for(triangle_count, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) boxes[i] = {boxes[i].low - centre_, boxes[i].high - centre_};
    });
    const Bvh bvh = build_bvh(boxes, max_leaf_size);
    bounds_ = bvh.bounds;
    if (!bounds_.is_empty()) {
        const Vec3 middle = (bounds_.low + bounds_.high) * 0.5f, width = bounds_.high - bounds_.low;
        const auto inverse = [](float x) { return x > 0.0f ? 1.0f / x : 0.0f; };
        view_.box_middle = {middle.x, middle.y};
        view_.box_scale = {inverse(width.x), inverse(width.y)};
    }

    const std::size_t count = bvh.primitives.size();
    std::vector<LeafTriangle> triangles(count);
    std::vector<CornerNormals> normals(count);
    const std::size_t uv_layers = arrays.uvs.size() / std::max<std::size_t>(6 * triangle_count, 1);
    std::vector<CornerUvs> uvs(uv_layers * count);
    std::vector<TrianglePositions> previous(arrays.previous_positions.empty() ? 0 : count);
    parallel_for(count, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const std::size_t t = bvh.primitives[i];
            const auto [vertex] = positions_of(arrays, arrays.positions, t, centre_);
            triangles[i] = {vertex[0], std::int32_t(t), vertex[1], arrays.material_slots[t], vertex[2]};
            normals[i] = corner_normals(arrays, t);
            for (std::size_t layer = 0; layer < uv_layers; ++layer) {
                const float* uv = &arrays.uvs[6 * (layer * triangle_count + t)];
                uvs[layer * count + i] = {{{uv[0], uv[1]}, {uv[2], uv[3]}, {uv[4], uv[5]}}};
            }
            if (!previous.empty()) {
                previous[i] = positions_of(arrays, arrays.previous_positions, t, centre_);
                for (int k = 0; k < 3; ++k)
                    if (!is_finite(previous[i].vertex[k])) previous[i].vertex[k] = vertex[k];
            }
        }
    });
    for (const LeafTriangle& triangle : triangles) {
        if (triangle.material_slot < 0) throw InputError("A mesh's material slots must not be negative.");
        slot_count_ = std::max(slot_count_, triangle.material_slot + 1);
    }

    nodes_ = Buffer<WideNode>(device, std::span(bvh.nodes), "a mesh's tree");
    triangles_ = Buffer<LeafTriangle>(device, std::span<const LeafTriangle>(triangles), "triangles");
    view_.nodes = nodes_.data();
    view_.triangles = triangles_.data();
    const bool any_normal = std::any_of(normals.begin(), normals.end(),
                                        [](const CornerNormals& n) { return dot(n.corner[0], n.corner[0]) > 0.0f; });
    if (any_normal) {
        normals_ = Buffer<CornerNormals>(device, std::span<const CornerNormals>(normals), "normals");
        view_.normals = normals_.data();
    }
    if (!uvs.empty()) {
        uvs_ = Buffer<CornerUvs>(device, std::span<const CornerUvs>(uvs), "texture coordinates");
        view_.uvs = uvs_.data();
        view_.uv_layers = std::int32_t(uv_layers);
        view_.triangle_count = std::int32_t(count);
    }
    if (!previous.empty()) {
        previous_positions_ = Buffer<TrianglePositions>(device, std::span<const TrianglePositions>(previous),
                                                        "previous positions");
        view_.previous_positions = previous_positions_.data();
    }
}

std::size_t Mesh::bytes() const {
    return nodes_.bytes() + triangles_.bytes() + normals_.bytes() + uvs_.bytes() + previous_positions_.bytes();
}

}  // namespace svgf
