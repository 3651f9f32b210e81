# SPDX-License-Identifier: Apache-2.0
"""Whether consecutive frames carry the same noise, as a fixed seed makes them."""

from __future__ import annotations

import numpy as np

from .reprojection import View

_FEWEST_PIXELS = 200
# Signs of independent noise agree as often as not: correlation 0, +- 0.07 for the fewest pixels.
_CORRELATED = 0.3


def noise_is_repeated(first: np.ndarray, second: np.ndarray, first_view: View, second_view: View) -> bool:
    """first, second: Combined [H, W, 3] of consecutive frames. False where they hold too little noise to tell.

    Asked only where depth, normal and albedo are smooth in both frames, so that what differs from the local mean is
    noise, not the picture. Its sign counts, not its size: a few fireflies must not decide.
    """
    smooth = _is_smooth(first_view) & _is_smooth(second_view)
    noises = [_above_mean(image.mean(axis=-1))[smooth] for image in (first, second)]
    told = (noises[0] != 0.0) & (noises[1] != 0.0)
    if told.sum() < _FEWEST_PIXELS:
        return False
    return float(np.mean(np.sign(noises[0][told]) * np.sign(noises[1][told]))) > _CORRELATED


def _above_mean(image: np.ndarray) -> np.ndarray:
    """A pixel against the mean of its neighbours: blind to gradients of light. Rounding is no noise."""
    padded = np.pad(np.log1p(np.maximum(image, 0.0)), 1, mode="edge")
    neighbours = 0.25 * (padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:])
    difference = padded[1:-1, 1:-1] - neighbours
    return np.where(np.abs(difference) > 1e-2, difference, 0.0)


def _is_smooth(view: View) -> np.ndarray:
    smooth = view.object_id != 0
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        depth, normal, albedo = (
            np.roll(image, (dy, dx), axis=(0, 1)) for image in (view.depth, view.normal, view.albedo)
        )
        smooth &= np.abs(depth - view.depth) < 0.05 * np.abs(view.depth)
        smooth &= (normal * view.normal).sum(axis=-1) > 0.99
        smooth &= np.abs(albedo - view.albedo).max(axis=-1) < 0.02
    return smooth
