# SPDX-License-Identifier: Apache-2.0
"""The viewport of Blender's default scene: what each change exports, restarts and shows.

See window.py. Takes a folder for pictures.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
import numpy as np
from mathutils import Quaternion
from window import override, picture, play, session, settled, space, start_engine, views
from svgf_blender.viewport.picture import OVERLAYS

draw_times: list[float] = []


def script() -> Iterator[float]:
    scene = start_engine()
    yield from settled()
    counters = session().counters
    assert (counters.exports, counters.full, counters.meshes) == (1, 1, 1), counters
    assert session().result.reset == "first frame" and session().result.samples == 8
    yield from picture("cube")

    drawn, draws, used = session().result.number, len(draw_times), time.process_time()
    yield 2.0
    assert session().result.number == session().drawn == drawn, "At its sample limit a view rests."
    assert len(draw_times) == draws, "At rest nothing is drawn."
    print(f"at rest: {time.process_time() - used:.2f} s of processors in 2 s, {draws} draws before")

    yield from orbit()
    assert session().counters.exports == 1, "Orbiting exports nothing."
    assert session().result.reset == "first frame", "Orbiting keeps history."
    assert session().result.frame.history_length.max() > 8
    yield from picture("orbit")

    bpy.data.objects["Cube"].location.x = 1.5
    yield from settled()
    assert (counters.exports, counters.meshes, counters.instances) == (2, 1, 2), counters
    assert session().result.reset == "first frame"
    yield from picture("moved")

    bpy.data.objects["Cube"].select_set(False)
    yield from settled()
    assert (counters.meshes, counters.instances, counters.materials) == (1, 2, 1), counters
    material = bpy.data.objects["Cube"].active_material
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.1, 0.05, 1)
    yield from settled()
    assert (counters.meshes, counters.instances, counters.materials) == (1, 2, 2), counters
    assert session().result.reset == "the materials changed"
    bpy.data.lights["Light"].energy *= 2
    yield from settled()
    assert counters.lights == 2 and session().result.reset == "the lights changed"
    yield from picture("red")

    mesh = bpy.data.objects["Cube"].data
    mesh.vertices[0].co.z += 1
    mesh.update()
    yield from settled()
    assert counters.meshes == 2 and counters.full == 1, counters

    for overlay in OVERLAYS:
        scene.svgf.viewport_overlay = overlay
        yield from settled()
        yield from picture(f"overlay_{overlay}")
    scene.svgf.viewport_overlay = "result"

    with override():
        bpy.ops.view3d.view_camera()
    yield 1.0  # Blender turns the view smoothly
    yield from settled()
    scene.svgf.viewport_overlay = "normal"
    yield from settled()
    assert outline_matches(scene), "The camera's frame is where Blender draws it."
    scene.svgf.viewport_overlay = "result"
    yield from settled()
    yield from picture("camera")
    exports = counters.exports
    for kind, said in (("PANO", ["panoramic cameras are not supported"]), ("PERSP", [])):
        scene.camera.data.type = kind
        yield 1.0
        assert [finding.text.partition(" yet;")[0] for finding in session().findings] == said
    assert counters.exports == exports, "What is wrong with the camera is known without an export."
    with override():
        bpy.ops.view3d.view_axis(type="TOP")
        bpy.ops.view3d.view_selected(use_all_regions=False)
    space().region_3d.view_perspective = "ORTHO"
    yield 1.0
    yield from settled()
    assert session().result.scene.camera.projection.name == "ORTHOGRAPHIC"
    yield from picture("orthographic")

    scene.svgf.method, scene.svgf.viewport_overlay = "none", "split"
    yield from settled()
    assert session().result.reset == "the settings changed"
    noisy, mean = session().result.frame.noisy, session().result.frame.color
    assert np.abs(np.diff(mean, axis=0)).mean() < np.abs(np.diff(noisy, axis=0)).mean()


def orbit(steps: int = 6) -> Iterator[float]:
    view = space().region_3d
    for _ in range(steps):
        view.view_rotation = Quaternion((0, 0, 1), 0.05) @ view.view_rotation
        yield 0.2
    yield from settled()


def outline_matches(scene: bpy.types.Scene) -> bool:
    """Whether a vertex of the cube that Blender projects to the view is on the silhouette that svgf sees there."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d

    cube = bpy.data.objects["Cube"]
    frame = session().result.frame
    surface = frame.object_id > 0
    with override():
        region, view = bpy.context.region, bpy.context.region_data
        points = [location_3d_to_region_2d(region, view, cube.matrix_world @ v.co) for v in cube.data.vertices]
    scale = np.array([frame.width / region.width, frame.height / region.height])
    corners = np.array(points) * scale
    columns, rows = np.flatnonzero(surface.any(axis=0)), np.flatnonzero(surface[::-1].any(axis=1))
    seen = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1])
    expected = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    print("outline", seen, expected)
    return bool(np.abs(seen - expected).max() <= 1.0)


def note_draws() -> None:
    draw = views.draw

    def noted(*arguments) -> None:
        draw_times.append(time.monotonic())
        draw(*arguments)

    views.draw = noted


note_draws()
play(script)
