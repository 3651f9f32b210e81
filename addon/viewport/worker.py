# SPDX-License-Identifier: GPL-3.0-or-later
"""The thread that renders for one view, and owns the renderer and its device. Nothing here knows Blender."""

from __future__ import annotations

import math
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from svgf.devices import Device, open_device
from svgf.effects import Effects
from svgf.errors import DeviceError, Error, Interrupted
from svgf.frame import Frame
from svgf.renderer import Renderer
from svgf.scene import Scene
from svgf.settings import Settings

from .follow import follow, restart_reason
from .picture import OVERLAYS, Look, PictureMemory, paint

_JOIN_SECONDS = 0.02
_STATISTICS_SECONDS = 0.25  # between readings of images that only panels show
_RUNS = 4  # launches with and without each effect that is measured
_LUMINANCE = (0.2126, 0.7152, 0.0722)

Part = tuple[float, float, float, float]
WHOLE: Part = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Request:
    """What a view wants to see.

    scene: as exported, with the view's camera and size; the same object means that nothing changed. sample_limit:
    frames of a scene that stands still, after which the worker sleeps. look: what is shown of them. part: left, bottom,
    right and top of the picture in the view, which is 1 wide and high.
    """

    scene: Scene
    settings: Settings
    device: str
    sample_limit: int
    look: Look = Look()
    part: Part = WHOLE


@dataclass(frozen=True, eq=False)
class Result:
    """What the worker has come to. A new one replaces it; it never changes.

    number: counts pictures and messages. request: the one that picture answers, as paint makes it. samples: frames
    since the view came to rest. reset: why history was last restarted. frames: frames since then. milliseconds: the
    newest frame, until it could be painted. painting: milliseconds from there to picture. noise: standard deviation of
    the picture's luminance as a share of its mean, NaN where unknown. history: the longest of a pixel, in frames. Both
    are renewed a few times a second. costs: milliseconds that each effect adds to a frame, if they were asked for.
    device: the hardware. error: what stops the picture from being renewed. note: what the user should know besides.
    """

    number: int = 0
    request: Request | None = None
    scene: Scene | None = None
    frame: Frame | None = None
    picture: np.ndarray | None = None
    samples: int = 0
    reset: str = ""
    frames: int = 0
    milliseconds: float = 0.0
    painting: float = 0.0
    noise: float = math.nan
    history: float = 0.0
    costs: Mapping[Effects, float] = field(default_factory=dict)
    device: str = ""
    error: str = ""
    note: str = ""


