# SPDX-License-Identifier: Apache-2.0
"""Blender quits with the add-on enabled, while a view and a final render are at work. Its exit code tells how it went.

See window.py. Takes nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
from window import play, session, start_engine, views, window

LONGEST_SECONDS = 30


def script() -> Iterator[float]:
    scene = start_engine(samples=10**6)
    end = time.monotonic() + LONGEST_SECONDS
    while not views.sessions_of(scene) or session().result.frame is None:
        assert time.monotonic() < end
        yield 0.05
    scene.svgf.samples = 10**6
    bpy.context.preferences.view.render_display_type = "NONE"
    with bpy.context.temp_override(window=window()):
        bpy.ops.render.render("INVOKE_DEFAULT")
    yield 1.0
    assert session().busy and bpy.app.is_job_running("RENDER")
    print("quits", flush=True)
    bpy.ops.wm.quit_blender()
    yield LONGEST_SECONDS
    raise AssertionError("Blender goes on.")


play(script)
