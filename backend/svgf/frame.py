# SPDX-License-Identifier: Apache-2.0
"""What a rendered frame holds."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np


class _Image:
    """A field that holds an array, or a function that makes it when it is first read: images stay on the device until
    someone looks at them. default: its value where none is given, if there is one."""

    def __init__(self, *default: None) -> None:
        self._default = default

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, frame: Frame | None, owner: type) -> np.ndarray:
        if frame is None:  # the dataclass asks for the default
            if self._default:
                return self._default[0]
            raise AttributeError(self._name)
        value = frame.__dict__[self._name]
        if callable(value):
            value = frame.__dict__[self._name] = value()
        return value

    def __set__(self, frame: Frame, value: np.ndarray | Callable[[], np.ndarray]) -> None:
        frame.__dict__[self._name] = value


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """One finished frame: numpy arrays, row 0 on top, float32 unless said. An image that was rendered on a GPU comes to
    the host when it is first read.

    color: [H, W, 3] denoised linear radiance. noisy: [H, W, 3] what the path tracer saw.
    albedo: [H, W, 3] diffuse plus specular albedo; in mirrors and clear glass what they are multiplied by times that of
    what they show, and roughness: [H, W], of that, too. normal: [H, W, 3] world space, zero on the background.
    depth: [H, W] planar, metres, 1e10 on the background. motion: [H, W, 3] previous pixel position minus this one (x
    right, y down, pixels) and expected previous depth minus this depth (metres).
    object_id: int32 [H, W], 0 on the background. variance: [H, W] luminance variance that the filter left over.
    history_length: [H, W] number of frames in the temporal mean.
    alpha: [H, W] share of the pixel that the scene covers, by which color is multiplied; None if the film is opaque.
    motion_error, reset_reason, repaired_values, suppressed_light: [H, W] as ``svgf.diagnostics`` says; None unless the
    settings ask for diagnostics.
    timings: milliseconds per stage. reset: why history was restarted at this frame, empty when it went on.
    """

    frame: int
    color: np.ndarray = _Image()
    noisy: np.ndarray = _Image()
    albedo: np.ndarray = _Image()
    normal: np.ndarray = _Image()
    depth: np.ndarray = _Image()
    motion: np.ndarray = _Image()
    roughness: np.ndarray = _Image()
    object_id: np.ndarray = _Image()
    variance: np.ndarray = _Image()
    history_length: np.ndarray = _Image()
    alpha: np.ndarray | None = _Image(None)
    motion_error: np.ndarray | None = _Image(None)
    reset_reason: np.ndarray | None = _Image(None)
    repaired_values: np.ndarray | None = _Image(None)
    suppressed_light: np.ndarray | None = _Image(None)
    timings: dict[str, float] = field(default_factory=dict)
    reset: str = ""

    @property
    def width(self) -> int:
        return self.color.shape[1]

    @property
    def height(self) -> int:
        return self.color.shape[0]

    def with_images(self, **images: np.ndarray) -> Frame:
        """The same frame with other images in some fields; the rest is not read for it."""
        other = copy.copy(self)
        other.__dict__.update(images)
        return other
