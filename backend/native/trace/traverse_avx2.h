// SPDX-License-Identifier: Apache-2.0
// The traversal of trace/intersect.h for processors with AVX2. It finds the same hits to the bit, as those depend on
// triangle tests alone, and these round alike; the order in which nodes are visited is its own.
//
// A CPU waits for memory where a GPU runs other threads, and guesses branches where a GPU masks them. So here every
// child waits on the stack with the distance at which the ray enters its box, the nearest on top: what lies behind a
// hit that was found in the meantime is dropped unseen, instances included, and memory is on its way before it is
// needed. Up to four triangles are tested at once.
#pragma once

#include <immintrin.h>

#include <array>

#include "trace/intersect.h"

namespace svgf {

// Permutations of the bytes of WideNode::sides along an axis, twice the same 16: where boxes begin or end, as integers.
struct alignas(32) SidePermutation {
    std::int8_t byte[32];
};
constexpr SidePermutation side_permutation(int end) {
    SidePermutation permutation{};
    for (int i = 0; i < 32; ++i) permutation.byte[i] = i % 4 == 0 ? std::int8_t(i / 2 + end) : std::int8_t(-1);
    return permutation;
}
constexpr SidePermutation permutation_of_end[2] = {side_permutation(0), side_permutation(1)};

// Which end of boxes a ray enters and leaves by, for each octant of directions: bit k is set where the direction is
// negative along axis k.
struct NodeSides {
    const SidePermutation *near[3], *far[3];
};
constexpr std::array<NodeSides, 8> sides_of_octant = [] {
    std::array<NodeSides, 8> sides{};
    for (std::uint32_t octant = 0; octant < 8; ++octant)
        for (std::uint32_t axis = 0; axis < 3; ++axis) {
            const bool is_negative = (octant >> axis) & 1u;
            sides[octant].near[axis] = &permutation_of_end[is_negative ? 1 : 0];
            sides[octant].far[axis] = &permutation_of_end[is_negative ? 0 : 1];
        }
    return sides;
}();

// BoxRay for the eight boxes of a node; lanes x, y, z, and 0.
struct EightBoxRay {
    __m128 origin, direction, inverse_direction;
    const NodeSides* sides;

    EightBoxRay() = default;
    EightBoxRay(__m128 origin, __m128 direction) : origin(origin), direction(direction) {
        const __m128 sign_bit = _mm_set1_ps(-0.0f);
        const __m128 size = _mm_andnot_ps(sign_bit, direction);
        __m128 largest = _mm_max_ps(size, _mm_shuffle_ps(size, size, 0x4e));
        largest = _mm_max_ps(largest, _mm_shuffle_ps(largest, largest, 0xb1));
        const __m128 smallest = _mm_max_ps(_mm_mul_ps(largest, _mm_set1_ps(smallest_share)),
                                           _mm_set1_ps(smallest_component));
        inverse_direction = _mm_div_ps(
            _mm_set1_ps(1.0f), _mm_or_ps(_mm_max_ps(size, smallest), _mm_and_ps(sign_bit, direction)));
        sides = &sides_of_octant[std::size_t(_mm_movemask_ps(inverse_direction)) & 7u];
    }

    // The ray in the space of an instance, rounded as transform_point and transform_vector do.
    EightBoxRay transformed(const Mat34& matrix) const {
        __m128 x = _mm_load_ps(&matrix.row[0].x), y = _mm_load_ps(&matrix.row[1].x), z = _mm_load_ps(&matrix.row[2].x);
        __m128 translation = _mm_setzero_ps();
        _MM_TRANSPOSE4_PS(x, y, z, translation);  // to columns
        const auto linear = [&](__m128 v) {
            const __m128 along_x = _mm_mul_ps(x, _mm_shuffle_ps(v, v, 0x00));
            const __m128 along_y = _mm_mul_ps(y, _mm_shuffle_ps(v, v, 0x55));
            return _mm_add_ps(_mm_add_ps(along_x, along_y), _mm_mul_ps(z, _mm_shuffle_ps(v, v, 0xaa)));
        };
        return {_mm_add_ps(linear(origin), translation), linear(direction)};
    }

