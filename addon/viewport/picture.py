# SPDX-License-Identifier: GPL-3.0-or-later
"""What a viewport shows of a frame: the result, or one of the images that it is made from."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from svgf.diagnostics import ResetReason
from svgf.display import write_display
from svgf.frame import Frame

_LARGEST_HALF = 65504.0  # beyond it Blender's view holds infinity, which draws black
_MOTION_RANGE_PX = 16.0
_HISTORY_RANGE_LOG2 = 5.0
_ERROR_RANGE_LOG10 = 2.0  # of the standard deviation, below radiance 1

# Of the overlay: colour and what it is called in the overlay's description.
RESET_COLORS = {
    ResetReason.KEPT: ((0.18, 0.18, 0.18), "grey has some"),
    ResetReason.BACKGROUND: ((0.0, 0.0, 0.0), "black is background"),
    ResetReason.RESTARTED: ((0.15, 0.35, 0.9), "blue all of it restarted"),
    ResetReason.BAD_MOTION: ((1.0, 0.0, 0.6), "pink its motion is no number"),
    ResetReason.OUTSIDE: ((0.1, 0.7, 0.3), "green entered the picture"),
    ResetReason.OTHER_OBJECT: ((0.9, 0.2, 0.1), "red another object was there"),
    ResetReason.OTHER_DEPTH: ((0.9, 0.55, 0.1), "orange something nearer or farther was there"),
    ResetReason.OTHER_NORMAL: ((0.9, 0.9, 0.2), "yellow what was there faced elsewhere"),
    ResetReason.LIGHT_CHANGED: ((0.9, 0.9, 0.9), "white the light on it changed"),
}
_RESET_COLORS = np.array([color for _, (color, _) in sorted(RESET_COLORS.items())], np.float32)
_BAD_COLOR = (1.0, 0.0, 0.6)
_MOTION_ERROR_RANGE_PX = 2.0


@dataclass(frozen=True)
class Look:
    """overlay: a key of OVERLAYS. split: where noisy ends and denoised begins, share of the width."""

    overlay: str = "result"
    split: float = 0.5


@dataclass(frozen=True)
class Overlay:
    """number: in Blender's files. is_data: shown as it is, without a view transform. image: [H, W] or [H, W, 3].
    diagnoses: whether it needs a frame with the images of ``svgf.diagnostics``."""

    label: str
    description: str
    number: int
    is_data: bool
    image: Callable[[Frame], np.ndarray]
    diagnoses: bool = False


def _depth(frame: Frame) -> np.ndarray:
    """White at the nearest surface of the frame, a quarter at the farthest one, black in the background."""
    surface = frame.object_id > 0
    depth = frame.depth[surface]
    image = np.zeros(surface.shape, np.float32)
    if depth.size:
        near, far = depth.min(), depth.max()
        image[surface] = 1.0 - 0.75 * (depth - near) / max(far - near, 1e-6)
    return image


def _motion(frame: Frame) -> np.ndarray:
    """Where a surface comes from: red to the right, green upwards; grey stands still."""
    return np.dstack(
        [
            0.5 + frame.motion[..., 0] / (2 * _MOTION_RANGE_PX),
            0.5 - frame.motion[..., 1] / (2 * _MOTION_RANGE_PX),
            np.full(frame.depth.shape, 0.5, np.float32),
        ]
    )


def _noise(frame: Frame) -> np.ndarray:
    """Decades of the standard deviation: 0.01 is black, 1 and more are white."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return 1.0 + 0.5 * np.log10(np.maximum(frame.variance, 0)) / _ERROR_RANGE_LOG10


def _reset_reasons(frame: Frame) -> np.ndarray:
    return _RESET_COLORS[frame.reset_reason.astype(np.intp)]


def _motion_error(frame: Frame) -> np.ndarray:
    return frame.motion_error / _MOTION_ERROR_RANGE_PX


def _repaired_values(frame: Frame) -> np.ndarray:
    """What the path tracer saw, dimmed, with pixels whose inputs no picture may hold in a colour of their own."""
    # One channel after the other: numpy is slow where the innermost axis is short.
    grey = 0.1 * sum(np.fmin(np.fmax(frame.noisy[..., channel], 0), 1) for channel in range(3))
    bad = frame.repaired_values > 0
    return np.stack([np.where(bad, np.float32(color), grey) for color in _BAD_COLOR], axis=2)


