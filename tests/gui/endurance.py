# SPDX-License-Identifier: Apache-2.0
"""What artists do to a viewport while it renders: nothing of it crashes, hangs or leaks.

See window.py. Takes names of steps, all of them by default.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
from window import (
    ARGUMENTS,
    areas,
    memory_mb,
    override,
    play,
    session,
    settled,
    space,
    start_engine,
    svgf_blender,
    views,
    window,
)

ENDLESS = 10**6  # samples, so that there is always a frame in the making
LONGEST_BLOCK_SECONDS = 0.05  # of the main thread's own time
LONGEST_WAIT_SECONDS = 0.5  # with what other programs on the machine take away


def script() -> Iterator[float]:
    measure = Blocks()
    for step in STEPS:
        name = step.__name__
        if ARGUMENTS and name not in ARGUMENTS:
            continue
        start_engine(samples=ENDLESS)
        yield from running()
        measure.reset()
        start = time.monotonic()
        yield from step()
        blocked = f"at most {measure.longest_work * 1e3:.0f} ms of work, {measure.longest * 1e3:.0f} ms of time at once"
        print(f"{name}: {time.monotonic() - start:.1f} s, {blocked}, {memory_mb():.0f} MB", flush=True)
        if name not in {"disable", "files"}:
            assert measure.longest_work < LONGEST_BLOCK_SECONDS and measure.longest < LONGEST_WAIT_SECONDS, name
    window().scene.render.engine = "BLENDER_WORKBENCH"
    yield 1.0
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("svgf")]


class Blocks:
    """The longest time that Blender's main thread spends in the add-on at once, and the longest that it works there."""

    def __init__(self) -> None:
        self.reset()
        for name in ("update", "draw"):
            setattr(views, name, self._timed(getattr(views, name)))

    def reset(self) -> None:
        self.longest = self.longest_work = 0.0

    def _timed(self, function: Callable[..., None]) -> Callable[..., None]:
        def timed(*arguments) -> None:
            start, work = time.perf_counter(), time.thread_time()
            function(*arguments)
            self.longest = max(self.longest, time.perf_counter() - start)
            self.longest_work = max(self.longest_work, time.thread_time() - work)

        return timed


def running(seconds: float = 30) -> Iterator[float]:
    """Waits for the first picture."""
    end = time.monotonic() + seconds
    while not views.sessions_of(window().scene) or session().result.frame is None:
        assert time.monotonic() < end
        yield 0.05
    assert not session().error, session().error


def toggles() -> Iterator[float]:
    """Fast ones, which find their session again, and slow ones, which start anew."""
    yield from toggle(20, 0.02)
    before = memory_mb()
    yield from toggle(150, 0.02)
    yield from toggle(30, 0.3)
    assert memory_mb() < 1.05 * before, (before, memory_mb())
    space().shading.type = "RENDERED"
    yield from running()


def toggle(times: int, seconds: float) -> Iterator[float]:
    for _ in range(times):
        space().shading.type = "SOLID" if space().shading.type == "RENDERED" else "RENDERED"
        yield seconds


def undo() -> Iterator[float]:
    with override():
        bpy.ops.ed.undo_push(message="before")
    for step in range(20):
        bpy.data.objects["Cube"].location.x = step * 0.1
        with override():
            bpy.ops.ed.undo_push(message="move")
        yield 0.02
    for action in (bpy.ops.ed.undo, bpy.ops.ed.redo, bpy.ops.ed.undo):
        for _ in range(18):
            with override():
                action()
            yield 0.01
    yield 0.5
    expected = bpy.data.objects["Cube"].location.x
    shown = session().result.scene.instances.object_to_world[0, 0, 3]
    assert abs(shown - expected) < 1e-6, (shown, expected)


def delete() -> Iterator[float]:
    for _ in range(10):
        with override():
            bpy.ops.mesh.primitive_uv_sphere_add(location=(2, 0, 0))
        yield 0.05
        bpy.data.objects.remove(bpy.context.object)
        yield 0.05
    yield 0.3
    assert len(session().result.scene.meshes) == 1 and not session().error
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    yield 0.5
    assert not session().result.scene.meshes and not session().error
    with override():
        bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.name = "Cube"
    yield 0.3


def edit_mode() -> Iterator[float]:
    for mode in ("EDIT", "SCULPT", "OBJECT"):
        with override():
            bpy.ops.object.mode_set(mode=mode)
        yield 0.3
        if mode == "EDIT":
            for _ in range(5):
                with override():
                    bpy.ops.transform.translate(value=(0, 0, 0.1))
                yield 0.1
    assert not session().error, session().error


