// SPDX-License-Identifier: Apache-2.0
// Groups of nodes of a binary tree become wide nodes: a node opens the child that a ray hits most likely until it has
// eight. The upper levels are made first, then the subtrees below them side by side.
//
// Depth is bounded for any input: opening the upper three levels of a binary subtree, all of them if it must, makes
// wide height w of binary height 3 w.
#include "scene/bvh.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <deque>

#include "core/host_buffer.h"
#include "device/threads.h"
#include "scene/binary_bvh.h"

namespace svgf {
namespace {

// Subtrees that the upper levels are opened into: enough for any number of threads, whatever their sizes.
constexpr std::size_t subtree_count = 512;

// A wide node that is not made yet.
struct Task {
    std::uint32_t wide, binary;
    int level;  // of the wide node, the root's is 1
};

// A part of the tree; indices in its nodes count within it.
struct Part {
    std::vector<WideNode> nodes;
    std::vector<std::uint32_t> primitives;
    int levels = 1;
};

class Collapser {
public:
    Collapser(const HostBuffer<BinaryNode>& nodes, std::span<const Primitive> primitives)
        : nodes_(nodes), primitives_(primitives) {}

    // Makes one wide node; calls pend(task) for each of its inner children, whose nodes come to lie at the end.
    template <class Pend>
    void collapse(const Task& task, Part& part, const Pend& pend) const {
        assert(task.level <= max_tree_levels);
        part.levels = std::max(part.levels, task.level);
        const Bounds& box = nodes_[task.binary].box;
        Children children;
        const int count = open(task, children);
        std::array<int, wide_node_children> child_of_slot;
        assign_slots(box, children, count, child_of_slot);

        WideNode wide{};
        wide.first_child = std::uint32_t(part.nodes.size());
        wide.first_primitive = std::uint32_t(part.primitives.size());
        std::uint32_t inner_count = 0, primitive_count = 0;
        Bounds child_boxes[wide_node_children];
        for (int s = 0; s < wide_node_children; ++s) {
            if (child_of_slot[s] < 0) continue;
            const std::uint32_t index = children[child_of_slot[s]];
            const BinaryNode& child = nodes_[index];
            child_boxes[s] = child.box;
            std::uint32_t slot = WideNode::inner_slot(s);
            if (child.is_leaf()) {
                slot = WideNode::leaf_slot(primitive_count, child.count);
                primitive_count += child.count;
                for (std::uint32_t i = 0; i < child.count; ++i)
                    part.primitives.push_back(primitives_[child.right_or_first + i].index);
            } else {
                wide.exponents_and_inner |= 1u << (24 + s);
                pend(Task{wide.first_child + inner_count++, index, task.level + 1});
            }
            wide.slot[s >> 2] |= slot << (8 * (s & 3));
        }
        wide.set_boxes(box, child_boxes);
        part.nodes.resize(part.nodes.size() + inner_count);
        part.nodes[task.wide] = wide;
    }

private:
    using Children = std::array<std::uint32_t, wide_node_children>;

    // The children of a wide node: its binary node's, opened until there are 8, those that are too high for the levels
    // left first, else the one that a ray hits most likely.
    int open(const Task& task, Children& children) const {
        const int height_left = 3 * (max_tree_levels - task.level);
        float area[wide_node_children];
        const auto put = [&](int i, std::uint32_t index) {
            const BinaryNode& node = nodes_[index];
            children[i] = index;
            area[i] = node.is_leaf() ? -1.0f : node.height > height_left ? infinity : node.box.half_area();
        };
        int count = 1;
        put(0, task.binary);
        while (count < wide_node_children) {
            int chosen = 0;
            for (int i = 1; i < count; ++i)
                if (area[i] > area[chosen]) chosen = i;
            if (area[chosen] < 0.0f) break;
            const std::uint32_t index = children[chosen];
            put(chosen, index + 1);
            put(count++, nodes_[index].right_or_first);
        }
        return count;
    }

    // Greedy: the child that lies furthest towards a free corner gets it. -1: free slot.
    void assign_slots(const Bounds& box, const Children& children, int count,
                      std::array<int, wide_node_children>& child_of_slot) const {
        child_of_slot.fill(-1);
        const Vec3 centre = (box.low + box.high) * 0.5f;
        float along[wide_node_children][wide_node_children];
        for (int i = 0; i < count; ++i) {
            const Bounds& child = nodes_[children[i]].box;
            const Vec3 d = (child.low + child.high) * 0.5f - centre;
            for (int s = 0; s < wide_node_children; ++s)
                along[i][s] = (s & 1 ? d.x : -d.x) + (s & 2 ? d.y : -d.y) + (s & 4 ? d.z : -d.z);
        }
        std::array<bool, wide_node_children> placed{};
        for (int round = 0; round < count; ++round) {
            int best_child = -1, best_slot = -1;
            for (int i = 0; i < count; ++i) {
                if (placed[i]) continue;
                for (int s = 0; s < wide_node_children; ++s)
                    if (child_of_slot[s] < 0 && (best_child < 0 || along[i][s] > along[best_child][best_slot]))
                        best_child = i, best_slot = s;
            }
            placed[best_child] = true;
            child_of_slot[best_slot] = best_child;
        }
    }

