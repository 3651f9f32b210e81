# SPDX-License-Identifier: GPL-3.0-or-later
"""Regular and random patterns: the Checker, Brick, Gradient, Wave, Magic and White Noise Texture nodes."""

from __future__ import annotations

import numpy as np

from .hashing import hash_floats
from .noise import fractal_brownian_motion

_TAU = np.float32(2 * np.pi)


def checker(vector: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """[n] 1 in the cells of the first colour, else 0."""
    cells = np.floor(_off_integers(vector * scale[:, None])).astype(np.int64) % 2
    return ((cells[:, 0] == cells[:, 1]) == (cells[:, 2] == 1)).astype(np.float32)


def brick(
    vector: np.ndarray,
    scale: np.ndarray,
    mortar_size: np.ndarray,
    mortar_smooth: np.ndarray,
    bias: np.ndarray,
    brick_width: np.ndarray,
    row_height: np.ndarray,
    *,
    offset: float,
    offset_frequency: int,
    squash: float,
    squash_frequency: int,
) -> np.ndarray:
    """[n, 3]: tint between the two brick colours, share of mortar, 0."""
    points = vector * scale[:, None]
    row = np.floor(points[:, 1] / row_height)
    shift = np.float32(0)
    if offset_frequency and squash_frequency:
        # Zero in every n-th row, also below 0.
        brick_width = brick_width * np.where(np.fmod(row, squash_frequency), 1, np.float32(squash))
        shift = np.where(np.fmod(row, offset_frequency), 0, brick_width * np.float32(offset))
    x = points[:, 0] + shift
    number = np.floor(x / brick_width)
    x, y = x - brick_width * number, points[:, 1] - row_height * row
    key = (row.astype(np.int64) << 16) + (number.astype(np.int64) & 0xFFFF)
    tint = np.clip(_brick_noise(key.astype(np.uint32)) + bias, 0, 1)
    edge = np.minimum(np.minimum(x, y), np.minimum(brick_width - x, row_height - y))
    depth = np.divide(1 - edge / mortar_size, mortar_smooth)
    depth = np.where(mortar_smooth == 0, 1, np.clip(depth, 0, 1))
    mortar = np.where(edge >= mortar_size, 0, depth * depth * (3 - 2 * depth))
    return np.stack(np.broadcast_arrays(tint, mortar, np.float32(0)), 1).astype(np.float32)


def _brick_noise(key: np.ndarray) -> np.ndarray:
    """[n] in [0, 1)."""
    n = (key + np.uint32(1013)) & np.uint32(0x7FFFFFFF)
    n = (n >> np.uint32(13)) ^ n
    n = (n * (n * n * np.uint32(60493) + np.uint32(19990303)) + np.uint32(1376312589)) & np.uint32(0x7FFFFFFF)
    return np.float32(0.5) * (n.astype(np.float32) / np.float32(1073741824))


def gradient(vector: np.ndarray, *, kind: str) -> np.ndarray:
    """[n] in [0, 1]."""
    x, y, z = vector.T
    if kind == "LINEAR":
        value = x
    elif kind == "QUADRATIC":
        value = np.maximum(x, 0) ** 2
    elif kind == "EASING":
        t = np.clip(x, 0, 1)
        value = t * t * (3 - 2 * t)
    elif kind == "DIAGONAL":
        value = (x + y) / 2
    elif kind == "RADIAL":
        value = np.arctan2(y, x) / _TAU + np.float32(0.5)
    else:
        value = np.maximum(np.float32(0.999999) - np.sqrt(x * x + y * y + z * z), 0)
        if kind == "QUADRATIC_SPHERE":
            value = value * value
    return np.clip(value, 0, 1)


def wave(
    vector: np.ndarray,
    scale: np.ndarray,
    distortion: np.ndarray,
    detail: np.ndarray,
    detail_scale: np.ndarray,
    detail_roughness: np.ndarray,
    phase: np.ndarray,
    *,
    kind: str,
    direction: str,
    profile: str,
) -> np.ndarray:
    """[n] in [0, 1]. kind: BANDS or RINGS."""
    points = _off_integers(vector * scale[:, None])
    x, y, z = points.T
    if kind == "BANDS":
        n = (x + y + z) * 10 if direction == "DIAGONAL" else {"X": x, "Y": y, "Z": z}[direction] * 20
    else:
        squares = {"X": y * y + z * z, "Y": x * x + z * z, "Z": x * x + y * y}
        n = np.sqrt(squares.get(direction, x * x + y * y + z * z)) * 20
    n = n + phase
    if np.any(distortion):
        noise = fractal_brownian_motion(
            points * detail_scale[:, None], np.clip(detail, 0, 15), detail_roughness, np.float32([2])
        )
        n = n + distortion * (noise * 2 - 1)
    if profile == "SIN":
        return np.float32(0.5) + np.float32(0.5) * np.sin(n - _TAU / 4)
    n = n / _TAU
    return n - np.floor(n) if profile == "SAW" else np.abs(n - np.floor(n + np.float32(0.5))) * 2


def magic(vector: np.ndarray, scale: np.ndarray, distortion: np.ndarray, *, depth: int) -> np.ndarray:
    """[n, 3]"""
    px, py, pz = np.fmod(vector, _TAU).T
    x = np.sin((px + py + pz) * 5 * scale)
    y = np.cos((-px + py - pz) * 5 * scale)
    z = -np.cos((-px - py + pz) * 5 * scale)
    if depth > 0:
        x, y, z = x * distortion, y * distortion, z * distortion
    for target, function, sign, signs in _MAGIC_STEPS[:depth]:
        folded = sign * function(signs[0] * x + signs[1] * y + signs[2] * z) * distortion
        x, y, z = (folded if axis == target else old for axis, old in zip("xyz", (x, y, z), strict=True))
    divisor = np.where(distortion != 0, distortion * 2, 1)
    return np.float32(0.5) - np.stack(np.broadcast_arrays(x / divisor, y / divisor, z / divisor), 1)


_MAGIC_STEPS = (
    ("y", np.cos, -1, (1, -1, 1)),
    ("x", np.cos, 1, (1, -1, -1)),
    ("z", np.sin, 1, (-1, -1, -1)),
    ("x", np.cos, -1, (-1, 1, -1)),
    ("y", np.sin, -1, (-1, 1, 1)),
    ("y", np.cos, -1, (-1, 1, 1)),
    ("x", np.cos, 1, (1, 1, 1)),
    ("z", np.sin, 1, (1, 1, -1)),
    ("x", np.cos, -1, (-1, -1, 1)),
    ("y", np.sin, -1, (1, -1, 1)),
)


def white_noise(vector: np.ndarray, w: np.ndarray, *, dimensions: int, color: bool) -> np.ndarray:
    """[n], or [n, 3] for the colour."""
    x, y, z = np.ascontiguousarray(vector.T)
    keys = {1: (w,), 2: (x, y), 3: (x, y, z), 4: (x, y, z, w)}[dimensions]
    first = hash_floats(*keys)
    if not color:
        return first
    if dimensions == 4:
        others = hash_floats(z, x, w, y), hash_floats(w, z, y, x)
    else:
        others = tuple(hash_floats(*keys, np.float32([seed])) for seed in (1, 2))
    return np.stack((first, *others), 1)


def _off_integers(points: np.ndarray) -> np.ndarray:
    """So that coordinates of faces at whole numbers do not flicker between two cells."""
    return (points + np.float32(1e-6)) * np.float32(0.999999)
