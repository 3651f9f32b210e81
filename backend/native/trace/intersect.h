// SPDX-License-Identifier: Apache-2.0
// Rays against the scene: one traversal of both levels of the tree, for the closest hit and for any hit.
//
// Nodes are visited front to back by the octant order of their slots [Ylitie17]; what is left of a node while one of
// its children is visited is a single entry of the stack, so the stack holds as many entries as the tree has levels.
// Boxes are tested with a margin for every rounding on the way, so that the tree never hides what a test of all
// triangles would find. Of hits at the same distance the one with the lowest instance and triangle counts, in
// whatever order they are found.
#pragma once

#if defined(__AVX2__) && !defined(__CUDACC__)
#include <immintrin.h>
#endif

#include "core/bits.h"
#include "core/load.h"
#include "core/vec.h"
#include "scene/flat_scene.h"

namespace svgf {

struct Ray {
    Vec3 origin;
    Vec3 direction;  // of any length; t counts in it
    float t_min = 0, t_max = infinity;  // both excluded
    std::uint32_t kind = ray_kind::all;  // sees the instances that have one of its bits
};

struct Hit {
    float t = infinity;
    float weight1 = 0, weight2 = 0;   // barycentric, of vertices 1 and 2
    std::int32_t instance = -1;       // -1: nothing was hit
    std::int32_t triangle = -1;       // of the mesh as it was given
    std::int32_t leaf_triangle = -1;  // the same in leaf order, where its data lie

    SVGF_HD bool found() const { return instance >= 0; }
};

// --- Triangles -------------------------------------------------------------------------------------------------------

// A ray for triangles [Woop13]: a shear maps it to the z axis. The rows contain the permutation of the axes, which
// costs a few multiplications by 0 and 1 but no choice by index.
struct TriangleRay {
    Vec3 origin, x, y, z;

    SVGF_HD TriangleRay(Vec3 origin, Vec3 direction) : origin(origin) {
        const Vec3 size = abs(direction);
        const bool along_z = size.z >= size.x && size.z >= size.y, along_y = !along_z && size.y >= size.x;
        if (along_z) {
            z = {0, 0, 1 / direction.z};
            x = {1, 0, -direction.x * z.z};
            y = {0, 1, -direction.y * z.z};
        } else if (along_y) {
            z = {0, 1 / direction.y, 0};
            x = {0, -direction.z * z.y, 1};
            y = {1, -direction.x * z.y, 0};
        } else {
            z = {1 / direction.x, 0, 0};
            x = {-direction.y * z.x, 1, 0};
            y = {-direction.z * z.x, 0, 1};
        }
    }
};

// Watertight: the sign of each edge function is exact, so a ray through a shared edge is on one side of it for one
// triangle and on the other for its neighbour, or on it for both. Both faces are hit.
SVGF_HD inline bool intersect_triangle(const TriangleRay& ray, const LeafTriangle& triangle, float& t, float& weight1,
                                       float& weight2) {
    const Vec3 a = triangle.vertex0 - ray.origin, b = triangle.vertex1 - ray.origin, c = triangle.vertex2 - ray.origin;
    const float ax = dot(ray.x, a), ay = dot(ray.y, a);
    const float bx = dot(ray.x, b), by = dot(ray.y, b);
    const float cx = dot(ray.x, c), cy = dot(ray.y, c);
    const float u = difference_of_products(cx, by, cy, bx);
    const float v = difference_of_products(ax, cy, ay, cx);
    const float w = difference_of_products(bx, ay, by, ax);
    const bool inside = (u >= 0 && v >= 0 && w >= 0) || (u <= 0 && v <= 0 && w <= 0);
    const float determinant = u + v + w;
    if (!inside || determinant == 0) return false;
    const float inverse = 1 / determinant;
    weight1 = v * inverse;
    weight2 = w * inverse;
    t = (u * dot(ray.z, a) + v * dot(ray.z, b) + w * dot(ray.z, c)) * inverse;
    return true;
}

// --- Boxes -----------------------------------------------------------------------------------------------------------

struct BoxRay {
    Vec3 origin, inverse_direction;
    std::uint32_t octant;  // bit k: the direction is negative along axis k

