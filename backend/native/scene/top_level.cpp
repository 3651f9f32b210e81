// SPDX-License-Identifier: Apache-2.0
#include "scene/top_level.h"

#include <algorithm>
#include <cstddef>

#include "device/threads.h"

namespace svgf {
namespace {

// Leaves that opening may lead to, for each instance and in all: moving an object builds the top level anew, which has
// to stay far below a millisecond.
constexpr std::size_t leaves_per_instance = 32, most_opened_leaves = 2048;

constexpr TopLeaf whole(std::int32_t instance) { return {instance, 0, 1u << 31}; }

Mat34 absolute(const Mat34& m) {
    Mat34 result;
    for (int row = 0; row < 3; ++row)
        result.row[row] = {std::fabs(m.row[row].x), std::fabs(m.row[row].y), std::fabs(m.row[row].z),
                           std::fabs(m.row[row].w)};
    return result;
}

// Box in the world of a box in object space, with room for the roundings of both matrices: a ray finds the mesh where
// its world_to_object puts it. Empty if anything is not finite.
Bounds world_bounds(const Bounds& box, const Mat34& object_to_world, const Mat34& world_to_object) {
    constexpr float rounding = 8.0f / 16777216.0f;
    if (box.is_empty()) return {};
    const Mat34 to_world = absolute(object_to_world), to_object = absolute(world_to_object);
    const Vec3 centre = transform_point(object_to_world, (box.low + box.high) * 0.5f);
    const Vec3 half = transform_vector(to_world, (box.high - box.low) * 0.5f);
    const Vec3 world_size = transform_point(to_world, max(abs(box.low), abs(box.high)));
    const Vec3 object_size = transform_point(to_object, world_size);
    const Vec3 margin = (world_size + transform_vector(to_world, object_size)) * rounding;
    const Bounds result{centre - half - margin, centre + half + margin};
    return is_finite(result.low) && is_finite(result.high) ? result : Bounds{};
}

// A leaf of the top level and its box.
struct Part {
    Bounds box;
    TopLeaf leaf;

    bool operator<(const Part& other) const { return box.half_area() < other.box.half_area(); }
};

// Whether an instance shares much of its space with another one. Only the largest are looked at: small ones meet few
// rays.
class OverlapsAnother {
public:
    explicit OverlapsAnother(std::span<const Part> parts) {
        std::vector<Part> largest(parts.begin(), parts.end());
        const auto end = largest.begin() + std::ptrdiff_t(std::min(largest.size(), most_examined));
        std::partial_sort(largest.begin(), end, largest.end(), [](const Part& a, const Part& b) { return b < a; });
        largest.erase(end, largest.end());
        overlaps_.resize(parts.size());
        for (const Part& a : largest)
            for (const Part& b : largest) {
                const Bounds common{max(a.box.low, b.box.low), min(a.box.high, b.box.high)};
                const float larger = max(a.box.half_area(), b.box.half_area());
                if (a.leaf.instance != b.leaf.instance && common.half_area() >= least_overlap * larger && larger > 0.0f)
                    overlaps_[std::size_t(a.leaf.instance)] = true;
            }
    }

    bool operator()(const Part& part) const { return overlaps_[std::size_t(part.leaf.instance)]; }

private:
    static constexpr std::size_t most_examined = 128;
    static constexpr float least_overlap = 0.25f;  // of the larger of the two, by surface area

    std::vector<bool> overlaps_;
};

// The children of a node of a mesh's tree, as parts of an instance.
template <class Add>
void open(const WideNode& node, std::int32_t instance, const Add& add) {
    std::uint32_t inner = 0;
    for (int s = 0; s < wide_node_children; ++s) {
        const std::uint32_t slot = WideNode::byte(node.slot, s);
        if (slot == 0) continue;
        TopLeaf leaf = whole(instance);
        if (WideNode::is_inner(slot))
            leaf.first = node.first_child + inner++;
        else
            leaf = {instance, node.first_primitive, (slot >> 5) << WideNode::first_of(slot)};
        add(node.child_box(s), leaf);
    }
}

}  // namespace

TopLevel build_top_level(std::span<const std::shared_ptr<Mesh>> meshes, std::span<const Instance> instances,
                         std::span<const Placement> placements, std::span<const std::int32_t> left_out) {
    const std::size_t count = instances.size();
    std::vector<Part> parts(count);
    parallel_for(count, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
            parts[i] = {world_bounds(meshes[std::size_t(instances[i].mesh)]->bounds(), placements[i].object_to_world,
                                     instances[i].world_to_object),
                        whole(std::int32_t(i))};
    });

    for (const std::int32_t instance : left_out)
        if (instance >= 0) parts[std::size_t(instance)].box = {};

    // All that may be opened come first, as a heap: the largest part is opened next.
    const auto end_of_heap = std::partition(parts.begin(), parts.end(), OverlapsAnother(parts));
    std::vector<Part> heap(parts.begin(), end_of_heap);
    parts.erase(parts.begin(), end_of_heap);
    std::make_heap(heap.begin(), heap.end());
    const std::size_t wanted = std::min(count + leaves_per_instance * heap.size(), most_opened_leaves);
    while (!heap.empty() && parts.size() + heap.size() < wanted) {
        std::pop_heap(heap.begin(), heap.end());
        const Part part = heap.back();
        heap.pop_back();
        const std::size_t i = std::size_t(part.leaf.instance);
        const std::span<const WideNode> nodes = meshes[std::size_t(instances[i].mesh)]->top_nodes();
        const bool is_node = part.leaf.bits >> WideNode::inner_bit;
        if (!is_node || part.leaf.first >= nodes.size()) {
            parts.push_back(part);
            continue;
        }
        open(nodes[part.leaf.first], part.leaf.instance, [&](const Bounds& box, const TopLeaf& leaf) {
            heap.push_back({world_bounds(box, placements[i].object_to_world, instances[i].world_to_object), leaf});
            std::push_heap(heap.begin(), heap.end());
        });
    }
    parts.insert(parts.end(), heap.begin(), heap.end());

    std::vector<Bounds> boxes(parts.size());
    std::transform(parts.begin(), parts.end(), boxes.begin(), [](const Part& part) { return part.box; });
    Bvh bvh = build_bvh(boxes, 1, TreeQuality::quick);
    TopLevel result{std::move(bvh.nodes), {}};
    for (const std::uint32_t part : bvh.primitives) result.leaves.push_back(parts[part].leaf);
    return result;
}

}  // namespace svgf
