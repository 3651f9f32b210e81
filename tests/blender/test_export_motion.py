# SPDX-License-Identifier: Apache-2.0
"""Animations: the state at the previous frame, what is shared between frames, and parts that equal the whole."""

from __future__ import annotations

from dataclasses import fields, is_dataclass

import bpy
import numpy as np
import pytest
from blend import (
    add_cube,
    add_geometry_nodes,
    add_light,
    add_material,
    add_mesh,
    animate,
    instance_of,
    link,
    save,
    validate,
)
from svgf.errors import InputError
from svgf_blender.export import export_file


def frames_of(tmp_path, frames, **options) -> list:
    scenes = list(export_file(save(tmp_path / "animation.blend"), frames=frames, **options))
    for scene in scenes:
        validate(scene)
    return scenes


def assert_equal(a, b, path="scene") -> None:
    """Equality of dataclasses and arrays, all the way down."""
    if is_dataclass(a):
        for item in fields(a):
            assert_equal(getattr(a, item.name), getattr(b, item.name), f"{path}.{item.name}")
    elif isinstance(a, tuple):
        assert len(a) == len(b), path
        for index, pair in enumerate(zip(a, b, strict=True)):
            assert_equal(*pair, f"{path}[{index}]")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and np.array_equal(a, b), path
    else:
        assert a == b, path


def add_arm() -> bpy.types.Object:
    """A cube that a bone turns, half a radian each frame."""
    bpy.ops.object.armature_add()
    armature = bpy.context.object
    bone = armature.pose.bones[0]
    bone.rotation_mode = "XYZ"
    animate(bone, "rotation_euler", (0, 0.0), (10, 5.0), index=2)
    arm = add_cube("Arm")
    arm.modifiers.new("Armature", "ARMATURE").object = armature
    arm.vertex_groups.new(name=bone.name).add(range(8), 1.0, "ADD")
    return arm


def add_swelling() -> bpy.types.Object:
    """A cube with a shape key that doubles it between frames 2 and 4."""
    cube = add_cube("Swelling")
    cube.shape_key_add(name="Basis")
    key = cube.shape_key_add(name="Large")
    for point in key.data:
        point.co *= 2
    animate(key, "value", (2, 0.0), (4, 1.0))
    return cube


def test_moving_object_and_camera(tmp_path):
    cube = add_cube("Moving")
    add_mesh("Resting", location=(0, 0, -2))
    animate(cube, "location", (0, 0.0), (10, 10.0), index=0)
    animate(bpy.context.scene.camera, "location", (0, -10.0), (10, 0.0), index=1)
    for frame, scene in zip((1, 2, 3), frames_of(tmp_path, (1, 2, 3)), strict=True):
        assert scene.frame == frame and not scene.cut
        instances = scene.instances
        moving, resting = instance_of(scene, "Moving"), instance_of(scene, "Resting")
        assert instances.object_to_world[moving, 0, 3] == pytest.approx(frame)
        assert instances.previous_object_to_world[moving, 0, 3] == pytest.approx(frame - 1, abs=1e-6)
        assert np.array_equal(instances.object_to_world[resting], instances.previous_object_to_world[resting])
        assert scene.camera.camera_to_world[1, 3] == pytest.approx(frame - 10)
        assert scene.previous_camera.camera_to_world[1, 3] == pytest.approx(frame - 11)


@pytest.mark.parametrize("add", [add_arm, add_swelling])
def test_deformation(tmp_path, add):
    add()
    scenes = frames_of(tmp_path, (3, 4))
    for scene in scenes:
        assert scene.meshes[0].previous_positions is not None
        assert not np.allclose(scene.meshes[0].previous_positions, scene.meshes[0].positions)
    first, second = (scene.meshes[0] for scene in scenes)
    assert second.previous_positions is first.positions
    assert second.triangles.shape == first.triangles.shape


