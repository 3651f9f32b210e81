# SPDX-License-Identifier: Apache-2.0
"""What a rendered frame holds."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class Frame:
    """One finished frame: numpy arrays, row 0 on top, float32 unless said.

    color: [H, W, 3] denoised linear radiance. noisy: [H, W, 3] what the path tracer saw.
    albedo: [H, W, 3] diffuse plus specular albedo. normal: [H, W, 3] world space, zero on the background.
    depth: [H, W] planar, metres, 1e10 on the background. motion: [H, W, 3] previous pixel position minus this one (x right,
    y down, pixels) and expected previous depth minus this depth (metres). roughness: [H, W].
    object_id: int32 [H, W], 0 on the background. variance: [H, W] luminance variance that the filter left over.
    history_length: [H, W] number of frames in the temporal mean.
    alpha: [H, W] share of the pixel that the scene covers, by which color is multiplied; None if the film is opaque.
    timings: milliseconds per stage. reset: why history was restarted at this frame, empty when it went on.
    """

    frame: int
    color: np.ndarray
    noisy: np.ndarray
    albedo: np.ndarray
    normal: np.ndarray
    depth: np.ndarray
    motion: np.ndarray
    roughness: np.ndarray
    object_id: np.ndarray
    variance: np.ndarray
    history_length: np.ndarray
    alpha: np.ndarray | None = None
    timings: dict[str, float] = field(default_factory=dict)
    reset: str = ""

    @property
    def width(self) -> int:
        return self.color.shape[1]

    @property
    def height(self) -> int:
        return self.color.shape[0]
