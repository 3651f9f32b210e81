// SPDX-License-Identifier: Apache-2.0
// Choosing one of many lights by what they are likely to contribute at a point: a walk down the light tree [Conty18],
// which at each node goes to one of the two children with probabilities proportional to their importance. The same walk
// towards a given light tells the probability of choosing it, for light that rays run into.
//
// Departures: the tree is a complete binary one, split in halves by count, so that the way to a light is the binary
// number of its leaf and needs no memory. Importance counts the cosine at the receiver, as pbrt-v4 does.
#pragma once

#include "core/load.h"
#include "core/vec.h"
#include "scene/flat_scene.h"

namespace svgf {

// An angle in [0, pi]. By both functions, as the cosine of a small angle has few digits left.
struct Angle {
    float cosine, sine;
};

SVGF_HD inline Angle angle_between(Vec3 a, Vec3 b) { return {dot(a, b), length(cross(a, b))}; }

SVGF_HD inline Angle angle_of(float cosine) {
    return {cosine, std::sqrt(max(0.0f, (1.0f - cosine) * (1.0f + cosine)))};
}

// max(0, a - b)
SVGF_HD inline Angle operator-(Angle a, Angle b) {
    if (a.cosine > b.cosine) return {1.0f, 0.0f};
    return {a.cosine * b.cosine + a.sine * b.sine, a.sine * b.cosine - a.cosine * b.sine};
}

// A bound of what the lights of a node contribute at a point, up to a factor [Conty18, Eq. 3]. normal: of the
// receiver, both of whose sides may be lit. Where it is 0, nothing arrives.
SVGF_HD inline float light_importance(const LightNode& node, Vec3 point, Vec3 normal) {
    const Vec3 extent = (node.high - node.low) * 0.5f;
    const Vec3 from_point = node.low + extent - point;
    const float distance_squared = dot(from_point, from_point), radius_squared = dot(extent, extent);
    // Close to the box its lights are as good as anywhere in it.
    const float falloff = std::fabs(node.power) / max(max(distance_squared, radius_squared), 1e-30f);
    if (distance_squared <= radius_squared) return falloff;
    const Vec3 direction = from_point / std::sqrt(distance_squared);
    // The box is seen under at most twice this angle; a little more, for the roundings.
    const float sin_box = min(1.0f, std::sqrt(radius_squared / distance_squared) * 1.001f + 1e-3f);
    const Angle box{std::sqrt((1.0f - sin_box) * (1.0f + sin_box)), sin_box};
    Angle axis = angle_between(node.axis, -direction), receiver = angle_between(normal, direction);
    if (node.power < 0.0f) axis.cosine = std::fabs(axis.cosine);
    receiver.cosine = std::fabs(receiver.cosine);
    const float cos_light = (axis - angle_of(node.cos_normals) - box).cosine;
    if (!(cos_light > node.cos_emission)) return 0.0f;
    return falloff * max(cos_light, 0.0f) * (receiver - box).cosine;
}

// Walks to the leaf that u chooses, or to `leaf` where that is >= 0, and sets it. Returns the probability of getting
// there; 0: no light of the tree reaches the point. The first steps use up u.x, the others u.y.
SVGF_HD SVGF_NOINLINE inline float walk_light_tree(const LightsView& lights, Vec3 point, Vec3 normal, Vec2 u,
                                                   std::int32_t& leaf) {
    constexpr int steps_of_first = 8;
    std::int32_t node = 0;
    float probability = 1.0f;
    for (int level = 0; level < lights.tree_depth; ++level) {
        const float left = light_importance(load(lights.nodes + 2 * node + 1), point, normal);
        const float right = light_importance(load(lights.nodes + 2 * node + 2), point, normal);
        const float sum = left + right;
        if (!(sum > 0.0f)) return 0.0f;
        const float left_share = left / sum;
        float& number = level < steps_of_first ? u.x : u.y;
        const bool goes_left = leaf >= 0 ? ((leaf >> (lights.tree_depth - 1 - level)) & 1) == 0 : number < left_share;
        const float share = goes_left ? left_share : 1.0f - left_share;
        number = min((goes_left ? number : number - left_share) / share, 0x1.fffffep-1f);
        probability *= share;
        node = 2 * node + (goes_left ? 1 : 2);
    }
    leaf = node - ((1 << lights.tree_depth) - 1);
    return probability;
}

}  // namespace svgf
