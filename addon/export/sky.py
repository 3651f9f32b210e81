# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky Texture nodes as images, which Cycles renders: its sky models are its own.

A render engine may not start a render of its own while it runs, so that another Blender without a window does it, in
two seconds. Skies are kept by their settings.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from svgf.errors import Interrupted
from svgf.io import exr

from .evaluation.images import Image
from .render_sky import sun_rows

# A sun of half a degree is three pixels wide.
WIDTH = 2048
_SCRIPT = Path(__file__).with_name("render_sky.py")
_KEPT = 8
_SECONDS = 300.0

# Images by settings, or why there is none.
_skies: OrderedDict[str, Image | str] = OrderedDict()
_job: _Job | None = None
# A viewport and a final render, which has a thread of its own, may ask at once.
_lock = threading.Lock()


@dataclass
class _Job:
    settings: str
    process: subprocess.Popen
    folder: tempfile.TemporaryDirectory
    started: float


def sky_settings(node: bpy.types.Node) -> str:
    """All that decides on a sky, as JSON."""
    shared = {prop.identifier for prop in bpy.types.Node.bl_rna.properties}
    own = [prop for prop in node.bl_rna.properties if prop.identifier not in shared and prop.type != "POINTER"]
    values = {prop.identifier: getattr(node, prop.identifier) for prop in own}
    return json.dumps({name: list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
                       for name, value in values.items()})  # fmt: skip


def sky_image(node: bpy.types.Node, should_stop: Callable[[], bool] | None) -> Image | str:
    """Of a Sky Texture node, equirectangular as Environment Texture nodes read it; or a clause that says why there is
    none.

    should_stop: is asked while the sky is rendered; where it says so, Interrupted is raised. None: does not wait. The
    worlds are then tagged for an update once there is a sky, and until then the last one stands in.
    """
    settings = sky_settings(node)
    while True:
        with _lock:
            if settings in _skies or _advance(settings):
                _skies.move_to_end(settings)
                return _skies[settings]
            if should_stop is None:
                ready = [sky for sky in _skies.values() if isinstance(sky, Image)]
                return ready[-1] if ready else "is still being rendered"
        if should_stop():
            raise Interrupted("The export was cancelled.")
        time.sleep(0.02)


def _advance(settings: str) -> bool:
    """Renders one sky after the other; returns whether this one is there."""
    if _job is None:
        _start(settings)
    return _finish() and settings in _skies


def _start(settings: str) -> None:
    global _job
    folder = tempfile.TemporaryDirectory(prefix="svgf-sky-")
    # As a module, Blender has no program of its own; -P: this folder must not hide modules of Blender's.
    blender = [bpy.app.binary_path, "--background", "--factory-startup", "--python-exit-code", "1", "--python"]
    command = blender if bpy.app.binary_path else [sys.executable, "-P"]
    command = [*command, str(_SCRIPT), "--", settings, str(WIDTH), folder.name]
    with open(Path(folder.name) / "log.txt", "wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT)
    _job = _Job(settings, process, folder, time.monotonic())
    if not bpy.app.background:
        bpy.app.timers.register(_announce, first_interval=0.2)


def _finish() -> bool:
    """Whether the job has ended; what came of it is then among the skies."""
    global _job
    if _job.process.poll() is None:
        if time.monotonic() - _job.started < _SECONDS:
            return False
        _job.process.kill()
        _job.process.wait()
    _skies[_job.settings] = _read(_job)
    while len(_skies) > _KEPT:
        _skies.popitem(last=False)
    _job.folder.cleanup()
    _job = None
    return True


def _read(job: _Job) -> Image | str:
    folder = Path(job.folder.name)
    if job.process.returncode:
        lines = (folder / "log.txt").read_text(errors="replace").strip().splitlines()
        return f"could not be rendered ({lines[-1] if lines else 'Blender ended without a word'})"
    pixels = np.ones((WIDTH // 2, WIDTH, 4), np.float32)
    pixels[..., :3] = _color(folder / "sky.exr")
    if (folder / "sun.exr").exists():
        first, last = (round(share * (WIDTH // 2)) for share in sun_rows(json.loads(job.settings), WIDTH))
        pixels[first:last, :, :3] = _color(folder / "sun.exr")
    return Image("Sky", pixels, False, "Linear", "REPEAT")


def _color(path: Path) -> np.ndarray:
    """[H, W, 3], the bottom row first."""
    image = next(image for image in exr.read(path).values() if image.ndim == 3)
    return np.maximum(image[::-1, :, :3], 0)


def _announce() -> float | None:
    """A timer: has the worlds exported again once the job has ended."""
    with _lock:
        if _job is not None and not _finish():
            return 0.1
    for world in bpy.data.worlds:
        world.update_tag()
    return None
