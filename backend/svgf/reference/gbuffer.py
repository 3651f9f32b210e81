# SPDX-License-Identifier: Apache-2.0
"""Stage "gbuffer": what the primary ray of each pixel sees, for demodulation, reprojection and edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..light_paths import LightPaths
from ..scene import RayVisibility
from .bsdf import NONE, TRANSMISSION
from .camera import Camera
from .intersect import Hits
from .opacity import find_path_hits, surface_choice
from .surface import SceneView, surface_at

BACKGROUND_DEPTH = 1e10
LARGEST_GRADIENT = 1e10
# Motion, in pixels, of what was behind the previous camera: reprojects to nowhere.
NO_MOTION = 1e6
# Links of a chain of mirrors and bends at most, see specular_chain.py.
LONGEST_CHAIN = 8


@dataclass
class PrimaryRays:
    """point: [n, 2] image points. origin, direction: [n, 3] unit. far: [n], where they end. keys: [n], see pixel_keys.
    sample_number: of their sample."""

    point: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    far: np.ndarray
    keys: np.ndarray
    sample_number: int


def trace_gbuffer(
    scene: SceneView,
    camera: Camera,
    previous_camera: Camera,
    rays: PrimaryRays,
    hits: Hits,
    passed: np.ndarray,
    transparent_bounces: int,
) -> dict[str, np.ndarray]:
    """hits, passed: see find_path_hits. Returns images as rows of pixels."""
    point, direction = rays.point, rays.direction
    hits, choice, tint = _see_through(scene, rays, hits, max(transparent_bounces, 1) - passed)
    count = len(point)
    images = {
        "normal": np.zeros((count, 3)),
        "depth": np.full(count, BACKGROUND_DEPTH),
        "depth_gradient": np.zeros((count, 2)),
        "object_id": np.zeros(count, dtype=np.int32),
        "material_id": np.zeros(count, dtype=np.int32),
        "roughness": np.zeros(count),
        "diffuse_albedo": np.zeros((count, 3)),
        "specular_albedo": np.zeros((count, 3)),
        "motion": np.zeros((count, 3)),
    }
    found = np.flatnonzero(hits.found)
    view = -direction[found]
    surface = surface_at(scene, hits, found, view, choice[found])
    bsdf = surface.bsdf(view)
    depth = camera.depth(surface.position)
    images["normal"][found] = bsdf.normal
    images["depth"][found] = depth
    gradient = camera.depth_gradient(point[found], depth, bsdf.geometric_normal)
    images["depth_gradient"][found] = np.clip(np.nan_to_num(gradient, nan=0.0), -LARGEST_GRADIENT, LARGEST_GRADIENT)
    images["object_id"][found] = surface.object_id
    images["material_id"][found] = surface.material + 1
    images["roughness"][found] = bsdf.roughness
    images["diffuse_albedo"][found] = bsdf.diffuse_albedo * tint[found]
    images["specular_albedo"][found] = bsdf.specular_albedo * tint[found]

    # The background is infinitely far: only the camera's rotation moves it, and parallel rays all see the same of it.
    seen_before, now = direction.copy(), point.copy()
    seen_before[found] = surface.previous_position - previous_camera.to_world[:, 3]
    if camera.has_aperture:
        # A point out of focus is seen from elsewhere than where it is.
        now[found] = camera.project(surface.position - camera.to_world[:, 3])[0]
        missed = ~hits.found
        now[missed] = camera.project(direction[missed])[0]
    images["motion"] = motion(previous_camera, now, seen_before)
    if previous_camera.is_orthographic:
        images["motion"][~hits.found, :2] = 0.0
    visible = images["motion"][:, 0] != NO_MOTION
    images["motion"][:, 2] -= images["depth"]
    images["motion"][~visible, 2] = 0.0
    images["motion"][~hits.found, 2] = 0.0
    if previous_camera.sees_as(camera):
        # What stands still moves by exactly 0, whatever the two projections round to.
        still = np.ones(count, dtype=bool)
        still[found] = (surface.previous_position == surface.position).all(axis=1)
        images["motion"][still] = 0.0
    return images


def _see_through(
    scene: SceneView, rays: PrimaryRays, hits: Hits, allowed: np.ndarray
) -> tuple[Hits, np.ndarray, np.ndarray]:
    """The hits that rays see, past those that let them go straight on, at most so many [n]; their choice [n], and what
    the ones before multiply light by, [n, 3]."""
    hits = hits.rows(np.arange(len(hits.t)))
    choice, tint = np.zeros(len(hits.t)), np.ones((len(hits.t), 3))
    rows, vertex = np.flatnonzero(hits.found), 0
    while len(rows):
        keys = rays.keys[rows]
        choice[rows] = surface_choice(scene, keys, rays.sample_number, vertex, hits.rows(rows))
        straight = surface_at(scene, hits, rows, -rays.direction[rows], choice[rows]).straight
        passes = (straight.max(axis=1, initial=0.0) > 0.0) & (allowed[rows] > 0)
        rows, keys, straight = rows[passes], keys[passes], straight[passes]
        vertex += 1
        tint[rows] *= straight
        allowed[rows] -= 1
        behind, passed = find_path_hits(
            scene, keys, rays.sample_number, vertex, rays.origin[rows], rays.direction[rows], hits.t[rows],
            rays.far[rows], np.full(len(rows), int(RayVisibility.CAMERA)), allowed[rows],
        )  # fmt: skip
        allowed[rows] -= passed
        hits.set_rows(rows, behind)
        rows = rows[behind.found]
    return hits, choice, tint


def may_follow(
    event: np.ndarray, bounces: int, limits: LightPaths, reflections: np.ndarray, refractions: np.ndarray
) -> np.ndarray:
    """bool [n]: whether chains of so many links have another one. event: of find_smooth_bounce."""
    refracts = event == TRANSMISSION
    made = np.where(refracts, refractions, reflections)
    allowed = np.where(refracts, limits.transmission_bounces, limits.glossy_bounces)
    return (event != NONE) & (reflections + refractions < min(bounces, LONGEST_CHAIN)) & (made < allowed)


def motion(previous_camera: Camera, point: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """[n, 3]: previous image point of vectors from the previous camera minus point, and their planar depth."""
    before, depth = previous_camera.project(vector)
    behind = ~((depth > 0.0) & np.isfinite(before).all(axis=1))
    before = np.where(behind[:, None], NO_MOTION, before - point)
    return np.concatenate([before, depth[:, None]], axis=1)
