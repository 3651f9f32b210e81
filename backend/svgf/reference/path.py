# SPDX-License-Identifier: Apache-2.0
"""Stage "path": light that reaches the camera, by unidirectional path tracing with next-event estimation.

At each vertex light is looked for twice, by a point on a light and by the direction that the BSDF samples; multiple
importance sampling weighs the two by the power heuristic [Veach97]. All paths advance by one vertex at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..flatten import MATERIAL_COLUMNS
from ..light_paths import LightPaths
from ..scene import RayVisibility
from .bsdf import NONE, Bsdf
from .bsdf_evaluate import evaluate
from .bsdf_sample import BsdfSample, find_smooth_bounce, sample
from .gbuffer import BACKGROUND_DEPTH, may_follow
from .intersect import SHADOW_END, Hits, offset_origin
from .opacity import find_path_hits, shadow_transmittance, surface_choice
from .sampling import (
    direction_pair,
    light_choice_pair,
    light_point_pair,
    lobe_pair,
    power_heuristic,
    random_pair,
)
from .shadow_terminator import find_light_side, shadow_rays
from .surface import SceneView, Surface, surface_at

ROULETTE_START = 3

_KINDS = (RayVisibility.DIFFUSE, RayVisibility.GLOSSY, RayVisibility.TRANSMISSION)


@dataclass
class Paths:
    """Paths that go on, one row each. pixel: where their light goes. throughput: [n, 3]. pdf, delta: of the BSDF sample
    that the ray follows, smallest_pdf: of those so far. share: [n, 3], of the light to come that belongs to the diffuse
    signal. normal: [n, 3], where the ray started. kind: of the ray. bounces: [n, 3] of each of _KINDS. ends: the ray
    only looks for light. measures_distance: the ray left the seen surface by a specular lobe. on_chain: all bounces so
    far lead to the surface that the pixel sees, see specular_chain.py; links: [n], those that do. transparent_bounces:
    [n]. t_min, t_max: [n], where the ray looks."""

    pixel: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    throughput: np.ndarray
    pdf: np.ndarray
    smallest_pdf: np.ndarray
    delta: np.ndarray
    share: np.ndarray
    normal: np.ndarray
    kind: np.ndarray
    bounces: np.ndarray
    ends: np.ndarray
    measures_distance: np.ndarray
    on_chain: np.ndarray
    links: np.ndarray
    transparent_bounces: np.ndarray
    t_min: np.ndarray
    t_max: np.ndarray

    def rows(self, chosen: np.ndarray) -> Paths:
        return Paths(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


class Signals:
    """Sums of light per pixel: emission, and two signals. split: "diffuse_specular" or "direct_indirect". With a
    transparent film, alpha too. hit_distance: [count], see Tracer.trace."""

    def __init__(self, count: int, split: str, has_specular: bool, limits: LightPaths, transparent_film: bool) -> None:
        self.images = {name: np.zeros((count, 3)) for name in ("emission", *split.split("_"))}
        self._first, self._second = split.split("_")
        self._has_specular = has_specular
        self._limits = limits
        self.transparent_film = transparent_film
        if split == "diffuse_specular" and not has_specular:
            del self.images["specular"]
        if transparent_film:
            self.images["alpha"] = np.zeros(count)
        self.hit_distance = np.zeros(count)

    def add(
        self, pixel: np.ndarray, value: np.ndarray, share: np.ndarray, bounces: np.ndarray, links: np.ndarray
    ) -> None:
        """bounces: [n], between the camera and the light. share, links: see Paths."""
        value = np.where(np.isfinite(value), value, 0.0)
        limit = 3.0 * np.where(bounces > 1, self._limits.clamp_indirect, self._limits.clamp_direct)
        with np.errstate(divide="ignore", invalid="ignore"):
            value = value * np.where(limit > 0.0, np.fmin(1.0, limit / value.sum(axis=1)), 1.0)[:, None]
        after_seen = np.minimum(bounces - links, 2)
        for number in np.unique(after_seen):
            chosen = after_seen == number
            self._add(pixel[chosen], value[chosen], share[chosen], number)

    def _add(self, pixel: np.ndarray, value: np.ndarray, share: np.ndarray, bounces: int) -> None:
        if bounces == 0:
            self.images["emission"][pixel] += value
        elif self._first == "direct":
            self.images[self._first if bounces == 1 else self._second][pixel] += value
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
    limits: LightPaths,
    origin: np.ndarray,
    direction: np.ndarray,
    near: np.ndarray,
    far: np.ndarray,
    hits: Hits,
    passed: np.ndarray,
    follows_chains: bool = False,
    chain_light: np.ndarray | None = None,
) -> None:
    """Adds one sample of every pixel to signals. keys: [n] of pixel_keys. origin, direction (unit), hits, passed: the
    primary rays, which look from near to far, and what find_path_hits says of them. follows_chains: the pixels see what
    specular_chain.py says. chain_light: what it returned for this sample."""
    count = len(direction)
    if chain_light is not None:
        signals.images["emission"] += chain_light
    paths = Paths(
        pixel=np.arange(count),
        origin=origin,
        direction=direction,
        throughput=np.ones((count, 3)),
        pdf=np.zeros(count),
        smallest_pdf=np.full(count, np.inf),
        delta=np.ones(count, dtype=bool),
        share=np.zeros((count, 3)),
        normal=np.zeros((count, 3)),
        kind=np.full(count, int(RayVisibility.CAMERA)),
        bounces=np.zeros((count, 3), dtype=np.int64),
        ends=np.zeros(count, dtype=bool),
        measures_distance=np.zeros(count, dtype=bool),
        on_chain=np.ones(count, dtype=bool),
        links=np.zeros(count, dtype=np.int64),
        transparent_bounces=np.zeros(count, dtype=np.int64),
        t_min=near,
        t_max=far,
    )
    if signals.transparent_film:
        signals.images["alpha"] += 1.0
    vertex = 0
    while len(paths.pixel):
        if vertex:
            hits, passed = find_path_hits(
                scene, keys[paths.pixel], sample_number, vertex, paths.origin, paths.direction, paths.t_min,
                paths.t_max, paths.kind, max(limits.transparent_bounces, 1) - paths.transparent_bounces,
            )  # fmt: skip
        paths.transparent_bounces = paths.transparent_bounces + passed
        is_known = paths.on_chain & (paths.links > 0) & (chain_light is not None)
        unknown = np.flatnonzero(~is_known)
        _add_lamps(scene, signals, paths.rows(unknown), hits.rows(unknown))
        _add_world(scene, signals, paths.rows(~hits.found & ~is_known))
        signals.hit_distance[paths.pixel[~hits.found & paths.measures_distance]] = BACKGROUND_DEPTH
        found = np.flatnonzero(hits.found)
        paths, t = paths.rows(found), hits.t[found]
        if not len(found):
            return
        choice = surface_choice(scene, keys[paths.pixel], sample_number, vertex, hits.rows(found))
        surface = surface_at(scene, hits, found, -paths.direction, choice)
        unknown = np.flatnonzero(~is_known[found])
        _add_emission(scene, signals, paths.rows(unknown), surface.chosen(unknown), t[unknown])

        # What goes straight on keeps its ray, so that what it finds has the density with which it was sampled.
        # As in Cycles the surface after the last that may be passed only shines, and one may always be passed.
        goes_on = paths.transparent_bounces < max(limits.transparent_bounces, 1)
        is_straight = surface.straight.max(axis=1, initial=0.0) > 0.0
        straight = paths.rows(goes_on & is_straight)
        straight.throughput = straight.throughput * surface.straight[goes_on & is_straight]
        straight.t_min = t[goes_on & is_straight]
        straight.transparent_bounces = straight.transparent_bounces + 1

        arrived = paths.measures_distance & ~is_straight & goes_on
        signals.hit_distance[paths.pixel[arrived]] = t[arrived]

        number = paths.bounces.sum(axis=1)
        lobe_and_roulette = random_pair(keys[paths.pixel], lobe_pair(vertex), sample_number)
        survival = np.where(number >= ROULETTE_START, np.minimum(1.0, paths.throughput.max(axis=1)), 1.0)
        alive = goes_on & ~is_straight & ~paths.ends & (lobe_and_roulette[:, 1] < survival)
        _simplify(surface, paths, limits)
        surface, paths, lobe_and_roulette = surface.chosen(alive), paths.rows(alive), lobe_and_roulette[alive]
        paths.throughput = paths.throughput / survival[alive][:, None]
        if len(paths.pixel):
            paths = _scatter(
                scene, signals, keys, sample_number, bounces, limits, paths, surface, lobe_and_roulette, vertex,
                follows_chains,
            )  # fmt: skip
        paths = Paths(**{
            field.name: np.concatenate([getattr(paths, field.name), getattr(straight, field.name)])
            for field in fields(Paths)
        })  # fmt: skip
        vertex += 1


def _scatter(
    scene: SceneView,
    signals: Signals,
    keys: np.ndarray,
    sample_number: int,
    bounces: int,
    limits: LightPaths,
    paths: Paths,
    surface: Surface,
    lobe_and_roulette: np.ndarray,
    vertex: int,
    follows_chains: bool,
) -> Paths:
    """Light that is sampled at surfaces, and the paths that leave them."""
    position, magnitude = surface.position, surface.magnitude
    bsdf = surface.bsdf(-paths.direction)
    allowed = _allowed_kinds(paths, limits)
    if scene.lights.intervals:
        _add_direct_light(
            scene, signals, keys, sample_number, limits, paths, surface, bsdf, allowed, vertex
        )

    next_direction = random_pair(keys[paths.pixel], direction_pair(vertex), sample_number)
    found = sample(bsdf, next_direction, lobe_and_roulette[:, 0])
    kind = np.array([0, *map(int, _KINDS)])[found.event]
    diffuse, specular = _kept(found.diffuse, found.specular, allowed, kind == RayVisibility.TRANSMISSION)
    value = diffuse + specular
    _leave_or_follow_chains(paths, bsdf, found, bounces, limits, follows_chains, _share(diffuse, value))
    paths.measures_distance &= (kind != RayVisibility.DIFFUSE) & (specular > 0.0).any(axis=1)
    paths.throughput = paths.throughput * value
    paths.direction, paths.pdf, paths.delta, paths.kind = found.direction, found.pdf, found.delta, kind
    paths.smallest_pdf = np.minimum(paths.smallest_pdf, np.where(found.delta, np.inf, found.pdf))
    paths.normal = bsdf.normal
    paths.origin = offset_origin(position, magnitude, bsdf.geometric_normal, found.direction)
    paths.t_min = np.zeros(len(position))
    paths.t_max = np.full(len(position), np.inf)
    paths.bounces = paths.bounces + (kind[:, None] == np.array(_KINDS))
    of_a_kind = (limits.diffuse_bounces, limits.glossy_bounces, limits.transmission_bounces)
    paths.ends = (paths.bounces > np.array(of_a_kind)).any(axis=1) | (paths.bounces.sum(axis=1) > bounces)
    return paths.rows(paths.throughput.max(axis=1) > 0.0)


def _leave_or_follow_chains(
    paths: Paths, bsdf: Bsdf, found: BsdfSample, bounces: int, limits: LightPaths, follows: bool, share: np.ndarray
) -> None:
    """At the first surface that does not go on with a path's chain, which is what the pixel sees, share [n, 3] divides
    the light to come."""
    event = find_smooth_bounce(bsdf).event if follows else np.full(len(paths.pixel), NONE)
    made = [paths.bounces[:, _KINDS.index(kind)] for kind in (RayVisibility.GLOSSY, RayVisibility.TRANSMISSION)]
    goes_on = may_follow(event, bounces, limits, *made)
    stays = paths.on_chain & goes_on & found.delta & (found.event == event)
    leaves = paths.on_chain & ~stays
    paths.share = np.where(leaves[:, None], share, paths.share)
    paths.measures_distance = leaves & ~goes_on
    paths.links = paths.links + stays
    paths.on_chain = stays


def _simplify(surface: Surface, paths: Paths, limits: LightPaths) -> None:
    """What Cycles leaves out or blurs of a surface that is seen by a diffuse ray, or by one that few samples follow."""
    if not limits.reflective_caustics:
        surface.rows[paths.kind == RayVisibility.DIFFUSE, MATERIAL_COLUMNS["specular_ior_level"]] = 0.0
    if limits.filter_glossy > 0.0:
        density = np.minimum(paths.smallest_pdf / limits.filter_glossy, 1.0)
        # GGX alpha is the square of roughness.
        roughness = surface.rows[:, MATERIAL_COLUMNS["roughness"]]
        roughness[:] = np.maximum(roughness, np.sqrt(0.5 * np.sqrt(1.0 - density)))


def _allowed_kinds(paths: Paths, limits: LightPaths) -> np.ndarray:
    """[n] bits of RayVisibility: the rays that may leave the next surface."""
    without = RayVisibility.NONE
    if not limits.reflective_caustics:
        without |= RayVisibility.GLOSSY
    if not limits.refractive_caustics:
        without |= RayVisibility.TRANSMISSION
    every = int(RayVisibility.ALL)
    return np.where(paths.kind == RayVisibility.DIFFUSE, every & ~int(without), every)


def _kept(
    diffuse: np.ndarray, specular: np.ndarray, kinds: np.ndarray, below: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What of BSDF values [n, 3] rays of these kinds carry. below: directions to the other side of the surface."""

    def has(above: RayVisibility) -> np.ndarray:
        return (kinds & np.where(below, int(RayVisibility.TRANSMISSION), int(above)) != 0)[:, None]

    return np.where(has(RayVisibility.DIFFUSE), diffuse, 0.0), np.where(has(RayVisibility.GLOSSY), specular, 0.0)


