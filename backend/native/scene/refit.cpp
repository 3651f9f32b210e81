// SPDX-License-Identifier: Apache-2.0
#include "scene/refit.h"

#include <algorithm>
#include <cstddef>
#include <memory>
#include <vector>

#include "device/threads.h"
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

// Sends arrays to a device. To be kept until it is done: where it reads some memory of the host without a detour, all
// threads copy them there first.
template <class AnyDevice>
class Sender {
public:
    explicit Sender(AnyDevice& device) : device_(device) {}

    template <class T>
    Buffer<T> operator()(std::span<const T> values, const char* what) {
        if constexpr (requires(AnyDevice& device) { device.host_memory(std::size_t()); }) {
            if (values.empty()) return Buffer<T>(device_, values, what);
            sent_.push_back(device_.host_memory(values.size_bytes()));
            T* const copy = static_cast<T*>(sent_.back().get());
            parallel_for(values.size(), [&](std::size_t begin, std::size_t end) {
                std::copy(values.data() + begin, values.data() + end, copy + begin);
            });
            values = {copy, values.size()};
        }
        return Buffer<T>(device_, values, what);
    }

private:
    AnyDevice& device_;
    std::vector<std::shared_ptr<void>> sent_;
};

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
      extents(device, nodes.size(), "a tree's boxes"),
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
                                      refit.extents.data()});
    }
    NodeExtent root;
    device.download(&root, refit.extents.data(), sizeof(NodeExtent));
    return {root.bounds, double(root.cost) / double(root.bounds.half_area())};
}

bool Mesh::refit(Device& device, const Arrays& arrays) {
    if (!refit_ || arrays.positions.size() != refit_->position_count || arrays.previous_positions.empty() ||
        arrays.previous_positions.size() != arrays.positions.size() || arrays.normals.size() != 3 * refit_->vertices.size())
        return false;
    // A mesh that had no normals has no room for any.
    if (!normals_ && std::any_of(arrays.normals.begin(), arrays.normals.end(), [](float x) { return x != 0.0f; }))
        return false;
    if (arrays.tangents.size() != (tangents_ ? 4 * refit_->vertices.size() : 0)) return false;
    Sender send(device);
    const Buffer<Vec3> positions = send(vectors_of(arrays.positions), "positions");
    const Buffer<Vec3> previous = send(vectors_of(arrays.previous_positions), "previous positions");
    Buffer<Vec3> normals;
    if (normals_) normals = send(vectors_of(arrays.normals), "normals");
    Buffer<Vec4> tangents;
    if (tangents_) tangents = send(vectors4_of(arrays.tangents), "tangents");
    Buffer<std::int32_t> changed(device, 1, "refit");
    changed.clear();
    device.launch("refit triangles", int(triangle_count()),
                  RefitTrianglesStage{centre_, refit_->vertices.data(), positions.data(), normals.data(),
                                      tangents.data(), previous.data(), triangles_.data(), normals_.data(),
                                      tangents_.data(), previous_positions_.data(), changed.data()});
    device.launch("refit triangles", int(refit_->left_out.size()),
                  RefitLeftOutStage{refit_->left_out.data(), refit_->vertices.data(), positions.data(), changed.data()});
    const RefitResult result = refit_nodes(device, *refit_);
    if (changed.download()[0] > 0) return false;
    set_bounds(result.bounds);
    // Where the mesh has left its centre, its coordinates would lose their digits.
    return result.cost <= largest_growth * refit_->built_cost && is_centred(bounds_);
}

}  // namespace svgf
