// SPDX-License-Identifier: Apache-2.0
// The scene as the stages see it: plain records and pointers to device memory. "World" is relative to FlatScene.origin.
#pragma once

#include <cstdint>

#include "core/vec.h"
#include "scene/opacity_map.h"
#include "scene/wide_node.h"

namespace svgf {

// A triangle in leaf order, 48 bytes, so that a leaf is read in a row and a hit needs no indirection.
struct alignas(16) LeafTriangle {
    Vec3 vertex0;
    std::int32_t index;  // in the mesh as it was given
    Vec3 vertex1;
    union {
        std::int32_t material_slot;
        std::int32_t member;  // where it is one of scene/merged_objects.h
    };
    Vec3 vertex2;
    std::int32_t leaf_triangle = -1;  // of a member: its number in its own mesh
};
static_assert(sizeof(LeafTriangle) == 48);

struct alignas(16) CornerNormals {  // 48 bytes; all zero: use the face normal
    Vec3 corner[3];
    float unused[3] = {};
};
struct alignas(8) CornerUvs {  // 24 bytes
    Vec2 corner[3];
};
struct alignas(16) CornerTangents {  // 48 bytes; along U, and the side of V: 1 or -1
    Vec4 corner[3];
};
struct TrianglePositions {  // 36 bytes
    Vec3 vertex[3];
};

// One mesh: its tree and, in leaf order, what its triangles carry.
struct MeshView {
    const WideNode* nodes = nullptr;
    const LeafTriangle* triangles = nullptr;
    const CornerNormals* normals = nullptr;                 // null: face normals everywhere
    const CornerUvs* uvs = nullptr;                         // [uv_layers, triangle_count]
    const CornerTangents* tangents = nullptr;               // null: those of the triangles
    const TrianglePositions* previous_positions = nullptr;  // null: as now
    std::int32_t tangent_layer = 0;                         // of UVs, to which tangents belong
    std::int32_t uv_layers = 0;                             // what is beyond reads as (0, 0)
    std::int32_t triangle_count = 0;
    Vec2 box_middle, box_scale;  // middle and inverse widths of its box in X and Y; 0 for no width
};

// Kinds of rays, the bits of svgf.RayVisibility: a ray sees what has its bit.
namespace ray_kind {
constexpr std::uint32_t camera = 1, diffuse = 2, glossy = 4, transmission = 8, shadow = 16, all = 31;
}

// What traversal and shading read of an instance, one cache line.
struct alignas(16) Instance {
    Mat34 world_to_object;
    std::int32_t mesh;
    std::int32_t object_id;
    std::int32_t material_start;
    std::uint32_t visibility : 8;  // bits of ray_kind
    std::uint32_t emitter : 24;    // 1 + index of its Emitter; 0: it does not shine
};
static_assert(sizeof(Instance) == 64);

// A part of an instance: nodes or primitives of its mesh's tree, as a group of trace/intersect.h names them.
struct TopLeaf {
    std::int32_t instance;
    std::uint32_t first, bits;
};

struct Placement {  // 96 bytes, read once per hit
    Mat34 object_to_world, previous_object_to_world;
};

enum class MaterialKind : std::int32_t {
    principled, diffuse, glossy, glass, refraction, translucent, transparent, mix, add
};

SVGF_HD constexpr bool is_mix(MaterialKind kind) { return kind == MaterialKind::mix || kind == MaterialKind::add; }
// Mixes of mixes, one within the other.
constexpr int deepest_mix = 16;
constexpr float smallest_ior = 1e-5f, largest_ior = 1000.0f;

// A row of FlatScene.materials with its whole numbers as such, 192 bytes.
struct alignas(16) Material {
    Vec3 base_color;
    MaterialKind kind;
    float metallic, roughness, ior, transmission;
    float specular_ior_level;
    Vec3 specular_tint;
    Vec3 emission;
    float alpha;
    float diffuse_roughness, anisotropic, anisotropic_rotation, normal_strength;
    float coat_weight, coat_roughness, coat_ior, sheen_weight;
    Vec3 coat_tint;
    float sheen_roughness;
    Vec3 sheen_tint;
    float factor;
    std::int32_t first, second;
    float factor_fresnel_ior, factor_facing_blend;
    Vec3 normal;                   // texel of the normal map
    std::int32_t normal_uv_layer;  // of its tangents; -1: there is none
    std::int32_t map_start, map_count, tangent_uv_layer;
    float multiscatter;  // 1: with energy compensation; 0: without
    Vec3 light_emission;
    std::int32_t alpha_map : 31;  // of material_maps; -1: alpha is a constant
    std::uint32_t coat_normal_mapped : 1;
};
static_assert(sizeof(Material) == 48 * sizeof(float));

// The values of a material that a map can give, by their column in FlatScene.materials.
enum class MaterialInput : std::int32_t {
    base_color = 0,
    metallic = 4,
    roughness = 5,
    ior = 6,
    transmission = 7,
    specular_ior_level = 8,
    specular_tint = 9,
    emission = 12,
    alpha = 15,
    diffuse_roughness = 16,
    anisotropic = 17,
    anisotropic_rotation = 18,
    normal_strength = 19,
    coat_weight = 20,
    coat_roughness = 21,
    coat_ior = 22,
    sheen_weight = 23,
    coat_tint = 24,
    sheen_roughness = 27,
    sheen_tint = 28,
    factor = 31,
    normal = 36,
};

// A row of FlatScene.material_maps with its whole numbers as such, 48 bytes.
struct alignas(16) MaterialMap {
    MaterialInput input;
    std::int32_t texture;
    std::int32_t channel;  // of a scalar; -1: RGB
    std::int32_t uv_layer;
    float uv_transform[6];
    std::int32_t same_texel;  // as the map before this one reads: not 0
    float unused;
};
static_assert(sizeof(MaterialMap) == 12 * sizeof(float));

enum class LightKind : std::int32_t { point, sun, spot, rectangle, ellipse, triangle, environment };

// A row of FlatScene.light_data, of 24 floats, and what belongs to it; 112 bytes.
struct alignas(16) Light {
    Vec3 position;                // triangle: vertex 0
    Vec3 axis_x, axis_y, axis_z;  // triangle: two edges and the unit normal; lamps shine along -axis_z
    Vec3 radiance;                // delta lamps: intensity, a sun's irradiance
    Vec2 size;                    // point, spot: radius; sun: sine and cosine of half its angle; area: widths
    float area;
    float cos_half_spot, spot_scale;  // area lamps: tangent of half the spread, and the scale of its fading
    float is_delta;
    // Suns, the environment: see estimate_irradiance(). Others: where its share of its leaf ends, and that share.
    float ambient, weight;
    float soft_falloff;  // point, spot: 1 for a disk that faces the point it lights, 0 for a sphere
    LightKind kind;
    std::uint32_t visibility;  // bits of ray_kind
    std::int32_t leaf;         // of the light tree; -1: the light is not in it
    std::int32_t emission_map;  // triangle: its EmissionMap, or -1
};
static_assert(sizeof(Light) == 28 * sizeof(float));

// Where the light of a triangle is found: light_of_triangle[table + triangle] counts from first_light, or is -1.
struct Emitter {
    std::int32_t first_light, table;
};

// An image by which the emission of a triangle is multiplied, 32 bytes.
struct alignas(16) EmissionMap {
    Vec2 corner[3];  // texture coordinates
    std::int32_t texture;
    std::int32_t unused;
};

// Node of the light tree, 48 bytes: a bound of where its lights are, where they shine to and how much [Conty18].
struct alignas(16) LightNode {
    Vec3 low, high;     // box around all lights
    Vec3 axis;          // of the cone of all normals
    float cos_normals;  // of the cone's half angle
    float cos_emission;  // of the angle from a normal within which a light shines
    float intensity;    // W / sr; negative: the lights shine on both sides of themselves
};
static_assert(sizeof(LightNode) == 12 * sizeof(float));

enum class Interpolation : std::int32_t { closest, linear, cubic };
enum class Extension : std::int32_t { repeat, extend, clip, mirror };

struct alignas(16) TextureView {
    const std::uint32_t* bytes = nullptr;  // RGBA, red in the lowest byte; null: floats
    const Vec4* floats = nullptr;
    std::int32_t width = 0, height = 0;
    Interpolation interpolation = Interpolation::linear;
    Extension extension = Extension::repeat;
    bool srgb = false;
    bool associated_alpha = false;  // colours are stored times alpha
};

struct LightsView {
    const Light* rows = nullptr;  // suns and the environment first, then lamps, then triangles
    std::int32_t count = 0;
    std::int32_t lamp_count = 0;            // all that are no triangles
    std::uint32_t sized_lamps_seen_by = 0;  // kinds of rays that can run into a lamp
    std::int32_t everywhere_count = 0;      // suns and the environment
    std::int32_t choices = 0;               // lights that may be chosen
    std::int32_t only = -1;                 // the one that is, where there is no other
    // The light tree of those that are somewhere: a complete binary one, the children of node i are 2 i + 1 and
    // 2 i + 2. Null: there are none.
    const LightNode* nodes = nullptr;
    const std::int32_t* light_of_leaf = nullptr;  // the first one; a leaf ends where shares do, at 1
    std::int32_t tree_depth = 0;  // 2^depth leaves
    const Emitter* emitters = nullptr;
    const std::int32_t* light_of_triangle = nullptr;
    const EmissionMap* emission_maps = nullptr;
};

struct WorldView {
    Vec3 radiance;  // times the environment's
    std::uint32_t visibility = ray_kind::all;
    std::int32_t texture = -1;  // the environment image
    Vec3 backdrop_radiance;     // the same two as the camera's rays see them
    std::int32_t backdrop_texture = -1;
    Vec3 to_environment[3];     // rows of a rotation
    // The density of directions that are sampled, constant within each cell of equirectangular maps: [rows + 1] and
    // [rows, columns + 1]. Null: the environment is only found by rays that run into it.
    const float* row_cdf = nullptr;
    const float* column_cdf = nullptr;
    std::int32_t rows = 0, columns = 0;
    std::int32_t light = -1;  // the environment's row of the lights
};

struct SceneView {
    const WideNode* nodes = nullptr;               // top level
    const TopLeaf* top_leaves = nullptr;  // its primitives
    bool has_one_leaf = false;            // rays then start in it
    const Instance* instances = nullptr;
    // The one that stands for scene/merged_objects.h, and of what rays hit there the instances; -1: there is none.
    std::int32_t merged_instance = -1;
    const std::int32_t* members = nullptr;
    const Placement* placements = nullptr;
    const float* terminator_offsets = nullptr;  // of each instance, >= 0, see trace/shadow_terminator.h; null: all 0
    const MeshView* meshes = nullptr;
    // Of each instance that of its triangles, in leaf order; null: no light passes any of them.
    const TriangleOpacity* const* opacity = nullptr;
    const std::uint32_t* opacity_words = nullptr;  // of the parts of cut-outs
    const std::int32_t* material_table = nullptr;
    const Material* materials = nullptr;
    const MaterialMap* material_maps = nullptr;
    const TextureView* textures = nullptr;
    const float* albedo_tables = nullptr;  // of trace/microfacet.h
    // Surfaces neither shine nor are OpacityClass::shaded: what the last ray of a path hits adds nothing.
    bool last_hits_are_dark = false;
    const std::uint8_t* dark_materials = nullptr;  // the same of each material: 1 or 0
    LightsView lights;
    WorldView world;
};

}  // namespace svgf
