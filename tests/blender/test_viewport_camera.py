# SPDX-License-Identifier: Apache-2.0
"""A view's matrices as a camera: the same one as the scene's camera gives, whatever Blender does to it."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from blend import add_camera, add_mesh, export
from svgf.scene import Camera, Projection
from svgf_blender.viewport.camera import border_in_frame, cut_out, same_camera, view_camera


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
    assert view.clip == (0.1, 100.0)
    assert view.window == pytest.approx(expected.window, rel=1e-5)
    assert np.allclose(view.camera_to_world, expected.camera_to_world, atol=1e-6)


def test_orthographic_view():
    camera = add_camera((0, -10, 0))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 6.0
    view = view_camera(*matrices(camera, 60, 40), (0.1, 100.0))
    assert view.projection is Projection.ORTHOGRAPHIC
    assert view.window == pytest.approx((-3, 3, -2, 2), rel=1e-5)
    assert view.clip == pytest.approx((0.1, 1000.0), rel=1e-3) and view.camera_to_world[1, 3] == -10


def test_orthographic_view_sees_what_is_behind_its_centre():
    """As Blender's matrices of a user's view from above, which clip 100 metres before and behind what it orbits."""
    matrix = np.diag([0.5, 1.0, -0.01, 1.0])
    view = view_camera(np.eye(4), matrix, (0.1, 50.0))
    assert view.camera_to_world[:, 3] == pytest.approx((0, 0, 100)) and view.clip == pytest.approx((0, 200))
    assert view.window == pytest.approx((-2, 2, -1, 1))


def test_border_is_cut_out_in_whole_pixels():
    camera = Camera(np.eye(3, 4), (-1.0, 1.0, -0.5, 0.5))
    view = cut_out(camera, (100, 50), (0.255, 0.0, 0.5, 0.5))
    assert view.size == (25, 25) and view.part == (0.25, 0.0, 0.5, 0.5)
    assert view.camera.window == pytest.approx((-0.5, 0.0, -0.5, 0.0))
    whole = cut_out(camera, (100, 50), (-1.0, -1.0, 2.0, 2.0))
    assert whole.size == (100, 50) and whole.camera.window == camera.window
    outside = cut_out(camera, (100, 50), (1.2, 1.2, 1.5, 1.5))
    assert outside.size == (1, 1)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_border_of_a_camera(kind):
    """Through a window of twice the picture's size, its left half is a quarter of the view."""
    camera = add_camera()
    camera.data.type = kind
    view_matrix, window_matrix = matrices(camera)
    half = np.diag([0.5, 0.5, 1.0, 1.0]) @ np.array(window_matrix)
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 96, 54
    frame = np.array(camera.data.view_frame(scene=bpy.context.scene))
    part = border_in_frame(half, frame, (0.0, 0.0, 0.5, 1.0))
    assert part == pytest.approx((0.25, 0.25, 0.5, 0.75), abs=1e-5)


def test_same_camera():
    view_matrix, window_matrix = matrices(add_camera())
    first, second = (view_camera(view_matrix, window_matrix, (0.1, 100.0)) for _ in range(2))
    assert first is not second and same_camera(first, second)
    assert not same_camera(first, view_camera(view_matrix, window_matrix, (0.1, 50.0)))
