# SPDX-License-Identifier: Apache-2.0
"""Rays through surfaces that let light pass straight.

A path's ray passes a surface that only lets a share of light through, whatever its colour, by a random number of the
triangle's own. All others stop it: those that tint light, that are one of several surfaces, or that shine. Of shadow
rays every surface takes its share.
"""

from __future__ import annotations

import numpy as np

from ..flatten import MATERIAL_COLUMNS
from ..scene import MaterialKind, RayVisibility
from .intersect import Hits, no_hits
from .sampling import random_at_triangle, shadow_pair, surface_pair
from .surface import MIXES, SceneView, column, find_opacity, material_rows_at, transmittance_at


def surface_choice(scene: SceneView, keys: np.ndarray, sample_number: int, vertex: int, hits: Hits) -> np.ndarray:
    """[n] in [0, 1), see surface_at. keys: [n] of the pixels of the rays."""
    triangle = hits.triangle - scene.shapes.start_of(hits.instance)
    return random_at_triangle(keys, surface_pair(vertex), sample_number, hits.instance, triangle)


def find_path_hits(
    scene: SceneView,
    keys: np.ndarray,
    sample_number: int,
    vertex: int,
    origin: np.ndarray,
    direction: np.ndarray,
    t_min: np.ndarray,
    t_max: np.ndarray,
    kind: np.ndarray,
    allowed: np.ndarray,
) -> tuple[Hits, np.ndarray]:
    """What stops the rays that lead to a vertex of paths, and the surfaces [n] that they passed before.

    allowed: [n], surfaces that a ray may pass; one more stops it. For the others see Geometry.closest."""
    shapes = scene.shapes
    if not (find_opacity(scene.materials)[0] < 1.0).any() and not _has_alpha_maps(scene):
        return shapes.closest(origin, direction, t_min, t_max, kind), np.zeros(len(origin), dtype=np.int64)
    ray, crossed = shapes.crossings(origin, direction, t_min, t_max, kind)
    ray, crossed = _once_each(ray, crossed)
    passes = _passes(scene, keys[ray], sample_number, vertex, crossed)
    number = _number_within(ray)
    stops = np.flatnonzero(~passes | (number >= allowed[ray]))
    row, first = np.unique(ray[stops], return_index=True)
    hits, passed = no_hits(len(origin)), np.bincount(ray[passes], minlength=len(origin))
    hits.set_rows(row, crossed.rows(stops[first]))
    passed[row] = number[stops[first]]
    return hits, passed


def shadow_transmittance(
    scene: SceneView,
    keys: np.ndarray,
    sample_number: int,
    vertex: int,
    origin: np.ndarray,
    direction: np.ndarray,
    t_max: np.ndarray,
    allowed: np.ndarray,
    kind: np.ndarray | int = int(RayVisibility.SHADOW),
) -> np.ndarray:
    """What is left, [n, 3], of light that goes straight on to the end of shadow rays from a vertex, through at most so
    many surfaces [n]."""
    shapes = scene.shapes
    kind = np.broadcast_to(kind, len(origin))
    ray, crossed = _once_each(*shapes.crossings(origin, direction, np.zeros(len(origin)), t_max, kind))
    left = np.ones((len(origin), 3))
    if len(ray):
        triangle = crossed.triangle - shapes.start_of(crossed.instance)
        choice = random_at_triangle(keys[ray], shadow_pair(vertex), sample_number, crossed.instance, triangle)
        share = transmittance_at(scene, crossed, np.arange(len(ray)), -direction[ray], choice)
        np.multiply.at(left, ray, np.where((_number_within(ray) < allowed[ray])[:, None], share, 0.0))
    return left


def surfaces_are_dark(scene: SceneView) -> bool:
    """Whether no surface shines, and each that lets light pass straight only takes a share, whatever its colour."""
    materials = scene.materials
    light = np.concatenate([column(materials, "emission"), column(materials, "light_emission")])
    kind = materials[:, MATERIAL_COLUMNS["kind"]].astype(np.int64)
    has_alpha_map = np.zeros(len(materials), dtype=bool)
    for row, (first, count) in enumerate(materials[:, [MATERIAL_COLUMNS["map_start"], MATERIAL_COLUMNS["map_count"]]]):
        maps = scene.material_maps[int(first) : int(first + count), 0]
        has_alpha_map[row] = (maps == MATERIAL_COLUMNS["alpha"]).any()
    is_opaque = (find_opacity(materials)[0] >= 1.0) & ~has_alpha_map
    parts = materials[:, [MATERIAL_COLUMNS["first"], MATERIAL_COLUMNS["second"]]].astype(np.int64)
    is_mix = np.isin(kind, MIXES)
    for _ in materials:  # parts may be mixes
        is_opaque = np.where(is_mix, is_opaque[parts].all(axis=1), is_opaque)
    tints = (kind == MaterialKind.TRANSPARENT) & ~_is_clear(materials)
    return not (light.any() or tints.any() or (is_mix & ~is_opaque).any())


def _is_clear(rows: np.ndarray) -> np.ndarray:
    return (column(rows, "base_color") >= 1.0).all(axis=1) & (rows[:, MATERIAL_COLUMNS["map_count"]] == 0)


def _passes(scene: SceneView, keys: np.ndarray, sample_number: int, vertex: int, hits: Hits) -> np.ndarray:
    """bool [n]: whether path rays pass these hits on their way."""
    if not len(hits.t):
        return np.zeros(0, dtype=bool)
    material, rows = material_rows_at(scene, hits)
    kind = rows[:, MATERIAL_COLUMNS["kind"]]
    first = MATERIAL_COLUMNS["emission"]
    is_dark = (scene.materials[material][:, first : first + 3] == 0.0).all(axis=1)
    is_clear = (kind == MaterialKind.TRANSPARENT) & _is_clear(rows)
    only_takes_a_share = ((kind == MaterialKind.PRINCIPLED) & is_dark) | is_clear
    opacity, _ = find_opacity(rows)
    return only_takes_a_share & (surface_choice(scene, keys, sample_number, vertex, hits) >= opacity)


def _has_alpha_maps(scene: SceneView) -> bool:
    return bool((scene.material_maps[:, 0] == MATERIAL_COLUMNS["alpha"]).any())


def _once_each(ray: np.ndarray, hits: Hits) -> tuple[np.ndarray, Hits]:
    """Without those that come again: the same triangle, or the other one at an edge."""
    again = (ray[1:] == ray[:-1]) & (hits.t[1:] == hits.t[:-1]) & (hits.instance[1:] == hits.instance[:-1])
    at_edge = hits.weights.min(axis=1, initial=1.0) == 0.0
    again &= (hits.triangle[1:] == hits.triangle[:-1]) | (at_edge[1:] & at_edge[:-1])
    keep = np.concatenate([[True], ~again])[: len(ray)]
    return ray[keep], hits.rows(keep)


def _number_within(ray: np.ndarray) -> np.ndarray:
    """Of rows that are sorted by ray: how many of the same ray are before each."""
    _, start, count = np.unique(ray, return_index=True, return_counts=True)
    return np.arange(len(ray)) - np.repeat(start, count)