    TriangleRay triangle_ray() const {
        alignas(16) float o[4], d[4];
        _mm_store_ps(o, origin);
        _mm_store_ps(d, direction);
        return {{o[0], o[1], o[2]}, {d[0], d[1], d[2]}};
    }
};

// The slots whose boxes the ray meets within [t_min, t_max], a bit for each, and where it enters them.
SVGF_ALWAYS_INLINE inline std::uint32_t intersect_eight(const WideNode& node, const EightBoxRay& ray, float t_min,
                                                        float t_max, float (&enter)[wide_node_children]) {
    const auto absolute = [](__m128 v) { return _mm_andnot_ps(_mm_set1_ps(-0.0f), v); };
    // The fourth lane of the first 16 bytes is no coordinate.
    const __m128 origin = _mm_blend_ps(_mm_load_ps(&node.origin.x), ray.origin, 8);
    const __m128i exponents = _mm_cvtepu8_epi32(_mm_cvtsi32_si128(int(node.exponents_and_inner & 0x00ffffffu)));
    const __m128 step = _mm_castsi128_ps(_mm_slli_epi32(exponents, 23));
    const __m128 scale = _mm_mul_ps(step, ray.inverse_direction);
    const __m128 start = _mm_mul_ps(_mm_sub_ps(origin, ray.origin), ray.inverse_direction);
    // The margin of intersect_children.
    const __m128 of_scale = _mm_mul_ps(absolute(scale), _mm_set1_ps(byte_offset * box_margin));
    const __m128 near_start = _mm_fnmadd_ps(absolute(start), _mm_set1_ps(box_margin), _mm_sub_ps(start, of_scale));
    const __m128 far_start = _mm_fmadd_ps(absolute(start), _mm_set1_ps(box_margin), _mm_add_ps(start, of_scale));

    const auto lane = [](__m128 v, int axis) {
        return _mm256_permutevar8x32_ps(_mm256_castps128_ps256(v), _mm256_set1_epi32(axis));
    };
    const auto distances = [&](const SidePermutation* side, __m128 from, int axis) {
        const __m128i sides = _mm_load_si128(reinterpret_cast<const __m128i*>(node.sides[axis]));
        const __m256i both = _mm256_broadcastsi128_si256(sides);
        const __m256i words = _mm256_shuffle_epi8(both, _mm256_load_si256(reinterpret_cast<const __m256i*>(side)));
        return _mm256_fmadd_ps(_mm256_cvtepi32_ps(words), lane(scale, axis), lane(from, axis));
    };
    const NodeSides& ends = *ray.sides;
    const __m256 near_x = distances(ends.near[0], near_start, 0), far_x = distances(ends.far[0], far_start, 0);
    const __m256 near_y = distances(ends.near[1], near_start, 1), far_y = distances(ends.far[1], far_start, 1);
    const __m256 near_z = distances(ends.near[2], near_start, 2), far_z = distances(ends.far[2], far_start, 2);
    const __m256 entered = _mm256_max_ps(_mm256_max_ps(near_x, near_y), _mm256_max_ps(near_z, _mm256_set1_ps(t_min)));
    const __m256 left = _mm256_min_ps(_mm256_min_ps(far_x, far_y), _mm256_min_ps(far_z, _mm256_set1_ps(t_max)));
    _mm256_store_ps(enter, entered);
    const __m128i slots = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(node.slot));
    const int is_free = _mm_movemask_epi8(_mm_cmpeq_epi8(slots, _mm_setzero_si128()));
    return std::uint32_t(_mm256_movemask_ps(_mm256_cmp_ps(entered, left, _CMP_LE_OQ)) & ~is_free);
}

// Hits of up to four triangles: intersect_triangle in four lanes, with the same roundings.
struct FourHits {
    alignas(16) float t[4], weight1[4], weight2[4];
};

