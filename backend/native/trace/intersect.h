// SPDX-License-Identifier: Apache-2.0
// Rays against the scene: one traversal of both levels of the tree, for the closest hit and for any hit.
//
// All children of a node are tested at once, which gives a mask of those that the ray meets: primitives in its low
// bits, inner children above them in the order in which the ray visits them, front to back by octant [Ylitie17]. What
// is left of a node while one of its children is visited is a single entry of the stack.
// Boxes are tested with a margin for every rounding on the way, so that the tree never hides what a test of all
// triangles would find. Of hits at the same distance the one with the lowest instance and triangle counts, in
// whatever order they are found.
#pragma once

#include "core/bits.h"
#include "core/load.h"
#include "core/vec.h"
#include "scene/flat_scene.h"

namespace svgf {

struct Ray {
    Vec3 origin;
    Vec3 direction;  // of any length; t counts in it
    float t_min = 0, t_max = infinity;   // both excluded; t_min >= 0
    std::uint32_t kind = ray_kind::all;  // sees the instances that have one of its bits
};

struct alignas(16) Hit {
    float t = infinity;
    float weight1 = 0, weight2 = 0;   // barycentric, of vertices 1 and 2
    std::int32_t instance = -1;       // -1: nothing was hit
    std::int32_t triangle = -1;       // of the mesh as it was given
    std::int32_t leaf_triangle = -1;  // the same in leaf order, where its data lie
    std::int32_t passed = 0;          // surfaces on the way that the ray passed
    std::int32_t unused = 0;

    SVGF_HD bool found() const { return instance >= 0; }
};

// --- Triangles -------------------------------------------------------------------------------------------------------

// A ray for triangles [Woop13]: a shear maps it to the z axis. The rows contain the permutation of the axes, which
// costs a few multiplications by 0 and 1 but no choice by index.
struct TriangleRay {
    Vec3 origin, x, y, z;