class Worker:
    """Renders the newest request again and again until its sample limit, one after the other without a queue."""

    def __init__(self, open_device: Callable[[str], Device] = open_device) -> None:
        self.result = Result()
        self._open_device = open_device
        self._condition = threading.Condition()
        self._request: Request | None = None
        self._rendering: Request | None = None  # at this moment
        self._tracing = False  # it is not being denoised yet
        self._measuring = False  # asked to, and not done yet
        self._stopping = False
        # Daemon, so that a Blender that ends without disabling the add-on is not held up.
        self._thread = threading.Thread(target=self._run, name="svgf view", daemon=True)
        # Of the thread alone:
        self._memory = PictureMemory()
        self._renderer: Renderer | None = None
        self._device_name = ""
        self._lost: set[str] = set()  # devices that failed
        self._done: Request | None = None  # the last request that was rendered
        self._failed: Request | None = None  # not tried again
        self._counted = -math.inf  # when noise and history were last read, in seconds
        self._mean: np.ndarray | None = None  # [H, W, 3] colour of all frames since the view came to rest
        self._alpha: np.ndarray | None = None  # [H, W] of the same frames
        self._squares: np.ndarray | None = None  # [H, W] their luminance's sum of squared distances from it

    def submit(self, request: Request) -> None:
        """Takes the place of the last request. A frame that is being rendered is finished first, unless it takes more
        than twice as long: then a coarser picture is wanted at once. While it is traced that costs no history.
        """
        with self._condition:
            self._request = request
            if self._tracing and self._rendering is not None and _pixels(self._rendering) > 2 * _pixels(request):
                self._interrupt()
            if not self._stopping and not self._thread.is_alive():
                self._thread.start()
            self._condition.notify()

    def measure_effects(self) -> None:
        """The next result says what each effect of the scene costs. Until then no frame is rendered."""
        with self._condition:
            self._measuring = True
            self._condition.notify()

    @property
    def measuring(self) -> bool:
        return self._measuring

    @property
    def busy(self) -> bool:
        """Whether there will be a new result without a new request."""
        return self._thread.is_alive() and self._has_work()

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    def stop(self) -> None:
        """Soon the thread ends by itself, and frees the device's memory."""
        with self._condition:
            self._stopping = True
            self._condition.notify()
        self._interrupt()

    def close(self) -> None:
        """Stops the thread and waits for its end."""
        self.stop()
        while self._thread.is_alive():
            self._thread.join(_JOIN_SECONDS)
            self._interrupt()  # again, because the renderer may only just be made

    def _interrupt(self) -> None:
        renderer = self._renderer
        if renderer is not None:
            renderer.interrupt()

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._stopping or self._has_work())
                if self._stopping:
                    break
                request = self._rendering = self._request
            try:
                self._serve(request)
            except Interrupted:
                pass  # to stop, or for a newer request of fewer pixels
            except DeviceError as error:
                self._drop_device(request, error)
            except Error as error:
                self._fail(request, str(error))
            except BaseException as error:  # The viewport shows whatever it is, and lives on.
                traceback.print_exc()
                self._fail(request, f"svgf failed: {error!r}. The traceback is in the console.")
            finally:
                self._rendering = None
        self._renderer = None

    def _has_work(self) -> bool:
        request, done = self._request, self._done
        if request is None or request is self._failed:
            return False
        result = self.result
        return (
            self._is_new(request)
            or result.samples < request.sample_limit
            or self._measuring
            or (done.look, done.part) != (request.look, request.part)
            or bool(result.error)  # of another request, so it is to be taken back
        )

    def _is_new(self, request: Request) -> bool:
        done = self._done
        return (
            done is None
            or request.scene is not done.scene
            or request.settings != done.settings
            or request.device != done.device
        )

    def _serve(self, request: Request) -> None:
        result = self.result
        undiagnosed = _diagnoses(request) and (result.frame is None or result.frame.reset_reason is None)
        if self._is_new(request) or result.samples < request.sample_limit or undiagnosed:
            result = self._render(request)
        measuring = self._measuring
        if measuring:
            result = self._with_costs(request, result)
        start = time.perf_counter()
        picture = paint(result.frame, request.look, self._memory)
        painting = (time.perf_counter() - start) * 1e3
        # In this order, so that the worker seems at rest only when its result can be seen; in _fail as well.
        self._publish(replace(result, request=request, picture=picture, painting=painting, error=""))
        self._done = request
        if measuring:
            self._measuring = False

    def _render(self, request: Request) -> Result:
        start = time.perf_counter()
        renderer = self._prepare(request)
        last, new = self.result, self._is_new(request)
        scene = follow(request.scene, last.scene) if new or last.scene is None else last.scene
        if new and self._done is not None:
            reason = restart_reason(request.scene, self._done.scene)
            if reason:
                renderer.reset(reason)
        self._tracing = True
        frame = renderer.render(scene, self._note_progress)
        samples = 1 if new or frame.reset else last.samples + 1
        if request.settings.method == "none":
            frame = self._averaged(frame, samples)
        if frame.alpha is not None:
            frame = self._with_mean_alpha(frame, samples)
        milliseconds = (time.perf_counter() - start) * 1e3
        noise, history = last.noise, last.history
        if samples >= request.sample_limit or time.monotonic() >= self._counted + _STATISTICS_SECONDS:
            noise, history = _noise(frame), float(frame.history_length.max())
            self._counted = time.monotonic()
        return replace(
            last,
            scene=scene,
            frame=frame,
            samples=samples,
            reset=frame.reset or last.reset,
            frames=1 if frame.reset else last.frames + 1,
            milliseconds=milliseconds,
            noise=noise,
            history=history,
            device=renderer.device.description,
        )

    def _note_progress(self, share: float) -> None:
        self._tracing = share < 1.0

    def _prepare(self, request: Request) -> Renderer:
        """The renderer of a request, a new one where the settings or the device are others."""
        device = "cpu" if request.device in self._lost else request.device
        renderer, settings = self._renderer, replace(request.settings, diagnostics=_diagnoses(request))
        if renderer is not None and settings == replace(renderer.settings, diagnostics=settings.diagnostics):
            renderer.settings = settings  # keeps its history
        if renderer is None or renderer.settings != settings or self._device_name != device:
            opened = renderer.device if renderer is not None and self._device_name == device else None
            self._renderer = renderer = None  # its memory is free before the next one asks for some
            self._device_name = device
            renderer = self._renderer = Renderer(settings, opened or self._open_device(device), interactive=True)
            if self.result.frame is not None:
                renderer.reset("the settings changed" if opened else "the device changed")
        return renderer

    def _with_costs(self, request: Request, result: Result) -> Result:
        """The result with what each effect costs; the picture does not depend on it, whatever goes wrong."""
        from svgf.bench.effects import measure  # seldom needed, so that views do not wait for it

        defaults = request.scene.defaults
        size = defaults.width, defaults.height
        device, bounces = self._prepare(request).device, request.settings.bounces
        try:
            rows = measure(device, request.scene.name, request.scene, size, bounces, _RUNS)
        except (DeviceError, Interrupted):
            raise
        except Exception as error:
            traceback.print_exc()
            return replace(result, note=f"What effects cost could not be measured: {error!r}.")
        return replace(
            result, costs={Effects[row.what]: row.on_ms - row.off_ms for row in rows if row.what in Effects.__members__}
        )

    def _averaged(self, frame: Frame, samples: int) -> Frame:
        """Without a denoiser, the mean of all frames since the view came to rest is the picture."""
        color = frame.color.astype(np.float64)
        if samples == 1:
            self._mean, self._squares = color, np.zeros(color.shape[:2])
        else:  # Welford's update, which does not cancel
            difference = color - self._mean
            self._mean = self._mean + difference / samples
            self._squares = self._squares + (difference @ _LUMINANCE) * ((color - self._mean) @ _LUMINANCE)
        variance = self._squares / max(samples * (samples - 1), 1)
        return frame.with_images(color=self._mean.astype(np.float32), variance=variance.astype(np.float32))

    def _with_mean_alpha(self, frame: Frame, samples: int) -> Frame:
        """No denoiser looks at it, so what one frame says of a silhouette is ragged."""
        self._alpha = frame.alpha if samples == 1 else self._alpha + (frame.alpha - self._alpha) / np.float32(samples)
        return frame.with_images(alpha=self._alpha)

    def _drop_device(self, request: Request, error: DeviceError) -> None:
        """The processor goes on where the GPU failed."""
        renderer, self._renderer = self._renderer, None
        if (renderer.device.name if renderer else self._device_name) == "cpu":
            self._fail(request, str(error))
        else:
            self._lost.add(request.device)
            self._publish(replace(self.result, note=f"{error} The CPU goes on."))

    def _fail(self, request: Request, message: str) -> None:
        self._publish(replace(self.result, error=message))
        self._failed = request
        self._measuring = False

    def _publish(self, result: Result) -> None:
        self.result = replace(result, number=self.result.number + 1)


def _pixels(request: Request) -> int:
    return request.scene.defaults.width * request.scene.defaults.height


def _diagnoses(request: Request) -> bool:
    """Whether what is shown is among what the denoiser tells only when asked."""
    return OVERLAYS[request.look.overlay].diagnoses


def _noise(frame: Frame) -> float:
    """What Result.noise says."""
    mean, deviation = float(frame.color.mean()), float(np.sqrt(np.maximum(frame.variance, 0)).mean())
    return deviation / mean if mean > 0 and deviation > 0 else math.nan
