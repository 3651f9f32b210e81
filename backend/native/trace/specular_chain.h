// SPDX-License-Identifier: Apache-2.0
// Stage "gbuffer", second part: what is seen in mirrors and through clear glass takes the place of the mirror in the
// G-buffer (primary surface replacement), and the light that it sends by itself is written without noise.
//
// Works on the pixels whose first surface is smooth and not diffuse. From each such surface one direction is followed,
// the mirrored or the refracted one, whichever carries more, at most `longest_chain` (8) times; what it is multiplied
// by is the albedo of the link. The surface where the chain ends is the one that the pixel sees:
//
//   normal          its normal, turned back by all mirrors and bends of the chain into the camera's view
//   depth           planar, of a point on the primary ray as far away as the chain is long
//   depth gradient  by ray differentials through the chain [Igehy99], with the curvature of smooth shading
//   albedos         its own times those of the links; the specular one plus what the links send elsewhere
//   object id       its own and those of all mirrors and bends as one number: their edges stay
//   motion          where it was seen before, by the previous mirrors; see Chain::find_point
//
// Stage "path" takes the same decisions from the same random numbers. Light that a path finds after it followed the
// whole chain is divided into signals at the seen surface; what goes elsewhere at a link is specular. So radiance is
// the same sum as before, and each signal goes with its albedo. Only the light of what the chain meets (emission, lamps
// and the world) is not left to the path, which may choose another lobe: its mean over that choice is written here.
//
// A surface is smooth if its roughness is so small that its lobe is a mirror (microfacet.h), and not diffuse if its
// diffuse albedo is 0. Depth is the way along the chain, not the optical image's: curved mirrors and lenses shrink what
// is behind them, and that is in the depth gradient and the motion. Measured, of moves by 4 and 13 pixels: motion in a
// chrome ball is right to 0.01 pixels, in a glass ball to 5 %; of flat mirrors and panes it is exact.
// A room with a mirror floor, a chrome and a glass ball, a pane and patterned walls (half of the pixels are smooth,
// camera and balls move, 128x72, 1 spp, 14 frames), and the toys (2 % smooth, 160x90, 10 frames); relMSE of all and of
// the smooth pixels, FLIP and flicker:
//
//   room  svgf+  without  0.594 1.165 0.219 0.0514      toys  svgf+  without  0.1081 0.250 0.1471 0.0305
//                with     0.059 0.084 0.219 0.0485                   with     0.1064 0.168 0.1470 0.0305
//   room  svgf   without  0.856 1.676 0.214 0.0517      toys  svgf   without  0.346  0.993 0.1143 0.0314
//                with     0.308 0.572 0.152 0.0481                   with     0.349  0.740 0.1144 0.0317
//
// Cornell, 2 % smooth: relMSE of the smooth pixels 0.0448 -> 0.0393 with svgf+ and 0.0721 -> 0.0574 with svgf; their
// FLIP grows from 0.127 to 0.153 with svgf+ and falls from 0.133 to 0.128 with svgf; all else is the same.
//
// Costs nothing without smooth surfaces. On an H200 at 1920x1080 stage "gbuffer" grows from 0.39 to 0.64 ms in cornell
// and from 1.05 to 1.45 in toys (2 % of the pixels each), and to 4.4 ms where 62 % of the pixels are mirrors and glass
// and all move; stage "path" by 1 to 4 %.
#pragma once

#include "trace/gbuffer.h"
#include "trace/light_paths.h"
#include "trace/lights.h"

namespace svgf {

// Planar depth of the world in a mirror: it is filtered as a surface, unlike the background.
constexpr float mirrored_background_depth = 1e9f;
// Newton's steps towards the previous image point, and how far the last one may still go, in pixels.
constexpr int motion_steps = 5;
constexpr float settled_step = 0.1f;

// A vector's derivatives by the image point's x and y.
struct Derivatives {
    Vec3 x, y;
};

// A triangle's point and edges in the world.
struct Facet {
    Vec3 position, edge1, edge2;

