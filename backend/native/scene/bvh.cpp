// SPDX-License-Identifier: Apache-2.0
// Two steps: a binary tree by the binned surface area heuristic [Wald07], then groups of its nodes become wide nodes.
//
// Depth is bounded for any input, however hostile, so that traversal needs no check on its stack. The binary tree of
// n primitives with h levels left splits by count wherever the heuristic would put more than 2^(h-1) on one side.
// Collapsing opens the upper three levels of a subtree, all of them if it must, so that binary height 3 w becomes
// wide height w.
#include "scene/bvh.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "device/threads.h"

namespace svgf {
namespace {

constexpr int max_binary_height = 3 * max_tree_levels;
constexpr int bin_count = 16;

// Subtrees of fewer primitives are built by one thread.
constexpr std::uint32_t parallel_grain = 8192;

// Cost of one level of the binary tree, in triangle tests. A wide node holds about three levels.
constexpr float level_cost = 0.4f;

struct Primitive {
    Bounds box;
    std::uint32_t index;

    Vec3 centre() const { return (box.low + box.high) * 0.5f; }
};

struct BinaryNode {
    Bounds box;
    std::uint32_t left = 0, right = 0;   // children, if count is 0
    std::uint32_t first = 0, count = 0;  // primitives of a leaf
    int height = 0;                      // levels below this node
};

struct Bin {
    Bounds box;
    std::uint32_t count = 0;
};

struct Split {
    int axis = -1;  // -1: none found
    int bin = 0;    // the first bin of the right side
    float cost = infinity;
};

class BinaryBuilder {
public:
    BinaryBuilder(std::vector<Primitive>& primitives, int leaf_size)
        : primitives_(primitives), leaf_size_(std::uint32_t(leaf_size)), nodes_(2 * primitives.size() - 1) {
        // The upper levels first, then the subtrees below them side by side.
        const std::uint32_t count = std::uint32_t(primitives_.size());
        build({0, 0, count, max_binary_height}, std::max(parallel_grain, count / 64), true);
        parallel_for(subtrees_.size(), 1, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) build(subtrees_[i], 0, false);
        });
        find_height(0);
    }

    std::vector<BinaryNode> take() { return std::move(nodes_); }

private:
    // A node and its primitives. A subtree of n primitives owns the 2n - 1 nodes that start with its root, so that
    // threads never meet.
    struct Task {
        std::uint32_t node, first, count;
        int height;
    };

    void build(const Task& task, std::uint32_t defer_below, bool collect) {
        if (collect && task.count < defer_below) {
            subtrees_.push_back(task);
            return;
        }
        BinaryNode& node = nodes_[task.node];
        Bounds centres;
        for (std::uint32_t i = task.first; i < task.first + task.count; ++i) {
            node.box.add(primitives_[i].box);
            centres.add(primitives_[i].centre());
        }
        const Split split = task.count > 1 ? find_split(task, centres, node.box) : Split{};
        if (task.count == 1 || (task.count <= leaf_size_ && split.cost >= float(task.count))) {
            node.first = task.first;
            node.count = task.count;
            return;
        }
        const std::uint32_t left_count = partition(task, centres, split);
        node.left = task.node + 1;
        node.right = task.node + 2 * left_count;
        build({node.left, task.first, left_count, task.height - 1}, defer_below, collect);
        build({node.right, task.first + left_count, task.count - left_count, task.height - 1}, defer_below, collect);
    }

    static int bin_of(float centre, float low, float scale) {
        return std::min(int((centre - low) * scale), bin_count - 1);
    }
    static float bin_scale(float low, float high) { return high > low ? float(bin_count) / (high - low) : 0.0f; }

    Split find_split(const Task& task, const Bounds& centres, const Bounds& box) const {
        std::array<std::array<Bin, bin_count>, 3> bins{};
        const Vec3 scale{bin_scale(centres.low.x, centres.high.x), bin_scale(centres.low.y, centres.high.y),
                         bin_scale(centres.low.z, centres.high.z)};
        for (std::uint32_t i = task.first; i < task.first + task.count; ++i) {
            const Vec3 centre = primitives_[i].centre();
            for (int axis = 0; axis < 3; ++axis) {
                Bin& bin = bins[axis][bin_of(centre[axis], centres.low[axis], scale[axis])];
                bin.box.add(primitives_[i].box);
                ++bin.count;
            }
        }
        Split best;
        for (int axis = 0; axis < 3; ++axis) {
            if (scale[axis] == 0.0f) continue;
            // Costs of the right sides from the right, then of the left sides from the left.
            std::array<float, bin_count> right_cost;
            Bin side;
            for (int i = bin_count - 1; i > 0; --i) {
                side.box.add(bins[axis][i].box);
                side.count += bins[axis][i].count;
                right_cost[i] = side.box.half_area() * float(side.count);
            }
            side = {};
            for (int i = 1; i < bin_count; ++i) {
                side.box.add(bins[axis][i - 1].box);
                side.count += bins[axis][i - 1].count;
                if (side.count == 0 || side.count == task.count) continue;
                const float cost = side.box.half_area() * float(side.count) + right_cost[i];
                if (cost < best.cost) best = {axis, i, cost};
            }
        }
        // A line or a point has no area: any split is then as good as any other.
        const float area = box.half_area();
        best.cost = area > 0.0f ? best.cost / area + level_cost : infinity;
        return best;
    }

