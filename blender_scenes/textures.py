# SPDX-License-Identifier: Apache-2.0
"""Base-colour textures made with numpy: sRGB in [0, 1], float64 [size, size, 3], row 0 at the bottom, tileable.

Each is a palette read with a smooth field, so it has no detail finer than a few texels (it neither shimmers at one
sample per pixel nor grows the exported scene: neighbouring texels repeat and deflate well).
"""

from __future__ import annotations

import numpy as np

_LEVELS = 40  # palette entries; fewer compress better, more hide banding


def clouds(size: int, seed: int, roughness: float = 1.6, finest: float = 6.0, stretch: float = 1.0) -> np.ndarray:
    """Tileable noise [size, size] of mean 0 and deviation 1 with a power-law spectrum.

    roughness: exponent of the amplitude's fall with frequency. finest: shortest wave in texels. stretch: > 1 draws
    the pattern out along y.
    """
    rng = np.random.default_rng(seed)
    frequency = np.fft.fftfreq(size) * size
    fx, fy = np.meshgrid(frequency, frequency * stretch)
    radius = np.hypot(fx, fy)
    amplitude = np.where(radius > 0, np.maximum(radius, 1) ** -roughness, 0) * np.exp(-((radius * finest / size) ** 2))
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((size, size))) * amplitude).real
    return (field - field.mean()) / field.std()


def palette(field: np.ndarray, colors: list[tuple[float, float, float]]) -> np.ndarray:
    """Colours along a polyline of sRGB triples, read with a field in [0, 1]."""
    field = np.round(np.clip(field, 0, 1) * _LEVELS) / _LEVELS
    stops = np.linspace(0, 1, len(colors))
    return np.stack([np.interp(field, stops, channel) for channel in np.transpose(colors)], axis=-1)


