// SPDX-License-Identifier: Apache-2.0
// Groups of nodes of a binary tree become wide nodes and leaves: of all ways to group them the one of the least cost by
// the surface area heuristic [Ylitie17, Section 3.1]. Where the child of the largest area is opened until there are
// eight, rays visit 5 to 14 % more nodes of Sponza and of two rooms, and an H200 traces camera rays of the smaller room
// at 4.6 instead of 5.1 billion per second. The upper levels are made first, then the subtrees below them side by side.
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
#include "scene/reinsertion.h"

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

// What the test of a primitive costs, in visits of a wide node. Between 0.3 and 1.5 an H200 traces Sponza, and rooms of
// 19,440 and 983,042 triangles, within 4 % of the same time.
constexpr float primitive_cost = 0.7f;

// By the surface area heuristic, the least cost of what each binary node can become: a leaf, a wide node, or up to
// seven of its parent's children. In visits of the root.
class CollapseCosts {
public:
    CollapseCosts(const HostBuffer<BinaryNode>& nodes, int leaf_size)
        : nodes_(nodes), leaf_size_(std::uint32_t(leaf_size)), costs_(nodes.size()) {
        const float size = max_component(nodes[0].box.high - nodes[0].box.low);
        scale_ = size > 0.0f ? 1.0f / size : 0.0f;
        // The subtrees below the upper levels side by side, then these from the bottom.
        std::vector<std::uint32_t> order{0};
        std::size_t upper = 0;
        for (; upper < order.size() && order.size() - upper < subtree_count; ++upper)
            push_children(order[upper], order);
        parallel_for(order.size() - upper, 1, [&](std::size_t begin, std::size_t end) {
            std::vector<std::uint32_t> subtree;
            for (std::size_t i = begin; i < end; ++i) {
                subtree.assign(1, order[upper + i]);
                for (std::size_t k = 0; k < subtree.size(); ++k) push_children(subtree[k], subtree);
                for (std::size_t k = subtree.size(); k-- > 0;) find(subtree[k]);
            }
        });
        for (std::size_t k = upper; k-- > 0;) find(order[k]);
    }

    // Whether a node that becomes one child is best a leaf, and then of how many primitives.
    bool is_leaf(std::uint32_t index) const { return costs_[index].is_leaf; }
    std::uint32_t count(std::uint32_t index) const { return costs_[index].count; }

    // How many of its parent's children, of up to `most`, a node becomes.
    int children(std::uint32_t index, int most) const {
        while (most > 1 && cost(index, most) == cost(index, most - 1)) --most;
        return nodes_[index].is_leaf() ? 1 : most;
    }
    // How many of them, of 2 to 8, come from the left child of an inner node.
    int left_children(std::uint32_t index, int children) const {
        const auto sum = [&](int left) {
            return cost(nodes_[index].left, left) + cost(nodes_[index].right, children - left);
        };
        int best = 1;
        for (int left = 2; left < children; ++left)
            if (sum(left) < sum(best)) best = left;
        return best;
    }

private:
    struct Costs {
        std::array<float, wide_node_children - 1> least;  // as one child, as up to two ...
        std::uint32_t count : 31, is_leaf : 1;            // count: no more than one above what a leaf holds
    };

    float cost(std::uint32_t index, int most) const { return costs_[index].least[std::size_t(most - 1)]; }

    void push_children(std::uint32_t index, std::vector<std::uint32_t>& order) const {
        if (nodes_[index].is_leaf()) return;
        order.push_back(nodes_[index].left);
        order.push_back(nodes_[index].right);
    }

    // A share of the root's, and a little more: of nodes without an area there shall be few, too.
    float area(const Bounds& box) const {
        const Vec3 size = (box.high - box.low) * scale_;
        const float area = size.x * size.y + size.y * size.z + size.z * size.x;
        return (area > 0.0f ? area : 0.0f) + 1e-9f;
    }

