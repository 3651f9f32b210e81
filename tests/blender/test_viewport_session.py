# SPDX-License-Identifier: Apache-2.0
"""From what Blender says has changed to the least that is exported, and to the request for the next picture."""

from __future__ import annotations

from operator import attrgetter

import bpy
import numpy as np
import pytest
from blend import add_cube, add_image, add_light, add_material, add_mesh, add_world, link_texture, principled
from svgf.scene import Camera, RenderDefaults
from svgf.settings import Settings
from svgf_blender.viewport.camera import View
from svgf_blender.viewport.picture import Look
from svgf_blender.viewport.session import ViewSession

counts = attrgetter("exports", "full", "meshes", "instances", "materials", "lights")
FIRST = View(Camera(np.eye(3, 4), (-1.0, 1.0, -0.5, 0.5)), (24, 12))
SECOND = View(Camera(np.eye(3, 4), (-0.9, 1.1, -0.5, 0.5)), (24, 12))
SIZE = RenderDefaults(24, 12, bounces=1)


class RecordingWorker:
    """Takes requests and renders nothing."""

    def __init__(self) -> None:
        from svgf_blender.viewport.worker import Result

        self.requests, self.result, self.busy = [], Result(), False

    def submit(self, request) -> None:
        self.requests.append(request)


@pytest.fixture
def world():
    """A cube with a material and an image, a plane and a lamp."""
    cube = add_cube("Cube")
    material = add_material("Paint", cube)
    link_texture(material, add_image("Image"))
    add_mesh("Plane", location=(0, 0, -1)).data.materials.append(add_material("Floor"))
    add_light("POINT", energy=10)
    add_world()


@pytest.fixture
def session(world):
    """A session that has exported all, and is told of each evaluation as a view would be."""
    session = ViewSession(RecordingWorker())

    def tell(_scene, depsgraph):
        session.sync(depsgraph, None, whole=False)

    bpy.context.view_layer.update()
    session.sync(bpy.context.evaluated_depsgraph_get(), None, whole=True)
    bpy.app.handlers.depsgraph_update_post.append(tell)
    yield session
    bpy.app.handlers.depsgraph_update_post.remove(tell)


def show(session, view=FIRST, defaults=SIZE, **changes):
    options = {"settings": Settings(), "device": "cpu", "sample_limit": 4, "look": Look(), "budget": 0, **changes}
    session.show(view, defaults, *options.values())
    return session._worker.requests


def exported(session, change) -> tuple:
    """How much (exports, full ones, meshes, instances, materials, lights) a change costs."""
    before = counts(session.counters)
    change()
    bpy.context.view_layer.update()
    assert not session.error
    return tuple(after - then for after, then in zip(counts(session.counters), before, strict=True))


def test_first_export_is_of_everything(session):
    assert counts(session.counters) == (1, 1, 2, 2, 2, 1)


def objects():
    return bpy.data.objects


def edit_mesh():
    mesh = objects()["Cube"].data
    mesh.vertices[0].co.z = 3
    mesh.update()


def color(value):
    principled(bpy.data.materials["Floor"]).inputs["Base Color"].default_value = (*value, 1)


@pytest.mark.parametrize(
    ("change", "cost"),
    [
        (lambda: None, (0, 0, 0, 0, 0, 0)),
        (lambda: setattr(objects()["Camera"], "location", (1, 2, 3)), (0, 0, 0, 0, 0, 0)),
        (lambda: setattr(objects()["Camera"].data, "lens", 20), (0, 0, 0, 0, 0, 0)),
        (lambda: setattr(objects()["Cube"], "location", (1, 2, 3)), (1, 0, 0, 1, 0, 0)),
        (lambda: objects()["Cube"].select_set(False), (1, 0, 0, 0, 0, 0)),
        (lambda: color((1, 0, 0)), (1, 0, 0, 0, 1, 0)),
        (edit_mesh, (1, 0, 1, 0, 0, 0)),
        (lambda: setattr(bpy.data.lights[0], "energy", 20), (1, 0, 0, 0, 0, 1)),
        (lambda: setattr(objects()["Lamp"], "location", (1, 2, 3)), (1, 0, 0, 0, 0, 1)),
        (lambda: objects()["Plane"].hide_set(True), (1, 0, 0, 0, 0, 0)),
        (lambda: bpy.data.objects.remove(objects()["Plane"]), (1, 0, 0, 0, 0, 0)),
        (lambda: objects()["Cube"].modifiers.new("Bevel", "BEVEL"), (1, 0, 1, 0, 0, 0)),
    ],
    ids=[
        *("nothing", "camera", "lens", "object", "selection", "material", "mesh"),
        *("power", "lamp", "hidden", "deleted", "modifier"),
    ],
)
def test_cost_of_a_change(session, change, cost):
    assert exported(session, change) == cost


