// SPDX-License-Identifier: Apache-2.0
// Choosing one of several lights by what each is likely to contribute at a point. Lights that are everywhere (suns, the
// environment) and the nodes of one level of the light tree [Conty18] stand beside each other, each with an estimate of
// the irradiance that it brings. From a node a walk goes down the tree, each time to one of the two children, with
// probabilities proportional to the same estimate. The probability of choosing a given light, for light that rays run
// into, comes of the same steps.
//
// Departures: the tree is a complete binary one, split in halves by count, so that the way to a light is the binary
// number of its leaf and needs no memory. Importance counts the cosine at the receiver, as pbrt-v4 does. The choice
// starts among several nodes instead of at the root, whose box says little about a few lights far apart: up to eight
// lights are all weighed on their own. The triangles of an object that has few are one leaf and are chosen by their
// power: weighing the sides of a box one by one takes time, and brought a room 1 % less variance.
//
// Against the power of the lights alone, for fewer than 16 and always between these, suns and the environment: mean
// variance at equal samples -39 % in Sponza (a sun, four lanterns); geometric mean of the pixels' .63 times with three
// lamps, .84 times with two and a sky.
#pragma once

#include "core/approximate.h"
#include "core/load.h"
#include "core/vec.h"
#include "scene/flat_scene.h"