def pixel_sizes() -> Iterator[float]:
    """Each one is a resize of all images; no mesh is read again."""
    for step in range(100):
        window().scene.render.preview_pixel_size = ("8", "4")[step % 2]
        areas("VIEW_3D")[0].tag_redraw()
        yield 0.02
        if step == 1:  # what other changes left over has been exported by now
            meshes = session().counters.meshes
    assert session().counters.meshes == meshes


def two_views() -> Iterator[float]:
    with override():
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    yield 0.5
    for area in areas("VIEW_3D"):
        area.spaces.active.shading.type = "RENDERED"
    yield 1.0
    assert len(views.sessions_of(window().scene)) == 2
    bpy.data.objects["Cube"].location.y = 1
    yield 1.0
    for each in views.sessions_of(window().scene):
        assert each.result.scene.instances.object_to_world[0, 1, 3] == 1 and not each.error
    areas("VIEW_3D")[1].type = "TEXT_EDITOR"
    yield 0.5
    assert len(views.sessions_of(window().scene)) == 1


def quad_view() -> Iterator[float]:
    with override():
        bpy.ops.screen.region_quadview()
    yield 1.5
    assert len(views.sessions_of(window().scene)) == 4
    with override():
        bpy.ops.screen.region_quadview()
    yield 0.5
    assert len(views.sessions_of(window().scene)) == 1


def local_view() -> Iterator[float]:
    with override():
        bpy.ops.mesh.primitive_uv_sphere_add(location=(2, 0, 0))
    yield 0.3
    assert len(session().result.scene.meshes) == 2
    with override():
        bpy.ops.view3d.localview()
    yield 0.7
    assert [mesh.name for mesh in session().result.scene.meshes] == [bpy.context.object.name]
    with override():
        bpy.ops.view3d.localview()
    yield 0.7
    assert len(session().result.scene.meshes) == 2
    bpy.data.objects.remove(bpy.context.object)
    yield 0.2


def playback() -> Iterator[float]:
    """History goes on from frame to frame, and only what is animated is exported."""
    scene, cube = window().scene, bpy.data.objects["Cube"]
    scene.frame_start, scene.frame_end = 1, 48
    for frame, x in ((1, -1.0), (48, 1.0)):
        cube.location.x = x
        cube.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    yield 0.5
    meshes, seen = session().counters.meshes, set()
    with override():
        bpy.ops.screen.animation_play()
    end = time.monotonic() + 60
    while scene.frame_current < 40 and time.monotonic() < end:
        yield 0.02
        seen.add(session().result.reset)
    with override():
        bpy.ops.screen.animation_cancel(restore_frame=False)
    print("restarts", seen, session().counters)
    assert session().counters.meshes == meshes
    assert session().result.frame.history_length.max() > 20
    yield 0.2


def engine_switch() -> Iterator[float]:
    for engine in ("BLENDER_WORKBENCH", "SVGF") * 5:
        window().scene.render.engine = engine
        yield 0.2
    yield from running()


def files() -> Iterator[float]:
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/scene.blend"
        bpy.ops.wm.save_as_mainfile(filepath=path)
        for _ in range(5):
            bpy.ops.wm.open_mainfile(filepath=path)
            yield 0.3
            start_engine(samples=ENDLESS)  # Blender opens files with Solid shading
            yield from running()
        bpy.ops.wm.read_homefile(app_template="")
        yield 0.5


def final_render() -> Iterator[float]:
    """F12 in the window, with the viewport at work."""
    render = window().scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 96, 54, 100
    for _ in range(2):
        bpy.ops.render.render()
        yield 0.3
    assert not session().error
    yield from running()


def disable() -> Iterator[float]:
    for _ in range(5):
        svgf_blender.unregister()
        assert not [thread for thread in threading.enumerate() if thread.name.startswith("svgf")]
        space().shading.type = "SOLID"  # else Blender would draw with EEVEE, which takes its time and memory
        yield 0.1
        svgf_blender.register()
        start_engine(samples=ENDLESS)
        yield from running()
    window().scene.svgf.viewport_samples = 1
    yield from settled()


STEPS = (
    *(toggles, undo, delete, edit_mode, pixel_sizes, two_views, quad_view, local_view, playback, engine_switch),
    *(files, final_render, disable),
)
play(script)
