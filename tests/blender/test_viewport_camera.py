# SPDX-License-Identifier: Apache-2.0
"""A view's matrices as a camera: the same one as the scene's camera gives, whatever Blender does to it."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from blend import add_camera, add_mesh, export
from svgf_blender.viewport.camera import ORTHOGRAPHIC_NOTE, same_camera, view_camera


def matrices(camera, width=96, height=54):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    return camera.matrix_world.inverted(), camera.calc_matrix_camera(depsgraph, x=width, y=height)


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
def test_is_the_camera_that_a_render_exports(fit):
    add_mesh()
    camera = add_camera((3, -7, 2))
    camera.rotation_euler = (1.2, 0.1, 0.4)
    camera.data.sensor_fit, camera.data.lens = fit, 35
    camera.data.shift_x, camera.data.shift_y = 0.2, -0.1
    view = view_camera(*matrices(camera), (0.1, 100.0))
    expected = export(size=(96, 54)).camera
    assert view.note == "" and view.camera.clip == (0.1, 100.0)
    assert view.camera.window == pytest.approx(expected.window, rel=1e-5)
    assert np.allclose(view.camera.camera_to_world, expected.camera_to_world, atol=1e-6)


def test_orthographic_view_is_a_long_lens():
    """Points of the middle plane are where they belong, points before and behind it nearly so."""
    camera = add_camera((0, -10, 0))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 6.0
    view_matrix, window_matrix = matrices(camera, 60, 60)
    view = view_camera(view_matrix, window_matrix, (0.1, 100.0))
    assert view.note == ORTHOGRAPHIC_NOTE
    left, right, bottom, top = view.camera.window
    for point in [(2.0, 0.0, -1.0), (2.0, 5.0, -1.0), (-3.0, 3.0, 3.0)]:
        local = view.camera.camera_to_world[:, :3].T @ (point - view.camera.camera_to_world[:, 3])
        assert view.camera.clip[0] < -local[2] < view.camera.clip[1]
        u, v = local[:2] / -local[2]
        x, y = (2 * u - left - right) / (right - left), (2 * v - bottom - top) / (top - bottom)
        assert (x, y) == pytest.approx((point[0] / 3, point[2] / 3), abs=0.02)


def test_same_camera():
    view_matrix, window_matrix = matrices(add_camera())
    first, second = (view_camera(view_matrix, window_matrix, (0.1, 100.0)).camera for _ in range(2))
    assert first is not second and same_camera(first, second)
    assert not same_camera(first, view_camera(view_matrix, window_matrix, (0.1, 50.0)).camera)