def _grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Texel centres (x, y) in [0, 1)."""
    axis = (np.arange(size) + 0.5) / size
    return np.meshgrid(axis, axis)


def _joints(position: np.ndarray, width: float) -> np.ndarray:
    """1 in the soft joint around whole numbers of `position`, else 0; width as a share of one unit."""
    distance = np.abs(position - np.round(position))
    return np.clip(1.5 - distance / width, 0, 1)


def _shade_of(cell: np.ndarray, seed: int) -> np.ndarray:
    """A random number in [-1, 1] for each cell number."""
    return np.random.default_rng(seed).uniform(-1, 1, int(cell.max()) + 1)[cell.astype(int)]


def plaster(size: int = 512) -> np.ndarray:
    """Warm lime plaster, softly mottled."""
    field = 0.55 + 0.17 * clouds(size, 1, 1.6, 10.0)
    return palette(field, [(0.82, 0.77, 0.69), (0.90, 0.86, 0.79), (0.95, 0.92, 0.87)])


def limestone(size: int = 256) -> np.ndarray:
    """Pale stone with bedding drawn out along the horizontal."""
    bedding = 0.8 * clouds(size, 2, 1.5, 7.0, 1.0) + 0.6 * clouds(size, 3, 1.3, 7.0, 0.3).T
    return palette(0.5 + 0.17 * bedding, [(0.66, 0.59, 0.49), (0.80, 0.74, 0.64), (0.89, 0.85, 0.77)])


def ashlar(size: int = 512) -> np.ndarray:
    """Two courses of two cut stones, each of a tone of its own."""
    x, y = _grid(size)
    course = np.floor(y * 4)
    column = x * 2 + 0.5 * (course % 2)
    stone = course * 2 + np.floor(column) % 2
    field = 0.58 + 0.14 * _shade_of(stone, 4) + 0.10 * clouds(size, 5, 1.6, 10.0)
    field -= 0.45 * np.maximum(_joints(column, 0.010), _joints(y * 4, 0.020))
    return palette(field, [(0.50, 0.43, 0.36), (0.76, 0.69, 0.59), (0.86, 0.80, 0.71)])


def checker_marble(size: int = 512) -> np.ndarray:
    """A floor of 4 x 4 polished tiles, light and dark in turn."""
    x, y = _grid(size)
    cell = np.floor(y * 4) * 4 + np.floor(x * 4)
    dark = (np.floor(x * 4) + np.floor(y * 4)) % 2
    veins = np.abs(clouds(size, 6, 1.7, 10.0))
    light = 0.86 - 0.11 * np.exp(-6 * veins) + 0.03 * _shade_of(cell, 7)
    deep = 0.24 + 0.08 * np.exp(-6 * veins) + 0.04 * _shade_of(cell, 8)
    field = np.where(dark > 0, deep, light)
    joint = np.maximum(_joints(x * 4, 0.010), _joints(y * 4, 0.010))
    field += joint * (0.45 - field)
    return palette(field, [(0.20, 0.13, 0.10), (0.50, 0.33, 0.24), (0.72, 0.61, 0.49), (0.92, 0.87, 0.78)])


def paving(size: int = 512) -> np.ndarray:
    """Terracotta pavers laid in a basket weave: pairs that lie and pairs that stand."""
    x, y = _grid(size)
    block_x, block_y = np.floor(x * 4), np.floor(y * 4)
    stands = (block_x + block_y) % 2 > 0
    across = np.where(stands, x, y) * 8
    along = np.where(stands, y, x) * 4
    paver = (block_y * 4 + block_x) * 2 + np.floor(across) % 2
    field = 0.55 + 0.20 * _shade_of(paver, 9) + 0.10 * clouds(size, 10, 1.6, 10.0)
    field -= 0.5 * np.maximum(_joints(across, 0.06), _joints(along, 0.03))
    return palette(field, [(0.48, 0.37, 0.30), (0.71, 0.56, 0.45), (0.83, 0.70, 0.58)])


def wood(size: int = 256, colors: list[tuple[float, float, float]] | None = None) -> np.ndarray:
    """Straight grain along y."""
    x, _ = _grid(size)
    bend = clouds(size, 11, 2.2, 24.0, 6.0)
    grain = 0.5 + 0.5 * np.sin(2 * np.pi * (x * 7 + 0.35 * bend))
    field = 0.30 + 0.45 * grain**1.5 + 0.10 * clouds(size, 12, 1.2, 6.0, 10.0)
    return palette(field, colors or [(0.36, 0.22, 0.12), (0.50, 0.33, 0.19), (0.62, 0.43, 0.27)])


def parquet(size: int = 512) -> np.ndarray:
    """Oak boards along x in eight rows, two boards a row, staggered."""
    x, y = _grid(size)
    row = np.floor(y * 8)
    along = x * 2 + np.array([0.0, 0.45, 0.2, 0.7, 0.35, 0.85, 0.1, 0.6])[row.astype(int)]
    board = row * 2 + np.floor(along) % 2
    bend = clouds(size, 13, 2.0, 24.0, 0.2)
    grain = 0.5 + 0.5 * np.sin(2 * np.pi * (y * 24 + 0.5 * bend + 3 * _shade_of(board, 14)))
    field = 0.50 + 0.20 * _shade_of(board, 15) + 0.16 * (grain - 0.5) + 0.05 * clouds(size, 16, 1.2, 8.0, 0.15)
    field -= 0.5 * np.maximum(_joints(along, 0.004), _joints(y * 8, 0.018))
    return palette(field, [(0.28, 0.16, 0.09), (0.55, 0.36, 0.21), (0.76, 0.56, 0.36)])


def rug(size: int = 512) -> np.ndarray:
    """A round rug seen from above: rings, a wreath of petals, a star in the middle. Not tileable."""
    x, y = _grid(size)
    radius, angle = np.hypot(x - 0.5, y - 0.5) * 2, np.arctan2(y - 0.5, x - 0.5)

    def soft(signed_distance: np.ndarray) -> np.ndarray:
        return np.clip(0.5 + signed_distance * size / 6, 0, 1)

    navy, cream, coral, teal, mustard = ((0.13, 0.19, 0.33), (0.90, 0.84, 0.72), (0.80, 0.36, 0.28),
                                         (0.22, 0.48, 0.50), (0.87, 0.65, 0.27))
    layers = [
        (1.00 - radius, navy), (0.95 - radius, cream), (0.91 - radius, coral), (0.80 - radius, cream),
        (0.78 - radius, navy), (0.06 * np.abs(np.cos(8 * angle)) - np.abs(radius - 0.66), mustard),
        (0.54 - radius, cream), (0.52 - radius, teal), (0.34 + 0.07 * np.cos(10 * angle) - radius, cream),
        (0.26 + 0.06 * np.cos(10 * angle) - radius, coral),
    ]
    image = np.broadcast_to(np.array(navy), (size, size, 3)).copy()
    for signed_distance, color in layers:
        image += soft(signed_distance)[..., None] * (np.array(color) - image)
    return np.round(image * 96) / 96


def stripes(colors: list[tuple[float, float, float]], size: int = 128) -> np.ndarray:
    """Soft-edged stripes of equal width along y, one of each colour."""
    x, _ = _grid(size)
    place = x * len(colors)
    index = np.floor(place).astype(int)
    fade = np.clip((place - index - 1) * size / len(colors) / 2 + 1, 0, 1)[..., None]
    table = np.array(colors)
    return np.round((table[index] * (1 - fade) + table[(index + 1) % len(colors)] * fade) * 96) / 96
