# SPDX-License-Identifier: GPL-3.0-or-later
"""What outlives Blender's engine instances: the renderer with its history, and the thread that owns it.

Blender makes a new engine for each frame of an animation. Sessions are kept by scene and view layer, from the start of
a render job to its end: a new job starts without history, so that its pixels do not depend on what was rendered before.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import bpy
from svgf.devices import Device, open_device
from svgf.errors import DeviceError, Interrupted
from svgf.frame import Frame
from svgf.renderer import Renderer
from svgf.scene import Scene
from svgf.settings import Settings

from .export import Exporter

Key = tuple[int, str]

_sessions: dict[Key, Session] = {}
_leaving: list[Session] = []  # closed, but their threads are still at work
_devices: dict[str, Device] = {}


class Session:
    """The exporter and the renderer of a view layer. All calls of the renderer come from one thread of its own.

    progress: finished share of the frame that is being rendered. reported: warnings that this job has shown. note: why
    another device goes on than the one that was asked for, or an empty string.
    """

    def __init__(self) -> None:
        self.exporter = Exporter()
        self.progress = 0.0
        self.reported: set[str] = set()
        self.note = ""
        self._renderer: Renderer | None = None
        self._device_name = ""
        self._lost: set[str] = set()  # devices that failed
        self._stopping = False
        self._future: Future[Frame] | None = None
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="svgf")

    @property
    def busy(self) -> bool:
        """Whether a frame is in the making."""
        return self._future is not None and not self._future.done()

    def start(self, scene: Scene, settings: Settings, device: str) -> Future[Frame]:
        """Renders the next frame in the background. History goes on unless the settings or the device are others.

        The future raises what open_device and Renderer.render raise.
        """
        self.progress = 0.0
        self._future = self._thread.submit(self._render, scene, settings, device)
        return self._future

    def stop(self) -> None:
        """For good: the frame in the making ends with svgf.Interrupted, as soon as its tree is built."""
        self._stopping = True
        renderer = self._renderer
        if renderer is not None:
            renderer.interrupt()

    def close(self) -> None:
        """Frees the device's memory, at once or when the frame in the making has ended; does not wait for that."""
        if self.busy:
            self.stop()
        else:
            self._renderer = None
        if self._stopping:
            # Its thread may still use the device; and an interrupt that came too late would stop another frame.
            _devices.pop(self._device_name, None)
        self._thread.shutdown(wait=False, cancel_futures=True)

    def join(self) -> None:
        """After close: waits for the thread."""
        self._thread.shutdown(wait=True)

    def _render(self, scene: Scene, settings: Settings, device: str) -> Frame:
        try:
            return self._render_on("cpu" if device in self._lost else device, scene, settings)
        except DeviceError as error:
            name = self._renderer.device.name if self._renderer is not None else self._device_name
            self._renderer = None
            _devices.pop(self._device_name, None)
            if name == "cpu":
                raise
            self._lost.add(device)
            self.note = f"{error} The CPU goes on."
            return self._render_on("cpu", scene, settings)
        finally:
            if self._stopping:
                self._renderer = None

    def _render_on(self, device: str, scene: Scene, settings: Settings) -> Frame:
        renderer = self._renderer
        if renderer is None or renderer.settings != settings or self._device_name != device:
            self._renderer = None  # its memory is free before the next one asks for some
            self._device_name = device
            renderer = self._renderer = Renderer(settings, _device(device))
        return renderer.render(scene, self._set_progress)

    def _set_progress(self, share: float) -> None:
        self.progress = share
        if self._stopping:  # the interrupt came before the frame had begun, which forgets it
            raise Interrupted("The render was cancelled.")


def find_session(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> Session:
    """The session of a view layer, new at the first frame of a job."""
    key = (scene.original.session_uid, view_layer.name)
    if key not in _sessions:
        _sessions[key] = Session()
    return _sessions[key]


def _device(name: str) -> Device:
    """Opening a device takes a moment, so it stays open until the add-on is disabled."""
    if name not in _devices:
        _devices[name] = open_device(name)
    return _devices[name]


@bpy.app.handlers.persistent
def _close_sessions(*_arguments) -> None:
    while _sessions:
        _, session = _sessions.popitem()
        session.close()
        _leaving.append(session)
    _leaving[:] = [session for session in _leaving if session.busy]


def _handler_lists() -> tuple[list, ...]:
    handlers = bpy.app.handlers
    return handlers.render_init, handlers.render_complete, handlers.render_cancel, handlers.load_pre


def register() -> None:
    for handlers in _handler_lists():
        handlers.append(_close_sessions)


def unregister() -> None:
    for handlers in _handler_lists():
        handlers.remove(_close_sessions)
    _close_sessions()
    for session in _leaving:
        session.join()
    _leaving.clear()
    _devices.clear()
