# SPDX-License-Identifier: Apache-2.0
"""Pictures of a scene in the viewport: through the camera, after an orbit, after an object was moved, of each overlay,
with a transparent film and a border, in four views, and of the panels.

See window.py. Takes a folder for pictures and a .blend file, such as blender_scenes/build.py makes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
from mathutils import Quaternion
from window import (
    ARGUMENTS,
    areas,
    drag_edge,
    override,
    picture,
    play,
    session,
    settled,
    space,
    start_engine,
    views,
    window,
)

# After window, which finds them.
from svgf_blender.ui.statistics import SVGF_PT_effects
from svgf_blender.viewport.picture import OVERLAYS


def script() -> Iterator[float]:
    _folder, path = ARGUMENTS
    name = Path(path).stem
    bpy.ops.wm.open_mainfile(filepath=path, load_ui=False)
    yield 0.5
    space().overlay.show_overlays = False
    areas("PROPERTIES")[0].spaces.active.context = "RENDER"
    with override():
        bpy.ops.view3d.view_camera()
    yield 0.5
    start = time.monotonic()
    start_engine(pixel_size="2", samples=32, budget=100)
    while not views.sessions_of(window().scene) or session().result.frame is None:
        yield 0.02
    print(f"first picture after {time.monotonic() - start:.2f} s")
    yield from picture(f"{name}_first")
    yield from settled(120)
    yield from picture(f"{name}_camera")

    view = space().region_3d
    view.view_perspective = "PERSP"
    view.view_distance = 3.0
    view.view_matrix = bpy.context.scene.camera.matrix_world.inverted()
    for _ in range(8):
        view.view_rotation = Quaternion((0, 0, 1), 0.03) @ view.view_rotation
        yield 0.3
    yield from picture(f"{name}_orbit")
    print("after the orbit", session().status(), session().result.reset, session().counters)
    yield from settled(120)
    yield from picture(f"{name}_orbit_settled")

    moved = max((each for each in bpy.data.objects if each.type == "MESH"), key=_is_movable)
    for _ in range(4):
        moved.location.z += 0.1
        yield 0.3
    yield from picture(f"{name}_moved")
    yield from settled(120)
    yield from picture(f"{name}_moved_settled")
    print("moved", moved.name, session().counters)

    settings = window().scene.svgf
    for overlay in OVERLAYS:
        settings.viewport_overlay = overlay
        yield from settled(120)
        yield from picture(f"{name}_overlay_{overlay}")
    settings.viewport_overlay = "result"

    window().scene.render.film_transparent = True
    with override():
        bpy.ops.view3d.render_border(xmin=150, xmax=420, ymin=100, ymax=330)
    yield from settled(120)
    yield from picture(f"{name}_transparent_border")
    with override():
        bpy.ops.view3d.clear_render_border()
        bpy.ops.screen.region_quadview()
    yield from settled(120)
    yield from picture(f"{name}_quad")
    with override():
        bpy.ops.screen.region_quadview()

    window().scene.render.film_transparent = False
    yield from drag_edge(areas("VIEW_3D")[0], -window().width // 4)
    bpy.ops.svgf.measure_effects()
    yield from settled(120)
    yield from picture(f"{name}_panels")


def _is_movable(each: bpy.types.Object) -> tuple[bool, int]:
    """The object with the most triangles that is smaller than a room."""
    return max(each.dimensions) < 2.5, len(each.data.polygons)


SVGF_PT_effects.bl_options = set()  # open from the start
play(script)