    SVGF_HD Vec3 normal() const { return normalize_any_length(accurate_cross(edge1, edge2)); }
};

SVGF_HD inline Facet find_facet(const SceneView& scene, const Hit& hit, bool previous) {
    const MeshView& mesh = scene.meshes[scene.instances[hit.instance].mesh];
    const Placement& placement = scene.placements[hit.instance];
    const Mat34& to_world = previous ? placement.previous_object_to_world : placement.object_to_world;
    const LeafTriangle& triangle = mesh.triangles[hit.leaf_triangle];
    Vec3 vertex[3] = {triangle.vertex0, triangle.vertex1, triangle.vertex2};
    if (previous && mesh.previous_positions)
        for (int i = 0; i < 3; ++i) vertex[i] = mesh.previous_positions[hit.leaf_triangle].vertex[i];
    return {transform_point(to_world, interpolate(vertex, hit)), transform_vector(to_world, vertex[1] - vertex[0]),
            transform_vector(to_world, vertex[2] - vertex[0])};
}

// One surface of a chain, continued beyond its triangle: a plane whose normal changes at a constant rate.
struct ChainLink {
    Hit hit;
    Vec3 position, plane_normal;
    Vec3 weight1, weight2;  // gradients of the barycentric weights on the plane
    Vec3 normal, change1, change2;  // shading normal at position, on the viewer's side, and its changes by the weights
    float eta = 0;  // of refraction, as in refract(); 0: a mirror

    SVGF_HD void place(const Facet& facet) {
        position = facet.position;
        plane_normal = facet.normal();
        const Vec3 across1 = cross(facet.edge2, plane_normal), across2 = cross(plane_normal, facet.edge1);
        weight1 = across1 / dot(facet.edge1, across1);
        weight2 = across2 / dot(facet.edge2, across2);
    }

    // The same surface where it was at the previous frame. Normals keep their angles with the triangle's edges.
    SVGF_HD void move(const Facet& now, const Facet& before) {
        const Vec3 old_plane_normal = plane_normal;
        Vec3* const normals[3] = {&normal, &change1, &change2};
        Vec3 parts[3];
        for (int i = 0; i < 3; ++i)
            parts[i] = {dot(*normals[i], now.edge1), dot(*normals[i], now.edge2), dot(*normals[i], old_plane_normal)};
        place(before);
        for (int i = 0; i < 3; ++i)
            *normals[i] = weight1 * parts[i].x + weight2 * parts[i].y + plane_normal * parts[i].z;
    }
};

// How a chain looks from an image point.
struct ChainView {
    Vec2 miss, miss_x, miss_y;  // of the seen point, within its plane, or of the world's direction; and derivatives
    float depth;
    Vec2 depth_gradient;
    bool is_valid;  // all surfaces are in front of the ray
};

struct Chain {
    ChainLink links[longest_chain];
    int count = 0;
    bool sees_world = false;
    Vec3 seen_position, seen_normal;  // of the world: the direction, twice

    // Follows the ray of an image point from surface to surface with its derivatives [Igehy99].
    SVGF_HD ChainView view_from(const Camera& camera, Vec2 point) const {
        const Ray ray = camera.ray(point);
        const float scale = 1.0f / length(ray.direction);
        Vec3 origin = ray.origin, direction = ray.direction * scale;
        Derivatives d_origin, d_direction;
        Vec2 d_scale, d_length;
        const Vec3 step_x = camera.step_x(), step_y = camera.step_y();
        if (camera.is_orthographic) {
            d_origin = {step_x, step_y};
        } else {
            d_scale = Vec2{dot(direction, step_x), dot(direction, step_y)} * (-scale * scale);
            d_direction = {step_x * scale + ray.direction * d_scale.x, step_y * scale + ray.direction * d_scale.y};
        }
        float distance = 0;
        bool is_valid = true;
        // To the plane through `position`.
        const auto transfer = [&](Vec3 position, Vec3 normal) {
            const float slope = 1.0f / dot(normal, direction);
            const float t = dot(normal, position - origin) * slope;
            const Vec3 dx = d_origin.x + d_direction.x * t, dy = d_origin.y + d_direction.y * t;
            const float dt_x = -dot(normal, dx) * slope, dt_y = -dot(normal, dy) * slope;
            d_origin = {dx + direction * dt_x, dy + direction * dt_y};
            origin += direction * t;
            distance += t;
            d_length.x += dt_x;
            d_length.y += dt_y;
            is_valid = is_valid && t > 0.0f;
        };
        for (int i = 0; i < count; ++i) {
            const ChainLink& link = links[i];
            transfer(link.position, link.plane_normal);
            const Vec3 offset = origin - link.position;
            const Vec3 sum = link.normal + link.change1 * dot(link.weight1, offset) +
                             link.change2 * dot(link.weight2, offset);
            const float size = 1.0f / length(sum);
            const Vec3 normal = sum * size;
            const auto turn = [&](Vec3 d_position) {
                const Vec3 change =
                    link.change1 * dot(link.weight1, d_position) + link.change2 * dot(link.weight2, d_position);
                return (change - normal * dot(normal, change)) * size;
            };
            const Vec3 turn_x = turn(d_origin.x), turn_y = turn(d_origin.y);
            bend(direction, d_direction, normal, turn_x, turn_y, link.eta);
        }
        ChainView view;
        const Frame frame(seen_normal);
        if (sees_world) {
            view.miss = {dot(frame.x, direction), dot(frame.y, direction)};
            view.miss_x = {dot(frame.x, d_direction.x), dot(frame.y, d_direction.x)};
            view.miss_y = {dot(frame.x, d_direction.y), dot(frame.y, d_direction.y)};
            view.depth = mirrored_background_depth;
        } else {
            transfer(seen_position, seen_normal);
            const Vec3 miss = origin - seen_position;
            view.miss = {dot(frame.x, miss), dot(frame.y, miss)};
            view.miss_x = {dot(frame.x, d_origin.x), dot(frame.y, d_origin.x)};
            view.miss_y = {dot(frame.x, d_origin.y), dot(frame.y, d_origin.y)};
            view.depth = distance * scale;
            view.depth_gradient = d_length * scale + d_scale * distance;
        }
        view.is_valid = is_valid;
        return view;
    }