def test_deformation_that_comes_to_rest(tmp_path):
    cube = add_swelling()
    for curve in _curves(cube.data.shape_keys):
        curve.extrapolation = "CONSTANT"
    meshes = [scene.meshes[0] for scene in frames_of(tmp_path, range(1, 8))]
    assert [mesh.previous_positions is not None for mesh in meshes] == [False, False, True, True, False, False, False]
    assert meshes[0] is meshes[1] and meshes[4] is meshes[5] is meshes[6]
    assert meshes[4] is not meshes[3] and meshes[4].positions is meshes[3].positions


def _curves(owner):
    return owner.animation_data.action.layers[0].strips[0].channelbags[0].fcurves


def test_topology_change_has_no_previous_positions(tmp_path):
    cube = add_cube()
    modifier = cube.modifiers.new("Array", "ARRAY")
    animate(modifier, "count", (1, 1), (2, 2))
    scenes = frames_of(tmp_path, (1, 2))
    assert len(scenes[1].meshes[0].positions) == 16
    assert all(scene.meshes[0].previous_positions is None for scene in scenes)


def test_what_does_not_change_is_the_same_object(tmp_path):
    animate(add_cube("Moving"), "location", (0, 0.0), (10, 10.0), index=0)
    add_material("Paint", bpy.data.objects["Moving"])
    add_light("POINT", shadow_soft_size=0)
    add_arm()
    first, second, third = frames_of(tmp_path, (1, 2, 3))
    row, arm = instance_of(first, "Moving"), instance_of(first, "Arm")
    assert first.meshes[row] is second.meshes[row] is third.meshes[row]
    assert second.meshes[arm] is not third.meshes[arm]
    assert second.meshes[arm].triangles is not None
    assert first.materials is second.materials is third.materials
    assert first.lights is second.lights and first.camera is second.camera and first.world is second.world
    assert np.array_equal(first.instances.object_id, third.instances.object_id)


def test_nothing_moves_nothing_new(tmp_path):
    add_cube()
    first, second = frames_of(tmp_path, (1, 2))
    assert first.meshes is second.meshes and first.instances is second.instances and first.camera is second.camera


def test_first_instance_hidden(tmp_path):
    """Instances keep their mesh, and with it their deformation, when the object that came first disappears."""
    cube = add_cube("A")
    for name in ("B", "C"):
        link(name, cube.data, (3, 0, 0))
    cube.hide_render = False
    cube.keyframe_insert("hide_render", frame=1)
    cube.hide_render = True
    cube.keyframe_insert("hide_render", frame=2)
    first, second = frames_of(tmp_path, (1, 2))
    assert len(first.instances.mesh) == 3 and len(second.instances.mesh) == 2
    assert first.meshes[0] is second.meshes[0]
    assert np.array_equal(first.instances.object_id[1:], second.instances.object_id)


def test_object_that_appears_has_not_moved(tmp_path):
    cube = add_cube("Late")
    add_mesh()
    animate(cube, "location", (0, 0.0), (10, 10.0), index=0)
    for frame, hidden in ((1, True), (2, False)):
        cube.hide_render = hidden
        cube.keyframe_insert("hide_render", frame=frame)
    first, second, third = frames_of(tmp_path, (1, 2, 3))
    assert len(first.instances.mesh) == 1
    late = instance_of(second, "Late")
    assert np.array_equal(second.instances.object_to_world[late], second.instances.previous_object_to_world[late])
    assert third.instances.previous_object_to_world[late, 0, 3] == pytest.approx(2)


