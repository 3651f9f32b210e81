# SPDX-License-Identifier: GPL-3.0-or-later
"""How fine a view is rendered while it changes: as coarse as the frame budget asks for. Nothing here knows Blender."""

from __future__ import annotations

# A view that has not changed for this long is still.
STILL_SECONDS = 0.3

_DIVISORS = (1, 2, 3, 4, 6, 8)
_FIRST_PIXELS = 10_000  # as many as any processor makes at once, before a frame has told what a pixel costs


class Resolution:
    """By how much both sides of a view's picture are divided.

    divisor: the last choice. It never falls while the view changes, because each step blurs or thins the history.
    """

    def __init__(self) -> None:
        self.divisor = 1
        self._milliseconds_per_pixel: float | None = None
        self._changed = 0.0

    def measure(self, milliseconds: float, pixels: int) -> None:
        """What a frame cost, without what does not depend on its size."""
        self._milliseconds_per_pixel = milliseconds / pixels

    def choose(self, pixels: int, budget: float, now: float, changed: bool) -> int:
        """pixels: of the whole picture. budget: milliseconds for a frame; 0: all that it takes. now: seconds.
        changed: since the last call."""
        if changed:
            was_still = self.is_still(now)
            self._changed = now
            needed = self._needed(pixels, budget)
            self.divisor = needed if was_still else max(self.divisor, needed)
        if budget <= 0 or self.is_still(now):
            self.divisor = 1
        return self.divisor

    def is_still(self, now: float) -> bool:
        return now >= self._changed + STILL_SECONDS

    def _needed(self, pixels: int, budget: float) -> int:
        known = self._milliseconds_per_pixel is not None
        cost, limit = (self._milliseconds_per_pixel * pixels, budget) if known else (pixels, _FIRST_PIXELS)
        return next((each for each in _DIVISORS if cost <= limit * each**2), _DIVISORS[-1])
