// SPDX-License-Identifier: Apache-2.0
// Rays against the scene: one traversal of both levels of the tree, for the closest hit and for any hit.
//
// All children of a node are tested at once, which gives a mask of those that the ray meets: primitives in its low bits,
// inner children above them in the order in which the ray visits them, front to back by octant [Ylitie17]. What is
// left of a node while one of its children is visited is a single entry of the stack.
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
    std::uint32_t octant;  // bit k: the direction is positive along axis k

    SVGF_HD BoxRay(Vec3 origin, Vec3 direction) : origin(origin) {
        // A component of zero becomes one that is too small to matter, so that no product is infinite or NaN.
        const float smallest = max(1e-15f * max_component(abs(direction)), 1e-30f);
        const auto inverse = [smallest](float d) { return 1 / std::copysign(max(std::fabs(d), smallest), d); };
        inverse_direction = {inverse(direction.x), inverse(direction.y), inverse(direction.z)};
        octant = (inverse_direction.x < 0 ? 0u : 1u) | (inverse_direction.y < 0 ? 0u : 2u) |
                 (inverse_direction.z < 0 ? 0u : 4u);
    }
};

// Relative error of a distance to a side, with room: the box test's own roundings, and those of the triangle test,
// which may place a hit as far outside of the box.
constexpr float box_margin = 8.0f / 16777216.0f;

// Like std::fmin and std::fmax: one instruction, and a NaN, from a product without bound, hides no box.
SVGF_HD inline float smaller(float a, float b) {
#if defined(__CUDA_ARCH__)
    return fminf(a, b);
#else
    return min(a, b);
#endif
}
SVGF_HD inline float larger(float a, float b) {
#if defined(__CUDA_ARCH__)
    return fmaxf(a, b);
#else
    return max(a, b);
#endif
}

// 1 + byte * 2^-15 for byte i of a word: a permutation of bytes, which is faster than a conversion.
SVGF_HD inline float one_and_byte(std::uint32_t bytes, int i) {
#if defined(__CUDA_ARCH__)
    return float_from_bits(__byte_perm(bytes, 0x3f800000u, 0x7604u | std::uint32_t(i) << 4));
#else
    return float_from_bits(0x3f800000u | ((bytes >> (8 * i)) & 0xffu) << 8);
#endif
}

// The children whose boxes the ray meets within [t_min, t_max]: their bits as WideNode describes them, those of inner
// children at inner_bit + (slot ^ octant), so that the nearest has the highest.
SVGF_HD inline std::uint32_t intersect_children(const WideNode& node, const BoxRay& ray, float t_min, float t_max) {
    // Along an axis, byte q of a box lies at distance (1 + q / byte_scale) * scale + start.
#if defined(V_HALF) && defined(__CUDA_ARCH__)
    constexpr float byte_scale = 1.0f, byte_offset = 1024.0f;
#else
    constexpr float byte_scale = 32768.0f, byte_offset = 1.0f;
#endif
    const Vec3 inverse = ray.inverse_direction;
    const Vec3 scale{node.step(0) * inverse.x * byte_scale, node.step(1) * inverse.y * byte_scale,
                     node.step(2) * inverse.z * byte_scale};
    const Vec3 origin = (node.origin - ray.origin) * inverse;
    const Vec3 start = origin - scale * byte_offset, margin = (abs(origin) + abs(scale) * byte_offset) * box_margin;
    const Vec3 near_start = start - margin, far_start = start + margin;
    const bool negative_x = inverse.x < 0, negative_y = inverse.y < 0, negative_z = inverse.z < 0;
#if defined(__AVX2__) && !defined(__CUDACC__)
    const auto words = [](const std::uint32_t (&bytes)[2]) {
        return _mm256_cvtepu8_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(bytes)));
    };
    const auto distances = [&](const std::uint32_t (&bytes)[2], float scale, float start) {
        const __m256i value = _mm256_or_si256(_mm256_slli_epi32(words(bytes), 8), _mm256_set1_epi32(0x3f800000));
        return _mm256_add_ps(_mm256_mul_ps(_mm256_castsi256_ps(value), _mm256_set1_ps(scale)), _mm256_set1_ps(start));
    };
    const __m256 near_x = distances(negative_x ? node.high[0] : node.low[0], scale.x, near_start.x);
    const __m256 near_y = distances(negative_y ? node.high[1] : node.low[1], scale.y, near_start.y);
    const __m256 near_z = distances(negative_z ? node.high[2] : node.low[2], scale.z, near_start.z);
    const __m256 far_x = distances(negative_x ? node.low[0] : node.high[0], scale.x, far_start.x);
    const __m256 far_y = distances(negative_y ? node.low[1] : node.high[1], scale.y, far_start.y);
    const __m256 far_z = distances(negative_z ? node.low[2] : node.high[2], scale.z, far_start.z);
    const __m256 enter = _mm256_max_ps(_mm256_max_ps(near_x, near_y), _mm256_max_ps(near_z, _mm256_set1_ps(t_min)));
    const __m256 leave = _mm256_min_ps(_mm256_min_ps(far_x, far_y), _mm256_min_ps(far_z, _mm256_set1_ps(t_max)));
    const __m256i met = _mm256_castps_si256(_mm256_cmp_ps(enter, leave, _CMP_LE_OQ));
    const __m256i slot = words(node.slot), shift = _mm256_and_si256(slot, _mm256_set1_epi32(31));
    const __m256i is_inner = _mm256_cmpgt_epi32(shift, _mm256_set1_epi32(WideNode::inner_bit - 1));
    const __m256i order = _mm256_xor_si256(shift, _mm256_and_si256(is_inner, _mm256_set1_epi32(int(ray.octant))));
    const __m256i bits = _mm256_and_si256(_mm256_sllv_epi32(_mm256_srli_epi32(slot, 5), order), met);
    __m128i mask = _mm_or_si128(_mm256_castsi256_si128(bits), _mm256_extracti128_si256(bits, 1));
    mask = _mm_or_si128(mask, _mm_shuffle_epi32(mask, 0x4e));
    mask = _mm_or_si128(mask, _mm_shuffle_epi32(mask, 0xb1));
    return std::uint32_t(_mm_cvtsi128_si32(mask));
