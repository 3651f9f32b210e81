# SPDX-License-Identifier: Apache-2.0
"""Rays against instances of triangle meshes.

Two levels of bounding volume hierarchy, walked by all rays at once. A hierarchy is a complete binary tree, so that a
level of it is an array and a step down is a test of all (ray, node) pairs that are left. Nothing is ordered front to
back: simple, not fast.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from ..scene import RayVisibility
from .vec import dot, normalize, transform_point, transform_vector

# (ray, node) pairs in flight, which bounds the memory.
RAYS_AT_ONCE = 1 << 13
# Share of the magnitude of a hit point's terms by which a ray starts off the surface: far above the rounding of
# float64.
SURFACE_OFFSET = 1e-10
# Shadow rays end this share of their length before the light.
SHADOW_END = 1.0 - 1e-4


class Hierarchy:
    """A complete binary tree of boxes over primitives that are given by their boxes [n, 3] each."""

    def __init__(self, lower: np.ndarray, upper: np.ndarray, leaf_size: int) -> None:
        self.count = len(lower)
        self.depth = max(0, int(np.ceil(np.log2(max(1, self.count) / leaf_size))))
        if not self.count:
            return
        # Repeating the last primitive fills the tree; testing it twice changes nothing.
        order = np.minimum(np.arange(leaf_size << self.depth), self.count - 1)[None]
        centre = (lower + upper) / 2.0
        for _ in range(self.depth):
            points = centre[order]
            axis = np.argmax(points.max(axis=1) - points.min(axis=1), axis=1)
            keys = np.take_along_axis(points, axis[:, None, None], axis=2)[:, :, 0]
            order = np.take_along_axis(order, np.argsort(keys, axis=1, kind="stable"), axis=1)
            order = order.reshape(2 * len(order), -1)
        self.leaves = order
        self.lower, self.upper = [lower[order].min(axis=1)], [upper[order].max(axis=1)]
        for _ in range(self.depth):
            self.lower.insert(0, self.lower[0].reshape(-1, 2, 3).min(axis=1))
            self.upper.insert(0, self.upper[0].reshape(-1, 2, 3).max(axis=1))

    def candidates(self, origin: np.ndarray, direction: np.ndarray, t_max: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (ray, primitive) of which the ray meets the leaf's box within [0, t_max]."""
        if not self.count or not len(origin):
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        with np.errstate(divide="ignore"):
            inverse = 1.0 / direction
        ray, node = np.arange(len(origin)), np.zeros(len(origin), dtype=np.int64)
        for level in range(self.depth + 1):
            if level:
                ray, node = np.repeat(ray, 2), (2 * node[:, None] + np.arange(2)).ravel()
            with np.errstate(invalid="ignore"):
                near = (self.lower[level][node] - origin[ray]) * inverse[ray]
                far = (self.upper[level][node] - origin[ray]) * inverse[ray]
            # fmin and fmax pass over the NaN of a ray that runs within a side of the box.
            enter = np.fmax.reduce(np.fmin(near, far), axis=1)
            leave = np.fmin.reduce(np.fmax(near, far), axis=1)
            met = ~(np.fmax(enter, 0.0) > np.fmin(leave * (1.0 + 1e-12), t_max[ray]))
            ray, node = ray[met], node[met]
        return np.repeat(ray, self.leaves.shape[1]), self.leaves[node].ravel()


