# SPDX-License-Identifier: Apache-2.0
"""Stage "gbuffer", second part: what is seen in mirrors and through clear glass takes the place of the mirror in the
G-buffer (primary surface replacement), and the light that it sends by itself is found without noise.

From each surface that is smooth and not diffuse one direction is followed, the mirrored or the refracted one, whichever
carries more. The surface where that chain ends is the one that the pixel sees. Its depth is that of a point on the
primary ray as far away as the chain is long; gradients are ray differentials through the chain [Igehy99]. The previous
image point is found by Newton's steps on the chain's surfaces, each continued as a plane whose normal changes at a
constant rate.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from ..light_paths import LightPaths
from ..scene import RayVisibility
from .bsdf import TRANSMISSION
from .bsdf_sample import find_smooth_bounce
from .camera import Camera
from .gbuffer import LARGEST_GRADIENT, NO_MOTION, PrimaryRays, may_follow
from .intersect import Hits, offset_origin
from .opacity import find_path_hits, surface_choice
from .sampling import frame, mix
from .surface import SceneView, Shapes, surface_at
from .vec import dot, normalize, transform_point

# Planar depth of the world in a mirror: it is filtered as a surface, unlike the background.
MIRRORED_BACKGROUND_DEPTH = 1e9
# Newton's steps, and how far the last one may still go, in pixels.
MOTION_STEPS = 5
SETTLED_STEP = 0.1


def combined_id(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """One positive id for two, [n]."""
    both = first.astype(np.uint32) * np.uint32(0x9E3779B9) + second.astype(np.uint32)
    return (mix(both) >> np.uint32(1) | np.uint32(1)).astype(np.int64)


@dataclass
class Links:
    """The chains' surfaces of one number, a row per pixel. position, plane_normal, normal (shading, on the viewer's
    side): [n, 3]. weight: [n, 2, 3], gradients of two barycentric weights; change: [n, 2, 3], of the normal by them.
    eta: [n], of refraction, 0 for a mirror."""

    position: np.ndarray
    plane_normal: np.ndarray
    weight: np.ndarray
    normal: np.ndarray
    change: np.ndarray
    eta: np.ndarray

    def rows(self, chosen: np.ndarray) -> Links:
        return Links(**{item.name: getattr(self, item.name)[chosen] for item in fields(self)})


@dataclass
class Chains:
    """links: of each number the chains' rows; count: [n], how many of them each has. seen_position, seen_normal:
    [n, 3], where they end; of the world, its direction. sees_world: bool [n]."""

    count: np.ndarray
    seen_position: np.ndarray
    seen_normal: np.ndarray
    sees_world: np.ndarray
    links: list[Links] = field(default_factory=list)


@dataclass
class View:
    """How chains look from image points. miss: [n, 2], of the seen point within its plane, or of the world's direction;
    miss_change: [n, 2 (x, y), 2]. depth: [n]; depth_gradient: [n, 2]. valid: bool [n], all surfaces lie ahead."""

    miss: np.ndarray
    miss_change: np.ndarray
    depth: np.ndarray
    depth_gradient: np.ndarray
    valid: np.ndarray


def view_from(chains: Chains, camera: Camera, point: np.ndarray) -> View:
    """Follows the rays of image points [n, 2] from surface to surface, with their derivatives."""
    left, right, bottom, top = camera.window
    steps = camera.to_world[:, :2].T * np.array([[(right - left) / camera.width], [(bottom - top) / camera.height]])
    count = len(point)
    origin, planar = camera.rays(point)
    scale = 1.0 / np.sqrt(dot(planar, planar))
    direction = planar * scale[:, None]
    d_origin, d_direction = np.zeros((count, 2, 3)), np.zeros((count, 2, 3))
    d_scale = np.zeros((count, 2))
    if camera.is_orthographic:
        d_origin += steps
    else:
        d_scale = -(direction @ steps.T) * scale[:, None] ** 2
        d_direction = steps * scale[:, None, None] + planar[:, None] * d_scale[..., None]
    distance, d_distance, valid = np.zeros(count), np.zeros((count, 2)), np.ones(count, dtype=bool)

    def transfer(rows: np.ndarray, position: np.ndarray, normal: np.ndarray) -> None:
        slope = 1.0 / dot(normal, direction[rows])
        t = dot(normal, position - origin[rows]) * slope
        moved = d_origin[rows] + d_direction[rows] * t[:, None, None]
        d_t = -dot(moved, normal[:, None]) * slope[:, None]
        d_origin[rows] = moved + direction[rows, None] * d_t[..., None]
        origin[rows] += direction[rows] * t[:, None]
        distance[rows] += t
        d_distance[rows] += d_t
        valid[rows] &= t > 0.0

    for number, link in enumerate(chains.links):
        rows = np.flatnonzero(chains.count > number)
        link = link.rows(rows)
        transfer(rows, link.position, link.plane_normal)
        offset = origin[rows] - link.position
        total = link.normal + np.einsum("nw,nwi->ni", np.einsum("nwi,ni->nw", link.weight, offset), link.change)
        size = np.sqrt(dot(total, total))
        normal = total / size[:, None]
        change = np.einsum("nwi,nxi,nwj->nxj", link.weight, d_origin[rows], link.change)
        turn = (change - normal[:, None] * dot(change, normal[:, None])[..., None]) / size[:, None, None]
        direction[rows], d_direction[rows] = _bend(direction[rows], d_direction[rows], normal, turn, link.eta)

    depth, gradient = np.full(count, MIRRORED_BACKGROUND_DEPTH), np.zeros((count, 2))
    rows = np.flatnonzero(~chains.sees_world)
    transfer(rows, chains.seen_position[rows], chains.seen_normal[rows])
    depth[rows] = (distance * scale)[rows]
    gradient[rows] = (d_distance * scale[:, None] + d_scale * distance[:, None])[rows]
    axes = np.stack(frame(chains.seen_normal), axis=1)
    world = chains.sees_world[:, None]
    miss = np.einsum("nai,ni->na", axes, np.where(world, direction, origin - chains.seen_position))
    miss_change = np.einsum("nai,nxi->nxa", axes, np.where(world[..., None], d_direction, d_origin))
    return View(miss, miss_change, depth, gradient, valid)


def _bend(direction, d_direction, normal, turn, eta) -> tuple[np.ndarray, np.ndarray]:
    """Directions [n, 3] after mirrors and refractions, and their derivatives [n, 2, 3]. turn: [n, 2, 3], of normals."""
    cosine = -dot(direction, normal)
    d_cosine = -(dot(d_direction, normal[:, None]) + dot(turn, direction[:, None]))
    mirrors = eta == 0.0
    inverse = np.where(mirrors, 1.0, 1.0 / np.where(mirrors, 1.0, eta))
    inside = np.sqrt(np.maximum(1.0 - (1.0 - cosine**2) * inverse**2, 1e-8))
    along = np.where(mirrors, 2.0 * cosine, cosine * inverse - inside)
    rate = np.where(mirrors, 2.0, inverse - cosine * inverse**2 / inside)
    turned = (
        d_direction * inverse[:, None, None]
        + normal[:, None] * (rate[:, None] * d_cosine)[..., None]
        + turn * along[:, None, None]
    )
    return normalize(direction * inverse[:, None] + normal * along[:, None]), turned


def find_points(chains: Chains, camera: Camera, point: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Image points [n, 2] from which chains see what they see, by Newton's steps from `point`; planar depths [n]; and
    whether the steps settled."""
    point, step = point.copy(), np.full(len(point), np.inf)
    with np.errstate(all="ignore"):
        for _ in range(MOTION_STEPS):
            going = step > 0.01 * SETTLED_STEP
            view = view_from(chains, camera, point)
            (xx, xy), (yx, yy) = view.miss_change[:, 0].T, view.miss_change[:, 1].T
            u, v = view.miss.T
            move = np.stack([yx * v - yy * u, xy * u - xx * v], axis=1) / (xx * yy - yx * xy)[:, None]
            point[going] += move[going]
            step = np.where(going, np.abs(move).max(axis=1), step)
            step[np.isnan(step)] = np.inf
        view = view_from(chains, camera, point)
        return point, view.depth, (step < SETTLED_STEP) & view.valid & np.isfinite(view.depth)


