# SPDX-License-Identifier: Apache-2.0
"""Writes 8-bit PNG files, so that a result can be looked at where no image library is installed."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np

from ..errors import InputError
from .files import replacing


def display(image: np.ndarray) -> np.ndarray:
    """Blender's "Standard" view of a linear Rec.709 image: clipped to [0, 1], sRGB curve, uint8 of the same shape.

    Values that are not finite show as black (NaN, -inf) or white (+inf).
    """
    linear = np.clip(np.nan_to_num(image, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)
    return np.rint(255 * curve).astype(np.uint8)


def write(pixels: np.ndarray, path: str | os.PathLike[str]) -> None:
    """pixels: uint8 [H, W, 3] as ``display`` makes them, row 0 on top. Raises InputError where it cannot be written."""
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
        raise InputError(f"A PNG needs uint8 pixels [H, W, 3], not {pixels.dtype} {list(pixels.shape)}.")
    height, width = pixels.shape[:2]
    # The "up" filter on every row: renders are smooth, so rows predict one another well.
    rows = pixels.reshape(height, 3 * width)
    filtered = np.empty((height, 1 + 3 * width), np.uint8)
    filtered[:, 0] = 2
    filtered[0, 1:] = rows[0]
    filtered[1:, 1:] = rows[1:] - rows[:-1]
    with replacing(path) as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        file.write(_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)))
        file.write(_chunk(b"sRGB", b"\0"))
        file.write(_chunk(b"IDAT", zlib.compress(filtered.tobytes(), 6)))
        file.write(_chunk(b"IEND", b""))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