def _share(diffuse: np.ndarray, total: np.ndarray) -> np.ndarray:
    return np.where(total > 0.0, diffuse / np.where(total > 0.0, total, 1.0), 0.0)


def _hit_weight(paths: Paths, light_pdf: np.ndarray) -> np.ndarray:
    """MIS weight [n, 1] of light that a ray ran into; a mirror direction is found in no other way."""
    return np.where(paths.delta, 1.0, power_heuristic(paths.pdf, light_pdf))[:, None]


def _add_lamps(scene: SceneView, signals: Signals, paths: Paths, hits: Hits) -> None:
    """Lamps stop no ray: all that are crossed before the hit shine."""
    lights = scene.lights
    for light, rows, radiance, pdf in lights.crossed_lamps(paths.origin, paths.direction, hits.t, paths.t_min):
        sees = paths.kind[rows] & lights.visibility[light] != 0
        crossing, radiance, pdf = paths.rows(rows[sees]), radiance[sees], pdf[sees]
        pdf = pdf * lights.choice_probability(np.full(len(pdf), light), crossing.origin, crossing.normal)
        value = crossing.throughput * radiance * _hit_weight(crossing, pdf)
        signals.add(crossing.pixel, value, crossing.share, crossing.bounces.sum(axis=1), crossing.links)