@dataclass
class Facets:
    """Triangles in the world: points [n, 3] and two edges [n, 2, 3]."""

    position: np.ndarray
    edges: np.ndarray

    @property
    def normal(self) -> np.ndarray:
        return normalize(np.cross(self.edges[:, 0], self.edges[:, 1]))


def find_facets(shapes: Shapes, hits: Hits, previous: bool) -> Facets:
    corners = (shapes.previous_corners if previous else shapes.corners)[hits.triangle]
    to_world = (shapes.previous_object_to_world if previous else shapes.object_to_world)[hits.instance]
    edges = corners[:, 1:] - corners[:, :1]
    return Facets(
        transform_point(to_world, np.einsum("nc,nci->ni", hits.weights, corners)),
        np.einsum("nij,nej->nei", to_world[..., :3], edges),
    )


def _weight_gradients(facets: Facets) -> np.ndarray:
    """[n, 2, 3]: of the weights of the second and third corner, within the plane."""
    first, second, normal = facets.edges[:, 0], facets.edges[:, 1], facets.normal
    across = np.stack([np.cross(second, normal), np.cross(normal, first)], axis=1)
    return across / dot(facets.edges, across)[..., None]


def make_links(shapes: Shapes, hits: Hits, normal: np.ndarray, eta: np.ndarray) -> Links:
    """normal: [n, 3], shading, on the viewer's side."""
    facets = find_facets(shapes, hits, previous=False)
    inverse = shapes.world_to_object[hits.instance]
    corners = np.einsum("nji,ncj->nci", inverse[..., :3], shapes.normals[hits.triangle])
    total = np.einsum("nc,nci->ni", hits.weights, corners)
    size = np.sqrt(dot(total, total))
    with np.errstate(divide="ignore", invalid="ignore"):
        change = (corners[:, 1:] - corners[:, :1]) * (np.sign(dot(total, normal)) / size)[:, None, None]
    change = np.where((size > 0.0)[:, None, None], change, 0.0)
    return Links(facets.position, facets.normal, _weight_gradients(facets), normal, change, eta)