    // The image point from which the seen point is seen, by Newton's steps from `point`: the chain's surfaces are
    // continued as ChainLink says, so of flat mirrors and panes it is exact and of curved ones good to the second order
    // [Zimmer15 follows previous paths on the surfaces themselves]. Returns false where the steps do not settle.
    SVGF_HD bool find_point(const Camera& camera, Vec2& point, float& depth) const {
        float step = infinity;
        for (int i = 0; i < motion_steps && step > 0.01f * settled_step; ++i) {
            const ChainView view = view_from(camera, point);
            const float determinant = view.miss_x.x * view.miss_y.y - view.miss_y.x * view.miss_x.y;
            const Vec2 move{(view.miss_y.x * view.miss.y - view.miss_y.y * view.miss.x) / determinant,
                            (view.miss_x.y * view.miss.x - view.miss_x.x * view.miss.y) / determinant};
            step = max(std::fabs(move.x), std::fabs(move.y));
            if (!is_finite(step)) return false;
            point = point + move;
        }
        const ChainView view = view_from(camera, point);
        depth = view.depth;
        return step < settled_step && view.is_valid && is_finite(depth);
    }

private:
    SVGF_HD static void bend(Vec3& direction, Derivatives& d, Vec3 normal, Vec3 turn_x, Vec3 turn_y, float eta) {
        const float cosine = -dot(direction, normal);
        const float d_cosine_x = -(dot(d.x, normal) + dot(direction, turn_x));
        const float d_cosine_y = -(dot(d.y, normal) + dot(direction, turn_y));
        if (eta == 0.0f) {
            d = {d.x + (normal * d_cosine_x + turn_x * cosine) * 2.0f,
                 d.y + (normal * d_cosine_y + turn_y * cosine) * 2.0f};
            direction = direction + normal * (2.0f * cosine);
            return;
        }
        const float inverse = 1.0f / eta;
        const float inside = std::sqrt(max(1.0f - (1.0f - cosine * cosine) * inverse * inverse, 1e-8f));
        const float along = cosine * inverse - inside;
        // The derivative of `along` by the cosine.
        const float rate = inverse - cosine * inverse * inverse / inside;
        d = {d.x * inverse + normal * (rate * d_cosine_x) + turn_x * along,
             d.y * inverse + normal * (rate * d_cosine_y) + turn_y * along};
        direction = normalize(direction * inverse + normal * along);
    }
};

// The linear map of the view behind mirrors and bends to the camera's, by rows.
struct Unfolding {
    Vec3 row[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};

    SVGF_HD Vec3 operator()(Vec3 v) const { return {dot(row[0], v), dot(row[1], v), dot(row[2], v)}; }