    SVGF_HD BoxRay(Vec3 origin, Vec3 direction) : origin(origin) {
        // A component of zero becomes one that is too small to matter, so that no product is infinite or NaN.
        const float smallest = max(1e-15f * max_component(abs(direction)), 1e-30f);
        const auto inverse = [smallest](float d) { return 1 / std::copysign(max(std::fabs(d), smallest), d); };
        inverse_direction = {inverse(direction.x), inverse(direction.y), inverse(direction.z)};
        octant = (inverse_direction.x < 0 ? 1u : 0u) | (inverse_direction.y < 0 ? 2u : 0u) |
                 (inverse_direction.z < 0 ? 4u : 0u);
    }
};

// Relative error of a distance to a side, with room: the box test's own roundings, and those of the triangle test,
// which may place a hit as far outside of the box.
constexpr float box_margin = 8.0f / 16777216.0f;

// Slots of a node by the order in which a ray visits them: bit (s ^ octant) for slot s.
SVGF_HD inline std::uint32_t in_visiting_order(std::uint32_t slots, std::uint32_t octant) {
    if (octant & 1) slots = ((slots & 0x55) << 1) | ((slots >> 1) & 0x55);
    if (octant & 2) slots = ((slots & 0x33) << 2) | ((slots >> 2) & 0x33);
    if (octant & 4) slots = ((slots & 0x0f) << 4) | (slots >> 4);
    return slots;
}

// The children whose boxes the ray meets within [t_min, t_max], in visiting order.
SVGF_HD inline std::uint32_t intersect_children(const WideNode& node, const BoxRay& ray, float t_min, float t_max) {
    // Along an axis, byte q of a box lies at distance q * step + start.
    const Vec3 inverse = ray.inverse_direction;
    const Vec3 step{node.step(0) * inverse.x, node.step(1) * inverse.y, node.step(2) * inverse.z};
    const Vec3 start = (node.origin - ray.origin) * inverse;
    const Vec3 margin = (abs(start) + 255.0f * abs(step)) * box_margin;
    const Vec3 near_start = start - margin, far_start = start + margin;
    const bool negative_x = inverse.x < 0, negative_y = inverse.y < 0, negative_z = inverse.z < 0;
    std::uint32_t slots = 0;
#if defined(__AVX2__) && !defined(__CUDACC__)
    const auto distances = [](const std::uint32_t (&bytes)[2], float step, float start) {
        const __m128i packed = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(bytes));
        const __m256 q = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(packed));
        return _mm256_add_ps(_mm256_mul_ps(q, _mm256_set1_ps(step)), _mm256_set1_ps(start));
    };
    const __m256 near_x = distances(negative_x ? node.high[0] : node.low[0], step.x, near_start.x);
    const __m256 near_y = distances(negative_y ? node.high[1] : node.low[1], step.y, near_start.y);
    const __m256 near_z = distances(negative_z ? node.high[2] : node.low[2], step.z, near_start.z);
    const __m256 far_x = distances(negative_x ? node.low[0] : node.high[0], step.x, far_start.x);
    const __m256 far_y = distances(negative_y ? node.low[1] : node.high[1], step.y, far_start.y);
    const __m256 far_z = distances(negative_z ? node.low[2] : node.high[2], step.z, far_start.z);
    const __m256 enter = _mm256_max_ps(_mm256_max_ps(near_x, near_y), _mm256_max_ps(near_z, _mm256_set1_ps(t_min)));
    const __m256 leave = _mm256_min_ps(_mm256_min_ps(far_x, far_y), _mm256_min_ps(far_z, _mm256_set1_ps(t_max)));
    slots = std::uint32_t(_mm256_movemask_ps(_mm256_cmp_ps(enter, leave, _CMP_LE_OQ)));
#else
    SVGF_UNROLL
    for (int half = 0; half < 2; ++half) {
        const std::uint32_t near_x = negative_x ? node.high[0][half] : node.low[0][half];
        const std::uint32_t near_y = negative_y ? node.high[1][half] : node.low[1][half];
        const std::uint32_t near_z = negative_z ? node.high[2][half] : node.low[2][half];
        const std::uint32_t far_x = negative_x ? node.low[0][half] : node.high[0][half];
        const std::uint32_t far_y = negative_y ? node.low[1][half] : node.high[1][half];
        const std::uint32_t far_z = negative_z ? node.low[2][half] : node.high[2][half];
        SVGF_UNROLL
        for (int i = 0; i < 4; ++i) {
            const auto distance = [i](std::uint32_t bytes, float step, float start) {
                return float((bytes >> (8 * i)) & 0xffu) * step + start;
            };
            const float enter = max(max(distance(near_x, step.x, near_start.x), distance(near_y, step.y, near_start.y)),
                                    max(distance(near_z, step.z, near_start.z), t_min));
            const float leave = min(min(distance(far_x, step.x, far_start.x), distance(far_y, step.y, far_start.y)),
                                    min(distance(far_z, step.z, far_start.z), t_max));
            slots |= (enter <= leave ? 1u : 0u) << (4 * half + i);
        }
    }
