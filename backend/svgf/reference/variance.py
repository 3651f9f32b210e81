# SPDX-License-Identifier: Apache-2.0
"""Stage "variance": of luminance; from time where history is long enough, else from 7x7 pixels [Schied17, Sec. 4.2]."""

from __future__ import annotations

from typing import Any

from .guides import Guides, edge_weight, namespace, tap

RADIUS = 3


def variance(moments: list[Any], length: Any, guides: Guides, settings: Any) -> list[Any]:
    """moments: per signal [H, W, 2], mean and variance of luminance over time. length: [H, W] frames in them.

    Returns per signal [H, W]. The 7x7 estimate weighs its taps by depth and normal [Schied17, Eq. 3, 4]; it is the
    variance of all samples in them, so what time tells already counts.
    """
    xp = namespace(length)
    short = guides.surface & (length < settings.spatial_variance_frames)
    weight = xp.zeros(length.shape)
    mean = [xp.zeros(length.shape) for _ in moments]
    squares = [xp.zeros(length.shape) for _ in moments]
    for dy in range(-RADIUS, RADIUS + 1):
        for dx in range(-RADIUS, RADIUS + 1):
            w = edge_weight(guides, dx, dy, settings.sigma_depth, settings.sigma_normal)
            before, weight = weight, weight + w
            share = w / xp.where(weight > 0.0, weight, 1.0)
            for signal, image in enumerate(moments):
                m, v = xp.moveaxis(tap(dx, dy, image)[1], -1, 0)
                difference = m - mean[signal]
                mean[signal] = mean[signal] + difference * share
                squares[signal] = squares[signal] + w * v + before * share * difference**2
    weight = xp.where(weight > 0.0, weight, 1.0)
    return [
        xp.where(short, s / weight, xp.where(guides.surface, m[..., 1], 0.0))
        for s, m in zip(squares, moments, strict=True)
    ]