    SVGF_HD void mirror(Vec3 normal) {
        for (Vec3& r : row) r = r - normal * (2.0f * dot(r, normal));
    }
    // A ray changes its direction: by the shortest rotation.
    SVGF_HD void turn(Vec3 before, Vec3 after) {
        const Vec3 axis = cross(before, after);
        const float scale = 1.0f / (1.0f + dot(before, after));
        for (Vec3& r : row) {
            const Vec3 side = cross(axis, r);
            r = r + side + cross(axis, side) * scale;
        }
    }
};

// One positive id for two.
SVGF_HD inline std::int32_t combined_id(std::int32_t first, std::int32_t second) {
    return std::int32_t(mix_bits(std::uint32_t(first) * 0x9e3779b9u + std::uint32_t(second)) >> 1 | 1u);
}

template <Effects kernel>
struct SpecularChainStage {
    static constexpr LaunchShape launch_shape{32, 4};

    GbufferStage<kernel> gbuffer;
    const std::int32_t* in_pixels;

    SVGF_HD void operator()(int i) const {
        const int pixel = in_pixels[i];
        const SceneView& scene = gbuffer.scene;
        const Camera& camera = gbuffer.camera;
        const int x = pixel % camera.width, y = pixel / camera.width;
        const Sampler sampler(pixel, gbuffer.seed, gbuffer.sample);
        const Vec2 point = pixel_point(x, y, sampler, gbuffer.box_filter);
        const Ray primary = primary_ray<kernel>(camera, point, sampler);

        Chain chain;
        Unfolding unfolding;
        Ray ray = primary;
        Hit hit = load(gbuffer.in_hit + pixel);
        Vec3 throughput{1, 1, 1}, elsewhere, light, first_normal;
        int reflections = 0, refractions = 0, allowed = max(gbuffer.limits.transparent_bounces, 1);
        std::int32_t object_id = 0;
        float distance = 0;
        bool moves = gbuffer.camera_moves;
        for (int vertex = 0;; ++vertex) {
            allowed -= hit.passed;
            if (chain.count > 0) add_lamps(ray, hit, throughput, chain.count, light);
            if (!hit.found()) break;
            const Vec3 view = -ray.direction;
            const Surface surface = find_surface<kernel>(scene, hit, view, surface_choice<kernel>(sampler, vertex, hit));
            if (chain.count > 0) add(light, throughput * surface.emission, chain.count);
            const bool ends = allowed <= 0;
            if constexpr (covers(kernel, Effects::alpha))
                if (max_component(surface.straight) > 0.0f && !ends) {
                    throughput *= surface.straight;
                    ray.t_min = hit.t;
                    hit = find_path_hit_apart<kernel>(scene, ray, sampler, vertex + 1, --allowed);
                    continue;
                }
            const Bsdf<kernel> bsdf(scene, surface, view);
            const SmoothBounce bounce = bsdf.find_smooth_bounce();
            distance += hit.t;
            moves = moves || is_moving(scene, hit);
            const std::int32_t id = scene.instances[hit.instance].object_id;
            object_id = chain.count > 0 ? combined_id(object_id, id) : id;
            if (ends || !may_follow(gbuffer.limits, bounce.event, chain.count, reflections, refractions)) {
                chain.seen_position = surface.position;
                chain.seen_normal = bsdf.geometric_normal;
                write_surface(pixel, chain, point, hit, moves, distance * planar(primary), object_id,
                              unfolding(bsdf.normal), surface.material.roughness, throughput * bsdf.diffuse_albedo,
                              throughput * bsdf.specular_albedo + elsewhere, light);
                return;
            }
            if (chain.count == 0) first_normal = bsdf.normal;
            add_link(chain, hit, bsdf.normal, bounce.eta);
            elsewhere += throughput * bounce.elsewhere;
            throughput *= bounce.weight;
            const bool mirrors = bounce.event == BsdfEvent::glossy;
            ++(mirrors ? reflections : refractions);
            if (mirrors)
                unfolding.mirror(bsdf.normal);
            else
                unfolding.turn(ray.direction, bounce.direction);
            ray = {offset_from_surface(surface, bounce.direction), bounce.direction, 0.0f, infinity,
                   mirrors ? ray_kind::glossy : ray_kind::transmission};
            hit = find_path_hit_apart<kernel>(scene, ray, sampler, vertex + 1, allowed);
        }
        if (scene.world.visibility & ray.kind)
            add(light, throughput * environment_radiance_of(ray.direction), chain.count);
        chain.sees_world = true;
        chain.seen_position = chain.seen_normal = ray.direction;
        write_surface(pixel, chain, point, {}, moves, mirrored_background_depth, combined_id(object_id, 0),
                      first_normal, 0.0f, {}, elsewhere, light);
    }

private:
    // Planar depth per length of the ray.
    SVGF_HD float planar(const Ray& ray) const { return -gbuffer.camera.to_camera(ray.direction).z; }

