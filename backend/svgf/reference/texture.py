# SPDX-License-Identifier: Apache-2.0
"""Image textures, read as Cycles reads them: texels are interpolated as they are stored, then divided by alpha where
they are stored times it, then decoded."""

from __future__ import annotations

import numpy as np

from ..scene import Extension, Interpolation


class Texture:
    """pixels: uint8 or float32 [H, W, 4], row 0 at the bottom. The rest: see svgf.scene.Texture."""

    def __init__(
        self, device, pixels: np.ndarray, srgb: bool, interpolation: int, extension: int, associated_alpha: bool
    ) -> None:
        pixels = np.asarray(pixels)
        scale = 255.0 if pixels.dtype == np.uint8 else 1.0
        texels = pixels.astype(np.float64) / scale
        self._texels = np.where(np.isfinite(texels), np.maximum(texels, 0.0), 0.0)
        self._srgb = bool(srgb)
        self._interpolation = Interpolation(interpolation)
        self._extension = Extension(extension)
        self._associated_alpha = bool(associated_alpha)

    def lookup(self, uv: np.ndarray) -> np.ndarray:
        """Linear RGBA [n, 4] at uv [n, 2], (0, 0) being the bottom left corner of the image."""
        height, width = self._texels.shape[:2]
        uv = np.where(np.isfinite(uv), uv, 0.0)
        x, y = uv[:, 0] * width, uv[:, 1] * height
        if self._interpolation == Interpolation.CLOSEST:
            value = self._texel(np.floor(x), np.floor(y))
        else:
            reach = 2 if self._interpolation == Interpolation.CUBIC else 1
            value = np.zeros((len(uv), 4))
            for row in range(1 - reach, 1 + reach):
                for column in range(1 - reach, 1 + reach):
                    i, j = np.floor(x - 0.5) + column, np.floor(y - 0.5) + row
                    weight = self._kernel(x - (i + 0.5)) * self._kernel(y - (j + 0.5))
                    value += weight[:, None] * self._texel(i, j)
        color, alpha = value[:, :3], value[:, 3:]
        if self._associated_alpha:
            color = np.where(alpha > 0.0, color / np.where(alpha > 0.0, alpha, 1.0), color)
        return np.concatenate([srgb_to_linear(color) if self._srgb else color, alpha], axis=1)

    def _kernel(self, distance: np.ndarray) -> np.ndarray:
        """Tent, or cubic B-spline."""
        x = np.abs(distance)
        if self._interpolation == Interpolation.LINEAR:
            return np.maximum(1.0 - x, 0.0)
        return np.where(x < 1.0, (4.0 - 6.0 * x**2 + 3.0 * x**3) / 6.0, np.maximum(2.0 - x, 0.0) ** 3 / 6.0)

    def _texel(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        height, width = self._texels.shape[:2]
        value = self._texels[_wrap(row, height, self._extension), _wrap(column, width, self._extension)]
        if self._extension == Extension.CLIP:
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            value = np.where(inside[:, None], value, 0.0)
        return value


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