    // Sorts the primitives of the left child before those of the right one; returns the number of the former.
    std::uint32_t partition(const Task& task, const Bounds& centres, const Split& split) {
        const auto begin = primitives_.begin() + task.first, end = begin + task.count;
        if (split.axis >= 0) {
            const float low = centres.low[split.axis], scale = bin_scale(low, centres.high[split.axis]);
            const auto middle = std::partition(begin, end, [&](const Primitive& primitive) {
                return bin_of(primitive.centre()[split.axis], low, scale) < split.bin;
            });
            const std::uint32_t count = std::uint32_t(middle - begin);
            const std::uint64_t room = std::uint64_t(1) << std::min(task.height - 1, 62);
            if (std::max(count, task.count - count) <= room) return count;
        }
        const Vec3 size = centres.high - centres.low;
        const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
        const std::uint32_t half = task.count / 2;
        std::nth_element(begin, begin + half, end, [axis](const Primitive& a, const Primitive& b) {
            const float ca = a.centre()[axis], cb = b.centre()[axis];
            return ca != cb ? ca < cb : a.index < b.index;
        });
        return half;
    }

    int find_height(std::uint32_t index) {
        BinaryNode& node = nodes_[index];
        if (node.count == 0) node.height = 1 + std::max(find_height(node.left), find_height(node.right));
        return node.height;
    }

    std::vector<Primitive>& primitives_;
    const std::uint32_t leaf_size_;
    std::vector<BinaryNode> nodes_;
    std::vector<Task> subtrees_;
};

class WideBuilder {
public:
    WideBuilder(const std::vector<BinaryNode>& nodes, const std::vector<Primitive>& primitives, Bvh& bvh)
        : nodes_(nodes), primitives_(primitives), bvh_(bvh) {
        bvh_.primitives.reserve(primitives.size());
        bvh_.nodes.resize(1);
        collapse({0, 0, 1});
        while (!pending_.empty()) {
            const Task task = pending_.back();
            pending_.pop_back();
            collapse(task);
        }
    }

private:
    struct Task {
        std::uint32_t wide, binary;
        int level;  // of the wide node, the root's is 1
    };

    void collapse(const Task& task) {
        assert(task.level <= max_tree_levels);
        bvh_.levels = std::max(bvh_.levels, task.level);
        std::array<std::uint32_t, wide_node_children> children;
        const int count = open(task, children);
        std::array<int, wide_node_children> child_of_slot;
        assign_slots(nodes_[task.binary].box, children, count, child_of_slot);

        WideNode wide = quantise(nodes_[task.binary].box, children, child_of_slot);
        wide.first_child = std::uint32_t(bvh_.nodes.size());
        wide.first_primitive = std::uint32_t(bvh_.primitives.size());
        std::uint32_t inner_count = 0, primitive_count = 0;
        for (int s = 0; s < wide_node_children; ++s) {
            if (child_of_slot[s] < 0) continue;
            const std::uint32_t index = children[child_of_slot[s]];
            const BinaryNode& child = nodes_[index];
            if (child.count == 0) {
                set_byte(wide.slot, s, inner_count);
                pending_.push_back({wide.first_child + inner_count++, index, task.level + 1});
            } else {
                set_byte(wide.slot, s, (child.count << 5) | primitive_count);
                primitive_count += child.count;
                for (std::uint32_t i = 0; i < child.count; ++i)
                    bvh_.primitives.push_back(primitives_[child.first + i].index);
            }
        }
        bvh_.nodes.resize(bvh_.nodes.size() + inner_count);
        bvh_.nodes[task.wide] = wide;
    }