    SVGF_HD Vec3 environment_radiance_of(Vec3 direction) const {
        if constexpr (covers(kernel, Effects::environment_map)) return environment_radiance(gbuffer.scene, direction);
        return gbuffer.scene.world.radiance;
    }

    SVGF_HD void add(Vec3& light, Vec3 value, int bounces) const {
        if (!is_finite(value)) return;
        if constexpr (covers(kernel, Effects::light_path_limits)) value = gbuffer.limits.clamped(value, bounces);
        light += value;
    }

    // As the path does: lamps stop no ray.
    SVGF_HD void add_lamps(const Ray& ray, const Hit& hit, Vec3 throughput, int bounces, Vec3& light) const {
        const LightsView& lights = gbuffer.scene.lights;
        if (!(lights.sized_lamps_seen_by & ray.kind)) return;
        for (int i = 0; i < lights.lamp_count; ++i) {
            const Light& lamp = lights.rows[i];
            Vec3 radiance;
            float pdf;
            if ((lamp.visibility & ray.kind) &&
                cross_lamp(lamp, ray.origin, ray.direction, ray.t_min, hit.t, radiance, pdf))
                add(light, throughput * radiance, bounces);
        }
    }

    SVGF_HD void add_link(Chain& chain, const Hit& hit, Vec3 normal, float eta) const {
        const SceneView& scene = gbuffer.scene;
        ChainLink& link = chain.links[chain.count++];
        link.hit = hit;
        link.normal = normal;
        link.eta = eta;
        link.place(find_facet(scene, hit, false));
        const Instance& instance = scene.instances[hit.instance];
        const MeshView& mesh = scene.meshes[instance.mesh];
        if (!mesh.normals) return;
        const Vec3(&corner)[3] = mesh.normals[hit.leaf_triangle].corner;
        const Vec3 sum = transform_normal(instance.world_to_object, interpolate(corner, hit));
        const float size = length(sum);
        if (!(size > 0.0f)) return;
        const float scale = (dot(sum, normal) < 0.0f ? -1.0f : 1.0f) / size;
        link.change1 = transform_normal(instance.world_to_object, corner[1] - corner[0]) * scale;
        link.change2 = transform_normal(instance.world_to_object, corner[2] - corner[0]) * scale;
    }

    // seen: the hit of the seen surface, if it is not the world.
    SVGF_HD void write_surface(int pixel, Chain& chain, Vec2 point, const Hit& seen, bool moves, float depth,
                               std::int32_t object_id, Vec3 normal, float roughness, Vec3 diffuse_albedo,
                               Vec3 specular_albedo, Vec3 light) const {
        const Vec2 gradient = chain.view_from(gbuffer.camera, point).depth_gradient;
        Vec3 motion;
        if (gbuffer.out_motion && moves) motion = find_motion(chain, point, seen);
        gbuffer.write(pixel, normal, depth, bounded(gradient), object_id, roughness, diffuse_albedo, specular_albedo,
                      motion);
        gbuffer.out_chain_light[pixel] = light;
    }

    // Moves the chain to the previous frame.
    SVGF_HD Vec3 find_motion(Chain& chain, Vec2 point, const Hit& seen) const {
        const SceneView& scene = gbuffer.scene;
        ImagePoint now{point, 0}, before;
        bool settled = true;
        // Through the middle of the lens the point is seen elsewhere.
        if (gbuffer.camera.aperture.radius > 0.0f)
            settled = chain.find_point(gbuffer.camera, now.point, now.depth);
        else
            now.depth = chain.view_from(gbuffer.camera, point).depth;
        for (int i = 0; i < chain.count; ++i)
            if (is_moving(scene, chain.links[i].hit))
                chain.links[i].move(find_facet(scene, chain.links[i].hit, false),
                                    find_facet(scene, chain.links[i].hit, true));
        if (seen.found() && is_moving(scene, seen)) {
            const Facet facet = find_facet(scene, seen, true);
            chain.seen_position = facet.position;
            chain.seen_normal = facet.normal();
        }
        before.point = now.point;
        settled = chain.find_point(gbuffer.previous_camera, before.point, before.depth) && settled;
        return settled ? motion_between(now, before) : Vec3{no_motion, no_motion, 0.0f};
    }
};

}  // namespace svgf