def move_links(links: Links, now: Facets, before: Facets) -> Links:
    """The same surfaces at the previous frame. Normals keep their angles with the triangles' edges."""
    weight, plane_normal = _weight_gradients(before), before.normal

    def turned(normals: np.ndarray) -> np.ndarray:
        within = np.einsum("ni,nei,nej->nj", normals, now.edges, weight)
        return within + plane_normal * dot(normals, now.normal)[:, None]

    change = np.stack([turned(links.change[:, 0]), turned(links.change[:, 1])], axis=1)
    return Links(before.position, plane_normal, weight, turned(links.normal), change, links.eta)


def _same_place(now: Facets, before: Facets) -> np.ndarray:
    return (now.position == before.position).all(axis=1) & (now.edges == before.edges).all(axis=(1, 2))


def replace_smooth_surfaces(
    scene: SceneView,
    camera: Camera,
    previous_camera: Camera,
    rays: PrimaryRays,
    hits: Hits,
    passed: np.ndarray,
    bounces: int,
    limits: LightPaths,
    images: dict[str, np.ndarray],
) -> np.ndarray:
    """Writes what mirrors and glass show over the images of trace_gbuffer, and keeps what the camera's rays hit
    themselves as "first_normal", "first_depth", "first_object_id" and "first_motion". hits, passed: see
    find_path_hits. Returns the light [n, 3] that the surfaces after the first ones send along the chains by
    themselves."""
    for name in ("normal", "depth", "object_id", "motion"):
        images[f"first_{name}"] = images[name].copy()
    walk = _Walk(scene, rays, hits, passed, bounces, limits)
    vertex = 0
    while walk.advance(vertex):
        vertex += 1
    rows = np.flatnonzero(walk.chains.count > 0)
    for name, values in walk.images.items():
        images[name][rows] = values[rows]
    planar = -camera.to_camera(rays.direction)[:, 2]
    world = walk.chains.sees_world
    images["depth"][rows] = np.where(world, MIRRORED_BACKGROUND_DEPTH, walk.distance * planar)[rows]
    chains = walk.chains_of(rows)
    gradient = view_from(chains, camera, rays.point[rows]).depth_gradient
    images["depth_gradient"][rows] = np.clip(np.nan_to_num(gradient, nan=0.0), -LARGEST_GRADIENT, LARGEST_GRADIENT)
    images["motion"][rows] = _find_motion(scene.shapes, walk, rows, camera, previous_camera, rays.point[rows])
    return walk.light


