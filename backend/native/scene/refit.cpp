// SPDX-License-Identifier: Apache-2.0
#include "scene/refit.h"

#include <algorithm>
#include <numeric>

#include "scene/mesh.h"

namespace svgf {
namespace {

// A tree whose cost has grown by this much since it was built is built anew.
constexpr float largest_growth = 1.3f;

std::span<const Vec3> vectors_of(std::span<const float> values) {
    return {reinterpret_cast<const Vec3*>(values.data()), values.size() / 3};
}

std::span<const Vec4> vectors4_of(std::span<const float> values) {
    return {reinterpret_cast<const Vec4*>(values.data()), values.size() / 4};
}

// Node indices sorted by level, the root's first, and where each level starts.
void sort_by_level(std::span<const WideNode> nodes, std::vector<std::uint32_t>& order, std::vector<int>& starts) {
    order = {0};
    starts = {0};
    for (std::size_t begin = 0; begin < order.size();) {
        const std::size_t end = order.size();
        starts.push_back(int(end));
        for (; begin < end; ++begin) {
            const WideNode& node = nodes[order[begin]];
            const int children = count_set_bits(node.inner_slots());
            for (int k = 0; k < children; ++k) order.push_back(node.first_child + std::uint32_t(k));
        }
    }
}

}  // namespace

Mesh::Refit::Refit(Device& device, const Arrays& arrays, std::span<const WideNode> nodes,
                   std::span<const std::int32_t> left_out, Mesh& mesh)
    : vertices(device, arrays.triangles, "a mesh's vertex indices"),
      bounds(device, nodes.size(), "a tree's boxes"),
      cost(device, nodes.size(), "a tree's cost"),
      left_out(device, left_out, "a mesh's vertex indices") {
    std::vector<std::uint32_t> order;
    sort_by_level(nodes, order, level_starts);
    levels = Buffer<std::uint32_t>(device, std::span<const std::uint32_t>(order), "a tree's levels");
    position_count = arrays.positions.size();
    built_cost = mesh.refit_nodes(device, *this).cost;
}

Mesh::RefitResult Mesh::refit_nodes(Device& device, Refit& refit) {
    for (std::size_t level = refit.level_starts.size() - 1; level-- > 0;) {
        const int begin = refit.level_starts[level], count = refit.level_starts[level + 1] - begin;
        device.launch("refit nodes", count,
                      RefitNodesStage{refit.levels.data() + begin, triangles_.data(), nodes_.data(),
                                      refit.bounds.data(), refit.cost.data()});
    }
    RefitResult result;
    device.download(&result.bounds, refit.bounds.data(), sizeof(Bounds));
    const std::vector<float> costs = refit.cost.download();
    result.cost = std::accumulate(costs.begin(), costs.end(), 0.0) / double(result.bounds.half_area());
    return result;
}

bool Mesh::refit(Device& device, const Arrays& arrays) {
    if (!refit_ || arrays.positions.size() != refit_->position_count || arrays.previous_positions.empty() ||
        arrays.previous_positions.size() != arrays.positions.size() || arrays.normals.size() != 3 * refit_->vertices.size())
        return false;
    // A mesh that had no normals has no room for any.
    if (!normals_ && std::any_of(arrays.normals.begin(), arrays.normals.end(), [](float x) { return x != 0.0f; }))
        return false;
    if (arrays.tangents.size() != (tangents_ ? 4 * refit_->vertices.size() : 0)) return false;
    const Buffer<Vec3> positions(device, vectors_of(arrays.positions), "positions");
    const Buffer<Vec3> previous(device, vectors_of(arrays.previous_positions), "previous positions");
    Buffer<Vec3> normals;
    if (normals_) normals = Buffer<Vec3>(device, vectors_of(arrays.normals), "normals");
    Buffer<Vec4> tangents;
    if (tangents_) tangents = Buffer<Vec4>(device, vectors4_of(arrays.tangents), "tangents");
    Buffer<std::int32_t> changed(device, 1, "refit");
    changed.clear();
    device.launch("refit triangles", int(triangle_count()),
                  RefitTrianglesStage{centre_, refit_->vertices.data(), positions.data(), normals.data(),
                                      tangents.data(), previous.data(), triangles_.data(), normals_.data(),
                                      tangents_.data(), previous_positions_.data(), changed.data()});
    device.launch("refit triangles", int(refit_->left_out.size()),
                  RefitLeftOutStage{refit_->left_out.data(), refit_->vertices.data(), positions.data(), changed.data()});
    if (changed.download()[0] > 0) return false;
    const RefitResult result = refit_nodes(device, *refit_);
    set_bounds(result.bounds);
    // Where the mesh has left its centre, its coordinates would lose their digits.
    return result.cost <= largest_growth * refit_->built_cost && is_centred(bounds_);
}

}  // namespace svgf
