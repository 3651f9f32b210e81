# SPDX-License-Identifier: Apache-2.0
"""Stage "modulate": the filtered signals times their albedos, summed, plus what shines by itself."""

from __future__ import annotations

from typing import Any

from .demodulate import repair
from .guides import luminance, namespace

LARGEST_VARIANCE = 3.4028234663852886e38  # of float32


def modulate(
    color: list[Any], variance: list[Any] | None, albedo: list[Any], emission: Any = None
) -> tuple[Any, Any, int]:
    """color, variance, albedo (of ``signal_albedo``): per signal. emission: [H, W, 3] or None.

    Returns radiance [H, W, 3], the variance of its luminance [H, W] (signals taken as independent; 0 without variance)
    and how many values of emission were bad.
    """
    xp = namespace(color[0])
    total, repaired = repair(emission) if emission is not None else (xp.zeros(color[0].shape), 0)
    total_variance = xp.zeros(color[0].shape[:2])
    for s, (c, a) in enumerate(zip(color, albedo, strict=True)):
        total = total + c * a
        if variance is not None:
            total_variance = total_variance + variance[s] * luminance(a) ** 2
    return total, xp.minimum(total_variance, LARGEST_VARIANCE), repaired
