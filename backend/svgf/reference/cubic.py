# SPDX-License-Identifier: Apache-2.0
"""Catmull-Rom splines over 4x4 pixels without the four corners; native/denoise/cubic.h."""

from __future__ import annotations

from typing import Any

from .guides import namespace


def catmull_rom(t: Any) -> list[Any]:
    """The weights of four pixels in a row for a place between the middle two, t from the second to the third."""
    return [
        0.5 * t * ((2.0 - t) * t - 1.0),
        1.0 + t * t * (1.5 * t - 2.5),
        0.5 * t * ((4.0 - 3.0 * t) * t + 1.0),
        0.5 * t * t * (t - 1.0),
    ]


def linear(t: Any) -> list[Any]:
    """The same, of the middle two alone."""
    zero = namespace(t).zeros(t.shape)
    return [zero, 1.0 - t, t, zero]


def cubic_taps(x: Any, y: Any, weights: Any) -> list[tuple[tuple[Any, Any], Any, bool]]:
    """Of places [H, W] in an image of that size, per tap: its (row, column), which is inside; its weight [H, W]; and
    whether it is one of the inner four. weights: ``catmull_rom`` or ``linear``."""
    xp = namespace(x)
    height, width = x.shape
    left, top = xp.floor(x).astype(int), xp.floor(y).astype(int)
    columns, rows = weights(x - left), weights(y - top)
    return [
        (
            (xp.clip(top + j - 1, 0, height - 1), xp.clip(left + i - 1, 0, width - 1)),
            columns[i] * rows[j],
            i in (1, 2) and j in (1, 2),
        )
        for j in range(4)
        for i in range(4)
        if i in (1, 2) or j in (1, 2)
    ]
