# SPDX-License-Identifier: Apache-2.0
"""Where a surface was in the frame before, and which of history's pixels saw it [Schied17, Sec. 4.1]. Departures from
the paper as in native/denoise/reprojection.h."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from .guides import Guides, namespace

# Bilinear taps that weigh less than this together say less than the 3x3 pixels around the nearest one.
LEAST_TAP_WEIGHT = 0.01
# Share of depth that the test forgives if motion does not say the expected previous depth.
UNKNOWN_DEPTH_TOLERANCE = 0.1


@dataclass(frozen=True, eq=False)
class Reprojection:
    """x, y [H, W]: pixels of the frame before, 0 = centre of the first one. expected_depth [H, W]. known bool [H, W]:
    motion is a number. reachable bool [H, W]: a bilinear tap can lie inside the frame; x and y are 0 elsewhere.
    repaired: motions of surfaces that were no numbers. tests_taps, interpolates: see PlusStep."""

    guides: Guides
    previous: Guides
    x: Any
    y: Any
    expected_depth: Any
    known: Any
    reachable: Any
    tolerance: float
    normal_tolerance: float
    repaired: int
    tests_taps: bool = True
    interpolates: bool = True

    def bilinear(self) -> Iterator[tuple[Any, Any, Any]]:
        """(column, row, weight), each [H, W], of the four taps; weight 0 where the tap saw another surface."""
        xp = namespace(self.x)
        left, top = xp.floor(self.x).astype(int), xp.floor(self.y).astype(int)
        right, below = self.x - left, self.y - top
        if not self.interpolates:
            right, below = xp.floor(right + 0.5), xp.floor(below + 0.5)
        for j in (0, 1):
            for i in (0, 1):
                share = (right if i else 1.0 - right) * (below if j else 1.0 - below)
                yield left + i, top + j, xp.where(self._accepts(left + i, top + j), share, 0.0)

    def saw_all(self) -> Any:
        """bool [H, W]: all four bilinear taps saw the surface."""
        xp = namespace(self.x)
        left, top = xp.floor(self.x).astype(int), xp.floor(self.y).astype(int)
        accepted = [self._accepts(left + i, top + j) for j in (0, 1) for i in (0, 1)]
        return accepted[0] & accepted[1] & accepted[2] & accepted[3] & self.interpolates

    def neighbours(self, spacing: int = 1) -> Iterator[tuple[Any, Any, Any]]:
        """(column, row, 1 or 0) of the 3x3 pixels around the nearest one, `spacing` pixels apart."""
        xp = namespace(self.x)
        x, y = xp.floor(self.x + 0.5).astype(int), xp.floor(self.y + 0.5).astype(int)
        for j in (-1, 0, 1):
            for i in (-1, 0, 1):
                column, row = x + i * spacing, y + j * spacing
                yield column, row, xp.where(self._accepts(column, row), 1.0, 0.0)

    def found(self) -> Any:
        """bool [H, W]: there is history."""
        xp = namespace(self.x)
        near, around = (sum(weight for _, _, weight in taps) for taps in (self.bilinear(), self.neighbours()))
        return xp.where(near >= LEAST_TAP_WEIGHT, True, around > 0.0)

    def compare(self, column: Any, row: Any) -> Comparison:
        """This frame's surfaces with those that the pixels (column, row) [H, W] saw, which may lie outside."""
        xp = namespace(self.x)
        height, width = self.x.shape
        slope = self.guides.gradient
        plane = self.expected_depth + slope[..., 0] * (column - self.x) + slope[..., 1] * (row - self.y)
        allowed = self.tolerance * xp.abs(self.expected_depth) + 0.5 * xp.abs(slope).sum(axis=-1)
        inside = self.reachable & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        row, column = xp.clip(row, 0, height - 1), xp.clip(column, 0, width - 1)
        old = self.previous
        return Comparison(
            inside,
            old.object_id[row, column] == self.guides.object_id,
            old.depth[row, column] - plane,
            allowed,
            (old.normal[row, column] * self.guides.normal).sum(axis=-1),
        )

    def _accepts(self, column: Any, row: Any) -> Any:
        xp = namespace(self.x)
        pixel = self.compare(column, row)
        if not self.tests_taps:
            return pixel.inside
        same = pixel.inside & pixel.same_object & (xp.abs(pixel.depth_error) <= pixel.allowed)
        return same & (pixel.cosine >= self.normal_tolerance)


@dataclass(frozen=True, eq=False)
class Comparison:
    """[H, W] each. inside bool: of the frame. same_object bool. depth_error: of the surface's plane, continued to the
    pixel; allowed: how large it may be. cosine: between the normals."""

    inside: Any
    same_object: Any
    depth_error: Any
    allowed: Any
    cosine: Any


def reproject(guides: Guides, previous: Guides, motion: Any, settings: Any) -> Reprojection:
    """motion: [H, W, 2 or 3], None: nothing moved. A motion that is no number leads nowhere."""
    xp = namespace(guides.depth)
    height, width = guides.depth.shape
    if motion is None:
        motion = xp.zeros((height, width, 3))
    tolerance = settings.depth_tolerance
    if motion.shape[-1] == 2:
        tolerance = max(tolerance, UNKNOWN_DEPTH_TOLERANCE)
    known = xp.isfinite(motion).all(axis=-1)
    repaired = int((guides.surface & ~known).sum())
    motion = xp.where(known[..., None], motion, 0.0).astype(xp.float64)
    rows, columns = xp.meshgrid(xp.arange(height), xp.arange(width), indexing="ij")
    x, y = columns + motion[..., 0], rows + motion[..., 1]
    reachable = guides.surface & known & (x > -1.0) & (x < width) & (y > -1.0) & (y < height)
    x, y = xp.where(reachable, x, 0.0), xp.where(reachable, y, 0.0)
    expected = guides.depth + (motion[..., 2] if motion.shape[-1] == 3 else 0.0)
    return Reprojection(
        guides, previous, x, y, expected, known, reachable, tolerance, settings.normal_tolerance, repaired
    )
