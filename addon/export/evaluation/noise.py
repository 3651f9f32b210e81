# SPDX-License-Identifier: GPL-3.0-or-later
"""Perlin noise [Perlin02] and its fractal sums [Musgrave94], as the Noise Texture node has them.

Points are float32 [n, d], d in 1..4. Detail, roughness and the like are numbers [n] or [1].
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from .hashing import hash_floats, hash_integers

# Bring the noise of each dimension to [-1, 1].
_SCALES = (0.25, 0.6616, 0.982, 0.8344)
_PERIOD = np.float32(100000)
_MAX_DETAIL = 15.0


def signed_noise(points: np.ndarray) -> np.ndarray:
    """[n] in [-1, 1]."""
    nudge = np.float32(0.5) * (np.abs(points) >= 1e6)
    return _perlin(np.fmod(points, _PERIOD) + nudge) * np.float32(_SCALES[points.shape[1] - 1])


def noise_texture(
    vector: np.ndarray,
    w: np.ndarray,
    scale: np.ndarray,
    detail: np.ndarray,
    roughness: np.ndarray,
    lacunarity: np.ndarray,
    offset: np.ndarray,
    gain: np.ndarray,
    distortion: np.ndarray,
    *,
    dimensions: int,
    kind: str,
    normalize: bool,
    color: bool,
) -> np.ndarray:
    """The Noise Texture node: [n], or [n, 3] for its colour."""
    points = join_coordinates(vector, w, dimensions) * scale[:, None]
    if np.any(distortion):
        shifts = [signed_noise(points + _offset(axis, dimensions)) for axis in range(dimensions)]
        points = points + np.stack(shifts, 1) * distortion[:, None]
    detail = np.clip(detail, 0, _MAX_DETAIL)
    roughness = np.maximum(roughness, 0)
    sum_octaves = _FRACTALS[kind]

    def values(points: np.ndarray) -> np.ndarray:
        return sum_octaves(points, detail, roughness, lacunarity, offset, gain, normalize)

    first = values(points)
    if not color:
        return first
    others = [values(points + _offset(dimensions + channel, dimensions)) for channel in (0, 1)]
    return np.stack([first, *others], 1)


def join_coordinates(vector: np.ndarray, w: np.ndarray, dimensions: int) -> np.ndarray:
    """[n, d] of the Vector and W inputs: W alone in 1D, the vector with it in 4D."""
    if dimensions == 1:
        return w[:, None]
    if dimensions < 4:
        return vector[:, :dimensions]
    count = max(len(vector), len(w))
    return np.concatenate([np.broadcast_to(vector, (count, 3)), np.broadcast_to(w[:, None], (count, 1))], 1)


def fractal_brownian_motion(
    points: np.ndarray,
    detail: np.ndarray,
    roughness: np.ndarray,
    lacunarity: np.ndarray,
    offset: np.ndarray | None = None,
    gain: np.ndarray | None = None,
    normalize: bool = True,
) -> np.ndarray:
    """Octaves 0..floor(detail), blended with one more by the fraction of detail."""
    whole, rest = np.floor(detail), detail - np.floor(detail)
    scale, amplitude = np.ones_like(lacunarity), np.ones_like(roughness)
    total, highest = np.float32(0), np.float32(0)
    result = np.float32(0)
    for octave in range(int(whole.max()) + 2):
        last = octave == whole + 1
        if octave > whole.max() and not rest.any():
            break
        noise = signed_noise(points * scale[:, None]) * amplitude
        before = _normalized(total, highest, normalize) if octave else noise
        total, highest = total + noise, highest + amplitude
        now = _normalized(total, highest, normalize)
        result = np.where(octave <= whole, now, np.where(last & (rest > 0), before + (now - before) * rest, result))
        scale, amplitude = scale * lacunarity, amplitude * roughness
    return result


def _normalized(total: np.ndarray, highest: np.ndarray, normalize: bool) -> np.ndarray:
    return np.float32(0.5) * total / highest + np.float32(0.5) if normalize else total


def _multifractal(points, detail, roughness, lacunarity, offset, gain, normalize):
    value, power = np.float32(1), np.ones_like(roughness)
    for octave in range(_octaves(detail)):
        value = value * (_share(detail, octave) * power * signed_noise(points) + 1)
        power, points = power * roughness, points * lacunarity[:, None]
    return value


def _heterogeneous_terrain(points, detail, roughness, lacunarity, offset, gain, normalize):
    value, power = offset + signed_noise(points), roughness
    for octave in range(1, _octaves(detail)):
        points = points * lacunarity[:, None]
        value = value + _share(detail, octave) * (signed_noise(points) + offset) * power * value
        power = power * roughness
    return value


def _hybrid_multifractal(points, detail, roughness, lacunarity, offset, gain, normalize):
    value, weight, power = np.float32(0), np.ones(1, np.float32), np.ones_like(roughness)
    for octave in range(_octaves(detail)):
        alive = weight > 0.001
        weight = np.minimum(weight, 1)
        signal = (signed_noise(points) + offset) * power
        value = value + np.where(alive, _share(detail, octave) * weight * signal, 0)
        weight = np.where(alive, weight * gain * signal, 0)
        power, points = power * roughness, points * lacunarity[:, None]
    return value


def _ridged_multifractal(points, detail, roughness, lacunarity, offset, gain, normalize):
    signal = (offset - np.abs(signed_noise(points))) ** 2
    value, power = signal, roughness
    for octave in range(1, int(detail.max()) + 1):
        points = points * lacunarity[:, None]
        weight = np.clip(signal * gain, 0, 1)
        signal = (offset - np.abs(signed_noise(points))) ** 2 * weight
        value = value + np.where(octave <= detail, signal * power, 0)
        power = power * roughness
    return value


_FRACTALS: dict[str, Callable] = {
    "FBM": fractal_brownian_motion,
    "MULTIFRACTAL": _multifractal,
    "HYBRID_MULTIFRACTAL": _hybrid_multifractal,
    "RIDGED_MULTIFRACTAL": _ridged_multifractal,
    "HETERO_TERRAIN": _heterogeneous_terrain,
}


def _octaves(detail: np.ndarray) -> int:
    return int(np.ceil(detail.max())) + 1


def _share(detail: np.ndarray, octave: int) -> np.ndarray:
    """Of an octave: 1 up to floor(detail), the fraction of detail for the one after."""
    return np.clip(np.where(octave <= np.floor(detail), 1, detail - octave + 1), 0, 1).astype(np.float32)


def _offset(seed: int, dimensions: int) -> np.ndarray:
    """[d] in [100, 200]: where the noise of a further channel is read."""
    if dimensions == 1:
        return 100 + hash_floats(np.float32(seed)) * np.float32(100)
    axes = np.arange(dimensions, dtype=np.float32)
    return 100 + hash_floats(np.full(dimensions, seed, np.float32), axes) * np.float32(100)


def _perlin(points: np.ndarray) -> np.ndarray:
    floors = np.floor(points)
    columns = (points - floors).T
    cells = floors.astype(np.int32).view(np.uint32).T
    fades = [t * t * t * (t * (t * 6 - 15) + 10) for t in columns]
    # An axis whose points all lie on the lattice, as Z does on a UV plane, needs no upper corners.
    corners = product(*((0, 1) if fade.any() else (0,) for fade in fades))
    total = np.zeros(len(points), np.float32)
    for corner in corners:
        weight = np.float32(1)
        for side, fade in zip(corner, fades, strict=True):
            weight = weight * (fade if side else 1 - fade)
        hashes = hash_integers(*(cell + np.uint32(side) for cell, side in zip(cells, corner, strict=True)))
        offsets = [column - np.float32(side) for column, side in zip(columns, corner, strict=True)]
        total += weight * _gradient(hashes, offsets)
    return total


def _gradient(hashes: np.ndarray, offsets: list[np.ndarray]) -> np.ndarray:
    """The dot product of an offset with the lattice gradient that the low bits of the hash choose."""
    if len(offsets) == 1:
        return _signed(hashes, 8, (1 + (hashes & 7)).astype(np.float32) * offsets[0])
    if len(offsets) == 2:
        x, y = offsets
        low = (hashes & 7) < 4
        return _signed(hashes, 1, np.where(low, x, y)) + _signed(hashes, 2, 2 * np.where(low, y, x))
    if len(offsets) == 3:
        x, y, z = offsets
        h = hashes & 15
        second = np.where(h < 4, y, np.where((h == 12) | (h == 14), x, z))
        return _signed(hashes, 1, np.where(h < 8, x, y)) + _signed(hashes, 2, second)
    x, y, z, w = offsets
    h = hashes & 31
    return (
        _signed(hashes, 1, np.where(h < 24, x, y))
        + _signed(hashes, 2, np.where(h < 16, y, z))
        + _signed(hashes, 4, np.where(h < 8, z, w))
    )


def _signed(hashes: np.ndarray, bit: int, value: np.ndarray) -> np.ndarray:
    return np.where(hashes & bit, -value, value)
