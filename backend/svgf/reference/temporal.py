# SPDX-License-Identifier: Apache-2.0
"""Stage "temporal": reprojection, and the running means of colour and luminance moments [Schied17, Sec. 4.1, 4.2].

Departures from the paper, as in native/denoise/temporal.h, where their reasons stand: the depth test compares the plane
of the old pixel with the expected previous depth; alpha = max(alpha, 1 / N); moments are kept as mean and variance.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from .guides import LARGEST_RADIANCE, Guides, in_range, luminance, namespace
from .reprojection import LEAST_TAP_WEIGHT, reproject


@dataclass(frozen=True, eq=False)
class History:
    """What a frame leaves to the next: per signal color [H, W, 3] and moments [H, W, 2] (mean, variance of luminance);
    length [H, W] frames in them; the guides they belong to."""

    color: list[Any]
    moments: list[Any]
    length: Any
    guides: Guides


def temporal(
    illumination: list[Any], guides: Guides, motion: Any, history: History | None, settings: Any
) -> tuple[History, int]:
    """illumination: [H, W, 3] per signal. motion: [H, W, 2 or 3], None: nothing moved.

    Returns the new means, moments and lengths (0 where there is no surface), and how many motions and reads of history
    were bad. Bad history is not read; a bad motion means no history.
    """
    xp = namespace(guides.depth)
    height, width = guides.depth.shape
    surface = guides.surface
    old_color = [xp.zeros((height, width, 3)) for _ in illumination]
    old_moments = [xp.zeros((height, width, 2)) for _ in illumination]
    length = xp.zeros((height, width))
    repaired = 0

    if history is not None:
        point = reproject(guides, history.guides, motion, settings)
        repaired += point.repaired
        good = usable(history)

        def add(taps: Iterable[tuple[Any, Any, Any]], where: Any) -> int:
            refused = 0
            for column, row, share in taps:
                share = xp.where(where, share, 0.0)
                bad = ~good[xp.clip(row, 0, height - 1), xp.clip(column, 0, width - 1)]
                refused += int(((share > 0.0) & bad).sum())
                mean.add(xp.where(bad, 0.0, share), column, row, history)
            return refused

        mean = _Mean(len(illumination), (height, width), xp)
        repaired += add(point.bilinear(), surface)
        # Too little found: any of the 3x3 pixels around the nearest one will do.
        searched = point.reachable & (mean.weight < LEAST_TAP_WEIGHT)
        mean.forget(searched)
        repaired += add(point.neighbours(), searched)
        old_color, old_moments, length = mean.color, mean.moments(), mean.length

    length = xp.where(surface, length + 1.0, 0.0)
    frames = xp.maximum(length, 1.0)
    alpha = xp.where(surface, xp.maximum(settings.alpha, 1.0 / frames), 1.0)[..., None]
    alpha_moments = xp.maximum(settings.alpha_moments, 1.0 / frames)
    color, moments = [], []
    for new, old, (old_mean, old_variance) in zip(
        illumination, old_color, ((m[..., 0], m[..., 1]) for m in old_moments), strict=True
    ):
        color.append((1.0 - alpha) * old + alpha * new)  # [Schied17, Sec. 4.1]
        light = luminance(new)
        # The same as second moment minus squared mean, but never negative and without cancellation.
        m = (1.0 - alpha_moments) * old_mean + alpha_moments * light
        v = (1.0 - alpha_moments) * (old_variance + alpha_moments * (light - old_mean) ** 2)
        moments.append(xp.where(surface[..., None], xp.stack([m, v], axis=-1), 0.0))
    return History(color, moments, length, guides), repaired


class _Mean:
    """Weighted mean of history taps; luminance moments are merged about their common mean [Chan83]."""

    def __init__(self, signals: int, shape: tuple[int, int], xp: Any) -> None:
        self._xp = xp
        self.weight = xp.zeros(shape)
        self.length = xp.zeros(shape)
        self.color = [xp.zeros((*shape, 3)) for _ in range(signals)]
        self._mean = [xp.zeros(shape) for _ in range(signals)]
        self._squares = [xp.zeros(shape) for _ in range(signals)]

    def add(self, weight: Any, column: Any, row: Any, history: History) -> None:
        """weight [H, W], 0 where the tap (column, row) is not to be read; those may lie outside the frame."""
        xp = self._xp
        row, column = (xp.where(weight > 0.0, index, 0) for index in (row, column))
        read = weight > 0.0
        before, self.weight = self.weight, self.weight + weight
        share = weight / xp.where(read, self.weight, 1.0)
        self.length = self.length + (xp.where(read, history.length[row, column], 0.0) - self.length) * share
        for signal in range(len(self.color)):
            color = xp.where(read[..., None], history.color[signal][row, column], 0.0)
            self.color[signal] = self.color[signal] + (color - self.color[signal]) * share[..., None]
            mean, variance = xp.moveaxis(
                xp.where(read[..., None], history.moments[signal][row, column], 0.0), -1, 0
            )
            difference = mean - self._mean[signal]
            self._mean[signal] = self._mean[signal] + difference * share
            self._squares[signal] = self._squares[signal] + weight * variance + before * share * difference**2

    def forget(self, where: Any) -> None:
        xp = self._xp
        self.weight = xp.where(where, 0.0, self.weight)
        self.length = xp.where(where, 0.0, self.length)
        self.color = [xp.where(where[..., None], 0.0, color) for color in self.color]
        self._mean = [xp.where(where, 0.0, mean) for mean in self._mean]
        self._squares = [xp.where(where, 0.0, squares) for squares in self._squares]

    def moments(self) -> list[Any]:
        xp = self._xp
        weight = xp.where(self.weight > 0.0, self.weight, 1.0)
        return [xp.stack([m, s / weight], axis=-1) for m, s in zip(self._mean, self._squares, strict=True)]


def usable(history: History) -> Any:
    """bool [H, W]: what is stored is numbers that an accumulation can have left there."""
    good = in_range(history.length, 0.0, 2.0**24)
    for color, moments in zip(history.color, history.moments, strict=True):
        good &= in_range(color, 0.0, 2.0 * LARGEST_RADIANCE).all(axis=-1)
        good &= in_range(moments[..., 0], 0.0, 2.0 * LARGEST_RADIANCE)
        good &= in_range(moments[..., 1], 0.0, 4.0 * LARGEST_RADIANCE**2)
    return good
