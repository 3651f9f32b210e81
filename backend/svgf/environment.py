# SPDX-License-Identifier: Apache-2.0
"""How directions are sampled by an environment image."""

from __future__ import annotations

import numpy as np

from .scene import Texture

# Cells of the map that directions are sampled by, at most. Finer images are averaged.
LARGEST_MAP = (256, 512)


def linear_pixels(image: Texture) -> np.ndarray:
    """[H, W, 3] linear colours."""
    pixels = np.asarray(image.pixels)[..., :3]
    if pixels.dtype != np.uint8:
        return pixels
    pixels = pixels.astype(np.float32) / np.float32(255)
    return np.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4) if image.srgb else pixels


def mean_radiance(image: Texture) -> np.ndarray:
    """[rows, columns]: mean of the channels, averaged down to at most LARGEST_MAP; row 0 looks down."""
    luminance = np.maximum(np.nan_to_num(linear_pixels(image).mean(axis=2, dtype=np.float64), posinf=0.0), 0.0)
    for axis, largest in enumerate(LARGEST_MAP):
        size = luminance.shape[axis]
        if size > largest:
            starts = -(-np.arange(largest) * size // largest)  # the first texel of each cell
            counts = np.diff(np.append(starts, size))
            sums = np.add.reduceat(luminance, starts, axis=axis)
            luminance = sums / (counts[:, None] if axis == 0 else counts)
    return luminance


def sampling_map(luminance: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """row_cdf [rows + 1], column_cdf [rows, columns + 1] (float32, as all devices use them), the mean over all
    directions of the radiance that is sampled, and the mean direction [3] of that radiance, in the environment's space:
    the shorter, the less of it comes from one side. Empty cdfs and zeros where sampling has nothing to gain.

    The map is lowered by its mean and cut off at zero [Karlik19]: rays that run into the sky find the rest.
    """
    rows = len(luminance)
    edges = np.sin((np.arange(rows + 1) / rows - 0.5) * np.pi)
    area = np.diff(edges) / 2.0  # share of all directions of each row
    mean = (luminance.mean(axis=1) * area).sum()
    excess = np.maximum(luminance - mean, 0.0)
    weight = excess.mean(axis=1) * area
    total = weight.sum()
    # What differs by roundings only is one colour.
    if not total > 1e-4 * mean:
        return np.zeros(0, np.float32), np.zeros((0, 1), np.float32), 0.0, np.zeros(3)
    columns = np.zeros((rows, luminance.shape[1] + 1))
    np.cumsum(excess, axis=1, out=columns[:, 1:])
    last = columns[:, -1:]
    columns = np.where(last > 0.0, columns / np.where(last > 0.0, last, 1.0), np.linspace(0, 1, columns.shape[1]))
    columns[:, -1] = 1.0
    row_cdf = np.concatenate([[0.0], np.cumsum(weight / total)])
    row_cdf[-1] = 1.0
    return row_cdf.astype(np.float32), columns.astype(np.float32), float(total), _mean_direction(excess * area[:, None])


def _mean_direction(weight: np.ndarray) -> np.ndarray:
    """[3], of the cells [rows, columns] of a map."""
    elevation = ((np.arange(weight.shape[0]) + 0.5) / weight.shape[0] - 0.5) * np.pi
    azimuth = (0.5 - (np.arange(weight.shape[1]) + 0.5) / weight.shape[1]) * 2.0 * np.pi
    around = np.stack([weight @ np.cos(azimuth), weight @ np.sin(azimuth)]) * np.cos(elevation)
    upward = weight.sum(axis=1) * np.sin(elevation)
    return np.append(around.sum(axis=1), upward.sum()) / weight.sum()
