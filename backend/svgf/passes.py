# SPDX-License-Identifier: Apache-2.0
"""The images of a frame as render passes: Blender 5's names, channels and signs. In files and in Blender alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from .diagnostics import DIAGNOSTICS
from .frame import Frame


@dataclass(frozen=True)
class Pass:
    """channels: a letter each, as in EXR files. unit: and what the numbers mean. image: [H, W] or [H, W, C] of a
    frame."""

    name: str
    channels: str
    unit: str
    image: Callable[[Frame], np.ndarray]


def _with_alpha(frame: Frame, color: np.ndarray) -> np.ndarray:
    """color: is multiplied by alpha already."""
    alpha = np.ones((frame.height, frame.width), np.float32) if frame.alpha is None else frame.alpha
    return np.concatenate([color, alpha[..., None]], axis=2)


def _vector(frame: Frame) -> np.ndarray:
    """Cycles' y axis points up, ours down."""
    next_frame = np.zeros((frame.height, frame.width, 2), np.float32)
    return np.concatenate([frame.motion[..., 0:1], -frame.motion[..., 1:2], next_frame], axis=2)


_RADIANCE = "W/(m^2 sr), linear Rec.709"

PASSES = {
    entry.name: entry
    for entry in (
        Pass("Combined", "RGBA", f"{_RADIANCE}, denoised", lambda frame: _with_alpha(frame, frame.color)),
        Pass("Noisy Image", "RGBA", f"{_RADIANCE}, as traced", lambda frame: _with_alpha(frame, frame.noisy)),
        Pass("Denoising Albedo", "RGB", "1, diffuse plus specular reflectance", lambda frame: frame.albedo),
        Pass("Normal", "XYZ", "1, world space, 0 on the background", lambda frame: frame.normal),
        Pass("Depth", "Z", "m, along the camera's axis, 1e10 on the background", lambda frame: frame.depth),
        Pass(
            "Vector",
            "XYZW",
            "px, x right, y up; XY = position at the previous frame - position now; ZW (next frame) unknown: 0",
            _vector,
        ),
        Pass(
            "Depth Change",
            "V",
            "m, expected depth at the previous frame - depth now",
            lambda frame: frame.motion[..., 2],
        ),
        Pass("Object Index", "X", "1, number of the object, 0 on the background", lambda frame: frame.object_id),
        Pass("Denoising Roughness", "X", "1, Principled BSDF's roughness", lambda frame: frame.roughness),
        Pass(
            "Variance", "V", "(W/(m^2 sr))^2, of the luminance, left over by the filter", lambda frame: frame.variance
        ),
        Pass("History Length", "V", "frames in the temporal mean", lambda frame: frame.history_length),
    )
}

# Of frames that were rendered with diagnostics.
DIAGNOSTIC_PASSES = {
    entry.name: entry
    for entry in (
        Pass(name.replace("_", " ").title(), "V", f"{unit}, {meaning}", attrgetter(name))
        for name, (unit, meaning) in DIAGNOSTICS.items()
    )
}
