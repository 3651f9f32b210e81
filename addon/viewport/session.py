# SPDX-License-Identifier: GPL-3.0-or-later
"""One view of one scene, from Blender's main thread: what was exported, and what the worker is asked for."""

from __future__ import annotations

import time
import traceback
from dataclasses import replace

import bpy
import numpy as np
from svgf.errors import Error
from svgf.scene import Camera, RenderDefaults, Scene
from svgf.settings import Settings

from ..export import Exporter
from ..export.changes import find_changes
from ..export.exporter import ExportCounters
from ..export.findings import Finding
from .camera import View, same_camera
from .picture import Look
from .resolution import Resolution
from .worker import Request, Result, Worker

# Until the first draw tells the view's camera.
_ANY_CAMERA = Camera(np.eye(3, 4), (-1.0, 1.0, -1.0, 1.0))


class ViewSession:
    """What outlives Blender's engine instances, which come and go with each change of the shading mode.

    engine: token of the instance that exported last; changes that came while there was none are unknown to it.
    drawn: number of the result that is on the screen. camera_findings: of the camera that the view looks through.
    """

    def __init__(self, worker: Worker | None = None) -> None:
        self.engine: object = None
        self.drawn = -1
        self.camera_findings: tuple[Finding, ...] = ()
        self._worker = worker or Worker()
        self._exporter = Exporter()
        self._resolution = Resolution()
        self._scene: Scene | None = None
        self._shown: Scene | None = None  # as of the last request, in full size
        self._request: Request | None = None
        self._error = ""

    @property
    def result(self) -> Result:
        return self._worker.result

    @property
    def counters(self) -> ExportCounters:
        """Of the exports so far."""
        return self._exporter.counters

    @property
    def busy(self) -> bool:
        """Whether a new picture will come by itself."""
        return self._worker.busy or self._resolution.divisor > 1

    @property
    def alive(self) -> bool:
        """Whether the worker's thread runs."""
        return self._worker.alive

    @property
    def has_news(self) -> bool:
        """Whether a draw would show, or ask for, something new."""
        refine = self._resolution.divisor > 1 and self._resolution.is_still(time.monotonic())
        return refine or self.result.number != self.drawn

    @property
    def error(self) -> str:
        """Why the picture is not what the scene is now, or an empty string."""
        return self._error or self.result.error

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is not as in Blender, of the newest export and of the camera."""
        return (*self._exporter.findings, *self.camera_findings) if self._scene else ()

    @property
    def sample_limit(self) -> int:
        return self._request.sample_limit if self._request else 0

    @property
    def divisor(self) -> int:
        """By how much the frame budget has divided the picture's sides."""
        return self._resolution.divisor

    def sync(self, depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None, whole: bool) -> None:
        """Exports what the evaluated depsgraph says has changed. whole: it cannot be trusted to name everything."""
        try:
            whole = whole or self._scene is None
            changes = None if whole else find_changes(depsgraph.updates)
            if whole or changes is not None:
                self._scene = self._exporter.export_view(depsgraph, _ANY_CAMERA, changes, space)
            self._error = ""
        except Error as error:
            self._error = str(error)
        except Exception as error:  # The last picture stays, with the reason; Blender goes on.
            traceback.print_exc()
            self._error = f"The export failed: {error!r}. The traceback is in the console."
        if self._error:
            self._scene = None  # the next one starts from scratch

    def show(
        self,
        view: View,
        defaults: RenderDefaults,
        settings: Settings,
        device: str,
        sample_limit: int,
        look: Look,
        budget: float,
    ) -> None:
        """Asks the worker for a picture, unless it is at work on that very one.

        defaults: with the picture's full size. budget: milliseconds for a frame while something changes; 0: any time.
        """
        if self._scene is None:
            return
        last = self._request
        scene = replace(self._scene, camera=view.camera, defaults=defaults)
        changed = self._shown is None or not _same_content(scene, self._shown)
        self._shown = scene if changed else self._shown
        scene = self._reduced(scene, budget, changed)
        if last is not None and _same_content(scene, last.scene):
            scene = last.scene
        request = Request(scene, settings, device, sample_limit, look, view.part)
        if last is None or not _same_request(request, last):
            self._request = request
            self._worker.submit(request)

    def _reduced(self, scene: Scene, budget: float, changed: bool) -> Scene:
        """The scene with the size that the budget allows."""
        frame, defaults = self.result.frame, scene.defaults
        if frame is not None:
            milliseconds = self.result.milliseconds - frame.timings.get("update", 0.0) + self.result.painting
            self._resolution.measure(milliseconds, frame.width * frame.height)
        divisor = self._resolution.choose(defaults.width * defaults.height, budget, time.monotonic(), changed)
        size = {name: -(-getattr(defaults, name) // divisor) for name in ("width", "height")}
        return replace(scene, defaults=replace(defaults, **size))

    def measure_effects(self) -> None:
        """Asks the worker what each effect costs; a later result tells."""
        self._worker.measure_effects()

    @property
    def measuring(self) -> bool:
        """Whether measure_effects was asked for, and is not done."""
        return self._worker.measuring

    def status(self) -> str:
        """One line for the corner of the view."""
        result = self.result
        if self.error:
            return self.error
        if result.frame is None:
            return "Rendering the first frame"
        parts = [f"Sample {result.samples}/{self.sample_limit}", f"{result.milliseconds + result.painting:.0f} ms"]
        if self.divisor > 1:
            parts.append(f"1/{self.divisor} resolution")
        return " | ".join([*parts, *([result.note] if result.note else [])])

    def stop(self) -> None:
        """The worker ends soon."""
        self._worker.stop()

    def close(self) -> None:
        """The worker has ended."""
        self._worker.close()


def _same_content(a: Scene, b: Scene) -> bool:
    """Whether two scenes differ at most in what is derived from one export. Everything large is kept by identity."""
    return (
        a.frame == b.frame
        and a.defaults == b.defaults
        and a.world == b.world
        and all(getattr(a, name) is getattr(b, name) for name in ("meshes", "materials", "textures", "lights"))
        and _same_placements(a, b)
        and same_camera(a.camera, b.camera)
    )


def _same_placements(a: Scene, b: Scene) -> bool:
    """Where everything is, whatever the exports before say about where it was."""
    names = ("mesh", "object_to_world", "object_id", "material_start", "material_table")
    return a.instances is b.instances or all(
        np.array_equal(getattr(a.instances, name), getattr(b.instances, name)) for name in names
    )


def _same_request(a: Request, b: Request) -> bool:
    return (
        a.scene is b.scene
        and a.settings == b.settings
        and (a.device, a.sample_limit, a.look, a.part) == (b.device, b.sample_limit, b.look, b.part)
    )
