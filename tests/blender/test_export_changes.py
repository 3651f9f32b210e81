# SPDX-License-Identifier: Apache-2.0
"""The cheapest export for each change: what is read again, and that the scene is what a new exporter would make."""

from __future__ import annotations

from dataclasses import asdict

import bpy
import numpy as np
import pytest
from blend import (
    add_cube,
    add_image,
    add_light,
    add_material,
    add_mesh,
    add_world,
    animate,
    link,
    link_texture,
    principled,
)
from svgf.scene import Camera
from svgf_blender.export import Exporter
from svgf_blender.export.timings import changes_of, measure

VIEW = Camera(np.eye(3, 4), (-1.0, 1.0, -1.0, 1.0))
ARRAYS = ("mesh", "object_to_world", "object_id", "material_start", "material_table")


class View:
    """An exporter that hears of edits as a viewport does."""

    def __init__(self) -> None:
        self._exporter = Exporter()
        self._depsgraph = bpy.context.evaluated_depsgraph_get()
        self.scene = self._exporter.export_view(self._depsgraph, VIEW)

    def edit(self, edit) -> dict[str, int]:
        """What an edit costs, of the counters those that are not 0. The scene is then as if exported anew."""
        before = asdict(self._exporter.counters)
        changes = changes_of(edit)
        if changes is not None:
            self.scene = self._exporter.export_view(self._depsgraph, VIEW, changes)
        anew = Exporter().export_view(self._depsgraph, VIEW)
        for name in ARRAYS:
            assert np.array_equal(getattr(self.scene.instances, name), getattr(anew.instances, name)), name
        assert [mesh.positions.tobytes() for mesh in self.scene.meshes] == [m.positions.tobytes() for m in anew.meshes]
        assert self.scene.materials == anew.materials and self.scene.world == anew.world
        assert [(light.name, light.power) for light in self.scene.lights] == [(l.name, l.power) for l in anew.lights]
        after = asdict(self._exporter.counters)
        return {name: after[name] - before[name] for name in after if after[name] != before[name]}


@pytest.fixture
def view():
    """Two cubes of one mesh, a quad, a lamp and a world."""
    cube = add_cube()
    link_texture(add_material("Paint", cube), add_image())
    link("Copy", cube.data, (3, 0, 0))
    add_mesh("Quad")
    add_light("POINT", "Lamp")
    add_world()
    return View()


def test_a_moved_object_is_one_matrix(view):
    cube = bpy.data.objects["Cube"]
    meshes = view.scene.meshes
    assert view.edit(lambda: setattr(cube.location, "x", 5)) == {"exports": 1, "instances": 1}
    instances = view.scene.instances
    moved = instances.object_to_world - instances.previous_object_to_world
    assert np.count_nonzero(moved.any(axis=(1, 2))) == 1 and moved[..., 3].max() == 5
    assert view.scene.meshes is meshes
    assert view.edit(lambda: setattr(cube.location, "x", 6)) == {"exports": 1, "instances": 1}
    assert (view.scene.instances.object_to_world - view.scene.instances.previous_object_to_world)[..., 3].max() == 1


def test_children_and_instances_move_with_their_parent(view):
    empty = link("Empty", None)
    bpy.data.objects["Quad"].parent = bpy.data.objects["Copy"].parent = empty
    view = View()
    assert view.edit(lambda: setattr(empty.location, "z", 2)) == {"exports": 1, "instances": 2}


def test_a_moved_lamp_is_read_again(view):
    lamp = bpy.data.objects["Lamp"]
    assert view.edit(lambda: setattr(lamp.location, "x", 5)) == {"exports": 1, "walks": 1, "lights": 1}
    assert view.scene.lights[0].light_to_world[0, 3] == 5


def test_a_colour_is_one_record(view):
    socket = principled(bpy.data.materials["Paint"]).inputs["Roughness"]
    counted = view.edit(lambda: setattr(socket, "default_value", 0.125))
    assert counted == {"exports": 1, "walks": 1, "materials": 1}


def test_lamp_and_world(view):
    lamp = bpy.data.lights["Lamp"]
    assert view.edit(lambda: setattr(lamp, "energy", 5)) == {"exports": 1, "walks": 1, "lights": 1}
    strength = bpy.context.scene.world.node_tree.nodes["Background"].inputs["Strength"]
    assert view.edit(lambda: setattr(strength, "default_value", 5)) == {"exports": 1, "walks": 1}


def test_an_edited_mesh_is_that_mesh(view):
    data = bpy.data.objects["Cube"].data

    def edit():
        data.vertices[0].co.x = 7
        data.update()

    before = view.scene.meshes
    assert view.edit(edit) == {"exports": 1, "walks": 1, "meshes": 1}
    assert [a is b for a, b in zip(before, view.scene.meshes, strict=True)] == [False, True]


def test_a_new_frame_is_what_is_animated(view):
    """An object that moves, and a mesh with a shape key, which each of its two users deforms for itself."""
    animate(bpy.data.objects["Quad"], "location", (1, 0.0), (2, 1.0), index=0)
    key = bpy.data.objects["Cube"]
    key.shape_key_add(name="Basis")
    large = key.shape_key_add(name="Large")
    large.data[0].co.x = 9
    animate(large, "value", (1, 0.0), (2, 1.0))
    bpy.context.scene.frame_set(1)
    view = View()
    counted = view.edit(lambda: bpy.context.scene.frame_set(2))
    assert counted == {"exports": 1, "walks": 1, "meshes": 2, "instances": 1}


@pytest.mark.parametrize("hide", ["hide_viewport", "visible_camera", "is_holdout"])
def test_visibility_reads_no_mesh(view, hide):
    counted = view.edit(lambda: setattr(bpy.data.objects["Quad"], hide, hide != "visible_camera"))
    assert counted == {"exports": 1, "walks": 1}


def test_selection_and_camera_are_nothing(view):
    assert view.edit(lambda: setattr(bpy.context.scene.camera.location, "x", 1)) == {}


def test_an_object_comes_and_goes(view):
    """Blender says that the mesh of a new object may differ, even where another object has it."""
    counted = view.edit(lambda: link("New", bpy.data.objects["Quad"].data))
    assert counted == {"exports": 1, "walks": 1, "meshes": 1, "instances": 1}
    assert view.edit(lambda: bpy.data.objects.remove(bpy.data.objects["Copy"])) == {"exports": 1, "walks": 1}


def test_timings_count_what_was_exported():
    rows = {row.change: row for row in measure(tries=1)}
    counts = {change: (row.walks, row.meshes, row.instances, row.materials, row.lights) for change, row in rows.items()}
    assert list(counts.values()) == [
        (1, 1, 1, 1, 0),
        (1, 1, 0, 0, 0),
        (1, 1, 1000, 1, 1),
        (0, 0, 1, 0, 0),
        (0, 0, 1000, 0, 0),
        (1, 0, 0, 1, 0),
        (1, 0, 0, 0, 1),
    ]
    assert all(row.milliseconds > 0 for row in rows.values())
