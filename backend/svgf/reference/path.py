# SPDX-License-Identifier: Apache-2.0
"""Stage "path": light that reaches the camera, by unidirectional path tracing with next-event estimation.

At each vertex light is looked for twice, by a point on a light and by the direction that the BSDF samples; multiple
importance sampling weighs the two by the power heuristic [Veach97]. All paths advance by one vertex at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from .bsdf import Bsdf, evaluate, sample
from .intersect import SHADOW_END, Hits, offset_origin
from .sampling import (
    direction_pair,
    light_choice_pair,
    light_point_pair,
    lobe_pair,
    power_heuristic,
    random_pair,
    surface_pair,
)
from .surface import SceneView, Surface, surface_at
from .vec import normalize

ROULETTE_START = 3


@dataclass
class Paths:
    """Paths that go on, one row each. pixel: where their light goes. throughput: [n, 3]. pdf, delta: of the BSDF sample
    that the ray follows. share: [n, 3], of the light to come that belongs to the diffuse signal."""

    pixel: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    throughput: np.ndarray
    pdf: np.ndarray
    delta: np.ndarray
    share: np.ndarray

    def rows(self, chosen: np.ndarray) -> Paths:
        return Paths(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


class Signals:
    """Sums of light per pixel: emission, and two signals. split: "diffuse_specular" or "direct_indirect"."""

    def __init__(self, count: int, split: str, has_specular: bool) -> None:
        self.images = {name: np.zeros((count, 3)) for name in ("emission", *split.split("_"))}
        self._first, self._second = split.split("_")
        self._has_specular = has_specular
        if split == "diffuse_specular" and not has_specular:
            del self.images["specular"]

    def add_emission(self, pixel: np.ndarray, value: np.ndarray) -> None:
        self.images["emission"][pixel] += value

    def add(self, pixel: np.ndarray, value: np.ndarray, share: np.ndarray, edges: int) -> None:
        """edges: rays between the first hit and the light. share: see Paths."""
        value = np.where(np.isfinite(value), value, 0.0)
        if self._first == "direct":
            self.images[self._first if edges == 1 else self._second][pixel] += value
        elif self._has_specular:
            self.images["diffuse"][pixel] += share * value
            self.images["specular"][pixel] += (1.0 - share) * value
        else:
            self.images["diffuse"][pixel] += value


def trace_paths(
    scene: SceneView,
    signals: Signals,
    keys: np.ndarray,
    sample_number: int,
    bounces: int,
    direction: np.ndarray,
    hits: Hits,
) -> None:
    """Adds one sample of every pixel to signals. keys: [n] of pixel_keys. direction, hits: the primary rays and what
    they hit."""
    count = len(direction)
    paths = Paths(
        pixel=np.arange(count),
        origin=np.zeros((count, 3)),  # of the primary rays: not needed, they were traced
        direction=normalize(direction),
        throughput=np.ones((count, 3)),
        pdf=np.zeros(count),
        delta=np.ones(count, dtype=bool),
        share=np.zeros((count, 3)),
    )
    for vertex in range(bounces + 2):
        if vertex:
            far = np.full(len(paths.pixel), np.inf)
            hits = scene.shapes.closest(paths.origin, paths.direction, np.zeros_like(far), far)
            _add_lamps(scene, signals, paths, hits, vertex)
        _add_world(scene, signals, paths.rows(~hits.found), vertex)
        found = np.flatnonzero(hits.found)
        paths, t = paths.rows(found), hits.t[found]
        if not len(found):
            return
        choice = random_pair(keys[paths.pixel], surface_pair(vertex), sample_number)[:, 0]
        surface = surface_at(scene, hits, found, -paths.direction, choice)
        _add_emission(scene, signals, paths, surface, t, vertex)
        if vertex == bounces + 1:
            return

        lobe_and_roulette = random_pair(keys[paths.pixel], lobe_pair(vertex), sample_number)
        bsdf = surface.bsdf(-paths.direction)
        if vertex >= ROULETTE_START:
            survival = np.minimum(1.0, paths.throughput.max(axis=1))
            alive = lobe_and_roulette[:, 1] < survival
            paths, bsdf, lobe_and_roulette = paths.rows(alive), bsdf.rows(alive), lobe_and_roulette[alive]
            position, magnitude = surface.position[alive], surface.magnitude[alive]
            paths.throughput = paths.throughput / survival[alive][:, None]
        else:
            position, magnitude = surface.position, surface.magnitude

        if len(scene.lights):
            light_choice = random_pair(keys[paths.pixel], light_choice_pair(vertex), sample_number)[:, 0]
            light_point = random_pair(keys[paths.pixel], light_point_pair(vertex), sample_number)
            _add_direct_light(scene, signals, paths, bsdf, position, magnitude, light_choice, light_point, vertex)

        next_direction = random_pair(keys[paths.pixel], direction_pair(vertex), sample_number)
        found = sample(bsdf, next_direction, lobe_and_roulette[:, 0])
        value = found.diffuse + found.specular
        if vertex == 0:
            paths.share = _share(found.diffuse, value)
        paths.throughput = paths.throughput * value
        paths.direction, paths.pdf, paths.delta = found.direction, found.pdf, found.delta
        paths.origin = offset_origin(position, magnitude, bsdf.geometric_normal, found.direction)
        paths = paths.rows(paths.throughput.max(axis=1) > 0.0)


def _share(diffuse: np.ndarray, total: np.ndarray) -> np.ndarray:
    return np.where(total > 0.0, diffuse / np.where(total > 0.0, total, 1.0), 0.0)


def _hit_weight(paths: Paths, light_pdf: np.ndarray) -> np.ndarray:
    """MIS weight [n, 1] of light that a ray ran into; a mirror direction is found in no other way."""
    return np.where(paths.delta, 1.0, power_heuristic(paths.pdf, light_pdf))[:, None]


def _add_lamps(scene: SceneView, signals: Signals, paths: Paths, hits: Hits, vertex: int) -> None:
    """Lamps stop no ray: all that are crossed before the hit shine. Primary rays do not see them."""
    for rows, radiance, pdf in scene.lights.crossed_lamps(paths.origin, paths.direction, hits.t):
        crossing = paths.rows(rows)
        value = crossing.throughput * radiance * _hit_weight(crossing, pdf)
        signals.add(crossing.pixel, value, crossing.share, edges=vertex)


def _add_world(scene: SceneView, signals: Signals, paths: Paths, vertex: int) -> None:
    value = paths.throughput * scene.lights.world_radiance
    if vertex == 0:
        signals.add_emission(paths.pixel, value)
    else:
        signals.add(paths.pixel, value, paths.share, edges=vertex)


def _add_emission(
    scene: SceneView, signals: Signals, paths: Paths, surface: Surface, t: np.ndarray, vertex: int
) -> None:
    if vertex == 0:
        signals.add_emission(paths.pixel, surface.emission)
        return
    cosine = np.einsum("ni,ni->n", surface.geometric_normal, paths.direction)
    pdf = scene.lights.triangle_pdf(surface.light_emission, t, cosine)
    value = paths.throughput * surface.emission * _hit_weight(paths, pdf)
    signals.add(paths.pixel, value, paths.share, edges=vertex)


def _add_direct_light(
    scene: SceneView,
    signals: Signals,
    paths: Paths,
    bsdf: Bsdf,
    position: np.ndarray,
    magnitude: np.ndarray,
    light_choice: np.ndarray,
    light_point: np.ndarray,
    vertex: int,
) -> None:
    light = scene.lights.sample(scene.lights.choose(light_choice), position, light_point)
    diffuse, specular, pdf = evaluate(bsdf, light.direction)
    total = diffuse + specular
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.where(light.delta, 1.0, power_heuristic(light.pdf, pdf)) / light.pdf
        value = paths.throughput * total * light.radiance * weight[:, None]
    lit = np.flatnonzero((light.pdf > 0.0) & (value > 0.0).any(axis=1))
    direction = light.direction[lit]
    origin = offset_origin(position[lit], magnitude[lit], bsdf.geometric_normal[lit], direction)
    lit = lit[~scene.shapes.occluded(origin, direction, light.distance[lit] * SHADOW_END)]
    share = _share(diffuse, total) if vertex == 0 else paths.share
    signals.add(paths.pixel[lit], value[lit], share[lit], edges=vertex + 1)