    TriangleRay() = default;
    SVGF_HD TriangleRay(Vec3 origin, Vec3 direction)
        : TriangleRay(origin, direction, {1 / direction.x, 1 / direction.y, 1 / direction.z}) {}
    // inverse: of the direction, at least of its largest component.
    SVGF_HD TriangleRay(Vec3 origin, Vec3 direction, Vec3 inverse) : origin(origin) {
        const Vec3 size = abs(direction);
        const bool along_z = size.z >= size.x && size.z >= size.y, along_y = !along_z && size.y >= size.x;
        if (along_z) {
            z = {0, 0, inverse.z};
            x = {1, 0, -direction.x * z.z};
            y = {0, 1, -direction.y * z.z};
        } else if (along_y) {
            z = {0, inverse.y, 0};
            x = {0, -direction.z * z.y, 1};
            y = {1, -direction.x * z.y, 0};
        } else {
            z = {inverse.x, 0, 0};
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

// Whether a hit counts for this triangle where surfaces are counted: of the triangles that share an edge or a vertex, a
// ray through it counts for one, by the rule of rasterization (an edge belongs to the triangle on its left).
SVGF_HD inline bool owns_hit(const TriangleRay& ray, const LeafTriangle& triangle, float weight1, float weight2) {
    constexpr float rounding = 1e-6f;
    if (min(min(weight1, weight2), 1.0f - (weight1 + weight2)) > rounding) return true;
    const Vec3 corner[3] = {triangle.vertex0 - ray.origin, triangle.vertex1 - ray.origin, triangle.vertex2 - ray.origin};
    Vec2 p[3];
    for (int k = 0; k < 3; ++k) p[k] = {dot(ray.x, corner[k]), dot(ray.y, corner[k])};
    bool owned = true;
    for (int k = 0; k < 3; ++k) {
        const Vec2 from = p[k], to = p[(k + 1) % 3], other = p[(k + 2) % 3];
        if (difference_of_products(from.x, to.y, to.x, from.y) != 0.0f) continue;
        // On this edge. The ray is the origin; the triangle's inside is where the other corner is.
        const bool is_left = difference_of_products(to.x - from.x, other.y - from.y, other.x - from.x,
                                                    to.y - from.y) > 0.0f;
        const float dx = is_left ? to.x - from.x : from.x - to.x, dy = is_left ? to.y - from.y : from.y - to.y;
        owned &= dy > 0.0f || (dy == 0.0f && dx > 0.0f);
    }
    return owned;
}

// --- Boxes -----------------------------------------------------------------------------------------------------------

// A component of a direction that is closer to zero, or a smaller share of the largest one, counts as this: too small
// to matter, and no product is infinite or NaN.
constexpr float smallest_component = 1e-30f, smallest_share = 1e-15f;

// Which of the two bytes of a slot expand_sides takes: as a permutation of a word and of four bytes more.
constexpr std::uint32_t lower_sides = 0x4240u, upper_sides = 0x4341u, other_sides = lower_sides ^ upper_sides;

struct BoxRay {
    Vec3 origin, inverse_direction;
    std::uint32_t octant;     // bit k: the direction is positive along axis k
    std::uint32_t enters[3];  // for expand_sides, per axis: the sides of boxes by which the ray enters

    SVGF_HD BoxRay(Vec3 origin, Vec3 direction) : origin(origin) {
        const float smallest = max(smallest_share * max_component(abs(direction)), smallest_component);
        const auto inverse = [smallest](float d) { return 1 / std::copysign(max(std::fabs(d), smallest), d); };
        inverse_direction = {inverse(direction.x), inverse(direction.y), inverse(direction.z)};
        octant = (inverse_direction.x < 0 ? 0u : 1u) | (inverse_direction.y < 0 ? 0u : 2u) |
                 (inverse_direction.z < 0 ? 0u : 4u);
        for (int axis = 0; axis < 3; ++axis) enters[axis] = (octant >> axis) & 1u ? lower_sides : upper_sides;
    }
};

// Relative error of a distance to a side, with room: the box test's own roundings, and those of the triangle test,
// which may place a hit as far outside of the box.
constexpr float box_margin = 10.0f / 16777216.0f;

// Whether the largest of three distances and t_min is no larger than the smallest of three and t_max; t_min is not
// negative. On the device as integers, which takes less instructions: floats that are not negative have the order of
// their bits, and where one is negative it loses against 0, or else the box lies behind the ray, whichever of them is
// found. There 0 stands for t_min, as an instruction knows it: few rays start farther away.
SVGF_HD inline bool overlap(Vec3 near, [[maybe_unused]] float t_min, Vec3 far, float t_max) {
#if defined(__CUDA_ARCH__)
    const int enter =
        __vimax3_s32_relu(__float_as_int(near.x), __float_as_int(near.y), __float_as_int(near.z));
    const int leave = min(__vimin3_s32(__float_as_int(far.x), __float_as_int(far.y), __float_as_int(far.z)),
                          __float_as_int(t_max));
    return enter <= leave;
#else
    return max(max(near.x, near.y), max(near.z, t_min)) <= min(min(far.x, far.y), min(far.z, t_max));
#endif
}

// byte_offset plus a side of each of two slots, whose bytes are a word of WideNode::sides. On the device by way of
// halves, of which 1024 + byte is one for each byte: two of them are one permutation, which chooses the side as well,
// and to float they go through another pipe than comparisons do, of which there are many.
constexpr float byte_offset = 1024.0f;
struct TwoFloats {
    float value[2];
};
SVGF_HD inline TwoFloats expand_sides(std::uint32_t bytes, std::uint32_t which) {
#if defined(__CUDA_ARCH__)
    TwoFloats result;
    asm("{ .reg .b16 low, high; mov.b32 {low, high}, %2; cvt.f32.f16 %0, low; cvt.f32.f16 %1, high; }"
        : "=f"(result.value[0]), "=f"(result.value[1])
        : "r"(__byte_perm(bytes, 0x64646464u, which)));
    return result;
#else
    const int shift = which == lower_sides ? 0 : 8;
    return {{byte_offset + float((bytes >> shift) & 0xffu), byte_offset + float((bytes >> (shift + 16)) & 0xffu)}};
#endif
}

// The bits that slot `i` of four sets in the hit mask: WideNode says how. The device shifts by the lowest five bits of a
// number.
SVGF_HD inline std::uint32_t mask_bits(std::uint32_t slots, int i) {
#if defined(__CUDA_ARCH__)
    const std::uint32_t slot = __byte_perm(slots, 0, 0x4440 + i);
    return __funnelshift_l(0, slot >> 5, slot);
#else
    const std::uint32_t slot = (slots >> (8 * i)) & 0xffu;
    return (slot >> 5) << (slot & 31u);
#endif
}

// The children whose boxes the ray meets within [t_min, t_max]: their bits as WideNode describes them, those of inner
// children at inner_bit + (slot ^ octant), so that the nearest has the highest.
//
// On an H200 this is what tracing costs, and its integer and comparison pipe what is busy: with bytes converted one by
// one and floats compared, primary rays of a room of 19,440 triangles came at 3.94 instead of 4.47 billions per second.
SVGF_HD inline std::uint32_t intersect_children(const WideNode& node, const BoxRay& ray, float t_min, float t_max) {
    // Along an axis, byte q of a box lies at distance q * scale + start.
    const Vec3 inverse = ray.inverse_direction;
    const Vec3 scale{node.step(0) * inverse.x, node.step(1) * inverse.y, node.step(2) * inverse.z};
    const Vec3 start = (node.origin - ray.origin) * inverse;
    const Vec3 extent = multiply_add(abs(scale), byte_offset, abs(start));
    const Vec3 from_zero = multiply_add(scale, -byte_offset, start);
    const Vec3 near_start = multiply_add(extent, -box_margin, from_zero);
    const Vec3 far_start = multiply_add(extent, box_margin, from_zero);
    std::uint32_t mask = 0;
    SVGF_UNROLL
    for (int half = 0; half < 2; ++half) {
        // Four slots at once: only the shifts of inner children have both of their highest bits set.
        const std::uint32_t slots = node.slot[half];
        const std::uint32_t inner = (slots >> 4) & (slots >> 3) & 0x01010101u;
        const std::uint32_t bytes = slots ^ (inner * ray.octant);
        SVGF_UNROLL
        for (int pair = 0; pair < 2; ++pair) {
            const int word = 2 * half + pair;
            const TwoFloats near_x = expand_sides(node.sides[0][word], ray.enters[0]);
            const TwoFloats near_y = expand_sides(node.sides[1][word], ray.enters[1]);
            const TwoFloats near_z = expand_sides(node.sides[2][word], ray.enters[2]);
            const TwoFloats far_x = expand_sides(node.sides[0][word], ray.enters[0] ^ other_sides);
            const TwoFloats far_y = expand_sides(node.sides[1][word], ray.enters[1] ^ other_sides);
            const TwoFloats far_z = expand_sides(node.sides[2][word], ray.enters[2] ^ other_sides);
            SVGF_UNROLL
            for (int i = 0; i < 2; ++i) {
                const Vec3 near{multiply_add(near_x.value[i], scale.x, near_start.x),
                                multiply_add(near_y.value[i], scale.y, near_start.y),
                                multiply_add(near_z.value[i], scale.z, near_start.z)};
                const Vec3 far{multiply_add(far_x.value[i], scale.x, far_start.x),
                               multiply_add(far_y.value[i], scale.y, far_start.y),
                               multiply_add(far_z.value[i], scale.z, far_start.z)};
                const std::uint32_t bits = mask_bits(bytes, 2 * pair + i);
                if (overlap(near, t_min, far, t_max)) mask |= bits;
            }
        }
    }
    return mask;
}

// Blocks of 128 threads that a multiprocessor should hold of a kernel that does nothing but trace rays: 64 registers
// per thread.
constexpr int trace_blocks = 8;

// --- Traversal -------------------------------------------------------------------------------------------------------

// Groups that wait at most: a level leaves what is left of its node, and its primitives where they are postponed.
constexpr int stack_entries = 4 * max_tree_levels;

// Some of the children of a node, by its hit mask: inner ones, with the slots of all inner children in the low bits, or
// primitives.
struct alignas(8) NodeGroup {
    std::uint32_t first, bits;

    SVGF_HD bool has_nodes() const { return bits >> WideNode::inner_bit; }
};

// Entries of a traversal's stack that lie in shared memory, on the device.
#if defined(__CUDA_ARCH__)
constexpr int shared_stack_entries = 8, shared_stack_threads = 128;  // of a block
#else
constexpr int shared_stack_entries = 0;
#endif

// The rest of them.
struct StackMemory {
    NodeGroup groups[stack_entries - shared_stack_entries];
};

// What a ray has still to visit. All traversals of a kernel use the same shared memory, one after the other.
class TraversalStack {
public:
    SVGF_HD explicit TraversalStack(StackMemory& memory) : groups_(memory.groups) {
#if defined(__CUDA_ARCH__)
        __shared__ uint2 entries[shared_stack_entries][shared_stack_threads];
        const int thread = int(threadIdx.y * blockDim.x + threadIdx.x);
        const unsigned address = unsigned(__cvta_generic_to_shared(&entries[0][thread]));
        // From the thread itself, as what comes from another one the compiler keeps: else it works the address out at
        // each access, which takes Sponza's rays 3 % longer.
        shared_ = __shfl_sync(__activemask(), address, thread & 31);
#endif
    }

    SVGF_HD bool is_empty() const { return size_ == 0; }
    SVGF_HD int size() const { return size_; }

    SVGF_HD void push(NodeGroup group) {
        if (size_ < shared_stack_entries)
            store_shared(group);
        else
            groups_[size_ - shared_stack_entries] = group;
        ++size_;
    }
    SVGF_HD NodeGroup pop() {
        --size_;
        return size_ < shared_stack_entries ? load_shared() : groups_[size_ - shared_stack_entries];
    }

private:
    // The entry on top, in shared memory.
#if defined(__CUDA_ARCH__)
    __device__ unsigned top() const { return shared_ + unsigned(size_ * shared_stack_threads) * 8u; }
    __device__ void store_shared(NodeGroup group) const {
        asm volatile("st.shared.v2.u32 [%0], {%1, %2};" ::"r"(top()), "r"(group.first), "r"(group.bits) : "memory");
    }
    __device__ NodeGroup load_shared() const {
        NodeGroup group;
        asm volatile("ld.shared.v2.u32 {%0, %1}, [%2];" : "=r"(group.first), "=r"(group.bits) : "r"(top()) : "memory");
        return group;
    }

    unsigned shared_;  // address of the thread's first entry
#else
    void store_shared(NodeGroup) const {}  // never called
    NodeGroup load_shared() const { return {}; }
#endif

    NodeGroup* groups_;
    int size_ = 0;
};

// Threads of the warp that are here at once; on the host none ever wait for another.
SVGF_HD inline int count_threads() {
#if defined(__CUDA_ARCH__)
    return __popc(__activemask());
#else
    return 32;
#endif
}

// Gives a hit in the tree of scene/merged_objects.h to the instance that the triangle belongs to. Returns false where
// that has left the tree.
SVGF_HD inline bool name_owner(const SceneView& scene, const LeafTriangle& triangle, Hit& found) {
    if (found.instance != scene.merged_instance) return true;
    found.instance = scene.members[triangle.member];
    found.leaf_triangle = triangle.leaf_triangle;
    return found.instance >= 0;
}

// What a traversal needs only a few times for each ray. The device keeps it in memory and makes triangle_ray anew for
// each triangle, and more rays fit: those that surfaces scatter take 2.17 instead of 2.41 ms in Sponza (H200).
#if defined(__CUDA_ARCH__)
using KeptFloat = volatile float;
using KeptInt = volatile std::int32_t;
#else
using KeptFloat = float;
using KeptInt = std::int32_t;
#endif

class KeptRay {
public:
    SVGF_HD explicit KeptRay(const Ray& ray)
        : origin_{ray.origin.x, ray.origin.y, ray.origin.z},
          direction_{ray.direction.x, ray.direction.y, ray.direction.z} {}

    SVGF_HD Vec3 origin() const { return {origin_[0], origin_[1], origin_[2]}; }
    SVGF_HD Vec3 direction() const { return {direction_[0], direction_[1], direction_[2]}; }

private:
    KeptFloat origin_[3], direction_[3];
};

class KeptHit {
public:
    SVGF_HD void keep(const Hit& hit) {
        t_ = hit.t;
        weight1_ = hit.weight1;
        weight2_ = hit.weight2;
        instance_ = hit.instance;
        triangle_ = hit.triangle;
        leaf_triangle_ = hit.leaf_triangle;
    }
    SVGF_HD Hit found() const { return {t_, weight1_, weight2_, instance_, triangle_, leaf_triangle_}; }
    // Of two hits at the same distance.
    SVGF_HD bool comes_after(const Hit& hit) const {
        return hit.instance < instance_ || (hit.instance == instance_ && hit.triangle < triangle_);
    }

private:
    KeptFloat t_ = infinity, weight1_ = 0, weight2_ = 0;
    KeptInt instance_ = -1, triangle_ = -1, leaf_triangle_ = -1;
};

// For rays that every surface stops.
struct NothingPasses {
    SVGF_HD bool operator()(const TriangleRay&, const LeafTriangle&, const Hit&) const { return false; }
};

// Returns whether there is a hit. With any_hit the first one found ends the search and hit is left as it was; else hit
// becomes the closest one. passes(triangle_ray, triangle, hit) is asked about every hit that would count, in any order,
// and says whether the ray goes on as if it were not there.
#if defined(__AVX2__) && !defined(__CUDACC__)
template <bool any_hit, class Passes>
bool traverse(const SceneView& scene, const Ray& ray, Hit& hit, Passes&& passes);  // trace/traverse_avx2.h
#else
template <bool any_hit, class Passes>
SVGF_HD inline bool traverse(const SceneView& scene, const Ray& ray, Hit& hit, Passes&& passes) {
    constexpr NodeGroup root{0, 1u << 31}, only_leaf{0, 1u};
    StackMemory memory;
    TraversalStack stack(memory);
    int instance_floor = 0;      // stack size at which the current instance is done
    std::int32_t instance = -1;  // -1: in the top level
    const WideNode* nodes = scene.nodes;
    const LeafTriangle* triangles = nullptr;
    BoxRay box_ray(ray.origin, ray.direction);
    Vec3 direction = ray.direction;
    float t_max = ray.t_max;
    NodeGroup group = scene.has_one_leaf ? only_leaf : root, primitives{0, 0};
    // While few threads of a warp test triangles the others wait. So what few have to test is put off, if there are
    // nodes to go on with [Ylitie17, Section 4.4]; bounce rays gain up to a half from it (H200). With those that surfaces
    // scatter it waits even if there are none, until a quarter of the warp has some: in Sponza they take 4.6 instead of
    // 5.1 ms. Camera and shadow rays would lose by it.
    const KeptRay world(ray);
    KeptHit best;
    const bool is_scattered = (ray.kind & (ray_kind::camera | ray_kind::shadow)) == 0;
    for (;;) {
        const int busy_threads = count_threads();
        if (primitives.bits) {
            // They have waited for those of other rays.
        } else if (group.has_nodes()) {
            const int bit = highest_set_bit(group.bits);
            group.bits ^= 1u << bit;
            const std::uint32_t slot = std::uint32_t(bit - WideNode::inner_bit) ^ box_ray.octant;
            const std::uint32_t before = group.bits & ((1u << slot) - 1) & 0xffu;
            const std::uint32_t child = group.first + std::uint32_t(count_set_bits(before));
            if (group.has_nodes()) stack.push(group);
            const WideNode& node = load(nodes + child);
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
                const TopLeaf leaf = scene.top_leaves[i];
                const Instance& placed = load(scene.instances + leaf.instance);
                if ((placed.visibility & ray.kind) == 0) continue;
                if (group.has_nodes()) stack.push(group);
                if (primitives.bits) stack.push(primitives);
                primitives.bits = 0;
                instance_floor = stack.size();
                instance = leaf.instance;
                const MeshView& mesh = scene.meshes[placed.mesh];
                const Vec3 origin = transform_point(placed.world_to_object, world.origin());
                direction = transform_vector(placed.world_to_object, world.direction());
                nodes = mesh.nodes;
                triangles = mesh.triangles;
                box_ray = BoxRay(origin, direction);
                group = {leaf.first, leaf.bits};
                if (!group.has_nodes()) stack.push(group);
                break;
            }
            if (is_scattered ? 4 * count_threads() < busy_threads : group.has_nodes() && count_threads() < 5) {
                primitives.bits |= 1u << (i - primitives.first);
                if (group.has_nodes()) {
                    stack.push(primitives);
                    primitives.bits = 0;
                }
                break;
            }
            const LeafTriangle& triangle = load(triangles + i);
            const TriangleRay triangle_ray(box_ray.origin, direction, box_ray.inverse_direction);
            float t, weight1, weight2;
            if (!intersect_triangle(triangle_ray, triangle, t, weight1, weight2)) continue;
            if (!(t > ray.t_min && t < ray.t_max && t <= t_max)) continue;
            Hit found{t, weight1, weight2, instance, triangle.index, std::int32_t(i)};
            if (!name_owner(scene, triangle, found)) continue;
            if constexpr (!any_hit) {
                if (t == t_max && !best.comes_after(found)) continue;
            }
            if (passes(triangle_ray, triangle, found)) continue;
            if constexpr (any_hit) return true;
            t_max = t;
            best.keep(found);
        }
        if (group.has_nodes() || primitives.bits) continue;
        if (stack.is_empty()) break;
        if (instance >= 0 && stack.size() == instance_floor) {
            instance = -1;
            nodes = scene.nodes;
            box_ray = BoxRay(world.origin(), world.direction());
        }
        group = stack.pop();
    }
    if constexpr (!any_hit)
        if (t_max < ray.t_max) hit = best.found();
    return t_max < ray.t_max;
}
#endif

SVGF_HD inline Hit find_closest_hit(const SceneView& scene, const Ray& ray) {
    Hit hit;
    traverse<false>(scene, ray, hit, NothingPasses{});
    return hit;
}

SVGF_HD inline bool is_occluded(const SceneView& scene, const Ray& ray) {
    Hit unused;
    return traverse<true>(scene, ray, unused, NothingPasses{});
}

}  // namespace svgf

#if defined(__AVX2__) && !defined(__CUDACC__)
#include "trace/traverse_avx2.h"
#endif
