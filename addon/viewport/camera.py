# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera of a 3D view, read from the matrices that Blender draws it with.

So a view through the scene's camera needs nothing of its own: its zoom, offset, sensor fit and shift are in them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from svgf.scene import Camera, Projection

from ..export.transforms import rigid
from .worker import WHOLE, Part


@dataclass(frozen=True)
class View:
    """camera: of the picture. size: its width and height, in pixels. part: where it is in the view, see Request."""

    camera: Camera
    size: tuple[int, int]
    part: Part = WHOLE


def view_camera(view_matrix: np.ndarray, window_matrix: np.ndarray, clip: tuple[float, float]) -> Camera:
    """view_matrix, window_matrix: [4, 4] world to view and view to clip space, as in RegionView3D.

    clip: (near, far) in metres, used for perspective views: a projection matrix in float32 keeps its far distance
    only roughly. Orthographic views reach behind the point that they orbit around; their camera stands back so far that
    all of that is in front of it.
    """
    projection = np.asarray(window_matrix, np.float64)
    camera_to_world = rigid(np.linalg.inv(np.asarray(view_matrix, np.float64)))
    if projection[3, 3] == 0:
        # x_clip = (p00 x + p02 z) / -z is -1 at the left edge and 1 at the right one; here z = -1.
        (left, right), (bottom, top) = (
            ((projection[axis, 2] - 1) / projection[axis, axis], (projection[axis, 2] + 1) / projection[axis, axis])
            for axis in (0, 1)
        )
        return Camera(camera_to_world, (left, right, bottom, top), clip)
    (left, right), (bottom, top) = (
        ((-1 - projection[axis, 3]) / projection[axis, axis], (1 - projection[axis, 3]) / projection[axis, axis])
        for axis in (0, 1)
    )
    near, far = ((projection[2, 3] + side) / projection[2, 2] for side in (1, -1))
    back = max(-near, 0.0)
    camera_to_world[:, 3] += camera_to_world[:, 2] * back
    return Camera(camera_to_world, (left, right, bottom, top), (near + back, far + back), Projection.ORTHOGRAPHIC)


def cut_out(camera: Camera, size: tuple[int, int], border: Part) -> View:
    """What of a view is in a border, a part of it, in whole pixels and at least one. size: of the view, in pixels."""
    left, right, bottom, top = camera.window
    columns, rows = (_pixels(border[axis], border[axis + 2], size[axis]) for axis in (0, 1))
    part = (columns[0] / size[0], rows[0] / size[1], columns[1] / size[0], rows[1] / size[1])
    window = (
        left + (right - left) * part[0],
        left + (right - left) * part[2],
        bottom + (top - bottom) * part[1],
        bottom + (top - bottom) * part[3],
    )
    return View(replace(camera, window=window), (columns[1] - columns[0], rows[1] - rows[0]), part)


def border_in_frame(window_matrix: np.ndarray, frame: np.ndarray, border: Part) -> Part:
    """A camera's render border as a part of the view through it.

    frame: [4, 3] corners of the camera's picture in camera space, anywhere on their rays. border: part of the picture.
    """
    corners = np.column_stack([np.asarray(frame, np.float64), np.ones(len(frame))]) @ np.asarray(window_matrix).T
    places = corners[:, :2] / corners[:, 3:] * 0.5 + 0.5
    (left, bottom), (right, top) = places.min(axis=0), places.max(axis=0)
    return (
        left + (right - left) * border[0],
        bottom + (top - bottom) * border[1],
        left + (right - left) * border[2],
        bottom + (top - bottom) * border[3],
    )


def same_camera(a: Camera, b: Camera) -> bool:
    return (
        a.window == b.window
        and a.clip == b.clip
        and a.projection is b.projection
        and a.aperture == b.aperture
        and np.array_equal(a.camera_to_world, b.camera_to_world)
    )


def _pixels(start: float, end: float, count: int) -> tuple[int, int]:
    first = min(max(math.floor(start * count), 0), count - 1)
    return first, max(min(math.ceil(end * count), count), first + 1)
