# SPDX-License-Identifier: Apache-2.0
"""What artists do to a viewport while it renders: nothing of it crashes, hangs, leaks or blocks Blender.

See window.py. Takes names of steps, all of them by default. Each step is done a few times first, so that what Blender
and the driver keep for good is there before memory is measured.
"""

from __future__ import annotations

import functools
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
import numpy as np
from window import (
    ARGUMENTS,
    areas,
    drag_edge,
    memory_mb,
    mouse,
    override,
    play,
    session,
    settled,
    space,
    start_engine,
    svgf_blender,
    until,
    views,
    window,
)

# After window, which finds them.
from svgf.settings import DenoiseSettings
from svgf_blender.ui import statistics
from svgf_blender.viewport.session import ViewSession

ENDLESS = 10**6  # samples, so that there is always a frame in the making
LARGEST_GROWTH = 1.05  # of the resident memory, in a step
LONGEST_BLOCK_SECONDS = 0.05  # of the main thread's own time
LONGEST_WAIT_SECONDS = 0.5  # with what other programs on the machine take away
SHORTEST_OF_REFLECTIONS = 4  # frames of history, of those that move; the longest of a pixel is seen to have 9


def script() -> Iterator[float]:
    unknown = set(ARGUMENTS) - {step.__name__ for step in STEPS}
    assert not unknown, unknown
    for step, (few, times) in STEPS.items():
        name = step.__name__
        if ARGUMENTS and name not in ARGUMENTS:
            continue
        areas("PROPERTIES")[0].spaces.active.context = "RENDER"  # with the panels that show what a frame costs
        start_engine(samples=ENDLESS)
        yield from running()
        yield from step(few)
        blocks.reset()
        before, start = memory_mb(), time.monotonic()
        yield from step(times)
        after = memory_mb()
        print(f"{name}: {times} times in {time.monotonic() - start:.1f} s, {before:.0f} -> {after:.0f} MB", flush=True)
        print(blocks, flush=True)
        assert after < LARGEST_GROWTH * before, name
        assert blocks.longest("work") < LONGEST_BLOCK_SECONDS and blocks.longest("time") < LONGEST_WAIT_SECONDS, name
    window().scene.render.engine = "BLENDER_WORKBENCH"
    yield from until(lambda: not our_threads(), "Threads are left.")


def our_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("svgf")]


class Blocks:
    """For each thing that Blender's main thread calls in the add-on, the longest that it takes and works at once."""

    def __init__(self) -> None:
        self._seconds: dict[str, dict[str, float]] = {}

    def reset(self) -> None:
        self._seconds.clear()

    def watch(self, owner: object, *names: str) -> None:
        for name in names:
            setattr(owner, name, self._timed(getattr(owner, name)))

    def watch_panel(self, panel: type[bpy.types.Panel]) -> None:
        timed = self._timed(panel.draw)

        def draw(panel, context) -> None:  # Blender counts the arguments
            timed(panel, context)

        panel.draw = draw

    def longest(self, what: str) -> float:
        return max(seconds[what] for seconds in self._seconds.values())

    def __str__(self) -> str:
        return "\n".join(
            f"    {name}: at most {seconds['work'] * 1e3:.1f} ms of work, {seconds['time'] * 1e3:.1f} ms of time"
            for name, seconds in self._seconds.items()
        )

    def _timed(self, function: Callable[..., object]) -> Callable[..., object]:
        @functools.wraps(function)  # with what marks a persistent handler
        def timed(*arguments) -> object:
            start, work = time.perf_counter(), time.thread_time()
            try:
                return function(*arguments)
            finally:
                seconds = self._seconds.setdefault(function.__qualname__, {"time": 0.0, "work": 0.0})
                seconds["time"] = max(seconds["time"], time.perf_counter() - start)
                seconds["work"] = max(seconds["work"], time.thread_time() - work)

        return timed


def running(seconds: float = 60) -> Iterator[float]:
    """Waits for the first picture."""
    end = time.monotonic() + seconds
    while not views.sessions_of(window().scene) or session().result.frame is None:
        assert time.monotonic() < end
        yield 0.05
    assert not session().error, session().error


def toggles(times: int) -> Iterator[float]:
    """Fast ones, which find their session again, and slow ones, which start anew."""
    for step in range(times):
        space().shading.type = "SOLID" if space().shading.type == "RENDERED" else "RENDERED"
        yield 0.3 if step % 5 == 0 else 0.02
    space().shading.type = "RENDERED"
    yield from running()


