# SPDX-License-Identifier: Apache-2.0
"""What a view costs besides tracing, for pictures of 1920x1080: painting in the worker's thread, upload and draw in
Blender's main thread. Medians, in milliseconds; Blender's window system decides what they mean (see its GPU backend).

See window.py. Takes nothing.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
import gpu
import numpy as np
from window import areas, play, space, window

# After window, which finds them.
from svgf.frame import Frame
from svgf_blender.viewport.draw import PictureTexture
from svgf_blender.viewport.picture import Look, PictureMemory, paint
from svgf_blender.viewport.worker import WHOLE

WIDTH, HEIGHT, REPEATS = 1920, 1080, 20


class CostEngine(bpy.types.RenderEngine):
    """Uploads and draws a new picture, and then the same one again, each time that it is asked."""

    bl_idname = "SVGF_COST"
    bl_label = "Cost of a view"
    times: dict[str, list[float]] = {}
    picture: np.ndarray

    def view_update(self, context, depsgraph) -> None:
        pass

    def view_draw(self, context, depsgraph) -> None:
        texture, scene, region, picture = PictureTexture(), depsgraph.scene, context.region, type(self).picture
        self._time("upload", lambda: texture.upload(picture, smooth=True))
        for name in ("first draw", "draw again"):
            self._time(name, lambda: texture.draw_light(self, scene, picture, WHOLE, region))

    def _time(self, name: str, action: Callable[[], None]) -> None:
        """Until the main thread goes on, and until the GPU is done."""
        start, work = time.perf_counter(), time.thread_time()
        action()
        worked, returned = time.thread_time() - work, time.perf_counter() - start
        gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")  # waits for the GPU
        done = time.perf_counter() - start
        for what, seconds in ((", work", worked), (", main thread", returned), (", GPU too", done)):
            self.times.setdefault(name + what, []).append(seconds * 1e3)


def script() -> Iterator[float]:
    random = np.random.default_rng(0)
    frame = random_frame(random)
    for name in ("result", "split", "normal", "repaired_values"):
        times, memory = [], PictureMemory()
        for _ in range(9):
            start = time.perf_counter()
            CostEngine.picture = paint(frame, Look(name), memory)
            times.append((time.perf_counter() - start) * 1e3)
        CostEngine.times[f"paint {name}"] = times
    bpy.utils.register_class(CostEngine)
    window().scene.render.engine = "SVGF_COST"
    space().shading.type = "RENDERED"
    for _ in range(REPEATS):
        CostEngine.picture = CostEngine.picture.copy()
        areas("VIEW_3D")[0].tag_redraw()
        yield 0.1
    backend = f"{gpu.platform.backend_type_get()}, {gpu.platform.renderer_get()}"
    print(f"A picture of {WIDTH}x{HEIGHT}, {backend}")
    for name, times in CostEngine.times.items():
        print(f"  {name:26} {statistics.median(times):8.2f} ms  ({len(times)} times)")
    assert len(CostEngine.times["draw again, work"]) >= REPEATS // 2
    space().shading.type = "SOLID"
    window().scene.render.engine = "SVGF"
    yield 0.5
    bpy.utils.unregister_class(CostEngine)


def random_frame(random: np.random.Generator) -> Frame:
    def image(*channels: int) -> np.ndarray:
        return random.random((HEIGHT, WIDTH, *channels), np.float32)

    return Frame(
        frame=1,
        color=image(3),
        noisy=image(3),
        albedo=image(3),
        normal=image(3),
        depth=image(),
        motion=image(3),
        roughness=image(),
        object_id=np.ones((HEIGHT, WIDTH), np.int32),
        variance=image(),
        history_length=image(),
        repaired_values=image(),
    )


play(script)
