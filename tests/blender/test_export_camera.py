# SPDX-License-Identifier: Apache-2.0
"""The camera's window against Blender's own framing."""

from __future__ import annotations

import itertools

import bpy
import numpy as np
import pytest
from blend import add_camera, add_mesh, export
from mathutils import Matrix
from svgf.light_paths import LightPaths
from svgf.scene import Projection

SIZES = [(1920, 1080), (1080, 1920), (512, 512), (1, 1), (37, 101)]
SENSORS = [("AUTO", 36, 24), ("HORIZONTAL", 36, 24), ("VERTICAL", 36, 24), ("AUTO", 20, 30), ("VERTICAL", 20, 30)]
SHIFTS = [(0, 0), (0.3, -0.2)]
ASPECTS = [(1, 1), (2, 1), (1, 1.5)]


def blender_window(camera, width: int, height: int, aspect: tuple[float, float]) -> list[float]:
    """Left, right, bottom, top from the projection matrix that Blender computes."""
    projection = camera.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(), x=width, y=height, scale_x=aspect[0], scale_y=aspect[1]
    )
    inverse = np.linalg.inv(np.array(projection, np.float64))
    corners = [inverse @ (x, y, -1, 1) for x, y in ((-1, -1), (1, 1))]
    (left, bottom), (right, top) = (corner[:2] / -corner[2] for corner in corners)
    return [left, right, bottom, top]


@pytest.mark.parametrize(("fit", "sensor_width", "sensor_height"), SENSORS)
def test_window_is_blenders(fit, sensor_width, sensor_height):
    add_mesh()
    scene = bpy.context.scene
    camera, render = scene.camera, scene.render
    camera.data.sensor_fit = fit
    camera.data.sensor_width, camera.data.sensor_height = sensor_width, sensor_height
    for (width, height), shift, aspect, lens in itertools.product(SIZES, SHIFTS, ASPECTS, (18, 85)):
        camera.data.lens = lens
        camera.data.shift_x, camera.data.shift_y = shift
        render.pixel_aspect_x, render.pixel_aspect_y = aspect
        expected = blender_window(camera, width, height, aspect)
        window = export(size=(width, height)).camera.window
        assert np.allclose(window, expected, rtol=2e-5, atol=2e-6), (width, height, shift, aspect, lens)


@pytest.mark.parametrize("size", [(1920, 1080), (1080, 1920)])
def test_window_is_the_frame_that_the_viewport_draws(size):
    add_mesh()
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.camera.data.shift_x = 0.1
    frame = np.array([corner / -corner.z for corner in scene.camera.data.view_frame(scene=scene)])
    left, right, bottom, top = export().camera.window
    assert np.allclose([left, right], [frame[:, 0].min(), frame[:, 0].max()], atol=1e-6)
    assert np.allclose([bottom, top], [frame[:, 1].min(), frame[:, 1].max()], atol=1e-6)


def test_render_size_and_defaults():
    add_mesh()
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 1001, 333, 50
    scene.render.fps, scene.render.fps_base = 30, 1.001
    if hasattr(scene, "cycles"):
        scene.cycles.max_bounces, scene.cycles.film_exposure = 7, 1.5
    defaults = export().defaults
    assert (defaults.width, defaults.height) == (500, 166)
    assert defaults.frames_per_second == pytest.approx(29.97, abs=1e-3)
    if hasattr(scene, "cycles"):
        assert (defaults.bounces, defaults.exposure) == (7, 1.5)
    assert export(size=(64, 36)).defaults.width == 64


def test_scale_of_the_camera_does_not_matter():
    add_mesh()
    camera = bpy.context.scene.camera
    camera.rotation_euler = (1.0, 0.2, 0.7)
    camera.location = (3, -4, 5)
    expected = export().camera.camera_to_world
    assert np.allclose(expected, np.array(camera.matrix_world)[:3], atol=1e-6)
    camera.scale = (2, 3, 0.1)
    rigid = export().camera.camera_to_world
    assert np.allclose(rigid, expected, atol=1e-6)
    assert np.allclose(rigid[:, :3].T @ rigid[:, :3], np.eye(3), atol=1e-7)