    // The children of a wide node: its binary node's, opened until there are 8, those that are too high for the levels
    // left first, else the one that a ray hits most likely.
    int open(const Task& task, std::array<std::uint32_t, wide_node_children>& children) const {
        const int height_left = 3 * (max_tree_levels - task.level);
        int count = 1;
        children[0] = task.binary;
        while (count < wide_node_children) {
            int chosen = -1;
            bool chosen_too_high = false;
            for (int i = 0; i < count; ++i) {
                const BinaryNode& node = nodes_[children[i]];
                if (node.count > 0) continue;
                const bool too_high = node.height > height_left;
                if (chosen < 0 || too_high > chosen_too_high ||
                    (too_high == chosen_too_high && node.box.half_area() > nodes_[children[chosen]].box.half_area())) {
                    chosen = i;
                    chosen_too_high = too_high;
                }
            }
            if (chosen < 0) break;
            const BinaryNode& node = nodes_[children[chosen]];
            children[chosen] = node.left;
            children[count++] = node.right;
        }
        return count;
    }

    // Greedy: the child that lies furthest towards a free corner gets it. -1: free slot.
    void assign_slots(const Bounds& box, const std::array<std::uint32_t, wide_node_children>& children, int count,
                      std::array<int, wide_node_children>& child_of_slot) const {
        child_of_slot.fill(-1);
        const Vec3 centre = (box.low + box.high) * 0.5f;
        std::array<bool, wide_node_children> placed{};
        for (int round = 0; round < count; ++round) {
            int best_child = -1, best_slot = -1;
            float best = -infinity;
            for (int i = 0; i < count; ++i) {
                if (placed[i]) continue;
                const Bounds& child = nodes_[children[i]].box;
                const Vec3 d = (child.low + child.high) * 0.5f - centre;
                for (int s = 0; s < wide_node_children; ++s) {
                    const float along = (s & 1 ? d.x : -d.x) + (s & 2 ? d.y : -d.y) + (s & 4 ? d.z : -d.z);
                    if (child_of_slot[s] < 0 && along > best) best = along, best_child = i, best_slot = s;
                }
            }
            placed[best_child] = true;
            child_of_slot[best_slot] = best_child;
        }
    }

    WideNode quantise(const Bounds& box, const std::array<std::uint32_t, wide_node_children>& children,
                      const std::array<int, wide_node_children>& child_of_slot) const {
        WideNode wide{};
        wide.origin = box.low;
        for (int axis = 0; axis < 3; ++axis) {
            const double extent = double(box.high[axis]) - box.low[axis];
            int exponent = extent > 0.0 ? std::clamp(std::ilogb(extent / 255.0), -126, 127) : -126;
            while (std::ldexp(255.0, exponent) < extent) ++exponent;
            wide.exponents_and_mask |= std::uint32_t(exponent + 127) << (8 * axis);
            const double origin = box.low[axis], step = std::ldexp(1.0, exponent);
            for (int s = 0; s < wide_node_children; ++s) {
                if (child_of_slot[s] < 0) continue;
                const Bounds& child = nodes_[children[child_of_slot[s]]].box;
                double low = std::clamp(std::floor((child.low[axis] - origin) / step), 0.0, 255.0);
                double high = std::clamp(std::ceil((child.high[axis] - origin) / step), 0.0, 255.0);
                while (low > 0.0 && origin + low * step > child.low[axis]) --low;
                while (high < 255.0 && origin + high * step < child.high[axis]) ++high;
                set_byte(wide.low[axis], s, std::uint32_t(low));
                set_byte(wide.high[axis], s, std::uint32_t(high));
            }
        }
        for (int s = 0; s < wide_node_children; ++s)
            if (child_of_slot[s] >= 0) wide.exponents_and_mask |= 1u << (24 + s);
        return wide;
    }

    static void set_byte(std::uint32_t (&words)[2], int s, std::uint32_t value) {
        words[s >> 2] |= value << (8 * (s & 3));
    }

    const std::vector<BinaryNode>& nodes_;
    const std::vector<Primitive>& primitives_;
    Bvh& bvh_;
    std::vector<Task> pending_;
};

}  // namespace

Bvh build_bvh(std::span<const Bounds> boxes, int leaf_size) {
    assert(leaf_size >= 1 && leaf_size <= max_leaf_size);
    Bvh bvh;
    std::vector<Primitive> primitives;
    primitives.reserve(boxes.size());
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        if (boxes[i].is_empty()) continue;
        primitives.push_back({boxes[i], std::uint32_t(i)});
        bvh.bounds.add(boxes[i]);
    }
    if (primitives.empty()) {
        bvh.nodes.resize(1);
        bvh.nodes[0] = WideNode{};
        return bvh;
    }
    const std::vector<BinaryNode> binary = BinaryBuilder(primitives, leaf_size).take();
    WideBuilder(binary, primitives, bvh);
    return bvh;
}

}  // namespace svgf
