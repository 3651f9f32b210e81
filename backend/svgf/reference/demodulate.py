# SPDX-License-Identifier: Apache-2.0
"""Stage "demodulate": radiance over albedo, so that the filter never blurs what textures draw [Schied17, Sec. 4]."""

from __future__ import annotations

from typing import Any

from .guides import LARGEST_RADIANCE, in_range, namespace

# Below this albedo the division would turn noise into fireflies; modulate multiplies by the same floor.
ALBEDO_FLOOR = 1e-3


def repair(values: Any) -> tuple[Any, int]:
    """Values outside [0, LARGEST_RADIANCE], NaN and infinities become 0; and how many they were."""
    xp = namespace(values)
    good = in_range(values, 0.0, LARGEST_RADIANCE)
    return xp.where(good, values, 0.0).astype(xp.float64), int((~good).sum())


def signal_albedo(albedos: list[Any], shape: tuple[int, ...], xp: Any) -> tuple[Any, int]:
    """[H, W, 3] the divisor of a signal, at least ALBEDO_FLOOR: the sum of its albedos, 1 without any."""
    if not albedos:
        return xp.ones(shape), 0
    repairs = [repair(albedo) for albedo in albedos]
    return xp.maximum(sum(albedo for albedo, _ in repairs), ALBEDO_FLOOR), sum(count for _, count in repairs)


def demodulate(radiance: Any, albedo: Any) -> tuple[Any, int]:
    """radiance [H, W, 3], albedo [H, W, 3] of ``signal_albedo`` -> illumination [H, W, 3] and the number of repairs."""
    xp = namespace(radiance)
    return repair(radiance.astype(xp.float64) / albedo)