// Returns the lanes that are hit with t_min < t < t_end and t <= t_max, a bit for each.
SVGF_ALWAYS_INLINE inline std::uint32_t intersect_four(const TriangleRay& ray, const LeafTriangle* const (&triangle)[4],
                                                       float t_min, float t_end, float t_max, FourHits& hits) {
    // Of one or two vertices of each triangle, rows to columns: x of all, y of all, z of all.
    const auto first_and_second = [&](int i) { return _mm256_loadu_ps(&triangle[i]->vertex0.x); };
    const __m256 xy01 = _mm256_unpacklo_ps(first_and_second(0), first_and_second(1));
    const __m256 xy23 = _mm256_unpacklo_ps(first_and_second(2), first_and_second(3));
    const __m256 z01 = _mm256_unpackhi_ps(first_and_second(0), first_and_second(1));
    const __m256 z23 = _mm256_unpackhi_ps(first_and_second(2), first_and_second(3));
    const auto third = [&](int i) { return _mm_load_ps(&triangle[i]->vertex2.x); };
    const __m128 third_xy01 = _mm_unpacklo_ps(third(0), third(1)), third_xy23 = _mm_unpacklo_ps(third(2), third(3));
    const __m128 third_z01 = _mm_unpackhi_ps(third(0), third(1)), third_z23 = _mm_unpackhi_ps(third(2), third(3));

    const __m256 ab[3] = {
        _mm256_sub_ps(_mm256_shuffle_ps(xy01, xy23, 0x44), _mm256_set1_ps(ray.origin.x)),
        _mm256_sub_ps(_mm256_shuffle_ps(xy01, xy23, 0xee), _mm256_set1_ps(ray.origin.y)),
        _mm256_sub_ps(_mm256_shuffle_ps(z01, z23, 0x44), _mm256_set1_ps(ray.origin.z)),
    };
    const __m128 c[3] = {
        _mm_sub_ps(_mm_shuffle_ps(third_xy01, third_xy23, 0x44), _mm_set1_ps(ray.origin.x)),
        _mm_sub_ps(_mm_shuffle_ps(third_xy01, third_xy23, 0xee), _mm_set1_ps(ray.origin.y)),
        _mm_sub_ps(_mm_shuffle_ps(third_z01, third_z23, 0x44), _mm_set1_ps(ray.origin.z)),
    };
    const auto dot_ab = [&](Vec3 row) {
        return _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(_mm256_set1_ps(row.x), ab[0]),
                                           _mm256_mul_ps(_mm256_set1_ps(row.y), ab[1])),
                             _mm256_mul_ps(_mm256_set1_ps(row.z), ab[2]));
    };
    const auto dot_c = [&](Vec3 row) {
        return _mm_add_ps(_mm_add_ps(_mm_mul_ps(_mm_set1_ps(row.x), c[0]), _mm_mul_ps(_mm_set1_ps(row.y), c[1])),
                          _mm_mul_ps(_mm_set1_ps(row.z), c[2]));
    };
    const auto low = [](__m256 v) { return _mm256_castps256_ps128(v); };
    const auto high = [](__m256 v) { return _mm256_extractf128_ps(v, 1); };

    const __m256 ab_x = dot_ab(ray.x), ab_y = dot_ab(ray.y);
    const __m256d ax = _mm256_cvtps_pd(low(ab_x)), bx = _mm256_cvtps_pd(high(ab_x));
    const __m256d ay = _mm256_cvtps_pd(low(ab_y)), by = _mm256_cvtps_pd(high(ab_y));
    const __m256d cx = _mm256_cvtps_pd(dot_c(ray.x)), cy = _mm256_cvtps_pd(dot_c(ray.y));
    // As difference_of_products: these products are exact.
    const auto difference = [](__m256d a, __m256d b, __m256d c, __m256d d) {
        return _mm256_cvtpd_ps(_mm256_sub_pd(_mm256_mul_pd(a, b), _mm256_mul_pd(c, d)));
    };
    const __m128 u = difference(cx, by, cy, bx), v = difference(ax, cy, ay, cx), w = difference(bx, ay, by, ax);
    const __m128 zero = _mm_setzero_ps();
    const __m128 least = _mm_min_ps(_mm_min_ps(u, v), w), most = _mm_max_ps(_mm_max_ps(u, v), w);
    const __m128 inside = _mm_or_ps(_mm_cmpge_ps(least, zero), _mm_cmple_ps(most, zero));
    const __m128 determinant = _mm_add_ps(_mm_add_ps(u, v), w);
    const __m128 counts = _mm_and_ps(inside, _mm_cmpneq_ps(determinant, zero));
    if (_mm_movemask_ps(counts) == 0) return 0;

    const __m128 inverse = _mm_div_ps(_mm_set1_ps(1.0f), determinant);
    const __m256 ab_z = dot_ab(ray.z);
    const __m128 sum = _mm_add_ps(_mm_add_ps(_mm_mul_ps(u, low(ab_z)), _mm_mul_ps(v, high(ab_z))),
                                  _mm_mul_ps(w, dot_c(ray.z)));
    const __m128 t = _mm_mul_ps(sum, inverse);
    _mm_store_ps(hits.t, t);
    _mm_store_ps(hits.weight1, _mm_mul_ps(v, inverse));
    _mm_store_ps(hits.weight2, _mm_mul_ps(w, inverse));
    const __m128 in_ray = _mm_and_ps(_mm_cmpgt_ps(t, _mm_set1_ps(t_min)), _mm_cmplt_ps(t, _mm_set1_ps(t_end)));
    const __m128 within = _mm_and_ps(in_ray, _mm_cmple_ps(t, _mm_set1_ps(t_max)));
    return std::uint32_t(_mm_movemask_ps(_mm_and_ps(counts, within)));
}