def test_hidden_object_comes_back(session):
    exported(session, lambda: objects()["Plane"].hide_set(True))
    assert exported(session, lambda: objects()["Plane"].hide_set(False))[2:4] == (1, 1)
    show(session)
    assert len(session._worker.requests[-1].scene.meshes) == 2


def test_painted_image_is_read_again(session):
    image = bpy.data.images["Image"]

    def paint():
        image.pixels.foreach_set(np.tile(np.float32([1, 0, 0, 1]), 4))
        image.update()
        image.update_tag()

    exported(session, paint)
    texture = show(session)[-1].scene.textures[0]
    assert (texture.pixels[0, 0] == [255, 0, 0, 255]).all()


def test_same_picture_is_asked_for_once(session):
    for _ in range(3):
        requests = show(session)
    assert len(requests) == 1
    exported(session, lambda: objects()["Cube"].select_set(False))
    assert len(show(session)) == 1, "A selection changes no picture."
    show(session, SECOND)
    assert requests[1].scene.meshes is requests[0].scene.meshes and session.counters.full == 1


def test_selection_after_a_move_changes_no_picture(session):
    """Although the export then says that the object has come to rest."""
    exported(session, lambda: setattr(objects()["Cube"], "location", (1, 0, 0)))
    requests = show(session)
    exported(session, lambda: objects()["Cube"].select_set(False))
    assert len(show(session)) == len(requests) == 1


@pytest.mark.parametrize(
    "changes",
    [{"settings": Settings(seed=1)}, {"device": "reference"}, {"sample_limit": 9}, {"look": Look("normal")}],
    ids=lambda changes: next(iter(changes)),
)
def test_options_make_a_request_but_no_scene(session, changes):
    first, second = show(session) and show(session, **changes)
    assert second.scene is first.scene


def test_size_and_view_make_a_scene(session):
    show(session)
    first, second = show(session, defaults=RenderDefaults(12, 6, bounces=1))
    assert second.scene is not first.scene and second.scene.meshes is first.scene.meshes


def test_engine_that_has_not_seen_all_exports_all(session):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    show(session)
    session.sync(depsgraph, None, whole=True)
    assert counts(session.counters) == (2, 2, 4, 2, 2, 1), "Read again, and found to be the same."
    assert len(show(session)) == 1


def test_empty_scene_without_camera(session):
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    bpy.context.view_layer.update()
    assert not session.error and not show(session)[-1].scene.meshes


def test_failed_export_is_shown_and_made_up_for(session, monkeypatch):
    from svgf_blender.export import exporter

    show(session)
    with monkeypatch.context() as patched:
        patched.setattr(exporter.Exporter, "export_view", lambda *_: 1 / 0)
        objects()["Cube"].location.x = 1
        bpy.context.view_layer.update()
        assert "ZeroDivisionError" in session.error and session.error == session.status()
        assert len(show(session)) == 1
    objects()["Cube"].location.x = 2
    bpy.context.view_layer.update()
    assert session.error == "" and len(show(session)) == 2


def test_budget_makes_the_picture_coarser_while_the_view_moves(session, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("svgf_blender.viewport.session.time.monotonic", lambda: now[0])
    monkeypatch.setattr("svgf_blender.viewport.resolution._FIRST_PIXELS", 6 * 3)
    first = show(session, budget=50)[-1].scene.defaults
    assert (first.width, first.height) == (6, 3) and session.busy and "1/4" not in session.status()
    now[0] = 1.0
    assert session.has_news, "A draw asks for the whole resolution."
    whole = show(session, budget=50)[-1].scene.defaults
    assert (whole.width, whole.height) == (24, 12)
    assert show(session, SECOND, budget=50)[-1].scene.defaults.width == 6
    assert show(session, SECOND, budget=0)[-1].scene.defaults.width == 24
