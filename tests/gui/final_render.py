# SPDX-License-Identifier: Apache-2.0
"""F12 in a window: it finishes with the right size, says what it does, and ends soon after Esc, however far it is.

See window.py.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
from window import play, window
from svgf_blender import session
from svgf_blender.engine import SVGFRenderEngine

LONGEST_CANCEL_SECONDS = 0.5
LONG_SAMPLES = 1_000_000


class Job:
    """A render job that Blender runs beside its main loop."""

    def __init__(self, animation: bool = False) -> None:
        self.ended = ""
        self.statuses: set[str] = set()
        handlers = bpy.app.handlers
        self._handlers = [
            (handlers.render_complete, self._end("complete")),
            (handlers.render_cancel, self._end("cancel")),
            (handlers.render_stats, lambda text, *_: self.statuses.add(str(text))),
        ]
        for handler_list, handler in self._handlers:
            handler_list.append(handler)
        with bpy.context.temp_override(window=window()):
            bpy.ops.render.render("INVOKE_DEFAULT", animation=animation)

    def _end(self, how: str) -> Callable[..., None]:
        def end(*_arguments) -> None:
            self.ended = how

        return end

    def wait(self, seconds: float = 60) -> Iterator[float]:
        end = time.monotonic() + seconds
        while not self.ended or bpy.app.is_job_running("RENDER"):
            assert time.monotonic() < end, "The render does not end."
            yield 0.02
        for handler_list, handler in self._handlers:
            handler_list.remove(handler)

    def cancel(self) -> Iterator[float]:
        """Esc, in the window that shows the render. The time from when the engine learns of it is ours."""
        moments.clear()
        pressed = time.monotonic()
        press_escape()
        yield from self.wait(20)
        # Without an entry, Blender ended the job before the engine had begun to wait for a frame.
        ours = moments.get("_wait", 0.0) - moments.get("stop", moments.get("_wait", 0.0))
        print(f"cancelled {time.monotonic() - pressed:.2f} s after Esc, of which {ours:.2f} s are ours", flush=True)
        assert self.ended == "cancel" and ours < LONGEST_CANCEL_SECONDS
        assert not session._sessions


moments: dict[str, float] = {}


def note_the_time_of(owner: type, name: str, before: bool) -> None:
    """In moments, when a method was called first, or when it returned last."""
    method = getattr(owner, name)

    def noted(*arguments):
        if before:
            moments.setdefault(name, time.monotonic())
        try:
            return method(*arguments)
        finally:
            if not before:
                moments[name] = time.monotonic()

    setattr(owner, name, noted)


def press_escape() -> None:
    """From outside, as a user does."""
    x, y = window().width // 2, window().height // 2
    subprocess.run(["xdotool", "mousemove", str(x), str(y), "key", "Escape"], check=True)


def script() -> Iterator[float]:
    note_the_time_of(session.Session, "stop", before=True)  # the engine's answer to Esc
    note_the_time_of(SVGFRenderEngine, "_wait", before=False)
    scene = window().scene
    scene.render.engine, scene.svgf.device = "SVGF", "cpu"
    scene.render.resolution_x, scene.render.resolution_y = 320, 180
    bpy.context.preferences.view.render_display_type = "AREA"

    job = Job()
    yield from job.wait()
    assert job.ended == "complete"

    scene.svgf.samples = LONG_SAMPLES
    for moment in (0.0, 0.1, 0.7, 2.0):  # while it exports, builds, and traces
        job = Job()
        yield moment
        yield from job.cancel()

    job = Job(animation=True)
    yield 0.5
    yield from job.cancel()

    # A mesh whose tree takes longer to build than Esc may take.
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=1000, y_subdivisions=1000)
    for moment in (0.3, 1.0, 1.5):
        job = Job()
        yield moment
        yield from job.cancel()

    scene.svgf.samples = 1
    job = Job()
    yield from job.wait()
    assert job.ended == "complete", "A cancelled job leaves nothing that spoils the next one."


play(script)
