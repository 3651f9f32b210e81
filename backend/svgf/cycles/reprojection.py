# SPDX-License-Identifier: Apache-2.0
"""Where motion leads in the frame before: to the same surface, if the vectors are right and the camera was not cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Enough to tell shares apart by a percent, and as quick for an image of any size.
_MOST_PIXELS = 40_000
_DEPTH_TOLERANCE = 0.1
_LEAST_COSINE = 0.8
_ALBEDO_TOLERANCE = 0.1
# In tolerances.
_CLEARLY = 0.5
_NEIGHBOURS = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]


@dataclass(frozen=True)
class View:
    """What a frame shows: depth [H, W], 1e10 on the background; normal [H, W, 3]; object_id int [H, W], 0 on the
    background; albedo [H, W, 3]; motion [H, W, 2] in pixels, y down."""

    depth: np.ndarray
    normal: np.ndarray
    object_id: np.ndarray
    albedo: np.ndarray
    motion: np.ndarray


def agreement(view: View, before: View) -> float:
    """The share of the pixels with a surface that motion leads to the same surface, give or take a pixel: rays are
    jittered. 1 where there are none to ask."""
    rows, columns = _sample(view.object_id != 0)
    if rows.size == 0:
        return 1.0
    motion = view.motion[rows, columns]
    agrees = np.zeros(rows.shape, bool)
    for dx, dy in _NEIGHBOURS:
        agrees |= _differences(view, before, rows, columns, motion + np.float32((dx, dy))).max(axis=-1) <= 1.0
    return float(agrees.mean())


def votes(view: View, before: View, signs: tuple[float, float], pixels: np.ndarray) -> tuple[int, int]:
    """Of the pixels [H, W] that have a surface, how many motion leads clearly nearer to the same surface as it is, and
    how many with its components multiplied by signs. Most have no opinion: what moves is mostly smooth."""
    rows, columns = _sample((view.object_id != 0) & pixels)
    motion = view.motion[rows, columns]
    as_it_is, otherwise = (
        np.clip(_differences(view, before, rows, columns, motion * np.float32(factors)).max(axis=-1), 0.0, 1.0)
        for factors in ((1.0, 1.0), signs)
    )
    return int((as_it_is < otherwise - _CLEARLY).sum()), int((otherwise < as_it_is - _CLEARLY).sum())


def _sample(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.nonzero(mask)
    step = max(1, rows.size // _MOST_PIXELS)
    return rows[::step], columns[::step]


def _differences(view: View, before: View, rows: np.ndarray, columns: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """[N, 3] in tolerances, of depth, normal and albedo; 2 where there is no such object in the frame before."""
    height, width = view.depth.shape
    with np.errstate(invalid="ignore"):
        x, y = np.rint(columns + motion[..., 0]), np.rint(rows + motion[..., 1])
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = (np.where(inside, position, 0).astype(int) for position in (x, y))
    same = inside & (before.object_id[y, x] == view.object_id[rows, columns])
    depth, old_depth = view.depth[rows, columns], before.depth[y, x]
    cosine = (view.normal[rows, columns] * before.normal[y, x]).sum(axis=-1)
    albedo = np.abs(view.albedo[rows, columns] - before.albedo[y, x]).max(axis=-1)
    differences = np.stack(
        [
            np.abs(old_depth - depth) / (_DEPTH_TOLERANCE * np.maximum(np.abs(depth), 1e-6)),
            (1.0 - cosine) / (1.0 - _LEAST_COSINE),
            albedo / _ALBEDO_TOLERANCE,
        ],
        axis=-1,
    )
    return np.where(same[..., None], np.nan_to_num(differences, nan=2.0), 2.0)
