# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera of a 3D view, read from the matrices that Blender draws it with.

So a view through the scene's camera needs nothing of its own: its zoom, offset, sensor fit and shift are in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from svgf.scene import Camera

from ..export.transforms import rigid

# How far an orthographic view's camera stands back, in widths of the view: the rays of a pixel at its edge then lean by
# a quarter of a percent, and float32 still tells surfaces apart that are 1e-5 of the width from each other.
_LONG_LENS = 200.0

ORTHOGRAPHIC_NOTE = "Orthographic views are not supported yet; a very long lens is used instead."


@dataclass(frozen=True)
class View:
    """camera: as svgf sees the view. note: a sentence about what is not as in Blender, or empty."""

    camera: Camera
    note: str = ""


def view_camera(view_matrix: np.ndarray, window_matrix: np.ndarray, clip: tuple[float, float]) -> View:
    """view_matrix, window_matrix: [4, 4] world to view and view to clip space, as in RegionView3D.

    clip: (near, far) in metres, used for perspective views: a projection matrix in float32 keeps its far distance
    only roughly.
    """
    projection = np.asarray(window_matrix, np.float64)
    camera_to_world = rigid(np.linalg.inv(np.asarray(view_matrix, np.float64)))
    if projection[3, 3] == 0:
        # x_clip = (p00 x + p02 z) / -z is -1 at the left edge and 1 at the right one; here z = -1.
        (left, right), (bottom, top) = (
            ((projection[axis, 2] - 1) / projection[axis, axis], (projection[axis, 2] + 1) / projection[axis, axis])
            for axis in (0, 1)
        )
        return View(Camera(camera_to_world, (left, right, bottom, top), clip))
    return View(_long_lens(camera_to_world, projection), ORTHOGRAPHIC_NOTE)


def _long_lens(camera_to_world: np.ndarray, projection: np.ndarray) -> Camera:
    """A perspective camera so far back that it hardly differs from the orthographic one."""
    near, far = ((projection[2, 3] + side) / projection[2, 2] for side in (1, -1))
    middle = max(near, 0.0)  # of a user's view, what it orbits around; of a camera, itself
    (left, right), (bottom, top) = (
        ((-1 - projection[axis, 3]) / projection[axis, axis], (1 - projection[axis, 3]) / projection[axis, axis])
        for axis in (0, 1)
    )
    distance = _LONG_LENS * max(right - left, top - bottom)
    moved = camera_to_world.copy()
    moved[:, 3] += camera_to_world[:, 2] * (distance - middle)
    window = tuple(side / distance for side in (left, right, bottom, top))
    return Camera(moved, window, (max(near - middle + distance, distance * 1e-3), far - middle + distance))


def same_camera(a: Camera, b: Camera) -> bool:
    return (
        a.window == b.window
        and a.clip == b.clip
        and a.projection is b.projection
        and np.array_equal(a.camera_to_world, b.camera_to_world)
    )