def test_moving_instances(tmp_path):
    """Instances of geometry nodes and of an animated collection know where they were."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=2, y_subdivisions=2)
    grid = bpy.context.object

    def cubes_on_points(tree, start, end):
        instance, cube = (tree.nodes.new(f"GeometryNode{name}") for name in ("InstanceOnPoints", "MeshCube"))
        tree.links.new(start, instance.inputs["Points"])
        tree.links.new(cube.outputs["Mesh"], instance.inputs["Instance"])
        tree.links.new(instance.outputs[0], end)

    add_geometry_nodes(grid, cubes_on_points)
    animate(grid, "location", (0, 0.0), (10, 20.0), index=2)
    (scene,) = frames_of(tmp_path, (5,))
    instances = scene.instances
    assert len(instances.mesh) == 9 and len(scene.meshes) == 1
    moved = instances.object_to_world - instances.previous_object_to_world
    assert np.allclose(moved[:, 2, 3], 2, atol=1e-5) and np.allclose(np.delete(moved.reshape(9, 12), 11, axis=1), 0)


def add_everything() -> None:
    """A bit of everything that moves, with particles that remember."""
    add_arm()
    add_swelling()
    cube = add_cube("Moving", (0, 3, 0))
    animate(cube, "location", (0, 0.0), (10, 10.0), index=0)
    animate(bpy.context.scene.camera, "rotation_euler", (0, 0.0), (10, 0.5), index=2)
    lamp = add_light("AREA")
    animate(lamp.data, "energy", (0, 0.0), (10, 100.0))


def test_part_of_an_animation_equals_the_whole(tmp_path):
    add_everything()
    path = save(tmp_path / "animation.blend")
    whole = {scene.frame: scene for scene in export_file(path, frames=range(1, 7))}
    for frames in ((4,), (5, 6), (2, 4, 5)):
        for scene in export_file(path, frames=frames):
            assert_equal(scene, whole[scene.frame])


def test_frames_and_size_default_to_the_file(tmp_path):
    add_cube()
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.frame_step = 3, 7, 2
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 200, 100, 50
    path = save(tmp_path / "defaults.blend")
    reports = []
    scenes = list(export_file(path, report=lambda done, total: reports.append((done, total))))
    assert [scene.frame for scene in scenes] == [3, 5, 7]
    assert (scenes[0].defaults.width, scenes[0].defaults.height) == (100, 50)
    assert reports == [(0, 3), (1, 3), (2, 3), (3, 3)]
    (other,) = export_file(path, frames=[3], size=(30, 60))
    assert (other.defaults.width, other.defaults.height) == (30, 60)
    left, right, bottom, top = other.camera.window
    assert (right - left) / (top - bottom) == pytest.approx(0.5)


def test_frames_can_be_left_early(tmp_path):
    add_cube()
    path = save(tmp_path / "early.blend")
    scenes = export_file(path, frames=range(1, 100))
    next(scenes)
    scenes.close()
    assert next(export_file(path, frames=[1])).frame == 1


def test_scripts_of_the_file_are_not_run(tmp_path):
    cube = add_cube()
    driver = cube.driver_add("location", 0).driver
    driver.expression = "__import__('os').getpid()"
    (scene,) = frames_of(tmp_path, (1,))
    assert scene.warnings[0].startswith("Scripts and Python drivers of the file are not run")
    assert scene.instances.object_to_world[0, 0, 3] == 0


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.blend", None, "There is no file"),
        ("empty.blend", b"", "cannot open"),
        ("text.blend", b"BLENDER is not enough", "cannot open"),
        ("truncated.blend", "half", "cannot open"),
    ],
)
def test_files_that_cannot_be_read(tmp_path, name, content, message):
    path = tmp_path / name
    if content == "half":
        add_cube()
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
        content = path.read_bytes()[: path.stat().st_size // 2]
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        next(export_file(path))
    assert name in str(error.value) and error.value.hint


@pytest.mark.parametrize("missing", ["camera", "mesh"])
def test_file_with_nothing_to_render(tmp_path, missing):
    if missing == "camera":
        add_cube()
        bpy.data.objects.remove(bpy.context.scene.camera)
    path = save(tmp_path / "nothing.blend")
    with pytest.raises(InputError, match=f"has no {missing}"):
        next(export_file(path, frames=[1]))
    # The next file is none the worse for it.
    bpy.ops.wm.read_factory_settings(use_empty=True)
