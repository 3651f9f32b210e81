# SPDX-License-Identifier: Apache-2.0
"""Lamps, emissive triangles and the environment: choosing one, sampling a point on it, and the same densities for rays
that run into one.

Densities are per solid angle and hold the probability of choosing the light. A lamp without size (delta) has density 1
for its only direction, and its radiance is then what arrives: intensity over squared distance, or a sun's irradiance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..flat_lights import ENVIRONMENT, TRIANGLE
from ..scene import LightKind, RayVisibility
from .environment import World
from .light_tree import choose_start, start_importance, start_level, tree_depth, walk_light_tree
from .sampling import concentric_disk, cone, to_world, triangle_barycentrics
from .vec import dot, normalize

_SPHERES = (LightKind.POINT, LightKind.SPOT)
_AREAS = (LightKind.RECTANGLE, LightKind.ELLIPSE)


@dataclass
class LightSample:
    """direction: [n, 3] unit, towards the light. distance: [n], inf for a sun. radiance: [n, 3]. pdf: [n], 0: no light
    there."""

    direction: np.ndarray
    distance: np.ndarray
    radiance: np.ndarray
    pdf: np.ndarray
    delta: np.ndarray


class Lights:
    """The lights of a FlatScene, see there for the columns. textures, world: of the scene."""

    def __init__(
        self,
        light_kind=(),
        light_data=(),
        light_visibility=None,
        light_tree=np.zeros((0, 12)),
        light_of_leaf=(),
        emitters=np.zeros((0, 2)),
        light_of_triangle=(),
        emission_map=None,
        emission_maps=np.zeros((0, 8)),
    ) -> None:
        self.kind = np.asarray(light_kind, dtype=np.int64)
        data = np.asarray(light_data, dtype=np.float64).reshape(-1, 24)
        self.position, self.axis_x, self.axis_y, self.axis_z, self.radiance = (
            data[:, i : i + 3] for i in range(0, 15, 3)
        )
        self.size, self.area = data[:, 15:17], data[:, 17]
        self.cos_half_spot, self.spot_smooth, self.delta = data[:, 18], data[:, 19], data[:, 20] != 0.0
        self.soft_falloff = data[:, 23] != 0.0
        every_ray = np.full(len(data), int(RayVisibility.ALL))
        self.visibility = every_ray if light_visibility is None else np.asarray(light_visibility, dtype=np.int64)
        self.ambient, self.weight = data[:, 21], data[:, 22]
        self.everywhere = int(np.isin(self.kind, (LightKind.SUN, ENVIRONMENT)).sum())
        self.tree = np.asarray(light_tree, dtype=np.float64).reshape(-1, 12)
        self.light_of_leaf = np.asarray(light_of_leaf, dtype=np.int64)
        self.leaf = np.full(len(data), -1, dtype=np.int64)
        leaves = np.flatnonzero(self.light_of_leaf >= 0)
        self.leaf[self.light_of_leaf[leaves]] = leaves
        for leaf in leaves:
            light = self.light_of_leaf[leaf]
            while self.ambient[light] < 1.0:
                light += 1
                self.leaf[light] = leaf
        self.emitters = np.asarray(emitters, dtype=np.int64).reshape(-1, 2)
        self.light_of_triangle = np.asarray(light_of_triangle, dtype=np.int64)
        self.emission_map = np.full(len(data), -1) if emission_map is None else np.asarray(emission_map)
        self.emission_maps = np.asarray(emission_maps, dtype=np.float64).reshape(-1, 8)
        self.textures: list = []
        self.world = World()

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def choices(self) -> int:
        """How many lights may be chosen."""
        return self.everywhere + np.count_nonzero(self.leaf >= 0)

    def choose(self, u: np.ndarray, point: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A light for each point [n, 3] with the receiver's lit normal [n, 3], and the probability of choosing it, 0
        for no light. u: [n, 2]."""
        start, place, chance = choose_start(self._start_importance(point, normal), u[:, 0])
        light = start.copy()
        rows = np.flatnonzero((start >= self.everywhere) & (chance > 0.0))
        if len(rows):
            numbers, none = np.column_stack([place, u[:, 1]])[rows], np.full(len(rows), -1)
            leaf, share, number = walk_light_tree(
                self.tree, start[rows] - self.everywhere, point[rows], normal[rows], numbers, none
            )
            first = self.light_of_leaf[leaf]
            light[rows] = first
            goes_on = np.flatnonzero((first >= 0) & (number >= self.ambient[first]))
            while len(goes_on):
                light[rows[goes_on]] += 1
                goes_on = goes_on[number[goes_on] >= self.ambient[light[rows[goes_on]]]]
            chance[rows] *= np.where(first >= 0, share * self.weight[light[rows]], 0.0)
        return np.maximum(light, 0), chance

    def choice_probability(self, light: np.ndarray, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """[n]: with which ``choose`` would have chosen lights [n]."""
        leaf = self.leaf[light]
        level = start_level(self.tree)
        start = np.where(light < self.everywhere, light, self.everywhere + (leaf >> (tree_depth(self.tree) - level)))
        importance = self._start_importance(point, normal)
        total = importance.sum(axis=1)
        known = (light < self.everywhere) | (leaf >= 0)
        own = np.take_along_axis(importance, np.where(known, start, 0)[:, None], axis=1)[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            chance = np.where(known & (own > 0.0), own / total, 0.0)
        rows = np.flatnonzero((leaf >= 0) & (chance > 0.0))
        if len(rows):
            _, share, _ = walk_light_tree(
                self.tree,
                start[rows] - self.everywhere,
                point[rows],
                normal[rows],
                np.zeros((len(rows), 2)),
                leaf[rows],
            )
            chance[rows] *= share * self.weight[light[rows]]
        return chance

    def _start_importance(self, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """[n, choices]: of the lights that are everywhere, and of the nodes at which walks start."""
        facing = np.maximum(normal @ self.axis_z[: self.everywhere].T, 0.0)
        facing[~normal.any(axis=1)] = 1.0
        everywhere = self.weight[: self.everywhere] * np.minimum(facing + self.ambient[: self.everywhere], 1.0)
        importance = np.concatenate([everywhere, start_importance(self.tree, point, normal)], axis=1)
        return importance if importance.shape[1] > 1 else np.ones_like(importance)

    def sample(self, light: np.ndarray, probability: np.ndarray, point: np.ndarray, uv: np.ndarray) -> LightSample:
        """A point on light [n] (indices), chosen with a probability [n], as seen from point [n, 3]."""
        count = len(light)
        result = LightSample(
            np.zeros((count, 3)), np.full(count, np.inf), self.radiance[light], np.zeros(count), self.delta[light]
        )
        samplers = {
            LightKind.POINT: self._sample_sphere,
            LightKind.SPOT: self._sample_sphere,
            LightKind.SUN: self._sample_sun,
            LightKind.RECTANGLE: self._sample_area,
            LightKind.ELLIPSE: self._sample_area,
            TRIANGLE: self._sample_area,
        }
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for kind, sampler in samplers.items():
                rows = np.flatnonzero(self.kind[light] == kind)
                if len(rows):
                    chosen = light[rows]
                    direction, distance, pdf = sampler(chosen, point[rows], uv[rows])
                    result.direction[rows], result.distance[rows], result.pdf[rows] = direction, distance, pdf
                    if kind == TRIANGLE:
                        result.radiance[rows] *= self._emission_texel(chosen, uv[rows])
                    elif kind in _AREAS:
                        cosine = dot(direction, self.axis_z[chosen])
                        result.radiance[rows] *= self.spread_attenuation(chosen, cosine)[:, None]
                    elif kind in _SPHERES:
                        falloff = np.where(self.delta[chosen], 1.0 / distance**2, 1.0)
                        result.radiance[rows] *= (falloff * self.spot_attenuation(chosen, direction))[:, None]
            rows = np.flatnonzero(self.kind[light] == ENVIRONMENT)
            if len(rows):
                result.direction[rows], result.pdf[rows] = self.world.sample(uv[rows])
                result.radiance[rows] = self.world.radiance(result.direction[rows])
        # A point at the very light, or a density without bound, has no part.
        bad = ~(np.isfinite(result.pdf) & np.isfinite(result.radiance).all(axis=1) & (result.distance > 0.0))
        result.pdf[bad], result.radiance[bad] = 0.0, 0.0
        result.pdf *= probability
        return result

    def _sample_sphere(self, light, point, uv):
        to_centre = self.position[light] - point
        radius = self.size[light, 0]
        axis = normalize(to_centre)
        one_minus_cos = sphere_cone(radius, dot(to_centre, to_centre))
        direction = normalize(to_world(cone(uv, one_minus_cos), axis))
        distance = sphere_distance(to_centre, direction, radius)
        pdf = 1.0 / (2.0 * np.pi * one_minus_cos)

        # Soft falloff: a disk through the centre that faces the point.
        soft = self.soft_falloff[light]
        disk = concentric_disk(uv) * radius[:, None]
        to_disk = to_centre + to_world(np.column_stack([disk, np.zeros(len(disk))]), axis)
        to_disk_distance = np.sqrt(dot(to_disk, to_disk))
        direction = np.where(soft[:, None], to_disk / to_disk_distance[:, None], direction)
        distance = np.where(soft, to_disk_distance, distance)
        pdf = np.where(soft, distance**2 / (dot(direction, axis) * np.pi * radius**2), pdf)

        delta = self.delta[light]
        direction = np.where(delta[:, None], axis, direction)
        distance = np.where(delta, np.sqrt(dot(to_centre, to_centre)), distance)
        return direction, distance, np.where(delta, 1.0, pdf)

    def _sample_sun(self, light, point, uv):
        axis = self.axis_z[light]
        one_minus_cos = sun_cone(self.size[light])
        delta = self.delta[light]
        direction = np.where(delta[:, None], axis, to_world(cone(uv, one_minus_cos), axis))
        pdf = np.where(delta, 1.0, 1.0 / (2.0 * np.pi * one_minus_cos))
        return direction, np.full(len(light), np.inf), pdf

    def _sample_area(self, light, point, uv):
        kind, size = self.kind[light], self.size[light]
        share = uv - 0.5
        share = np.where((kind == LightKind.ELLIPSE)[:, None], concentric_disk(uv) / 2.0, share) * size
        share = np.where((kind == TRIANGLE)[:, None], triangle_barycentrics(uv), share)
        on_light = self.position[light] + share[:, 0:1] * self.axis_x[light] + share[:, 1:2] * self.axis_y[light]
        to_light = on_light - point
        distance = np.sqrt(dot(to_light, to_light))
        direction = to_light / distance[:, None]
        cosine = dot(direction, self.axis_z[light])
        # Lamps shine along -axis_z only, triangles both ways.
        cosine = np.where(kind == TRIANGLE, np.abs(cosine), cosine)
        return direction, distance, np.where(cosine > 0.0, distance**2 / (cosine * self.area[light]), 0.0)

    def spot_attenuation(self, light, direction: np.ndarray) -> np.ndarray:
        """[n] for directions towards the lamp; 1 for what is no spot."""
        cosine = dot(-direction, -self.axis_z[light])
        t = np.clip((cosine - self.cos_half_spot[light]) * self.spot_smooth[light], 0.0, 1.0)
        return np.where(self.kind[light] == LightKind.SPOT, t * t * (3.0 - 2.0 * t), 1.0)

    def spread_attenuation(self, light, cosine: np.ndarray) -> np.ndarray:
        """[n]: of area lamps behind a grid of slats, seen at angles of these cosines."""
        with np.errstate(divide="ignore", invalid="ignore"):
            tangent = np.sqrt(np.maximum(0.0, 1.0 - cosine * cosine)) / cosine
        faded = np.maximum(0.0, self.cos_half_spot[light] - tangent) * self.spot_smooth[light]
        return np.where(self.spot_smooth[light] > 0.0, faded, 1.0)

    def _emission_texel(self, light: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """[n, 3]: what the emission of triangles is multiplied by at sampled points."""
        color = np.ones((len(light), 3))
        share = triangle_barycentrics(uv)
        rows = self.emission_map[light]
        for row in np.unique(rows[rows >= 0]):
            chosen = rows == row
            corners = self.emission_maps[row, :6].reshape(3, 2)
            at = corners[0] + share[chosen] @ (corners[1:] - corners[0])
            color[chosen] = self.textures[int(self.emission_maps[row, 6])].lookup(at)[:, :3]
        return color

    def crossed_lamps(
        self, origin: np.ndarray, direction: np.ndarray, t_hit: np.ndarray, t_min: np.ndarray | float = 0.0
    ) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
        """For every lamp with size: its index, the rows that see it between t_min and t_hit (inf on a miss), their
        radiance [m, 3] and density [m], without the probability of choosing it."""
        for light in np.flatnonzero((self.kind != TRIANGLE) & (self.kind != ENVIRONMENT) & ~self.delta):
            if self.kind[light] == LightKind.SUN:
                seen = np.isinf(t_hit) & (dot(direction, self.axis_z[light]) >= self.size[light, 1])
                pdf = np.full(len(origin), 1.0 / (2.0 * np.pi * sun_cone(self.size[light])))
            else:
                crossing = self._cross_sphere if self.kind[light] in _SPHERES else self._cross_area
                if self.soft_falloff[light]:
                    crossing = self._cross_facing_disk
                t, pdf = crossing(light, origin, direction)
                seen = (t > t_min) & (t < t_hit)
            rows = np.flatnonzero(seen)
            if len(rows):
                attenuation = self.spot_attenuation(light, direction[rows])
                if self.kind[light] in _AREAS:
                    attenuation = self.spread_attenuation(light, dot(direction[rows], self.axis_z[light]))
                yield int(light), rows, self.radiance[light] * attenuation[:, None], pdf[rows]

    def _cross_sphere(self, light, origin, direction):
        to_centre = self.position[light] - origin
        radius = self.size[light, 0]
        t = sphere_distance(to_centre, direction, radius, miss=-1.0)
        return t, 1.0 / (2.0 * np.pi * sphere_cone(radius, dot(to_centre, to_centre)))

    def _cross_facing_disk(self, light, origin, direction):
        to_centre = self.position[light] - origin
        radius = self.size[light, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            centre_distance = np.sqrt(dot(to_centre, to_centre))
            cosine = dot(direction, to_centre) / centre_distance
            t = centre_distance / cosine
            beside = t[:, None] * direction - to_centre
            seen = (cosine > 0.0) & (dot(beside, beside) <= radius**2)
            return np.where(seen, t, -1.0), t * t / (cosine * np.pi * radius**2)

    def _cross_area(self, light, origin, direction):
        with np.errstate(divide="ignore", invalid="ignore"):
            cosine = dot(direction, self.axis_z[light])
            t = dot(self.position[light] - origin, self.axis_z[light]) / cosine
            local = origin + t[:, None] * direction - self.position[light]
            share = (
                np.stack([dot(local, self.axis_x[light]), dot(local, self.axis_y[light])], axis=1) / self.size[light]
            )
            if self.kind[light] == LightKind.ELLIPSE:
                inside = (share**2).sum(axis=1) <= 0.25
            else:
                inside = (np.abs(share) <= 0.5).all(axis=1)
            pdf = t * t / (cosine * self.area[light])
        return np.where(inside & (cosine > 0.0), t, -1.0), pdf

    def find(self, emitter: np.ndarray, triangle: np.ndarray) -> np.ndarray:
        """The lights [n] of triangles (numbers within their meshes) of emitters [n]; -1 for none."""
        if not len(self.emitters):
            return np.full(len(emitter), -1)
        first, table = self.emitters[emitter].T
        entry = np.where(emitter >= 0, table + triangle, 0)
        number = self.light_of_triangle[entry]
        return np.where((emitter >= 0) & (number >= 0), first + number, -1)

    def triangle_pdf(self, light: np.ndarray, t: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        """Density of hits at distance t of the triangles that are lights [n], without the probability of choosing them;
        0 for light -1."""
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            pdf = t * t / (np.abs(cosine) * self.area[light] if len(self) else 1.0)
        return np.where(light >= 0, pdf, 0.0)


def sphere_cone(radius, distance_squared):
    """1 - cosine of half the angle under which a sphere is seen; 2, all directions, from within."""
    with np.errstate(divide="ignore", invalid="ignore"):
        sine_squared = radius * radius / distance_squared
        outside = sine_squared / (1.0 + np.sqrt(np.maximum(0.0, 1.0 - sine_squared)))
    return np.where(distance_squared > radius * radius, outside, 2.0)


def sun_cone(size):
    """As sphere_cone, of a sun's size columns (sine, cosine)."""
    return size[..., 0] ** 2 / (1.0 + size[..., 1])


def sphere_distance(to_centre: np.ndarray, direction: np.ndarray, radius, miss: float | None = None) -> np.ndarray:
    """Distance to a sphere: where the ray enters it, or leaves it from within. A ray that passes by: the point closest
    to the centre, or miss where that is given."""
    along = dot(to_centre, direction)
    beside = to_centre - along[:, None] * direction
    half_chord_squared = radius * radius - dot(beside, beside)
    half_chord = np.sqrt(np.maximum(half_chord_squared, 0.0))
    inside = dot(to_centre, to_centre) <= radius * radius
    t = np.where(inside, along + half_chord, along - half_chord)
    return t if miss is None else np.where((half_chord_squared >= 0.0) & (t > 0.0), t, miss)
