# SPDX-License-Identifier: Apache-2.0
"""Image textures, read as Cycles reads them: uint8 texels are interpolated first and decoded after."""

from __future__ import annotations

import numpy as np

from ..scene import Extension, Interpolation


class Texture:
    """pixels: uint8 or float32 [H, W, 4], row 0 at the bottom. interpolation, extension: see svgf.scene."""

    def __init__(self, device, pixels: np.ndarray, srgb: bool, interpolation: int, extension: int) -> None:
        pixels = np.asarray(pixels)
        scale = 255.0 if pixels.dtype == np.uint8 else 1.0
        self._texels = pixels[..., :3].astype(np.float64) / scale
        self._srgb = bool(srgb)
        self._interpolation = Interpolation(interpolation)
        self._extension = Extension(extension)

    def lookup(self, uv: np.ndarray) -> np.ndarray:
        """Linear colour [n, 3] at uv [n, 2], (0, 0) being the bottom left corner of the image."""
        height, width = self._texels.shape[:2]
        uv = np.where(np.isfinite(uv), uv, 0.0)
        x, y = uv[:, 0] * width, uv[:, 1] * height
        if self._interpolation == Interpolation.CLOSEST:
            color = self._texel(np.floor(x), np.floor(y))
        else:
            x, y = x - 0.5, y - 0.5
            left, below = np.floor(x), np.floor(y)
            right_share, top_share = (x - left)[:, None], (y - below)[:, None]
            bottom = self._texel(left, below) * (1.0 - right_share) + self._texel(left + 1.0, below) * right_share
            top = (
                self._texel(left, below + 1.0) * (1.0 - right_share)
                + self._texel(left + 1.0, below + 1.0) * right_share
            )
            color = bottom * (1.0 - top_share) + top * top_share
        return srgb_to_linear(color) if self._srgb else color

    def _texel(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        height, width = self._texels.shape[:2]
        color = self._texels[_wrap(row, height, self._extension), _wrap(column, width, self._extension)]
        if self._extension == Extension.CLIP:
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            color = np.where(inside[:, None], color, 0.0)
        return color


def _wrap(index: np.ndarray, size: int, extension: Extension) -> np.ndarray:
    """Texel indices within the image for whole numbers beyond it."""
    if extension == Extension.REPEAT:
        index = index % size
    elif extension == Extension.MIRROR:
        index = index % (2 * size)
        index = np.where(index < size, index, 2 * size - 1 - index)
    return np.clip(index, 0, size - 1).astype(np.int64)


def srgb_to_linear(color: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    return np.where(color <= 0.04045, color / 12.92, (np.maximum(color, 0.0) + 0.055) ** 2.4 / 1.055**2.4)
