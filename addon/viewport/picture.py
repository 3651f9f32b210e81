# SPDX-License-Identifier: GPL-3.0-or-later
"""What a viewport shows of a frame: the result, or one of the images that it is made from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from svgf.frame import Frame

_LARGEST_HALF = 65504.0  # beyond it a half-float texture holds infinity, which draws black
_MOTION_RANGE_PX = 16.0
_HISTORY_RANGE_LOG2 = 5.0


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
    ).clip(0, 1)


# Name -> (label, description, number in Blender's files, image [H, W] or [H, W, 3] of a frame).
OVERLAYS: dict[str, tuple[str, str, int, Callable[[Frame], np.ndarray]]] = {
    "result": ("Result", "The denoised picture", 0, lambda frame: frame.color),
    "noisy": ("Noisy Input", "What the path tracer saw in the newest frame", 1, lambda frame: frame.noisy),
    "albedo": ("Albedo", "Colour of the surfaces, which is not filtered", 2, lambda frame: frame.albedo),
    "normal": (
        "Normal",
        "World space normals, from -1 to 1",
        3,
        lambda frame: np.where(frame.object_id[..., None] > 0, frame.normal * 0.5 + 0.5, 0),
    ),
    "depth": ("Depth", "Nearest surface white, farthest one dark", 4, _depth),
    "motion": ("Motion", "Where surfaces come from, within 16 pixels: red right, green up, grey still", 5, _motion),
    "history_length": (
        "History Length",
        "Frames in the temporal mean: 1 is black, 32 and more are white",
        6,
        lambda frame: (np.log2(np.maximum(frame.history_length, 1)) / _HISTORY_RANGE_LOG2).clip(0, 1),
    ),
    "variance": (
        "Noise Left",
        "Standard deviation that the filter estimates for its result",
        7,
        lambda frame: np.sqrt(np.maximum(frame.variance, 0)),
    ),
}


def paint(frame: Frame, overlay: str) -> np.ndarray:
    """float32 [H, W, 4], bottom row first, opaque and finite: what a half-float texture takes."""
    image = OVERLAYS[overlay][-1](frame)
    pixels = np.ones((frame.height, frame.width, 4), np.float32)
    pixels[..., :3] = (image if image.ndim == 3 else image[..., None])[::-1]
    np.nan_to_num(pixels, copy=False, nan=0.0)
    return pixels.clip(0, _LARGEST_HALF, out=pixels)
