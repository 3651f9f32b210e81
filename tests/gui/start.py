# SPDX-License-Identifier: Apache-2.0
"""From choosing the engine to the first denoised picture in the view: cold, then warm, and where the time goes.

See window.py. Takes a .blend file, such as blender_scenes/build.py makes, and a number of warm starts.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
from window import ARGUMENTS, areas, override, play, space, start_engine, views, window

# After window, which finds them.
from svgf_blender.viewport import worker
from svgf_blender.viewport.draw import PictureTexture
from svgf_blender.viewport.session import ViewSession

LONGEST_SECONDS = 30
moments: dict[str, float] = {}


def script() -> Iterator[float]:
    path, count = ARGUMENTS
    bpy.ops.wm.open_mainfile(filepath=path, load_ui=False)
    yield 0.5
    areas("PROPERTIES")[0].spaces.active.context = "RENDER"
    with override():
        bpy.ops.view3d.view_camera()
    window().scene.render.engine = "BLENDER_WORKBENCH"
    space().shading.type = "RENDERED"
    yield 2.0
    region = next(region for region in areas("VIEW_3D")[0].regions if region.type == "WINDOW")
    print(f"A view of {region.width}x{region.height}, {Path(path).stem}")
    for number in range(1 + int(count)):
        moments.clear()
        start, used = time.perf_counter(), time.process_time()
        start_engine(pixel_size="1", samples=4, budget=50)
        while "drawn" not in moments:
            assert time.perf_counter() < start + LONGEST_SECONDS
            yield 0.02
        steps = ", ".join(f"{name} {(moment - start) * 1e3:.0f}" for name, moment in moments.items())
        used = time.process_time() - used
        print(f"  {'warm' if number else 'cold'} {moments['drawn'] - start:.2f} s, {used:.2f} s of processors; {steps} ms")
        window().scene.render.engine = "BLENDER_WORKBENCH"
        yield 0.3
        while views.sessions_of(window().scene):
            yield 0.05
        yield 0.5


def note_the_end_of(owner: object, name: str, label: str) -> None:
    """In moments, when a function had returned for the first time."""
    function = getattr(owner, name)

    def noted(*arguments, **named):
        result = function(*arguments, **named)
        moments.setdefault(label, time.perf_counter())
        return result

    setattr(owner, name, noted)


def note_the_start_of(owner: object, name: str, label: str) -> None:
    function: Callable = getattr(owner, name)

    def noted(*arguments, **named):
        moments.setdefault(label, time.perf_counter())
        return function(*arguments, **named)

    setattr(owner, name, noted)


note_the_start_of(ViewSession, "sync", "asked to export")
note_the_end_of(ViewSession, "sync", "exported")
note_the_start_of(worker.Worker, "submit", "requested")
note_the_start_of(worker.Renderer, "__init__", "device open")
note_the_end_of(worker.Renderer, "__init__", "renderer made")
note_the_end_of(worker.Renderer, "render", "rendered")
note_the_end_of(worker, "paint", "painted")
note_the_start_of(PictureTexture, "draw_light", "draw begun")
note_the_end_of(PictureTexture, "draw_light", "drawn")
play(script)