class _Walk:
    """All chains, one surface further at a time."""

    def __init__(
        self, scene: SceneView, rays: PrimaryRays, hits: Hits, passed: np.ndarray, bounces: int, limits: LightPaths
    ) -> None:
        count = len(rays.point)
        self._scene, self._rays, self._bounces, self._limits = scene, rays, bounces, limits
        self._rows = np.arange(count)  # the rays' pixels, and below what belongs to them
        self._origin, self._direction, self._near, self._far = rays.origin, rays.direction, np.zeros(count), rays.far
        self._kind = np.full(count, int(RayVisibility.CAMERA))
        self._hits = hits
        self._throughput, self._elsewhere = np.ones((count, 3)), np.zeros((count, 3))
        self._reflections, self._refractions = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        self._allowed = max(limits.transparent_bounces, 1) - passed
        self._unfolding = np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
        self.light, self.distance = np.zeros((count, 3)), np.zeros(count)
        self.chains = Chains(
            np.zeros(count, dtype=int), np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count, dtype=bool)
        )
        self.link_hits: list[Hits] = []
        nowhere = np.zeros(count, dtype=int)
        self.seen_hits = Hits(np.full(count, np.inf), nowhere, nowhere.copy(), np.zeros((count, 3)))
        self.images = {
            "normal": np.zeros((count, 3)),
            "object_id": np.zeros(count, dtype=np.int64),
            "roughness": np.zeros(count),
            "diffuse_albedo": np.zeros((count, 3)),
            "specular_albedo": np.zeros((count, 3)),
        }

    def advance(self, vertex: int) -> bool:
        """Whether there is anything left to do."""
        scene, rows, hits = self._scene, self._rows, self._hits
        self._add_lamps()
        self._end_in_world(np.flatnonzero(~hits.found))
        found = np.flatnonzero(hits.found)
        if not len(found):
            return False
        view, rows = -self._direction[found], rows[found]
        keys, sample_number = self._rays.keys, self._rays.sample_number
        choice = surface_choice(scene, keys[rows], sample_number, vertex, hits.rows(found))
        surface = surface_at(scene, hits, found, view, choice)
        on_chain = self.chains.count[rows] > 0
        self._add(rows[on_chain], (self._throughput[rows] * surface.emission)[on_chain])

        ends = self._allowed[rows] <= 0
        straight = (surface.straight.max(axis=1, initial=0.0) > 0.0) & ~ends
        self._throughput[rows[straight]] *= surface.straight[straight]
        self._allowed[rows[straight]] -= 1

        t = hits.t[found]
        bsdf = surface.bsdf(view)
        bounce = find_smooth_bounce(bsdf)
        self.distance[rows[~straight]] += t[~straight]
        id_so_far = self.images["object_id"][rows]
        ids = np.where(on_chain, combined_id(id_so_far, surface.object_id), surface.object_id)
        self.images["object_id"][rows] = np.where(straight, id_so_far, ids)
        goes_on = may_follow(
            bounce.event, self._bounces, self._limits, self._reflections[rows], self._refractions[rows]
        )
        goes_on &= ~ends & ~straight
        self._end_at(found, rows, ~goes_on & ~straight, surface, bsdf)
        self._add_links(found, rows, goes_on, bsdf, bounce, view)

        ahead = straight | goes_on
        origin = offset_origin(surface.position, surface.magnitude, bsdf.geometric_normal, bounce.direction)
        old = found[ahead]
        bends = goes_on[ahead]
        kind = np.where(bounce.event == TRANSMISSION, int(RayVisibility.TRANSMISSION), int(RayVisibility.GLOSSY))
        self._origin = np.where(bends[:, None], origin[ahead], self._origin[old])
        self._direction = np.where(bends[:, None], bounce.direction[ahead], self._direction[old])
        self._near = np.where(bends, 0.0, t[ahead])
        self._far = np.where(bends, np.inf, self._far[old])
        self._kind = np.where(bends, kind[ahead], self._kind[old])
        self._rows = rows[ahead]
        if not len(self._rows):
            return False
        self._hits, passed = find_path_hits(
            scene, keys[self._rows], sample_number, vertex + 1, self._origin, self._direction, self._near, self._far,
            self._kind, self._allowed[self._rows],
        )  # fmt: skip
        self._allowed[self._rows] -= passed
        return True

    def chains_of(self, rows: np.ndarray) -> Chains:
        chains = self.chains
        return Chains(
            chains.count[rows],
            chains.seen_position[rows],
            chains.seen_normal[rows],
            chains.sees_world[rows],
            [link.rows(rows) for link in chains.links],
        )

    def _add(self, rows: np.ndarray, value: np.ndarray) -> None:
        value = np.where(np.isfinite(value), value, 0.0)
        limit = 3.0 * np.where(self.chains.count[rows] > 1, self._limits.clamp_indirect, self._limits.clamp_direct)
        with np.errstate(divide="ignore", invalid="ignore"):
            kept = np.where(limit > 0.0, np.fmin(1.0, limit / value.sum(axis=1)), 1.0)
        self.light[rows] += value * kept[:, None]

    def _add_lamps(self) -> None:
        lights = self._scene.lights
        for light, seen, radiance, _ in lights.crossed_lamps(self._origin, self._direction, self._hits.t, self._near):
            rows = self._rows[seen]
            counts = (self._kind[seen] & lights.visibility[light] != 0) & (self.chains.count[rows] > 0)
            self._add(rows[counts], (self._throughput[rows] * radiance)[counts])

    def _end_in_world(self, missed: np.ndarray) -> None:
        missed = missed[self.chains.count[self._rows[missed]] > 0]
        rows, direction, world = self._rows[missed], self._direction[missed], self._scene.world
        visible = self._kind[missed] & world.visibility != 0
        self._add(rows[visible], self._throughput[rows[visible]] * world.radiance(direction[visible]))
        self.chains.sees_world[rows] = True
        self.chains.seen_position[rows] = self.chains.seen_normal[rows] = direction
        self.images["object_id"][rows] = combined_id(self.images["object_id"][rows], np.zeros(len(rows)))
        self.images["normal"][rows] = self.chains.links[0].normal[rows] if len(rows) else 0.0
        self.images["specular_albedo"][rows] = self._elsewhere[rows]

    def _end_at(self, found: np.ndarray, rows: np.ndarray, chosen: np.ndarray, surface, bsdf) -> None:
        rows_of, throughput = rows[chosen], self._throughput[rows[chosen]]
        self.chains.seen_position[rows_of] = surface.position[chosen]
        self.chains.seen_normal[rows_of] = bsdf.geometric_normal[chosen]
        for item in fields(Hits):
            getattr(self.seen_hits, item.name)[rows_of] = getattr(self._hits, item.name)[found[chosen]]
        images = self.images
        images["normal"][rows_of] = np.einsum("nij,nj->ni", self._unfolding[rows_of], bsdf.normal[chosen])
        images["roughness"][rows_of] = bsdf.roughness[chosen]
        images["diffuse_albedo"][rows_of] = throughput * bsdf.diffuse_albedo[chosen]
        images["specular_albedo"][rows_of] = throughput * bsdf.specular_albedo[chosen] + self._elsewhere[rows_of]

    def _add_links(self, found, rows, chosen, bsdf, bounce, view) -> None:
        if not chosen.any():
            return
        at, eta = rows[chosen], np.where(bounce.event == TRANSMISSION, bounce.eta, 0.0)[chosen]
        hits = Hits(**{item.name: getattr(self._hits, item.name)[found[chosen]] for item in fields(Hits)})
        new = make_links(self._scene.shapes, hits, bsdf.normal[chosen], eta)
        count, total = self.chains.count, len(self.light)
        for number in np.unique(count[at]):
            here = count[at] == number
            if number == len(self.chains.links):
                self.chains.links.append(
                    Links(
                        **{item.name: np.zeros((total, *getattr(new, item.name).shape[1:])) for item in fields(Links)}
                    )
                )
                self.link_hits.append(
                    Hits(
                        **{
                            item.name: np.zeros(
                                (total, *getattr(hits, item.name).shape[1:]), getattr(hits, item.name).dtype
                            )
                            for item in fields(Hits)
                        }
                    )  # fmt: skip
                )
            for item in fields(Links):
                getattr(self.chains.links[number], item.name)[at[here]] = getattr(new, item.name)[here]
            for item in fields(Hits):
                getattr(self.link_hits[number], item.name)[at[here]] = getattr(hits, item.name)[here]
        count[at] += 1
        self._elsewhere[at] += self._throughput[at] * bounce.elsewhere[chosen]
        self._throughput[at] *= bounce.weight[chosen]
        refracts = eta != 0.0
        self._refractions[at] += refracts
        self._reflections[at] += ~refracts
        n = bsdf.normal[chosen]
        mirror = np.eye(3) - 2.0 * n[:, :, None] * n[:, None, :]
        turn = _rotation(bounce.direction[chosen], -view[chosen])
        self._unfolding[at] = self._unfolding[at] @ np.where(refracts[:, None, None], turn, mirror)