def _suppressed_light(frame: Frame) -> np.ndarray:
    return frame.suppressed_light


def _history(frame: Frame) -> np.ndarray:
    return np.log2(np.maximum(frame.history_length, 1)) / _HISTORY_RANGE_LOG2


def _normal(frame: Frame) -> np.ndarray:
    image = frame.normal * np.float32(0.5) + np.float32(0.5)
    image[frame.object_id <= 0] = 0
    return image


OVERLAYS = {
    "result": Overlay("Result", "The denoised picture", 0, False, lambda frame: frame.color),
    "split": Overlay(
        "Split Screen",
        "Noisy input on the left, result on the right",
        8,
        False,
        lambda frame: frame.color,
    ),
    "noisy": Overlay(
        "Noisy Input",
        "What the path tracer saw in the newest frame",
        1,
        False,
        lambda frame: frame.noisy,
    ),
    "albedo": Overlay("Albedo", "Colour of the surfaces, which is not filtered", 2, False, lambda frame: frame.albedo),
    "normal": Overlay("Normal", "World space normals, from -1 to 1", 3, True, _normal),
    "depth": Overlay("Depth", "Nearest surface white, farthest one dark", 4, True, _depth),
    "motion": Overlay(
        "Motion",
        "Where surfaces come from, within 16 pixels: red right, green up, grey still",
        5,
        True,
        _motion,
    ),
    "history_length": Overlay(
        "History Length",
        "Frames in the temporal mean: 1 is black, 32 and more are white",
        6,
        True,
        _history,
    ),
    "variance": Overlay(
        "Noise Left",
        "Standard deviation that the filter estimates for its result: black is 0.01 and less, white 1 and more",
        7,
        True,
        _noise,
    ),
    "reset_reason": Overlay(
        "Reset Reason",
        "Why pixels have no history: " + ", ".join(meaning for _, meaning in RESET_COLORS.values()),
        9,
        True,
        _reset_reasons,
        diagnoses=True,
    ),
    "repaired_values": Overlay(
        "NaN Map",
        "Pixels whose input was not a number, infinite or negative, and was repaired",
        10,
        True,
        _repaired_values,
        diagnoses=True,
    ),
    "motion_error": Overlay(
        "Motion Error",
        "By how much the motion misses where the surface was: white is 2 pixels and more",
        11,
        True,
        _motion_error,
        diagnoses=True,
    ),
    "suppressed_light": Overlay(
        "Suppressed Light",
        "Light that the firefly limit cut from this frame's samples",
        12,
        False,
        _suppressed_light,
        diagnoses=True,
    ),
}


class PictureMemory:
    """Memory of pictures that nobody holds any more, for the next ones: new pages cost more than to fill them."""

    def __init__(self) -> None:
        self._free: list[np.ndarray] = []

    def new(self, height: int, width: int) -> np.ndarray:
        """float32 [H, W, 4] of any values."""
        shape = height, width, 4
        memory = None
        while self._free and (memory is None or memory.shape != shape):
            memory = self._free.pop()
        if memory is None or memory.shape != shape:
            memory = np.empty(shape, np.float32)
        picture = memory.view()
        weakref.finalize(picture, self._free.append, memory).atexit = False
        return picture


def paint(frame: Frame, look: Look, memory: PictureMemory | None = None) -> np.ndarray:
    """float32 [H, W, 4], bottom row first, alpha premultiplied, finite: what a half-float texture takes."""
    overlay = OVERLAYS[look.overlay]
    pixels = (memory or PictureMemory()).new(frame.height, frame.width)
    write_display(pixels, overlay.image(frame), 1 if overlay.is_data else _LARGEST_HALF)
    if look.overlay == "split":
        column = round(look.split * frame.width)
        write_display(pixels[:, :column], frame.noisy[:, :column], _LARGEST_HALF)
        pixels[:, max(column - 1, 0) : column] = 1
    if look.overlay in ("result", "split") and frame.alpha is not None:
        pixels[..., 3] = np.fmin(np.fmax(frame.alpha, 0), 1)[::-1]  # fmax and fmin take what is a number
    return pixels