#else
    std::uint32_t mask = 0;
    SVGF_UNROLL
    for (int half = 0; half < 2; ++half) {
        const std::uint32_t near_x = negative_x ? node.high[0][half] : node.low[0][half];
        const std::uint32_t near_y = negative_y ? node.high[1][half] : node.low[1][half];
        const std::uint32_t near_z = negative_z ? node.high[2][half] : node.low[2][half];
        const std::uint32_t far_x = negative_x ? node.low[0][half] : node.high[0][half];
        const std::uint32_t far_y = negative_y ? node.low[1][half] : node.high[1][half];
        const std::uint32_t far_z = negative_z ? node.low[2][half] : node.high[2][half];
        // Four slots at once: only the shifts of inner children have both of their highest bits set.
        const std::uint32_t slots = node.slot[half];
        const std::uint32_t inner = (slots >> 4) & (slots >> 3) & 0x01010101u;
        const std::uint32_t shifts = (slots ^ (inner * ray.octant)) & 0x1f1f1f1fu;
        const std::uint32_t children = (slots >> 5) & 0x07070707u;
#if defined(V_HALF) && defined(__CUDA_ARCH__)
        float v[6][4];
        const auto expand = [](std::uint32_t bytes, float (&out)[4]) {
            asm("{.reg .b16 a,b; mov.b32 {a,b}, %2; cvt.f32.f16 %0, a; cvt.f32.f16 %1, b;}" : "=f"(out[0]), "=f"(out[1]) : "r"(__byte_perm(bytes, 0x64646464u, 0x4140)));
            asm("{.reg .b16 a,b; mov.b32 {a,b}, %2; cvt.f32.f16 %0, a; cvt.f32.f16 %1, b;}" : "=f"(out[2]), "=f"(out[3]) : "r"(__byte_perm(bytes, 0x64646464u, 0x4342)));
        };
        expand(near_x, v[0]); expand(near_y, v[1]); expand(near_z, v[2]); expand(far_x, v[3]); expand(far_y, v[4]); expand(far_z, v[5]);
#endif
        SVGF_UNROLL
        for (int i = 0; i < 4; ++i) {
#if defined(V_HALF) && defined(__CUDA_ARCH__)
            const float nx = v[0][i] * scale.x + near_start.x, ny = v[1][i] * scale.y + near_start.y, nz = v[2][i] * scale.z + near_start.z;
            const float fx = v[3][i] * scale.x + far_start.x, fy = v[4][i] * scale.y + far_start.y, fz = v[5][i] * scale.z + far_start.z;
#else
            const auto one = [i](std::uint32_t bytes, float scale, float start) { return one_and_byte(bytes, i) * scale + start; };
            const float nx = one(near_x, scale.x, near_start.x), ny = one(near_y, scale.y, near_start.y), nz = one(near_z, scale.z, near_start.z);
            const float fx = one(far_x, scale.x, far_start.x), fy = one(far_y, scale.y, far_start.y), fz = one(far_z, scale.z, far_start.z);
#endif
#if defined(V_VIMAX) && defined(__CUDA_ARCH__)
            const int e = max(__vimax3_s32(__float_as_int(nx), __float_as_int(ny), __float_as_int(nz)), __float_as_int(t_min));
            const int l = min(__vimin3_s32(__float_as_int(fx), __float_as_int(fy), __float_as_int(fz)), __float_as_int(t_max));
            if (e <= l) mask |= ((children >> (8 * i)) & 0xffu) << ((shifts >> (8 * i)) & 0xffu);
            continue;
#endif
            const auto distance = [i](std::uint32_t bytes, float scale, float start) {
                return one_and_byte(bytes, i) * scale + start;
            };
            const float enter =
                larger(larger(nx, ny), larger(nz, t_min));
            const float leave =
                smaller(smaller(fx, fy), smaller(fz, t_max));
            if (enter <= leave) mask |= ((children >> (8 * i)) & 0xffu) << ((shifts >> (8 * i)) & 0xffu);
        }
    }
    return mask;