// The triangles of a mesh from `first` on whose bits are set. Returns whether the search ends; else hit.t is how far
// the ray goes on.
template <bool any_hit, class Passes>
bool test_triangles(const SceneView& scene, const LeafTriangle* triangles, std::uint32_t first, std::uint32_t bits,
                    std::int32_t instance, const TriangleRay& triangle_ray, const Ray& ray, Hit& hit, Passes& passes) {
    do {
        const LeafTriangle* lanes[4];
        const std::uint32_t lanes_used = (1u << min(count_set_bits(bits), 4)) - 1;
        const LeafTriangle* last = nullptr;
        for (int i = 0; i < 4; ++i) {
            if (bits) last = triangles + first + lowest_set_bit(bits);
            lanes[i] = last;
            bits &= bits - 1;
        }
        FourHits four;
        std::uint32_t hit_lanes = intersect_four(triangle_ray, lanes, ray.t_min, ray.t_max, hit.t, four) & lanes_used;
        for (; hit_lanes; hit_lanes &= hit_lanes - 1) {
            const int i = lowest_set_bit(hit_lanes);
            const LeafTriangle& triangle = *lanes[i];
            Hit found{four.t[i], four.weight1[i], four.weight2[i], instance, triangle.index,
                      std::int32_t(lanes[i] - triangles)};
            if (!name_owner(scene, triangle, found)) continue;
            if constexpr (!any_hit) {
                const bool closer =
                    found.t < hit.t ||
                    (found.t == hit.t && (found.instance < hit.instance ||
                                          (found.instance == hit.instance && found.triangle < hit.triangle)));
                if (!closer) continue;
            }
            if (passes(triangle_ray, triangle, found)) continue;
            if constexpr (any_hit) return true;
            hit = found;
        }
    } while (bits);
    return false;
}

// What a ray has still to visit waits on its stack as one number: the distance at which it enters a box, and below it a
// node of the tree that it is in, or a leaf of the top level. Distances are not negative: numbers have their order.
constexpr std::uint32_t top_leaf_bit = 1u << 31;
// A level of either tree leaves seven of its children at most.
constexpr int distance_stack_entries = 2 * max_tree_levels * (wide_node_children - 1) + 1;

// Puts the nearest on top.
inline void sort_distances(std::uint64_t* entries, int count) {
    for (int i = 1; i < count; ++i) {
        const std::uint64_t entry = entries[i];
        int place = i;
        for (; place > 0 && entries[place - 1] < entry; --place) entries[place] = entries[place - 1];
        entries[place] = entry;
    }
}