#endif
    return in_visiting_order(slots & node.used_slots(), ray.octant);
}

// --- Traversal -------------------------------------------------------------------------------------------------------

// Returns whether there is a hit. With any_hit the first one found ends the search and hit is left as it was; else hit
// becomes the closest one. Each step stands here once, and all rays share it: inlined for closest and any hit, with the
// box test at each of its three uses, it made stage "path" wait for instructions most of the time.
SVGF_HD SVGF_NOINLINE inline bool traverse(const SceneView& scene, const Ray& ray, bool any_hit, Hit& hit) {
    // A node and those of its children that are still to be visited.
    struct Group {
        std::uint32_t node, slots;
    };
    Group stack[2 * max_tree_levels];
    int stack_size = 0;
    int instance_floor = 0;      // stack size at which the current instance is done
    std::int32_t instance = -1;  // -1: in the top level
    const WideNode* nodes = scene.nodes;
    const LeafTriangle* triangles = nullptr;
    BoxRay box_ray(ray.origin, ray.direction);
    TriangleRay triangle_ray(ray.origin, ray.direction);
    float t_max = ray.t_max;
    Group group{0, 0};
    bool enters = true;  // the node of the group, whose children are not tested yet
    for (;;) {
        if (enters) {
            group.slots = intersect_children(load(nodes + group.node), box_ray, ray.t_min, t_max);
            enters = false;
        }
        if (group.slots == 0) {
            if (instance >= 0 && stack_size == instance_floor) {
                instance = -1;
                instance_floor = 0;
                nodes = scene.nodes;
                box_ray = BoxRay(ray.origin, ray.direction);
            }
            if (stack_size == 0) break;
            group = stack[--stack_size];
            continue;
        }
        const int first = lowest_set_bit(group.slots);
        group.slots &= group.slots - 1;
        const WideNode& node = nodes[group.node];
        const std::uint32_t slot = WideNode::byte(node.slot, first ^ int(box_ray.octant));
        const std::uint32_t count = WideNode::primitive_count(slot);
        if (count == 0) {
            const std::uint32_t child = node.first_child + WideNode::offset(slot);
            if (group.slots) stack[stack_size++] = group;
            group.node = child;
            enters = true;
            continue;
        }
        const std::uint32_t begin = node.first_primitive + WideNode::offset(slot);
        if (instance < 0) {
            // Leaves of the top level hold one instance each.
            const std::int32_t next = scene.instance_order[begin];
            const Instance& placed = scene.instances[next];
            if ((placed.visibility & ray.kind) == 0) continue;
            if (group.slots) stack[stack_size++] = group;
            instance = next;
            instance_floor = stack_size;
            const Vec3 origin = transform_point(placed.world_to_object, ray.origin);
            const Vec3 direction = transform_vector(placed.world_to_object, ray.direction);
            const MeshView& mesh = scene.meshes[placed.mesh];
            nodes = mesh.nodes;
            triangles = mesh.triangles;
            box_ray = BoxRay(origin, direction);
            triangle_ray = TriangleRay(origin, direction);
            group.node = 0;
            enters = true;
            continue;
        }
        for (std::uint32_t i = begin; i < begin + count; ++i) {
            const LeafTriangle triangle = load(triangles + i);
            float t, weight1, weight2;
            if (!intersect_triangle(triangle_ray, triangle, t, weight1, weight2)) continue;
            if (!(t > ray.t_min && t < ray.t_max && t <= t_max)) continue;
            if (any_hit) return true;
            const std::int32_t index = triangle.index;
            const bool closer = t < t_max || instance < hit.instance ||
                                (instance == hit.instance && index < hit.triangle);
            if (!closer) continue;
            t_max = t;
            hit = {t, weight1, weight2, instance, index, std::int32_t(i)};
        }
    }
    return t_max < ray.t_max;
}

SVGF_HD inline Hit find_closest_hit(const SceneView& scene, const Ray& ray) {
    Hit hit;
    traverse(scene, ray, false, hit);
    return hit;
}

SVGF_HD inline bool is_occluded(const SceneView& scene, const Ray& ray) {
    Hit unused;
    return traverse(scene, ray, true, unused);
}

}  // namespace svgf