#endif
}

// --- Traversal -------------------------------------------------------------------------------------------------------

// Returns whether there is a hit. With any_hit the first one found ends the search and hit is left as it was; else hit
// becomes the closest one.
template <bool any_hit>
SVGF_HD inline bool traverse(const SceneView& scene, const Ray& ray, Hit& hit) {
    // Some of the children of a node, by its hit mask: inner ones, with the slots of all inner children in the low
    // bits, or primitives.
    struct Group {
        std::uint32_t first, bits;

        SVGF_HD bool has_nodes() const { return bits >> WideNode::inner_bit; }
    };
    constexpr Group root{0, 1u << 31};
    constexpr Group only_instance{0, 1u};
    // A group per level, and one of instances.
    #if defined(V_POSTPONE)
    Group stack[4 * max_tree_levels + 1];
#else
    Group stack[2 * max_tree_levels + 1];
#endif
    int stack_size = 0;
    int instance_floor = 0;      // stack size at which the current instance is done
    std::int32_t instance = -1;  // -1: in the top level
    const WideNode* nodes = scene.nodes;
    const LeafTriangle* triangles = nullptr;
    BoxRay box_ray(ray.origin, ray.direction);
    TriangleRay triangle_ray(ray.origin, ray.direction);
    float t_max = ray.t_max;
    Group group = scene.has_one_instance ? only_instance : root;
    for (;;) {
        Group primitives;
        if (group.has_nodes()) {
            const int bit = highest_set_bit(group.bits);
            group.bits ^= 1u << bit;
            const std::uint32_t slot = std::uint32_t(bit - WideNode::inner_bit) ^ box_ray.octant;
            const std::uint32_t before = group.bits & ((1u << slot) - 1) & 0xffu;
            const std::uint32_t child = group.first + std::uint32_t(count_set_bits(before));
            if (group.has_nodes()) stack[stack_size++] = group;
            const WideNode node = load(nodes + child);
            const std::uint32_t mask = intersect_children(node, box_ray, ray.t_min, t_max);
            group = {node.first_child, (mask & 0xff000000u) | node.inner_slots()};
            primitives = {node.first_primitive, mask & 0x00ffffffu};
        } else {
            primitives = group;
            group.bits = 0;
        }
        while (primitives.bits) {
            const std::uint32_t i = primitives.first + std::uint32_t(lowest_set_bit(primitives.bits));
            primitives.bits &= primitives.bits - 1;
            if (instance < 0) {
                if (group.has_nodes()) stack[stack_size++] = group;
                if (primitives.bits) stack[stack_size++] = primitives;
                instance_floor = stack_size;
                instance = scene.instance_order[i];
                const Instance placed = load(scene.instances + instance);
                const MeshView& mesh = scene.meshes[placed.mesh];
                const Vec3 origin = transform_point(placed.world_to_object, ray.origin);
                const Vec3 direction = transform_vector(placed.world_to_object, ray.direction);
                nodes = mesh.nodes;
                triangles = mesh.triangles;
                box_ray = BoxRay(origin, direction);
                triangle_ray = TriangleRay(origin, direction);
                group = root;
                break;
            }
#if defined(V_POSTPONE) && defined(__CUDA_ARCH__)
            if (group.has_nodes() && __popc(__activemask()) < V_POSTPONE) {
                primitives.bits |= 1u << (i - primitives.first);
                stack[stack_size++] = primitives;
                break;
            }
#endif
            const LeafTriangle triangle = load(triangles + i);
            float t, weight1, weight2;
            if (!intersect_triangle(triangle_ray, triangle, t, weight1, weight2)) continue;
            if (!(t > ray.t_min && t < ray.t_max && t <= t_max)) continue;
            if constexpr (any_hit) return true;
            const std::int32_t index = triangle.index;
            const bool closer = t < t_max || instance < hit.instance ||
                                (instance == hit.instance && index < hit.triangle);
            if (!closer) continue;
            t_max = t;
            hit = {t, weight1, weight2, instance, index, std::int32_t(i)};
        }
        if (group.has_nodes()) continue;
        if (stack_size == 0) break;
        if (instance >= 0 && stack_size == instance_floor) {
            instance = -1;
            nodes = scene.nodes;
            box_ray = BoxRay(ray.origin, ray.direction);
        }
        group = stack[--stack_size];
    }
    return t_max < ray.t_max;
}

SVGF_HD inline Hit find_closest_hit(const SceneView& scene, const Ray& ray) {
    Hit hit;
    traverse<false>(scene, ray, hit);
    return hit;
}

SVGF_HD inline bool is_occluded(const SceneView& scene, const Ray& ray) {
    Hit unused;
    return traverse<true>(scene, ray, unused);
}

}  // namespace svgf