// hit is a new one: its distance is infinite.
template <bool any_hit, class Passes>
inline bool traverse(const SceneView& scene, const Ray& ray, Hit& hit, Passes&& passes) {
    const EightBoxRay world_ray(_mm_setr_ps(ray.origin.x, ray.origin.y, ray.origin.z, 0),
                                _mm_setr_ps(ray.direction.x, ray.direction.y, ray.direction.z, 0));
    EightBoxRay object_ray;
    TriangleRay triangle_ray;
    std::int32_t object_ray_instance = -1, triangle_ray_instance = -1;  // for which they are known
    const EightBoxRay* box_ray = &world_ray;
    std::uint64_t stack[distance_stack_entries];
    int size = 0;
    int instance_floor = -1;     // stack size at which the current instance is done; -1: in the top level
    std::int32_t instance = -1;
    const WideNode* nodes = scene.nodes;
    const LeafTriangle* triangles = nullptr;
    float t_max = ray.t_max;
    std::uint32_t child = scene.has_one_leaf ? top_leaf_bit : 0;

    const auto entry = [](float distance, std::uint32_t child) {
        return std::uint64_t(bits_of(distance)) << 32 | child;
    };
    for (;;) {
        std::uint32_t first_primitive = 0, primitives = 0;
        if (child & top_leaf_bit) {
            const TopLeaf leaf = scene.top_leaves[child & ~top_leaf_bit];
            const Instance& placed = scene.instances[leaf.instance];
            if (placed.visibility & ray.kind) {
                instance_floor = size;
                instance = leaf.instance;
                const MeshView& mesh = scene.meshes[placed.mesh];
                nodes = mesh.nodes;
                triangles = mesh.triangles;
                box_ray = &object_ray;
                if (instance != object_ray_instance) {
                    object_ray_instance = instance;
                    object_ray = instance == scene.merged_instance ? world_ray
                                                                   : world_ray.transformed(placed.world_to_object);
                }
                if (leaf.bits >> WideNode::inner_bit) {
                    child = leaf.first;
                    continue;
                }
                first_primitive = leaf.first;
                primitives = leaf.bits;
            }
        } else {
            const WideNode& node = nodes[child];
            alignas(32) float enter[wide_node_children];
            const std::uint32_t met = intersect_eight(node, *box_ray, ray.t_min, t_max, enter);
            const std::uint32_t inner = node.inner_slots();
            const auto* const slots = reinterpret_cast<const std::uint8_t*>(node.slot);
            const int first = size;
            for (std::uint32_t left = met & inner; left; left &= left - 1) {
                const int slot = lowest_set_bit(left);
                const std::uint32_t next =
                    node.first_child + std::uint32_t(count_set_bits(inner & ((1u << slot) - 1)));
                prefetch(nodes + next);
                prefetch(reinterpret_cast<const char*>(nodes + next) + 64);
                stack[size++] = entry(enter[slot], next);
            }
            std::uint32_t left = met & ~inner;
            if (instance_floor < 0) {
                for (; left; left &= left - 1) {
                    const int slot = lowest_set_bit(left);
                    const std::uint32_t leaf = node.first_primitive + WideNode::first_of(slots[slot]);
                    stack[size++] = entry(enter[slot], top_leaf_bit | leaf);
                }
            } else {
                first_primitive = node.first_primitive;
                for (; left; left &= left - 1) {
                    const std::uint32_t slot = slots[lowest_set_bit(left)];
                    primitives |= (slot >> 5) << WideNode::first_of(slot);
                }
            }
            if (size - first > 1) sort_distances(stack + first, size - first);
        }
        if (primitives) {
            if (instance != triangle_ray_instance) {
                triangle_ray_instance = instance;
                triangle_ray = object_ray.triangle_ray();
            }
            if (test_triangles<any_hit>(scene, triangles, first_primitive, primitives, instance, triangle_ray, ray,
                                        hit, passes))
                return true;
            if constexpr (!any_hit) t_max = min(t_max, hit.t);
        }
        do {
            if (size == instance_floor) {
                instance_floor = -1;
                nodes = scene.nodes;
                box_ray = &world_ray;
            }
            if (size == 0) return !any_hit && hit.found();
            child = std::uint32_t(stack[--size]);
        } while (float_from_bits(std::uint32_t(stack[size] >> 32)) > t_max);
    }
}

}  // namespace svgf