def _rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """[n, 3, 3]: the shortest ones that take unit vectors to others."""
    axis, cosine = np.cross(start, end), dot(start, end)
    x, y, z = axis.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.eye(3) + cross + cross @ cross / (1.0 + cosine)[:, None, None]


def _find_motion(
    shapes: Shapes, walk: _Walk, rows: np.ndarray, camera: Camera, previous_camera: Camera, point: np.ndarray
) -> np.ndarray:
    """[n, 3] of rows: previous image points minus these, and depths."""
    chains, now = walk.chains_of(rows), point
    settled = np.ones(len(rows), dtype=bool)
    still = np.full(len(rows), previous_camera.sees_as(camera))
    if camera.has_aperture:  # through the middle of the lens the point is seen elsewhere
        now, depth, settled = find_points(chains, camera, point)
    else:
        depth = view_from(chains, camera, point).depth

    def both(hits: Hits) -> tuple[Facets, Facets]:
        hits = Hits(**{item.name: getattr(hits, item.name)[rows] for item in fields(Hits)})
        return find_facets(shapes, hits, previous=False), find_facets(shapes, hits, previous=True)

    for number, link in enumerate(chains.links):
        there = chains.count > number
        facets, before = both(walk.link_hits[number])
        stays = _same_place(facets, before)
        still &= stays | ~there
        moved = move_links(link, facets, before)
        for item in fields(Links):
            value = getattr(link, item.name)
            value[there & ~stays] = getattr(moved, item.name)[there & ~stays]
    facets, before = both(walk.seen_hits)
    moving = ~chains.sees_world & ~_same_place(facets, before)
    still &= ~moving
    chains.seen_position[moving] = before.position[moving]
    chains.seen_normal[moving] = before.normal[moving]
    then, depth_then, settled_then = find_points(chains, previous_camera, now)
    motion = np.concatenate([then - now, (depth_then - depth)[:, None]], axis=1)
    visible = settled & settled_then & (depth_then > 0.0) & np.isfinite(motion).all(axis=1)
    motion = np.where(visible[:, None], motion, [NO_MOTION, NO_MOTION, 0.0])
    return np.where(still[:, None], 0.0, motion)
