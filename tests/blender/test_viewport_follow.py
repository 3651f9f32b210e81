# SPDX-License-Identifier: Apache-2.0
"""Motion and history between scenes that were exported one by one, but not all rendered."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from blend import add_camera, add_cube, add_light, add_mesh, add_world, export
from svgf_blender.export import Exporter
from svgf_blender.viewport.follow import follow, restart_reason


def exported(exporter, **changes):
    for name, location in changes.items():
        bpy.data.objects[name].location = location
    return export(previous=exporter)


def test_first_scene_stands_still():
    add_cube("Cube")
    exporter = Exporter()
    exported(exporter)
    first = follow(exported(exporter, Cube=(1, 0, 0)), None)
    assert first.frame == 1 and first.previous_camera is first.camera
    assert np.array_equal(first.instances.previous_object_to_world, first.instances.object_to_world)


def test_motion_is_from_what_was_rendered_last():
    add_cube("Cube")
    exporter = Exporter()
    first = follow(exported(exporter), None)
    exported(exporter, Cube=(1, 0, 0))  # never rendered
    second = follow(exported(exporter, Cube=(3, 0, 0)), first)
    moved = second.instances.object_to_world - second.instances.previous_object_to_world
    assert moved[0, :, 3].tolist() == [3, 0, 0] and second.frame == 2
    third = follow(exported(exporter), second)
    assert np.array_equal(third.instances.previous_object_to_world, third.instances.object_to_world)


def test_camera_moves_from_the_view_that_was_rendered_last():
    add_cube()
    scene = export()
    first = follow(scene, None)
    turned = replace(scene, camera=replace(scene.camera, window=(-2.0, 2.0, -1.0, 1.0)))
    assert follow(turned, first).previous_camera is first.camera


def test_new_and_deleted_objects():
    add_cube("Old")
    add_mesh("Gone")
    exporter = Exporter()
    first = follow(exported(exporter), None)
    bpy.data.objects.remove(bpy.data.objects["Gone"])
    add_cube("New", (5, 0, 0))
    second = follow(exported(exporter, Old=(0, 2, 0)), first)
    moved = (second.instances.object_to_world - second.instances.previous_object_to_world)[:, 1, 3]
    assert sorted(moved) == [0, 2] and all(mesh.previous_positions is None for mesh in second.meshes)
    assert follow(replace(second, instances=first.instances, meshes=first.meshes), second).frame == 3


def test_deformation_is_from_what_was_rendered_last():
    mesh = add_mesh().data
    exporter = Exporter()
    first = follow(exported(exporter), None)
    for height in (1.0, 2.0):  # the first one is never rendered
        mesh.vertices[0].co.z = height
        mesh.update()
        scene = exported(exporter)
    second = follow(scene, first)
    assert second.meshes[0].previous_positions is first.meshes[0].positions
    third = follow(exported(exporter), second)
    assert third.meshes[0].previous_positions is None
    assert follow(exported(exporter), third).meshes[0] is third.meshes[0], "Nothing to upload."


def test_edited_topology_has_no_motion():
    obj = add_mesh()
    exporter = Exporter()
    first = follow(exported(exporter), None)
    obj.modifiers.new("Subdivision", "SUBSURF")
    assert follow(exported(exporter), first).meshes[0].previous_positions is None


def test_everything_deleted():
    add_cube("Cube")
    exporter = Exporter()
    first = follow(exported(exporter), None)
    bpy.data.objects["Cube"].hide_viewport = True
    depsgraph = bpy.context.evaluated_depsgraph_get()
    empty = follow(exporter.export_view(depsgraph, first.camera), first)
    assert not empty.meshes
    bpy.data.objects["Cube"].hide_viewport = False
    assert follow(exported(exporter), empty).frame == 3


def test_restart_reasons():
    cube = add_cube("Cube")
    lamp = add_light("POINT", energy=10).data
    exporter = Exporter()
    before = exported(exporter)

    def reason() -> str:
        nonlocal before
        last, before = before, exported(exporter)
        return restart_reason(before, last)

    assert reason() == "" and restart_reason(before, None) == ""
    cube.location.x = 1
    assert reason() == ""
    lamp.energy = 20
    assert reason() == "the lights changed"
    cube.data.materials.append(bpy.data.materials.new("Paint"))
    bpy.data.materials["Paint"].metallic = 1.0
    assert reason() == "the materials changed"
    add_world()
    assert reason() == "the world changed"
    add_camera((1, 1, 1), "Other")
    assert reason() == ""
    bpy.context.scene.frame_set(3)
    lamp.energy = 30
    assert reason() == "", "An animated lamp."
    bpy.context.scene.frame_set(1)
    assert reason() == "frame 1 does not follow frame 3"
