# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading images between their texels, as Cycles does: bytes are interpolated first and decoded after."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .color import srgb_to_linear


@dataclass(frozen=True, eq=False)
class Image:
    """pixels: uint8 or float32 [H, W, 4], row 0 at the bottom. srgb: of bytes.

    associated_alpha: colours are stored times alpha, in the pixels' encoding, and divided by it when they are read.
    interpolation: Linear, Closest, Cubic or Smart. extension: REPEAT, EXTEND, CLIP or MIRROR.
    """

    name: str
    pixels: np.ndarray
    srgb: bool
    interpolation: str
    extension: str
    associated_alpha: bool = False

    @cached_property
    def digest(self) -> bytes:
        """Of the content, whatever its name."""
        layout = self.pixels.shape, self.pixels.dtype.str, self.srgb
        state = hashlib.sha1(
            repr((layout, self.interpolation, self.extension, self.associated_alpha)).encode(), usedforsecurity=False
        )
        state.update(np.ascontiguousarray(self.pixels))
        return state.digest()

    @cached_property
    def is_gray(self) -> bool:
        """Whether each channel holds the luminance."""
        color = self.pixels[..., :3]
        return bool((color == color[..., :1]).all())


def sample_color(vector: np.ndarray, *, image: Image) -> np.ndarray:
    """[n, 3] linear colour."""
    texels = _sample(vector, image)
    color = texels[:, :3]
    if image.associated_alpha:
        alpha = texels[:, 3:]
        color = color / np.where(alpha > 0, alpha, np.float32(1))
    return srgb_to_linear(color) if image.srgb else color


def sample_alpha(vector: np.ndarray, *, image: Image) -> np.ndarray:
    """[n]"""
    return _sample(vector, image)[:, 3]


def equirectangular(direction: np.ndarray) -> np.ndarray:
    """[n, 3] image coordinates of directions."""
    x, y, z = direction.T
    u = np.float32(0.5) - np.arctan2(y, x) / np.float32(2 * np.pi)
    v = np.float32(0.5) + np.arctan2(z, np.hypot(x, y)) / np.float32(np.pi)
    return np.stack([u, v, np.zeros_like(u)], 1)


def mirror_ball(direction: np.ndarray) -> np.ndarray:
    """[n, 3] image coordinates of directions."""
    x, y, z = direction.T
    size = 2 * np.sqrt(np.maximum(-0.5 * (y - 1), 0))
    size = np.where(size > 0, size, 1)
    return np.stack([(x / size + 1) / 2, (z / size + 1) / 2, np.zeros_like(x)], 1)


def _sample(vector: np.ndarray, image: Image) -> np.ndarray:
    height, width = image.pixels.shape[:2]
    x, y = vector[:, 0] * np.float32(width), vector[:, 1] * np.float32(height)
    x, y = np.where(np.isfinite(x), x, 0), np.where(np.isfinite(y), y, 0)
    if image.interpolation == "Closest":
        return _texels(image, np.floor(x), np.floor(y))
    x, y = x - np.float32(0.5), y - np.float32(0.5)
    left, below = np.floor(x), np.floor(y)
    if image.interpolation == "Linear":
        reach, weigh = (0, 1), _linear_weights
    else:
        reach, weigh = (-1, 0, 1, 2), _cubic_weights
    total = np.zeros((len(x), 4), np.float32)
    columns, rows = weigh(x - left), weigh(y - below)
    for row, row_weight in zip(reach, rows, strict=True):
        for column, column_weight in zip(reach, columns, strict=True):
            total += _texels(image, left + column, below + row) * (row_weight * column_weight)[:, None]
    return total


def _linear_weights(t: np.ndarray) -> tuple[np.ndarray, ...]:
    return 1 - t, t


def _cubic_weights(t: np.ndarray) -> tuple[np.ndarray, ...]:
    """Of the uniform cubic B-spline."""
    s = 1 - t
    return s**3 / 6, (4 - 6 * t**2 + 3 * t**3) / 6, (4 - 6 * s**2 + 3 * s**3) / 6, t**3 / 6


def _texels(image: Image, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """float32 [n, 4]"""
    height, width = image.pixels.shape[:2]
    texels = image.pixels[_wrap(row, height, image.extension), _wrap(column, width, image.extension)]
    texels = texels.astype(np.float32) / np.float32(255) if texels.dtype == np.uint8 else texels
    if image.extension == "CLIP":
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        texels = np.where(inside[:, None], texels, 0)
    return texels


def _wrap(index: np.ndarray, size: int, extension: str) -> np.ndarray:
    if extension == "REPEAT":
        index = index % size
    elif extension == "MIRROR":
        index = index % (2 * size)
        index = np.where(index < size, index, 2 * size - 1 - index)
    return np.clip(index, 0, size - 1).astype(np.int64)