def _add_world(scene: SceneView, signals: Signals, paths: Paths) -> None:
    if signals.transparent_film:
        seen = paths.kind == RayVisibility.CAMERA
        signals.images["alpha"][paths.pixel[seen]] -= paths.throughput[seen].mean(axis=1)
        paths = paths.rows(~seen)
    paths = paths.rows(paths.kind & scene.world.visibility != 0)
    pdf = np.zeros(len(paths.pixel))
    if scene.world.light >= 0:
        pdf = scene.world.density(paths.direction) * scene.lights.probability[scene.world.light]
    value = paths.throughput * scene.world.radiance(paths.direction, paths.kind) * _hit_weight(paths, pdf)
    signals.add(paths.pixel, value, paths.share, paths.bounces.sum(axis=1), paths.links)


def _add_emission(scene: SceneView, signals: Signals, paths: Paths, surface: Surface, t: np.ndarray) -> None:
    cosine = np.einsum("ni,ni->n", surface.geometric_normal, paths.direction)
    pdf = scene.lights.triangle_pdf(surface.light, t, cosine)
    lit = np.flatnonzero((surface.light >= 0) & ~paths.delta)
    pdf[lit] *= scene.lights.choice_probability(surface.light[lit], paths.origin[lit], paths.normal[lit])
    value = paths.throughput * surface.emission * _hit_weight(paths, pdf)
    signals.add(paths.pixel, value, paths.share, paths.bounces.sum(axis=1), paths.links)


