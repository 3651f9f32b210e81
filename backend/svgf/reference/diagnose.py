# SPDX-License-Identifier: Apache-2.0
"""Stage "diagnose": what a frame can tell beside its result, ``svgf.diagnostics``. As native/denoise/diagnose.h."""

from __future__ import annotations

from typing import Any

from ..diagnostics import ResetReason
from .demodulate import ALBEDO_FLOOR
from .guides import BACKGROUND_DEPTH, LARGEST_RADIANCE, Guides, in_range, namespace
from .reprojection import Comparison, Reprojection


def reset_reason(guides: Guides, point: Reprojection | None, changed: Any) -> Any:
    """[H, W] of ResetReason. point: None without history. changed: bool [H, W], the light on it has."""
    xp = namespace(guides.depth)
    reason = xp.where(guides.surface, ResetReason.RESTARTED, ResetReason.BACKGROUND)
    if point is None:
        return reason
    there = _nearest(point)
    refused = xp.full(guides.depth.shape, int(ResetReason.OTHER_NORMAL))
    refused = xp.where(xp.abs(there.depth_error) > there.allowed, ResetReason.OTHER_DEPTH, refused)
    refused = xp.where(there.same_object, refused, ResetReason.OTHER_OBJECT)
    refused = xp.where(there.inside, refused, ResetReason.OUTSIDE)
    refused = xp.where(point.known, refused, ResetReason.BAD_MOTION)
    kept = xp.where(changed, ResetReason.LIGHT_CHANGED, ResetReason.KEPT)
    return xp.where(guides.surface, xp.where(point.found(), kept, refused), reason)


def motion_error(guides: Guides, point: Reprojection | None, window: Any) -> Any:
    """[H, W] px. window: left, right, bottom, top of the image one unit ahead."""
    xp = namespace(guides.depth)
    if point is None:
        return xp.zeros(guides.depth.shape)
    there = _nearest(point)
    footprint = guides.depth * (float(window[1]) - float(window[0])) / guides.depth.shape[1]
    per_pixel = xp.abs(guides.gradient).sum(axis=-1) + footprint + 1e-30
    return xp.where(there.inside & there.same_object & guides.surface, xp.abs(there.depth_error) / per_pixel, 0.0)


def repaired_values(
    inputs: dict[str, Any], signals: dict[str, tuple[str, ...]], reads_motion: bool, reads_roughness: bool
) -> Any:
    """[H, W]: how many of a pixel's inputs were repaired. signals: the albedos of each. reads_motion: there is
    history. reads_roughness: of a specular signal."""
    depth = inputs["depth"]
    xp = namespace(depth)
    bad = xp.zeros(depth.shape)

    def outside(image: Any) -> Any:
        return ~in_range(image, 0.0, LARGEST_RADIANCE)

    for signal, albedos in signals.items():
        given = [inputs[name] for name in albedos if name in inputs]
        total = sum(xp.where(outside(a), 0.0, a) for a in given) if given else xp.ones((*depth.shape, 3))
        for image in given:
            bad = bad + outside(image).sum(axis=-1)
        bad = bad + outside(inputs[signal].astype(xp.float64) / xp.maximum(total, ALBEDO_FLOOR)).sum(axis=-1)
    if "emission" in inputs:
        bad = bad + outside(inputs["emission"]).sum(axis=-1)
    named = inputs["object_id"] != 0 if "object_id" in inputs else ~(depth >= BACKGROUND_DEPTH)
    good = in_range(depth, 0.0, LARGEST_RADIANCE)
    good &= in_range(inputs["normal"], -LARGEST_RADIANCE, LARGEST_RADIANCE).all(axis=-1)
    bad = bad + (named & ~good)
    surface = named & good & (xp.where(good, depth, BACKGROUND_DEPTH) < BACKGROUND_DEPTH)
    if "depth_gradient" in inputs:
        bad = bad + xp.where(surface[..., None], ~xp.isfinite(inputs["depth_gradient"]), 0).sum(axis=-1)
    if reads_roughness and "specular" in signals and "roughness" in inputs:
        bad = bad + (surface & ~in_range(inputs["roughness"], 0.0, 1.0))
    if reads_motion and inputs.get("motion") is not None:
        bad = bad + (surface & ~xp.isfinite(inputs["motion"]).all(axis=-1))
    return bad


def _nearest(point: Reprojection) -> Comparison:
    xp = namespace(point.x)
    return point.compare(xp.floor(point.x + 0.5).astype(int), xp.floor(point.y + 0.5).astype(int))
