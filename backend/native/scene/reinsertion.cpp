// SPDX-License-Identifier: Apache-2.0
#include "scene/reinsertion.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/bits.h"
#include "core/host_buffer.h"
#include "device/threads.h"

namespace svgf {
namespace {

// Nodes that are looked at in a round: first a share of all, and never many more than this. It is the large ones that
// count, of which a large mesh has little more than a small one.
constexpr std::size_t share_of_nodes = 16, most_nodes = 32768;
// The list of the next round's nodes, some of which are in it more than once, grows no further.
constexpr std::size_t most_listed = 4 * most_nodes;
constexpr int rounds = 8;
// Places that are tried for a node at most. Few need as many.
constexpr int most_places = 128;

// Nodes that a thread takes at a time where all are gone through.
constexpr std::size_t chunk = 16384;

// Half the surface area of a box that is not empty.
float half_area(const Bounds& box) {
    const Vec3 size = box.high - box.low;
    return size.x * size.y + size.y * size.z + size.z * size.x;
}

Bounds join(Bounds a, const Bounds& b) {
    a.add(b);
    return a;
}

// A node goes beside another one, where its old parent becomes the parent of both.
struct Move {
    std::uint32_t node, beside;
    float gain;  // in area of all inner nodes

    bool operator<(const Move& other) const { return gain != other.gain ? gain > other.gain : node < other.node; }
};

class Reinsertion {
public:
    explicit Reinsertion(std::span<BinaryNode> nodes) : nodes_(nodes), changed_in_(nodes.size()) {
        parallel_for(nodes.size(), [&](std::size_t begin, std::size_t end) {
            std::fill(changed_in_.data() + begin, changed_in_.data() + end, std::uint8_t(0));
        });
    }

    void run() {
        std::vector<std::uint32_t> looked_at = choose();
        std::vector<Move> moves;
        for (int round = 1; round <= rounds && !looked_at.empty(); ++round) {
            moves.resize(looked_at.size());
            parallel_for(moves.size(), 64, [&](std::size_t begin, std::size_t end) {
                for (std::size_t i = begin; i < end; ++i) moves[i] = find_move(looked_at[i]);
            });
            std::erase_if(moves, [](const Move& move) { return !(move.gain > 0.0f); });
            std::sort(moves.begin(), moves.end());
            // Then all that would have moved, and what has new neighbours.
            looked_at.clear();
            for (const Move& move : moves) {
                looked_at.push_back(move.node);
                make(move, std::uint8_t(round), looked_at);
            }
            std::sort(looked_at.begin(), looked_at.end());
            looked_at.erase(std::unique(looked_at.begin(), looked_at.end()), looked_at.end());
        }
    }

private:
    std::uint32_t sibling(std::uint32_t index) const {
        const BinaryNode& parent = nodes_[nodes_[index].parent];
        return parent.left == index ? parent.right : parent.left;
    }

    // What a node may gain at most, in steps of an eighth.
    std::uint32_t promise(std::uint32_t index) const {
        const BinaryNode& node = nodes_[index];
        const float gain = half_area(nodes_[node.parent].box) - half_area(node.box);
        return gain > 0.0f ? bits_of(gain) >> 20 : 0;
    }
    static constexpr std::uint32_t promise_count = 1u << 11;

    // The nodes of the most promise.
    std::vector<std::uint32_t> choose() const {
        const std::size_t most = std::min(nodes_.size() / share_of_nodes, most_nodes);
        const std::size_t chunks = (nodes_.size() + chunk - 1) / chunk;
        const auto for_nodes = [&](const auto& body) {
            parallel_for(chunks, 1, [&](std::size_t begin, std::size_t end) {
                for (std::size_t c = begin; c < end; ++c)
                    for (std::size_t i = c * chunk; i < std::min((c + 1) * chunk, nodes_.size()); ++i)
                        body(c, std::uint32_t(i));
            });
        };
        std::vector<std::array<std::uint32_t, promise_count>> counts(chunks);
        for_nodes([&](std::size_t c, std::uint32_t i) { ++counts[c][promise(i)]; });
        std::uint32_t least = promise_count;
        for (std::size_t total = 0; least > 1; --least) {
            for (const auto& count : counts) total += count[least - 1];
            if (total > most) break;
        }
        std::vector<std::vector<std::uint32_t>> found(chunks);
        for_nodes([&](std::size_t c, std::uint32_t i) {
            if (promise(i) >= least) found[c].push_back(i);
        });
        std::vector<std::uint32_t> chosen;
        for (const auto& part : found) chosen.insert(chosen.end(), part.begin(), part.end());
        return chosen;
    }

