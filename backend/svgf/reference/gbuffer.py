# SPDX-License-Identifier: Apache-2.0
"""Stage "gbuffer": what the primary ray of each pixel sees, for demodulation, reprojection and edges."""

from __future__ import annotations

import numpy as np

from .camera import Camera
from .intersect import Hits
from .surface import SceneView, surface_at
from .vec import dot, normalize

BACKGROUND_DEPTH = 1e10
LARGEST_GRADIENT = 1e10
# Motion, in pixels, of what was behind the previous camera: reprojects to nowhere.
NO_MOTION = 1e6


def trace_gbuffer(
    scene: SceneView,
    camera: Camera,
    previous_camera: Camera,
    point: np.ndarray,
    direction: np.ndarray,
    hits: Hits,
    choice: np.ndarray,
) -> dict[str, np.ndarray]:
    """point: [n, 2] image points, direction: [n, 3] of planar depth 1, hits: of these rays, choice: [n], see surface_at.
    Returns images as rows of pixels."""
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
    view = -normalize(direction[found])
    surface = surface_at(scene, hits, found, view, choice[found])
    bsdf = surface.bsdf(view)
    depth = camera.depth(surface.position)
    images["normal"][found] = bsdf.normal
    images["depth"][found] = depth
    images["depth_gradient"][found] = depth_gradient(camera, direction[found], depth, bsdf.geometric_normal)
    images["object_id"][found] = surface.object_id
    images["material_id"][found] = surface.material + 1
    images["roughness"][found] = bsdf.roughness
    images["diffuse_albedo"][found] = bsdf.diffuse_albedo
    images["specular_albedo"][found] = bsdf.specular_albedo

    # The background is infinitely far: only the camera's rotation moves it.
    seen_before = direction.copy()
    seen_before[found] = surface.previous_position - previous_camera.to_world[:, 3]
    images["motion"] = motion(previous_camera, point, seen_before)
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


def depth_gradient(
    camera: Camera, direction: np.ndarray, depth: np.ndarray, geometric_normal: np.ndarray
) -> np.ndarray:
    """Derivatives [n, 2] of the depth of the hit's plane by the image point.

    The ray s d meets the plane n (x - p) = 0 at depth s = n p / n d, so ds = -s (n dd) / (n d).
    """
    normal = camera.to_camera(geometric_normal)
    across = dot(normal, camera.to_camera(direction))
    with np.errstate(divide="ignore", invalid="ignore"):
        gradient = np.stack([-depth * (normal @ step) / across for step in camera.pixel_steps()], axis=1)
    return np.clip(np.nan_to_num(gradient, nan=0.0), -LARGEST_GRADIENT, LARGEST_GRADIENT)


def motion(previous_camera: Camera, point: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """[n, 3]: previous image point of vectors from the previous camera minus point, and their planar depth."""
    before, depth = previous_camera.project(vector)
    behind = ~((depth > 0.0) & np.isfinite(before).all(axis=1))
    before = np.where(behind[:, None], NO_MOTION, before - point)
    return np.concatenate([before, depth[:, None]], axis=1)