def intersect_triangles(
    origin: np.ndarray, direction: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Row by row: t (inf where missed, both sides hit) and the weights [n, 3] of the corners [n, 3 corners, 3]
    [Woop13].

    Watertight: rays through a shared edge or vertex do not slip between triangles.
    """
    axis_z = np.argmax(np.abs(direction), axis=1)
    axes = np.stack([(axis_z + 1) % 3, (axis_z + 2) % 3, axis_z], axis=1)
    d = np.take_along_axis(direction, axes, axis=1)
    p = np.take_along_axis(corners - origin[:, None], axes[:, None], axis=2)
    shear = d / d[:, 2:3]
    x = p[:, :, 0] - shear[:, 0:1] * p[:, :, 2]
    y = p[:, :, 1] - shear[:, 1:2] * p[:, :, 2]
    # Scaled edge functions, each the weight of the corner opposite of the edge.
    edges = np.stack(
        [x[:, (i + 2) % 3] * y[:, (i + 1) % 3] - y[:, (i + 2) % 3] * x[:, (i + 1) % 3] for i in range(3)], axis=1
    )
    determinant = edges.sum(axis=1)
    inside = ((edges >= 0.0).all(axis=1) | (edges <= 0.0).all(axis=1)) & (determinant != 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = edges / determinant[:, None]
        t = dot(weights, p[:, :, 2]) / d[:, 2]
    return np.where(inside, t, np.inf), weights


@dataclass
class Hits:
    """t: [n], inf where nothing was hit. instance, triangle (over all meshes): [n]. weights: [n, 3] of the corners."""

    t: np.ndarray
    instance: np.ndarray
    triangle: np.ndarray
    weights: np.ndarray

    @property
    def found(self) -> np.ndarray:
        return np.isfinite(self.t)

    def rows(self, chosen: np.ndarray) -> Hits:
        return Hits(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})

    def set_rows(self, chosen: np.ndarray, hits: Hits) -> None:
        for field in fields(self):
            getattr(self, field.name)[chosen] = getattr(hits, field.name)


def no_hits(count: int) -> Hits:
    return Hits(np.full(count, np.inf), np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros((count, 3)))


class Geometry:
    """Meshes in a row, and their instances."""

    def __init__(
        self,
        meshes: list,
        instance_mesh: np.ndarray,
        object_to_world: np.ndarray,
        world_to_object: np.ndarray,
        visibility: np.ndarray,
    ) -> None:
        self.meshes = meshes
        self.visibility = visibility
        self.instance_mesh = instance_mesh
        self.object_to_world = object_to_world
        self.world_to_object = world_to_object
        sizes = [len(mesh.corners) for mesh in meshes]
        self.first_triangle = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
        self.corners = np.concatenate([np.zeros((0, 3, 3)), *(mesh.corners for mesh in meshes)])
        lower, upper, filled = self._instance_boxes()
        self.placed = np.flatnonzero(filled)
        self.top = Hierarchy(lower[filled], upper[filled], leaf_size=1)

    def _instance_boxes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = len(self.instance_mesh)
        lower, upper = np.zeros((count, 3)), np.zeros((count, 3))
        filled = np.zeros(count, dtype=bool)
        for index, mesh in enumerate(self.meshes):
            members = np.flatnonzero(self.instance_mesh == index)
            if not mesh.hierarchy.count or not len(members):
                continue
            box = np.stack([mesh.hierarchy.lower[0][0], mesh.hierarchy.upper[0][0]])
            transform = self.object_to_world[members]
            centre = transform_point(transform, box.mean(axis=0))
            half = np.abs(transform[:, :, :3]) @ ((box[1] - box[0]) / 2.0)
            half += 1e-12 * (np.abs(transform[:, :, :3]) @ np.abs(box).max(axis=0) + np.abs(transform[:, :, 3]))
            lower[members], upper[members], filled[members] = centre - half, centre + half, True
        return lower, upper, filled

    def start_of(self, instance: np.ndarray) -> np.ndarray:
        """Where the triangles of the meshes of instances [n] start in the row of all meshes."""
        if not len(self.instance_mesh):
            return np.zeros(len(instance), dtype=np.int64)
        return self.first_triangle[self.instance_mesh[instance]]

    def closest(
        self, origin: np.ndarray, direction: np.ndarray, t_min: np.ndarray, t_max: np.ndarray, kind: np.ndarray
    ) -> Hits:
        """The nearest triangle with t_min < t < t_max of the instances that rays of this kind [n] (bits of
        RayVisibility) see. Arrays [n, 3] and [n]; t counts in lengths of direction."""
        hits = no_hits(len(origin))
        for start in range(0, len(origin), RAYS_AT_ONCE):
            rows = slice(start, start + RAYS_AT_ONCE)
            self._closest(hits, start, origin[rows], direction[rows], t_min[rows], t_max[rows], kind[rows])
        return hits

    def _closest(self, hits: Hits, start: int, origin, direction, t_min, t_max, kind) -> None:
        nearest = hits.t[start : start + len(origin)]
        for row, found in self._crossings(origin, direction, t_min, t_max, kind, nearest):
            # Sorted by t within each ray, the first is the nearest.
            order = np.lexsort((found.t, row))
            row, winner = np.unique(row[order], return_index=True)
            hits.set_rows(row + start, found.rows(order[winner]))

    def crossings(
        self, origin: np.ndarray, direction: np.ndarray, t_min: np.ndarray, t_max: np.ndarray, kind: np.ndarray
    ) -> tuple[np.ndarray, Hits]:
        """All hits with t_min < t < t_max, sorted by ray and t, and the ray of each. Arguments: see closest."""
        rays, hits = [np.zeros(0, np.int64)], [no_hits(0)]
        for start in range(0, len(origin), RAYS_AT_ONCE):
            part = slice(start, start + RAYS_AT_ONCE)
            rest = (a[part] for a in (origin, direction, t_min, t_max, kind))
            for row, found in self._crossings(*rest, t_max[part]):
                rays.append(row + start)
                hits.append(found)
        ray = np.concatenate(rays)
        found = Hits(**{f.name: np.concatenate([getattr(part, f.name) for part in hits]) for f in fields(Hits)})
        order = np.lexsort((found.triangle, found.instance, found.t, ray))
        return ray[order], found.rows(order)

    def _crossings(self, origin, direction, t_min, t_max, kind, nearest) -> Iterator[tuple[np.ndarray, Hits]]:
        """Mesh by mesh and part by part, rays and hits with t_min < t < t_max and t < nearest. nearest may change
        meanwhile. A triangle may come twice for one ray."""
        ray, placed = self.top.candidates(origin, direction, t_max)
        instance = self.placed[placed]
        sees = (self.visibility[instance] & kind[ray]) != 0
        ray, instance = ray[sees], instance[sees]
        mesh_of_pair = self.instance_mesh[instance]
        for index in np.unique(mesh_of_pair):
            mesh, chosen = self.meshes[index], mesh_of_pair == index
            pair_ray, pair_instance = ray[chosen], instance[chosen]
            to_object = self.world_to_object[pair_instance]
            pair_origin = transform_point(to_object, origin[pair_ray])
            pair_direction = transform_vector(to_object, direction[pair_ray])
            for first in range(0, len(pair_ray), RAYS_AT_ONCE):
                part = slice(first, first + RAYS_AT_ONCE)
                limit = np.minimum(t_max[pair_ray[part]], nearest[pair_ray[part]])
                pair, primitive = mesh.hierarchy.candidates(pair_origin[part], pair_direction[part], limit)
                pair = pair + first
                triangle = mesh.solid[primitive]
                t, weights = intersect_triangles(pair_origin[pair], pair_direction[pair], mesh.corners[triangle])
                row = pair_ray[pair]
                valid = (t > t_min[row]) & (t < t_max[row]) & (t < nearest[row])
                triangle = triangle + self.first_triangle[index]
                yield row[valid], Hits(t, pair_instance[pair], triangle, weights).rows(valid)

    def occluded(self, origin: np.ndarray, direction: np.ndarray, t_max: np.ndarray) -> np.ndarray:
        kind = np.full(len(origin), int(RayVisibility.SHADOW))
        return self.closest(origin, direction, np.zeros(len(origin)), t_max, kind).found


def solid_triangles(corners: np.ndarray) -> np.ndarray:
    """Indices of the triangles that can be hit: finite and with an area."""
    with np.errstate(all="ignore"):
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.flatnonzero(np.isfinite(normal).all(axis=1) & (normal != 0.0).any(axis=1))


def offset_origin(
    position: np.ndarray, magnitude: np.ndarray, geometric_normal: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """Where a ray from a surface starts: off it, on the side of its direction, so that it does not hit where it starts
    [Wachter19].

    magnitude: [n], of the terms that were summed to the position, to which its rounding is proportional.
    """
    side = np.where(dot(geometric_normal, direction) < 0.0, -1.0, 1.0)
    return position + (side * SURFACE_OFFSET * magnitude)[:, None] * geometric_normal


def triangle_normals(corners: np.ndarray) -> np.ndarray:
    return normalize(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