namespace svgf {

// An angle in [0, pi]. By both functions, as the cosine of a small angle has few digits left.
struct Angle {
    float cosine, sine;
};

SVGF_HD inline Angle angle_between(Vec3 a, Vec3 b) {
    const Vec3 sine = cross(a, b);
    return {dot(a, b), fast_sqrt(dot(sine, sine))};
}

SVGF_HD inline Angle angle_of(float cosine) {
    return {cosine, fast_sqrt(max(0.0f, (1.0f - cosine) * (1.0f + cosine)))};
}

// max(0, a - b)
SVGF_HD inline Angle operator-(Angle a, Angle b) {
    if (a.cosine > b.cosine) return {1.0f, 0.0f};
    return {a.cosine * b.cosine + a.sine * b.sine, a.sine * b.cosine - a.cosine * b.sine};
}

// Light from below the horizon counts as if it came at this cosine: a coat may have a normal of its own.
constexpr float least_cos_receiver = 0.02f;

// Of the receiver; its normal is Bsdf::lit_normal() in all that follows.
SVGF_HD inline bool faces_one_way(Vec3 normal) { return max_component(abs(normal)) > 0.0f; }

// An estimate of the irradiance of the lights of a node at a point [Conty18, Eq. 3]. Where it is 0, nothing arrives.
SVGF_HD inline float light_importance(const LightNode& node, Vec3 point, Vec3 normal) {
    const Vec3 extent = (node.high - node.low) * 0.5f;
    const Vec3 from_point = node.low + extent - point;
    const float distance_squared = dot(from_point, from_point), radius_squared = dot(extent, extent);
    // Close to the box its lights are as good as anywhere in it.
    const float falloff = fast_quotient(std::fabs(node.intensity), max(max(distance_squared, radius_squared), 1e-30f));
    if (distance_squared <= radius_squared) return falloff;
    const float inverse_distance = fast_reciprocal_sqrt(distance_squared);
    const Vec3 direction = from_point * inverse_distance;
    // The box is seen under at most twice this angle; a little more, for the roundings.
    const float sin_box = min(1.0f, fast_sqrt(radius_squared) * inverse_distance * 1.001f + 1e-3f);
    const Angle box{fast_sqrt((1.0f - sin_box) * (1.0f + sin_box)), sin_box};
    float weight = falloff;
    if (node.cos_normals > -1.0f) {
        Angle axis = angle_between(node.axis, -direction);
        if (node.intensity < 0.0f) axis.cosine = std::fabs(axis.cosine);
        const float cos_light = (axis - angle_of(node.cos_normals) - box).cosine;
        if (!(cos_light > node.cos_emission)) return 0.0f;
        weight *= max(cos_light, 0.0f);
    }
    if (!faces_one_way(normal)) return weight;
    return weight * max((angle_of(dot(normal, direction)) - box).cosine, least_cos_receiver);
}

// The same of a sun or the environment, which is taken for a sun and for light from all around.
SVGF_HD inline float estimate_irradiance(const Light& light, Vec3 normal) {
    const float facing = faces_one_way(normal) ? max(dot(light.axis_z, normal), 0.0f) : 1.0f;
    return light.weight * min(facing + light.ambient, 1.0f);
}

// Finds the light that u chooses, or, where `light` is >= 0, only the probability with which it would be chosen, which
// is returned; 0: none reaches the point. The first steps use up u.x, the others u.y.
SVGF_HD SVGF_NOINLINE inline float find_light_choice(const LightsView& lights, Vec3 point, Vec3 normal, Vec2 u,
                                                     std::int32_t& light) {
    constexpr int start_level = 3, steps_of_first = 8;
    constexpr float below_one = 0x1.fffffep-1f;
    const int everywhere = lights.everywhere_count, depth = lights.tree_depth;
    int level = min(depth, start_level);
    const int first_node = (1 << level) - 1, count = everywhere + (lights.nodes ? 1 << level : 0);
    const bool is_given = light >= 0;
    const int leaf = is_given ? lights.rows[light].leaf : -1;
    // Of the lights that are everywhere, and of the nodes after them, which are kept: estimating them again takes longer
    // than reading.
    float of_node[1 << start_level];
    const auto importance = [&](int i) {
        return i < everywhere ? estimate_irradiance(lights.rows[i], normal) : of_node[i - everywhere];
    };
    float total = 0.0f, width = 0.0f;
    SVGF_NO_UNROLL
    for (int i = 0; i < count; ++i) {
        // With nothing beside it there is nothing to weigh.
        if (i >= everywhere)
            of_node[i - everywhere] =
                count == 1 ? 1.0f : light_importance(load(lights.nodes + first_node + i - everywhere), point, normal);
        total += importance(i);
    }
    int start = -1;
    if (is_given) {
        start = light < everywhere ? light : leaf >= 0 ? everywhere + (leaf >> (depth - level)) : -1;
        if (start >= 0) width = importance(start);
    } else {
        float place = u.x * total;
        for (int i = 0; i < count; ++i) {
            const float found = importance(i);
            if (!(found > 0.0f)) continue;
            start = i;
            width = found;
            if (place < width) break;
            place -= width;
        }
        u.x = min(fast_quotient(place, width), below_one);
    }
    if (!(width > 0.0f)) return 0.0f;
    float probability = fast_quotient(width, total);
    if (start < everywhere) {
        light = start;
        return probability;
    }
    std::int32_t node = first_node + start - everywhere;
    for (; level < depth; ++level) {
        const float left = light_importance(load(lights.nodes + 2 * node + 1), point, normal);
        const float right = light_importance(load(lights.nodes + 2 * node + 2), point, normal);
        const float sum = left + right;
        if (!(sum > 0.0f)) return 0.0f;
        const float left_share = fast_quotient(left, sum);
        float& number = level < steps_of_first ? u.x : u.y;
        const bool goes_left = is_given ? ((leaf >> (depth - 1 - level)) & 1) == 0 : number < left_share;
        const float share = goes_left ? left_share : 1.0f - left_share;
        number = min(fast_quotient(goes_left ? number : number - left_share, share), below_one);
        probability *= share;
        node = 2 * node + (goes_left ? 1 : 2);
    }
    if (!is_given) {
        light = lights.light_of_leaf[node - ((1 << depth) - 1)];
        if (light < 0) return 0.0f;
        const float number = depth < steps_of_first ? u.x : u.y;
        while (!(number < lights.rows[light].ambient)) ++light;
    }
    return probability * lights.rows[light].weight;
}

}  // namespace svgf