def resizes(times: int) -> Iterator[float]:
    """Of the view by its edge, and of the whole window. Nothing is exported."""
    yield 0.5
    before, sizes = replace(session().counters), set()
    edge, width, height = areas("VIEW_3D")[0].width, window().width, window().height
    for step in range(times):
        smaller = 60 * (step % 2 == 0)
        if step % 10 < 8:
            yield from drag_edge(areas("VIEW_3D")[0], edge - smaller - areas("VIEW_3D")[0].width)
        else:
            yield from resize_window(width - smaller, height - smaller)
        sizes.add((window_region().width, window_region().height))

    def is_back() -> bool:
        region, frame = window_region(), session().result.frame
        size = -(-region.width // 4), -(-region.height // 4)
        return abs(areas("VIEW_3D")[0].width - edge) < 5 and (frame.width, frame.height) == size

    yield from until(is_back, "View or picture are not as large as before.")  # for memory is compared
    print(f"    {len(sizes)} sizes, the last one {window_region().width}x{window_region().height}")
    assert session().counters == before and len(sizes) >= min(times, 3), sizes


def resize_window(width: int, height: int) -> Iterator[float]:
    search = ["xdotool", "search", "--onlyvisible", "--class", "blender"]
    found = subprocess.run(search, check=True, capture_output=True, text=True).stdout.split()
    mouse("windowsize", found[-1], width, height)
    yield 0.2


def window_region() -> bpy.types.Region:
    return next(region for region in areas("VIEW_3D")[0].regions if region.type == "WINDOW")


def undo(times: int) -> Iterator[float]:
    with override():
        bpy.ops.ed.undo_push(message="before")
    for step in range(times):
        bpy.data.objects["Cube"].location.x = step * 0.1
        with override():
            bpy.ops.ed.undo_push(message="move")
        yield 0.02
    for action in (bpy.ops.ed.undo, bpy.ops.ed.redo, bpy.ops.ed.undo):
        for _ in range(times - 1):
            with override():
                action()
            yield 0.01
    yield 0.5
    expected = bpy.data.objects["Cube"].location.x
    yield from until(lambda: abs(shown_place()[0] - expected) < 1e-6, "The view does not show what undo brought back.")


def shown_place(each: ViewSession | None = None) -> np.ndarray:
    """Of the only instance, in the newest picture of a view."""
    return (each or session()).result.scene.instances.object_to_world[0, :, 3]


def shown_meshes() -> set[str]:
    return {mesh.name for mesh in session().result.scene.meshes}


def delete(times: int) -> Iterator[float]:
    for _ in range(times):
        with override():
            bpy.ops.mesh.primitive_uv_sphere_add(location=(2, 0, 0))
        yield 0.05
        bpy.data.objects.remove(bpy.context.object)
        yield 0.05
    yield from until(lambda: shown_meshes() == {"Cube"}, "The spheres are still there.")
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    yield from until(lambda: not shown_meshes(), "The cube is still there.")
    assert not session().error, session().error
    with override():
        bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.name = "Cube"
    yield 0.3


def modes(times: int) -> Iterator[float]:
    for _ in range(times):
        for mode in ("EDIT", "SCULPT", "VERTEX_PAINT", "OBJECT"):
            with override():
                bpy.ops.object.mode_set(mode=mode)
            yield 0.3
            if mode == "EDIT":
                for way in (0.1, -0.1):
                    with override():
                        bpy.ops.transform.translate(value=(0, 0, way))
                    yield 0.1
        assert not session().error, session().error


def pixel_sizes(times: int) -> Iterator[float]:
    """Each one is a resize of all images; no mesh is read again."""
    yield 0.5
    before = replace(session().counters)
    for step in range(times):
        window().scene.render.preview_pixel_size = ("8", "4")[step % 2]
        areas("VIEW_3D")[0].tag_redraw()
        yield 0.02
    counters = session().counters
    # Blender says only that the scene has changed, so all is looked at, and nothing found that is new.
    assert replace(counters, exports=before.exports, walks=before.walks) == before, (counters, before)


def two_views(times: int) -> Iterator[float]:
    cube = bpy.data.objects["Cube"]
    for _ in range(times):
        with override():
            bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
        yield from until(lambda: len(areas("VIEW_3D")) == 2, "The view is not split.")
        for area in areas("VIEW_3D"):
            area.spaces.active.shading.type = "RENDERED"
        yield from rendered_views(2)
        cube.location.y += 1
        for each in views.sessions_of(window().scene):
            yield from until(lambda each=each: shown_place(each)[1] == cube.location.y, "A view does not follow.")
            assert not each.error, each.error
        with bpy.context.temp_override(window=window(), area=areas("VIEW_3D")[1]):
            bpy.ops.screen.area_close()
        yield from rendered_views(1)


def rendered_views(count: int) -> Iterator[float]:
    """Waits until so many views, and no others, have a picture."""

    def done() -> bool:
        sessions = views.sessions_of(window().scene)
        return len(sessions) == count and all(each.result.frame is not None for each in sessions)

    yield from until(done, f"There are not {count} views.")


def quad_view(times: int) -> Iterator[float]:
    for _ in range(times):
        for count in (4, 1):
            with override():
                bpy.ops.screen.region_quadview()
            yield from rendered_views(count)


def local_view(times: int) -> Iterator[float]:
    for _ in range(times):
        with override():
            bpy.ops.mesh.primitive_uv_sphere_add(location=(2, 0, 0))
        name = bpy.context.object.name
        yield from until(lambda name=name: shown_meshes() == {"Cube", name}, "The sphere is not there.")
        for expected in ({name}, {"Cube", name}):
            with override():
                bpy.ops.view3d.localview()
            yield 0.5  # Blender moves the view there
            yield from until(lambda expected=expected: shown_meshes() == expected, "Local view shows something else.")
        bpy.data.objects.remove(bpy.context.object)
        yield from until(lambda: shown_meshes() == {"Cube"}, "The sphere is still there.")


def playback(frames: int) -> Iterator[float]:
    """History goes on from frame to frame, and only what is animated is exported.

    Twice. Matt, the cube keeps all the history that something gets that moves. Glossy, it keeps less: a reflection does
    not move as its surface does, is given up where it differs from the new samples (specular_history_clamp), and of two
    signals Frame.history_length tells the shorter one.
    """
    cube = bpy.data.objects["Cube"]
    for frame, x in ((1, -1.0), (frames, 1.0)):
        cube.location.x = x
        cube.keyframe_insert("location", frame=frame)
    material = cube.active_material or bpy.data.materials.new("Cube")  # the cube may be a new one
    cube.active_material = material
    level = material.node_tree.nodes["Principled BSDF"].inputs["Specular IOR Level"]
    for level.default_value, kept in ((0.5, SHORTEST_OF_REFLECTIONS), (0.0, int(DenoiseSettings().history_frames))):
        yield from play_animation(frames, kept)
    level.default_value = 0.5
    cube.animation_data_clear()
    yield 0.2


def play_animation(frames: int, kept: int) -> Iterator[float]:
    """kept: frames that the longest history of a pixel has afterwards, if as many were rendered: Blender does not wait
    for a frame that takes long."""
    scene = window().scene
    scene.frame_start, scene.frame_end = 1, frames
    scene.frame_set(1)
    yield 0.5
    before, restarts, shown = replace(session().counters), set(), set()
    with override():
        bpy.ops.screen.animation_play()
    end = time.monotonic() + 300
    while len(shown) < frames and time.monotonic() < end:
        yield 0.02
        shown.add(scene.frame_current)
        restarts.add(session().result.reset)
    with override():
        bpy.ops.screen.animation_cancel(restore_frame=False)
    result, counters = session().result, session().counters
    longest = result.frame.history_length.max()
    print(f"    {len(shown)} frames, {result.frames} rendered, history {longest:.0f}, restarts {restarts}, {counters}")
    assert len(shown) == frames and len(restarts) == 1
    assert longest >= min(result.frames, kept)
    exports = counters.exports - before.exports
    assert 0 < counters.instances - before.instances <= exports
    # Blender says with each frame that the scene has changed, so all objects are looked at, and no mesh is read.
    assert replace(counters, exports=before.exports, walks=before.walks, instances=before.instances) == before


def engine_switch(times: int) -> Iterator[float]:
    for _ in range(times):
        for engine in ("BLENDER_WORKBENCH", "SVGF"):
            window().scene.render.engine = engine
            yield 0.2
    yield from running()


def files(times: int) -> Iterator[float]:
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/scene.blend"
        bpy.ops.wm.save_as_mainfile(filepath=path)
        for _ in range(times):
            bpy.ops.wm.open_mainfile(filepath=path)
            yield 0.3
            start_engine(samples=ENDLESS)  # Blender opens files with Solid shading
            yield from running()
        bpy.ops.wm.read_homefile(app_template="")
        yield 0.5


def final_render(times: int) -> Iterator[float]:
    """F12 in the window, with the viewport at work."""
    render = window().scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 96, 54, 100
    for _ in range(times):
        bpy.ops.render.render()
        yield 0.3
    assert not session().error
    yield from running()


def disable(times: int) -> Iterator[float]:
    for _ in range(times):
        svgf_blender.unregister()
        assert not our_threads(), our_threads()
        space().shading.type = "SOLID"  # else Blender would draw with EEVEE, which takes its time and memory
        yield 0.1
        svgf_blender.register()
        start_engine(samples=ENDLESS)
        yield from running()
    window().scene.svgf.viewport_samples = 1
    yield from settled()


# How often each is done before memory is measured, and then.
STEPS = {
    toggles: (40, 200),
    resizes: (20, 100),
    undo: (10, 20),
    delete: (3, 10),
    modes: (1, 3),
    pixel_sizes: (20, 100),
    two_views: (1, 3),
    quad_view: (1, 3),
    local_view: (1, 3),
    playback: (12, 48),
    engine_switch: (3, 10),
    files: (2, 5),
    final_render: (2, 4),
    disable: (2, 5),
}

blocks = Blocks()
blocks.watch(views, "update", "draw", "_tick", "_draw_data", "_stop_all", "_forget_engines")
for panel in (statistics.SVGF_PT_cost, statistics.SVGF_PT_effects, statistics.SVGF_PT_warnings):
    blocks.watch_panel(panel)
play(script)