    Move find_move(std::uint32_t index) const {
        Move best{index, index, 0.0f};
        const BinaryNode& node = nodes_[index];
        // A place is not found for the root, nor for its children: the root stays what it is.
        if (node.parent == 0) return best;
        int places = most_places;
        // From below a node's sibling up: beyond each of the nodes above it, all that lies on their other side. What
        // taking it out saves are its parent, and of the nodes that it leaves what they shrink by.
        std::uint32_t above = node.parent, other = sibling(index);
        float saved = half_area(nodes_[above].box);
        Bounds rest = nodes_[other].box;
        search(other, node.box, saved, places, best);
        while (above != 0) {
            other = sibling(above);
            search(other, node.box, saved, places, best);
            above = nodes_[above].parent;
            rest.add(nodes_[other].box);
            saved += half_area(nodes_[above].box) - half_area(rest);
        }
        return best;
    }

    // Looks for the best place for a box at a node or below, where those above it have saved so much.
    void search(std::uint32_t root, const Bounds& box, float saved, int& places, Move& best) const {
        struct Place {
            std::uint32_t node;
            float saved;  // less what the nodes above grow by
        };
        const float area = half_area(box);
        std::array<Place, max_binary_height + 1> pending;
        int size = 0;
        pending[size++] = {root, saved};
        while (size > 0 && places > 0) {
            const Place place = pending[--size];
            // The new parent is no smaller than the box.
            if (!(place.saved - area > best.gain)) continue;
            --places;
            const BinaryNode& node = nodes_[place.node];
            const float gain = place.saved - half_area(join(node.box, box));
            if (gain > best.gain) best.gain = gain, best.beside = place.node;
            if (node.is_leaf()) continue;
            const float below = gain + half_area(node.box);
            pending[size++] = {node.right, below};
            pending[size++] = {node.left, below};
        }
    }

    // Unless something is in the way. Adds the nodes whose neighbours are others then.
    void make(const Move& move, std::uint8_t round, std::vector<std::uint32_t>& others) {
        const auto [node, beside, gain] = move;
        const std::uint32_t parent = nodes_[node].parent, target = nodes_[beside].parent;
        const std::uint32_t above = nodes_[parent].parent, other = sibling(node);
        if (beside == other) return;
        const std::array changed{node, parent, other, above, beside, target};
        for (const std::uint32_t index : changed)
            if (changed_in_[index] == round) return;
        std::uint32_t depth = 1;  // of both afterwards
        for (std::uint32_t index = beside; index != 0; index = nodes_[index].parent, ++depth)
            if (index == node) return;
        if (depth + std::max(nodes_[node].height, nodes_[beside].height) > max_binary_height) return;

        replace(above, parent, other);
        update(above);
        replace(target, beside, parent);
        nodes_[parent].left = beside;
        nodes_[parent].right = node;
        nodes_[node].parent = nodes_[beside].parent = parent;
        update(parent);
        for (const std::uint32_t index : changed) {
            changed_in_[index] = round;
            if (!nodes_[index].is_leaf() && others.size() < most_listed)
                others.insert(others.end(), {nodes_[index].left, nodes_[index].right});
        }
    }

    void replace(std::uint32_t parent, std::uint32_t child, std::uint32_t by) {
        BinaryNode& node = nodes_[parent];
        (node.left == child ? node.left : node.right) = by;
        nodes_[by].parent = parent;
    }

    // Boxes and heights from a node up.
    void update(std::uint32_t index) {
        for (;; index = nodes_[index].parent) {
            BinaryNode& node = nodes_[index];
            node.box = join(nodes_[node.left].box, nodes_[node.right].box);
            node.height = 1 + std::max(nodes_[node.left].height, nodes_[node.right].height);
            if (index == 0) return;
        }
    }

    const std::span<BinaryNode> nodes_;
    HostBuffer<std::uint8_t> changed_in_;  // round in which each node had last another parent or other children
};

}  // namespace

void reinsert_nodes(std::span<BinaryNode> nodes) { Reinsertion(nodes).run(); }

}  // namespace svgf