def test_camera_of_a_parent_with_shear_stays_rigid():
    add_mesh()
    bpy.context.scene.camera.matrix_world = Matrix.Shear("XY", 4, (0.5, 0.2)) @ Matrix.Rotation(1, 4, "X")
    rotation = export().camera.camera_to_world[:, :3]
    assert np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-7) and np.linalg.det(rotation) > 0


def test_clip_distances():
    add_mesh()
    data = bpy.context.scene.camera.data
    data.clip_start, data.clip_end = 0.5, 250
    assert export().camera.clip == (0.5, 250)


def test_orthographic_window_is_in_metres():
    add_mesh()
    data = bpy.context.scene.camera.data
    data.type, data.ortho_scale, data.shift_x = "ORTHO", 6.0, 0.25
    camera = export(size=(200, 100)).camera
    assert camera.projection is Projection.ORTHOGRAPHIC
    assert np.allclose(camera.window, (-1.5, 4.5, -1.5, 1.5))


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_aperture(kind):
    mesh = add_mesh(location=(1, 2, 3))
    camera = bpy.context.scene.camera
    data = camera.data
    assert export().camera.aperture.radius == 0
    data.type, data.lens, data.dof.use_dof = kind, 40, True
    data.dof.aperture_fstop, data.dof.focus_distance = 2.0, 7.0
    data.dof.aperture_blades, data.dof.aperture_rotation, data.dof.aperture_ratio = 5, 0.4, 1.5
    aperture = export().camera.aperture
    assert aperture.radius == pytest.approx(0.01 if kind == "PERSP" else 0.25)
    assert (aperture.focus_distance, aperture.blades) == (7.0, 5)
    assert (aperture.rotation, aperture.ratio) == pytest.approx((0.4, 1.5))
    data.dof.focus_object = mesh
    # The camera at (0, -10, 0) looks along +Y.
    assert export().camera.aperture.focus_distance == pytest.approx(12.0, rel=1e-6)


def test_light_paths_are_those_of_cycles():
    add_mesh()
    scene = bpy.context.scene
    if not hasattr(scene, "cycles"):
        pytest.skip("The Cycles add-on is disabled.")
    cycles = scene.cycles
    cycles.diffuse_bounces, cycles.glossy_bounces, cycles.transmission_bounces = 1, 2, 3
    cycles.transparent_max_bounces, cycles.caustics_reflective, cycles.caustics_refractive = 4, False, False
    cycles.sample_clamp_direct, cycles.sample_clamp_indirect, cycles.blur_glossy = 5.0, 6.0, 0.5
    scene.render.film_transparent = True
    defaults = export().defaults
    assert defaults.light_paths == LightPaths(1, 2, 3, 4, False, False, 5.0, 6.0, 0.5)
    assert defaults.transparent_film


def test_what_is_not_simulated_is_named():
    add_mesh()
    bpy.context.scene.camera.data.type = "PANO"
    bpy.context.scene.render.use_motion_blur = True
    warnings = "\n".join(export().warnings)
    assert 'Camera "Camera": panoramic cameras are not supported yet; a perspective one is used instead.' in warnings
    assert 'Scene "Scene": motion blur is not supported yet' in warnings


def test_another_camera_is_a_cut(tmp_path):
    from blend import save
    from svgf_blender.export import export_file

    add_mesh()
    scene = bpy.context.scene
    for name, frame, x in (("First", 1, 0), ("Second", 3, 5)):
        scene.timeline_markers.new(name, frame=frame).camera = add_camera((x, -10, 0), name)
    scenes = list(export_file(save(tmp_path / "cut.blend"), frames=range(1, 5)))
    assert [scene.cut for scene in scenes] == [False, False, True, False]
    assert [scene.camera.camera_to_world[0, 3] for scene in scenes] == [0, 0, 5, 5]
    assert [scene.previous_camera.camera_to_world[0, 3] for scene in scenes] == [0, 0, 0, 5]
    (alone,) = export_file(tmp_path / "cut.blend", frames=[3])
    assert alone.cut