def _add_direct_light(
    scene: SceneView,
    signals: Signals,
    keys: np.ndarray,
    sample_number: int,
    limits: LightPaths,
    paths: Paths,
    surface: Surface,
    bsdf: Bsdf,
    allowed: np.ndarray,
    vertex: int,
) -> None:
    light_choice = random_pair(keys[paths.pixel], light_choice_pair(vertex), sample_number)
    light_point = random_pair(keys[paths.pixel], light_point_pair(vertex), sample_number)
    index, probability = scene.lights.choose(light_choice, surface.position, bsdf.normal)
    light = scene.lights.sample(index, probability, surface.position, light_point)
    side = find_light_side(surface, bsdf.geometric_normal, light.direction)
    diffuse, specular, pdf = evaluate(bsdf, light.direction, side)
    diffuse, specular = _kept(diffuse, specular, allowed & scene.lights.visibility[index], side < 0.0)
    total = diffuse + specular
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.where(light.delta, 1.0, power_heuristic(light.pdf, pdf)) / light.pdf
        value = paths.throughput * total * light.radiance * weight[:, None]
    lit = np.flatnonzero((light.pdf > 0.0) & (value > 0.0).any(axis=1))
    origin, direction, distance = shadow_rays(surface.chosen(lit), light.direction[lit], light.distance[lit])
    surfaces = limits.transparent_bounces - paths.transparent_bounces[lit]
    value[lit] *= shadow_transmittance(
        scene,
        keys[paths.pixel[lit]],
        sample_number,
        vertex,
        origin,
        direction,
        distance * SHADOW_END,
        surfaces,
    )
    share = np.where(paths.on_chain[lit, None], _share(diffuse[lit], total[lit]), paths.share[lit])
    signals.add(paths.pixel[lit], value[lit], share, paths.bounces.sum(axis=1)[lit] + 1, paths.links[lit])
