# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera, framed exactly as Blender frames it."""

from __future__ import annotations

import bpy
import numpy as np
from svgf.errors import InputError
from svgf.scene import Aperture, Camera, Projection

from .findings import Findings
from .transforms import rigid
from .unsupported import find_in_camera

_SMALLEST_DISTANCE = 1e-5  # of the focus, in metres


def render_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Width and height in pixels of the image that Blender would render."""
    scale = render.resolution_percentage / 100
    return max(int(render.resolution_x * scale), 1), max(int(render.resolution_y * scale), 1)


def window(
    camera: bpy.types.Camera, width: int, height: int, pixel_aspect: tuple[float, float]
) -> tuple[float, float, float, float]:
    """(left, right, bottom, top) of the image, on the plane one unit in front of a perspective camera, in metres for an
    orthographic one.

    The sensor spans the image along one axis: the one that `sensor_fit` names, or the longer one with AUTO, which
    always takes the sensor's width. Shift is measured in units of that axis too.
    """
    across, down = width * pixel_aspect[0], height * pixel_aspect[1]
    horizontal = camera.sensor_fit == "HORIZONTAL" or (camera.sensor_fit == "AUTO" and across >= down)
    sensor = camera.sensor_height if camera.sensor_fit == "VERTICAL" else camera.sensor_width
    span = camera.ortho_scale if camera.type == "ORTHO" else sensor / camera.lens
    scale = span / (across if horizontal else down)
    half_width, half_height = across * scale / 2, down * scale / 2
    x, y = camera.shift_x * span, camera.shift_y * span
    return x - half_width, x + half_width, y - half_height, y + half_height


def check_camera(camera: bpy.types.Object | None, scene: bpy.types.Scene) -> None:
    """Raises InputError where a scene's camera is missing, or an object of another kind."""
    if camera is None or camera.type != "CAMERA":
        raise InputError(
            f'Scene "{scene.name}" has no camera.', "Add a camera and make it the active one (Ctrl+Numpad 0)."
        )


def export_camera(
    camera: bpy.types.Object | None, scene: bpy.types.Scene, size: tuple[int, int], findings: Findings
) -> Camera:
    """camera: evaluated object. size: (width, height) of the image. Raises InputError where there is no camera."""
    check_camera(camera, scene)
    data, render = camera.data, scene.render
    find_in_camera(camera, findings)
    # float32 values as Python floats: the same arithmetic on every platform from here on.
    matrix = np.array(camera.matrix_world, np.float64)
    return Camera(
        camera_to_world=rigid(matrix),
        window=window(data, *size, (render.pixel_aspect_x, render.pixel_aspect_y)),
        clip=(data.clip_start, data.clip_end),
        projection=Projection.ORTHOGRAPHIC if data.type == "ORTHO" else Projection.PERSPECTIVE,
        aperture=export_aperture(camera),
    )


def export_aperture(camera: bpy.types.Object) -> Aperture:
    """As Cycles has it: the f-number divides the focal length, in millimetres, or 1 m for parallel rays."""
    data, lens = camera.data, camera.data.dof
    if not lens.use_dof or lens.aperture_fstop <= 0:
        return Aperture()
    focal_length = 1.0 if data.type == "ORTHO" else data.lens * 1e-3
    return Aperture(
        radius=focal_length / (2 * lens.aperture_fstop),
        focus_distance=max(_focus_distance(camera), _SMALLEST_DISTANCE),
        blades=lens.aperture_blades,
        rotation=lens.aperture_rotation,
        ratio=lens.aperture_ratio,
    )


def _focus_distance(camera: bpy.types.Object) -> float:
    """Along the view, to the object in focus where there is one."""
    lens = camera.data.dof
    if lens.focus_object is None:
        return lens.focus_distance
    matrix = lens.focus_object.matrix_world
    pose = lens.focus_object.pose
    bone = pose.bones.get(lens.focus_subtarget) if pose and lens.focus_subtarget else None
    if bone is not None:
        matrix = matrix @ bone.matrix
    axis = rigid(np.array(camera.matrix_world, np.float64))[:, 2]
    return float(abs(axis @ (np.array(matrix.translation) - np.array(camera.matrix_world.translation))))
