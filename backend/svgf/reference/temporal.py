# SPDX-License-Identifier: Apache-2.0
"""Stage "temporal": reprojection, and the running means of colour and luminance moments [Schied17, Sec. 4.1, 4.2].

Departures from the paper, as in native/denoise/temporal.h, where their reasons stand: the depth test compares the plane
of the old pixel with the expected previous depth; alpha = max(alpha, 1 / N); moments are kept as mean and variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .guides import LARGEST_RADIANCE, Guides, in_range, luminance, namespace

# Valid bilinear taps that weigh less than this altogether say less than the 3x3 search does.
LEAST_TAP_WEIGHT = 0.01
# Share of depth that the test forgives if motion does not say the expected previous depth.
UNKNOWN_DEPTH_TOLERANCE = 0.1


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
        if motion is None:
            motion = xp.zeros((height, width, 3))
        tolerance = settings.depth_tolerance
        if motion.shape[-1] == 2:
            tolerance = max(tolerance, UNKNOWN_DEPTH_TOLERANCE)
        known = xp.isfinite(motion).all(axis=-1)
        repaired += int((surface & ~known).sum())
        motion = xp.where(known[..., None], motion, 0.0).astype(xp.float64)
        rows, columns = xp.meshgrid(xp.arange(height), xp.arange(width), indexing="ij")
        x, y = columns + motion[..., 0], rows + motion[..., 1]
        reachable = surface & known & (x > -1.0) & (x < width) & (y > -1.0) & (y < height)
        x, y = xp.where(reachable, x, 0.0), xp.where(reachable, y, 0.0)
        expected = guides.depth + (motion[..., 2] if motion.shape[-1] == 3 else 0.0)

        mean = _Mean(len(illumination), (height, width), xp)
        left, top = xp.floor(x).astype(int), xp.floor(y).astype(int)
        for j in (0, 1):
            for i in (0, 1):
                share = (x - left if i else 1.0 - (x - left)) * (y - top if j else 1.0 - (y - top))
                accepted, refused = _test(left + i, top + j, x, y, expected, tolerance, guides, history, settings)
                repaired += int((refused & reachable & (share > 0.0)).sum())
                mean.add(xp.where(accepted & reachable, share, 0.0), left + i, top + j, history)
        # Too little found: any of the 3x3 pixels around the nearest one will do.
        searched = reachable & (mean.weight < LEAST_TAP_WEIGHT)
        mean.forget(searched)
        nearest_x, nearest_y = xp.floor(x + 0.5).astype(int), xp.floor(y + 0.5).astype(int)
        for j in (-1, 0, 1):
            for i in (-1, 0, 1):
                accepted, refused = _test(
                    nearest_x + i, nearest_y + j, x, y, expected, tolerance, guides, history, settings
                )
                repaired += int((refused & searched).sum())
                mean.add(xp.where(accepted & searched, 1.0, 0.0), nearest_x + i, nearest_y + j, history)
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


def _test(
    column: Any,
    row: Any,
    x: Any,
    y: Any,
    expected: Any,
    tolerance: float,
    guides: Guides,
    history: History,
    settings: Any,
) -> tuple[Any, Any]:
    """Two bool [H, W]: history's pixel (column, row) saw the surface that was at (x, y); it did, but is no numbers."""
    xp = namespace(guides.depth)
    height, width = guides.depth.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    row, column = xp.clip(row, 0, height - 1), xp.clip(column, 0, width - 1)
    old = history.guides
    slope = old.gradient[row, column]
    plane = old.depth[row, column] + slope[..., 0] * (x - column) + slope[..., 1] * (y - row)
    allowed = tolerance * xp.abs(expected) + 0.5 * xp.abs(slope).sum(axis=-1)
    same = inside & guides.surface & (old.object_id[row, column] == guides.object_id)
    same &= xp.abs(plane - expected) <= allowed
    same &= (old.normal[row, column] * guides.normal).sum(axis=-1) >= settings.normal_tolerance
    good = usable(history)[row, column]
    return same & good, same & ~good


def usable(history: History) -> Any:
    """bool [H, W]: what is stored is numbers that an accumulation can have left there."""
    good = in_range(history.length, 0.0, 2.0**24)
    for color, moments in zip(history.color, history.moments, strict=True):
        good &= in_range(color, 0.0, 2.0 * LARGEST_RADIANCE).all(axis=-1)
        good &= in_range(moments[..., 0], 0.0, 2.0 * LARGEST_RADIANCE)
        good &= in_range(moments[..., 1], 0.0, 4.0 * LARGEST_RADIANCE**2)
    return good