    const HostBuffer<BinaryNode>& nodes_;
    const std::span<const Primitive> primitives_;
};

// Puts the parts behind the upper levels, where their roots already have a place.
Bvh join(Part&& top, const std::deque<Task>& roots, const std::vector<Part>& parts) {
    Bvh bvh{std::move(top.nodes), std::move(top.primitives), {}, top.levels};
    std::vector<std::size_t> node_start(parts.size()), primitive_start(parts.size());
    std::size_t nodes = bvh.nodes.size(), primitives = bvh.primitives.size();
    for (std::size_t i = 0; i < parts.size(); ++i) {
        node_start[i] = nodes;
        primitive_start[i] = primitives;
        nodes += parts[i].nodes.size() - 1;
        primitives += parts[i].primitives.size();
        bvh.levels = std::max(bvh.levels, parts[i].levels);
    }
    bvh.nodes.resize(nodes);
    bvh.primitives.resize(primitives);
    parallel_for(parts.size(), 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            for (std::size_t k = 0; k < parts[i].nodes.size(); ++k) {
                WideNode node = parts[i].nodes[k];
                // The part's root is not among the rest.
                node.first_child += std::uint32_t(node_start[i]) - 1;
                node.first_primitive += std::uint32_t(primitive_start[i]);
                bvh.nodes[k == 0 ? roots[i].wide : node_start[i] + k - 1] = node;
            }
            std::copy(parts[i].primitives.begin(), parts[i].primitives.end(),
                      bvh.primitives.begin() + std::ptrdiff_t(primitive_start[i]));
        }
    });
    return bvh;
}

Bvh collapse(const HostBuffer<BinaryNode>& nodes, std::span<const Primitive> primitives) {
    const Collapser collapser(nodes, primitives);
    Part top;
    top.nodes.resize(1);
    std::deque<Task> pending{{0, 0, 1}};
    while (!pending.empty() && pending.size() < subtree_count) {
        const Task task = pending.front();
        pending.pop_front();
        collapser.collapse(task, top, [&](const Task& child) { pending.push_back(child); });
    }
    std::vector<Part> parts(pending.size());
    parallel_for(parts.size(), 1, [&](std::size_t begin, std::size_t end) {
        std::vector<Task> stack;
        for (std::size_t i = begin; i < end; ++i) {
            parts[i].nodes.resize(1);
            stack.push_back({0, pending[i].binary, pending[i].level});
            while (!stack.empty()) {
                const Task task = stack.back();
                stack.pop_back();
                collapser.collapse(task, parts[i], [&](const Task& child) { stack.push_back(child); });
            }
        }
    });
    return join(std::move(top), pending, parts);
}

}  // namespace

Bvh build_bvh(std::span<const Bounds> boxes, int leaf_size) {
    assert(leaf_size >= 1 && leaf_size <= max_leaf_size);
    // Sorted out by chunks, so that the order does not depend on the threads.
    constexpr std::size_t chunk = 8192;
    const std::size_t chunks = (boxes.size() + chunk - 1) / chunk;
    std::vector<std::size_t> start(chunks + 1);
    std::vector<Bounds> chunk_bounds(chunks);
    const auto for_boxes = [&](const auto& body) {
        parallel_for(chunks, 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t c = begin; c < end; ++c)
                for (std::size_t i = c * chunk; i < std::min((c + 1) * chunk, boxes.size()); ++i)
                    if (!boxes[i].is_empty()) body(c, i);
        });
    };
    for_boxes([&](std::size_t c, std::size_t i) {
        ++start[c + 1];
        chunk_bounds[c].add(boxes[i]);
    });
    Bounds bounds;
    for (std::size_t c = 0; c < chunks; ++c) {
        start[c + 1] += start[c];
        bounds.add(chunk_bounds[c]);
    }
    if (start.back() == 0) return {.nodes = std::vector<WideNode>(1), .primitives = {}, .bounds = {}};
    HostBuffer<Primitive> primitives(start.back());
    for_boxes([&](std::size_t c, std::size_t i) {
        primitives[start[c]++] = {boxes[i].low, std::uint32_t(i), boxes[i].high, 0};
    });
    Bvh bvh = collapse(build_binary_bvh(primitives, leaf_size, 3 * max_tree_levels), primitives);
    bvh.bounds = bounds;
    return bvh;
}

}  // namespace svgf