    // Of a node whose children's costs are known.
    void find(std::uint32_t index) {
        const BinaryNode& node = nodes_[index];
        Costs& costs = costs_[index];
        const float area = this->area(node.box);
        if (node.is_leaf()) {
            costs.count = costs.is_leaf = 1;
            costs.least.fill(area * primitive_cost);
            return;
        }
        const auto split_cost = [&](int children) {
            const int left = left_children(index, children);
            return cost(nodes_[index].left, left) + cost(node.right, children - left);
        };
        costs.count = std::min(count(node.left) + count(node.right), leaf_size_ + 1);
        const float as_leaf = area * primitive_cost * float(costs.count);
        const float as_node = area + split_cost(wide_node_children);
        costs.is_leaf = costs.count <= leaf_size_ && as_leaf <= as_node;
        costs.least[0] = costs.is_leaf ? as_leaf : as_node;
        for (std::size_t i = 1; i < costs.least.size(); ++i)
            costs.least[i] = std::min(costs.least[i - 1], split_cost(int(i + 1)));
    }

    const HostBuffer<BinaryNode>& nodes_;
    const std::uint32_t leaf_size_;
    float scale_;
    HostBuffer<Costs> costs_;
};

class Collapser {
public:
    Collapser(const HostBuffer<BinaryNode>& nodes, std::span<const Primitive> primitives, int leaf_size)
        : nodes_(nodes), primitives_(primitives), costs_(nodes, leaf_size) {}

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
            if (costs_.is_leaf(index)) {
                slot = WideNode::leaf_slot(primitive_count, costs_.count(index));
                primitive_count += costs_.count(index);
                push_primitives(index, part.primitives);
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

    // The children of a wide node: the best, unless one of them is too high for the levels left.
    int open(const Task& task, Children& children) const {
        int count = 0;
        if (costs_.is_leaf(task.binary))
            children[count++] = task.binary;
        else
            open_best(task.binary, wide_node_children, children, count);
        for (int i = 0; i < count; ++i)
            if (height(children[i]) > 3 * (max_tree_levels - task.level)) return open_highest(task.binary, children);
        return count;
    }

    void open_best(std::uint32_t index, int most, Children& children, int& count) const {
        const int left = costs_.left_children(index, most);
        const auto put = [&](std::uint32_t child, int most) {
            most = costs_.children(child, most);
            if (most == 1)
                children[count++] = child;
            else
                open_best(child, most, children, count);
        };
        put(nodes_[index].left, left);
        put(nodes_[index].right, most - left);
    }

    int open_highest(std::uint32_t index, Children& children) const {
        int count = 0;
        children[count++] = index;
        while (count < wide_node_children) {
            const auto highest = std::max_element(children.begin(), children.begin() + count, [&](auto a, auto b) {
                return height(a) < height(b);
            });
            if (height(*highest) == 0) break;
            const std::uint32_t opened = *highest;
            *highest = nodes_[opened].left;
            children[count++] = nodes_[opened].right;
        }
        return count;
    }

    int height(std::uint32_t index) const { return costs_.is_leaf(index) ? 0 : nodes_[index].height; }

    void push_primitives(std::uint32_t index, std::vector<std::uint32_t>& primitives) const {
        const BinaryNode& node = nodes_[index];
        if (node.is_leaf()) return primitives.push_back(primitives_[node.primitive].index);
        push_primitives(node.left, primitives);
        push_primitives(node.right, primitives);
    }

    // Greedy: the child that lies furthest towards a free corner gets it. Swapping pairs until the sum of all is at its
    // best saves bounce rays less than half a percent of their visits. -1: free slot.
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
    const CollapseCosts costs_;
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

Bvh collapse(const HostBuffer<BinaryNode>& nodes, std::span<const Primitive> primitives, int leaf_size) {
    const Collapser collapser(nodes, primitives, leaf_size);
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

Bvh build_bvh(std::span<const Bounds> boxes, int leaf_size, TreeQuality quality) {
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
    HostBuffer<BinaryNode> nodes = build_binary_bvh(primitives);
    if (quality == TreeQuality::high) reinsert_nodes(nodes);
    Bvh bvh = collapse(nodes, primitives, leaf_size);
    bvh.bounds = bounds;
    return bvh;
}

}  // namespace svgf
